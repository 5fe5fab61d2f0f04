"""What is found of a log's columns, and in words: what is wrong, and what corrects it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

_SAID = {
    "swapped_efforts": "the efforts of {} are swapped",
    "swapped_positions": "the positions and velocities of {} are swapped",
    "swapped_joints": "the columns of {} are swapped",
    "without_gravity": "gravity has been taken out of the efforts already",
    "without_friction": "friction has been taken out of the efforts already",
    "without_rotor_inertia": "the rotors' inertia has been taken out of the efforts already",
    "effort_magnitude": (
        "the efforts of {} never change their sign, though the motion needs both: they "
        "are magnitudes"
    ),
}
_GEARED = 5.0  # all gains beyond it are those of gears and of motor constants


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


def mistake_words(
    kind: str, joints: Sequence[str], values: Sequence[float], *, all_joints: bool
) -> str:
    """Return what is wrong, as a clause that begins with a small letter.

    Args:
        kind: See `ColumnFinding`.
        joints: Names of the joints.
        values: What corrects it.
        all_joints: Whether it is in the columns of all joints.
    """
    where = "all joints" if all_joints else " and ".join(joints)
    if kind in _SAID:
        return _SAID[kind].format(where)
    factor = values[0]
    if kind.startswith("effort"):
        return _effort_words(kind, where, values, all_joints=all_joints)
    if kind == "time":
        return f"time runs {1.0 / factor:.4g} times as fast as the robot's"
    if kind == "velocity_factor":
        return f"the velocities of {where} are {1.0 / factor:.4g} times the positions' derivatives"
    return _position_words(kind, where, factor)


def _effort_words(kind: str, where: str, values: Sequence[float], *, all_joints: bool) -> str:
    factor = values[0]
    if kind == "effort_sign":
        return f"the effort of {where} has the wrong sign"
    if kind == "effort_unit":
        return f"the efforts of {where} are in {'N·mm or mN' if factor < 1.0 else 'kN·m or kN'}"
    if kind == "effort_limit":
        falls = f" at rest, and none at a speed of {values[1]:.3g}" if len(values) > 1 else ""
        return (
            f"the efforts of {where} are what was asked for: its motor gives at most "
            f"{factor:.4g}{falls}"
        )
    if kind == "effort_gains":
        gains = ", ".join(f"{value:.3g}" for value in values)
        side = ": torques of the motors, or currents" if min(map(abs, values)) > _GEARED else ""
        return f"the efforts of each joint must be multiplied by a number of its own, {gains}{side}"
    own = f"one number, {factor:.3g}" if all_joints else f"{factor:.3g}"
    return f"the efforts of {where} must be multiplied by {own} to match what the bodies need"


def _position_words(kind: str, where: str, factor: float) -> str:
    alone = "alone" in kind
    if kind == "position_zero":
        return f"the position of {where} has another zero, {_angle(-factor)} off"
    quantity = "position" if alone else "position and velocity"
    if kind.endswith("_sign"):
        return f"the {quantity} of {where} {'has' if alone else 'have'} the wrong sign"
    unit = "degrees" if factor < 1.0 else "radians in place of degrees"
    return f"the {quantity} of {where} {'is' if alone else 'are'} in {unit}"


def mistake_advice(kind: str, joints: Sequence[str], values: Sequence[float]) -> str:
    """Return what corrects it, in a sentence.

    Args:
        kind: See `ColumnFinding`.
        joints: Names of the joints.
        values: What corrects it.
    """
    if kind == "effort_magnitude":
        return "Log them with their sign: no other column can give it back."
    if kind == "effort_limit":
        return (
            "Log what the motor gives, or let --correct-columns keep the efforts to the limit, "
            "which a saved model then knows."
        )
    if kind.startswith("effort"):
        each = zip(joints, values, strict=True)
        found = " ".join(f"--gain {joint}={value:.4g}" for joint, value in each)
        return f"Correct it by {found}."
    if kind.startswith("swapped"):
        return "Swap them in the mapping (--mapping), or name the columns so."
    if kind.startswith("without"):
        return "Log the efforts before that, or use a model without it."
    return _motion_advice(kind, values[0])


def _motion_advice(kind: str, value: float) -> str:
    if kind == "time":
        return f"Multiply time by {value:.4g}, by its `gain` in the mapping, or give --rate."
    if kind == "velocity_factor":
        return f"They are not used; multiply them by {value:.4g} in the mapping, or leave them out."
    if kind == "position_zero":
        return f"Add {_angle(value)} to it, or turn the joint's origin in the model."
    unit = "deg" if value < 1.0 else "rad"
    entry = "gain: -1" if kind.endswith("_sign") else f"unit: {unit}"
    return f"Correct it in the mapping (--mapping), by `{entry}`."


def _angle(value: float) -> str:
    return f"{value:+.4g} rad ({math.degrees(value):+.1f}°)"
