"""A mistake found in the columns of logs."""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.diagnosis.columns.kinds import KINDS


@dataclass(frozen=True)
class ColumnFinding:
    """Mistake in the columns of logs, with the evidence."""

    # "effort_sign", "effort_unit", "effort_gain" (of one joint, or common to all), "effort_gains"
    # (each joint has its own), "effort_limit" (the log contains commands beyond the motor's limit),
    # "effort_magnitude" (without signs), "swapped_efforts", "swapped_positions",
    # "swapped_joints" (positions, velocities and efforts), "position_sign", "position_unit",
    # "position_zero", "position_alone_sign", "position_alone_unit" (the velocities are right),
    # "velocity_factor", "time", "without_gravity", "without_friction" or "without_rotor_inertia"
    kind: str
    joints: tuple[str, ...]  # joints with wrong columns; all joints if the whole log is wrong
    # Corrections: a factor for each joint (one for time); for a zero, the offset to add, rad or m;
    # for a limit, the largest effort and, if it falls with speed, the no-load speed; empty for
    # swaps and subtracted terms.
    values: tuple[float, ...]
    gain: float  # twice the log-odds against no mistake
    probability: float  # of this mistake, among no mistake and all rivals
    rivals: tuple[tuple[str, float], ...]  # other explanations, in words, and their probabilities
    error_before: float  # nrms of a quick fit before the correction, on the fitted samples
    error_after: float  # nrms of the same fit after the correction
    words: str  # the mistake, as a clause
    advice: str  # the correction, as a sentence

    @property
    def is_correctable(self) -> bool:
        """Return whether a change of columns or of their values corrects it."""
        return self.kind in ("time", "effort_limit") or bool(KINDS[self.kind].columns)

    @property
    def evidence(self) -> str:
        """Return the probability and the errors, as a clause."""
        return (
            f"probability {min(self.probability, 0.999):.3g}; nrms of a quick fit "
            f"{self.error_before:.3g} → {self.error_after:.3g}"
        )

    def __str__(self) -> str:
        rivals = "".join(f"; or {words} ({chance:.2g})" for words, chance in self.rivals)
        return f"{self.words} ({self.evidence}{rivals}). {self.advice}"
