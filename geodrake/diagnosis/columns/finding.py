"""What is found of a log's columns."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ColumnFinding:
    """A mistake in the columns of logs, with the evidence.

    Attributes:
        kind: "effort_sign", "effort_unit", "effort_gain" (of one joint, or one of all),
            "effort_gains" (each joint has its own), "effort_limit" (of what a motor can give;
            the log has what was asked for), "effort_magnitude" (without signs),
            "swapped_efforts", "swapped_positions", "swapped_joints" (positions, velocities and
            efforts), "position_sign", "position_unit", "position_zero", "position_alone_sign",
            "position_alone_unit" (the velocities are right), "velocity_factor", "time",
            "without_gravity", "without_friction" or "without_rotor_inertia".
        joints: The joints whose columns it is in; all joints of the log for one of the whole log.
        values: What corrects it, of each of the joints (one for time): factors, or for a zero what
            is to be added, rad or m; of a limit the largest effort, and the speed at which there
            is none if it falls with the speed; empty for swaps and for what was taken out.
        gain: Twice the logarithm of its odds against no mistake.
        probability: That of this mistake, among it, none and its rivals.
        rivals: Other mistakes that may be in its place, in words, with their probabilities.
        error_before: nrms of a quick fit without it, on the samples that were fitted.
        error_after: nrms of the same with it corrected.
        words: What is wrong, in a clause.
        advice: What corrects it, in a sentence; empty where no column can.
    """

    kind: str
    joints: tuple[str, ...]
    values: tuple[float, ...]
    gain: float
    probability: float
    rivals: tuple[tuple[str, float], ...]
    error_before: float
    error_after: float
    words: str
    advice: str

    @property
    def is_correctable(self) -> bool:
        """Whether other columns, or other numbers in them, correct it."""
        return not self.kind.startswith(("without_", "effort_magnitude"))

    @property
    def evidence(self) -> str:
        """How sure it is, in a clause."""
        return (
            f"probability {min(self.probability, 0.999):.3g}; nrms of a quick fit "
            f"{self.error_before:.3g} → {self.error_after:.3g}"
        )

    def __str__(self) -> str:
        rivals = "".join(f"; or {words} ({chance:.2g})" for words, chance in self.rivals)
        return " ".join(filter(None, [f"{self.words} ({self.evidence}{rivals}).", self.advice]))
