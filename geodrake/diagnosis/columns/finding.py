"""Mistakes found in a log's columns: what is wrong, and what corrects it, in words."""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.diagnosis.columns.kinds import KINDS


@dataclass(frozen=True)
class ColumnFinding:
    """A mistake in the columns of logs, with the evidence."""

    # "effort_sign", "effort_unit", "effort_gain" (of one joint, or one of all), "effort_gains"
    # (each joint has its own), "effort_limit" (of what a motor can give; the log has what was asked
    # for), "effort_magnitude" (without signs), "swapped_efforts", "swapped_positions",
    # "swapped_joints" (positions, velocities and efforts), "position_sign", "position_unit",
    # "position_zero", "position_alone_sign", "position_alone_unit" (the velocities are right),
    # "velocity_factor", "time", "without_gravity", "without_friction" or "without_rotor_inertia"
    kind: str
    joints: tuple[str, ...]  # whose columns it is in; all joints of the log for the whole log
    # What corrects it, of each of the joints (one for time): factors, or for a zero what is to be
    # added, rad or m; of a limit the largest effort, and the speed at which there is none if it
    # falls with the speed; empty for swaps and for what was taken out.
    values: tuple[float, ...]
    gain: float  # twice the logarithm of its odds against no mistake
    probability: float  # that of this mistake, among it, none and its rivals
    rivals: tuple[tuple[str, float], ...]  # others in its place, in words, and their probabilities
    error_before: float  # nrms of a quick fit without it, on the samples that were fitted
    error_after: float  # nrms of the same with it corrected
    words: str  # what is wrong, in a clause
    advice: str  # what corrects it, in a sentence

    @property
    def is_correctable(self) -> bool:
        """Return whether other columns, or other numbers in them, correct it."""
        return self.kind in ("time", "effort_limit") or bool(KINDS[self.kind].columns)

    @property
    def evidence(self) -> str:
        """Return how sure it is, in a clause."""
        return (
            f"probability {min(self.probability, 0.999):.3g}; nrms of a quick fit "
            f"{self.error_before:.3g} → {self.error_after:.3g}"
        )

    def __str__(self) -> str:
        rivals = "".join(f"; or {words} ({chance:.2g})" for words, chance in self.rivals)
        return f"{self.words} ({self.evidence}{rivals}). {self.advice}"
