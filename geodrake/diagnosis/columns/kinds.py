"""Kinds of mistakes in columns: their changes, usual factors and words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

DEGREE = math.pi / 180.0
THOUSAND = (1e-3, 1e3)  # N·mm in place of N·m, or the reverse; milliseconds
TIMES = (*THOUSAND, 60.0, 1.0 / 60.0, 0.1, 10.0, 0.5, 2.0)

_MOTION = ("position", "velocity", "acceleration", "command")
_ALL = (*_MOTION, "effort", "temperature")
_POSITIONS, _EFFORTS = ("position", "scale", "zero", "rate"), ("effort", "gain")
_UNSURE = 5.0  # factor by which effects that the model lacks may change a gain
_GEARED = 5.0  # larger gains of all joints are gear ratios or motor constants
_BY_MAPPING = "`geodrake log --write-mapping FILE.yaml` writes a mapping that corrects it"
_BY_SWAP = f"{_BY_MAPPING}; or rename the columns."
_BY_MODEL = "Log the efforts before the subtraction, or use a model without that term."


@dataclass(frozen=True)
class Kind:
    """Kind of mistake."""

    words: str  # the mistake, as a clause that begins with a small letter
    advice: str  # the correction, as a sentence
    changes: tuple[str, ...] = ()  # fields of `Assignment` that a factor or swap changes
    columns: tuple[str, ...] = ()  # columns of a log to correct, all by the same change
    factors: tuple[float, ...] = ()  # candidates


def _gain(words: str, factors: tuple[float, ...] = ()) -> Kind:
    return Kind(words, "Correct it with {gains}.", ("gain",), ("effort",), factors)


def _position(words: str, changes: tuple[str, ...], columns: tuple[str, ...]) -> Kind:
    factors = (-1.0,) if words.endswith("sign") else (DEGREE, 1.0 / DEGREE)
    advice = f"{_BY_MAPPING}, with `{{entry}}`."
    return Kind(words, advice, changes, columns, factors)


_BOTH = ("scale", "rate"), _MOTION
_ALONE = ("scale",), ("position", "command")

KINDS: Mapping[str, Kind] = {
    "effort_sign": _gain("the effort of {where} has the wrong sign", (-1.0,)),
    "effort_unit": _gain("the efforts of {where} are in {effort}", THOUSAND),
    "effort_gain": _gain(
        "the efforts of {where} must be multiplied by {number} to match the bodies"
    ),
    "effort_gains": _gain(
        "the efforts of each joint must be multiplied by its own factor, {numbers}"
    ),
    "effort_limit": Kind(
        "the efforts of {where} are commands: its motor saturates at {limit}",
        "Log the motor's effort, or let --correct-columns apply the limit, which is saved "
        "with the model.",
    ),
    "effort_magnitude": Kind(
        "the efforts of {where} never change sign, though the motion requires it: they are "
        "magnitudes",
        "Log them with their sign; or, if servo commands are logged too, use these: --kind "
        "command.",
    ),
    "swapped_efforts": Kind("the efforts of {where} are swapped", _BY_SWAP, _EFFORTS, ("effort",)),
    "swapped_positions": Kind(
        "the positions and velocities of {where} are swapped", _BY_SWAP, _POSITIONS, _MOTION
    ),
    "swapped_joints": Kind(
        "the columns of {where} are swapped", _BY_SWAP, (*_POSITIONS, *_EFFORTS), _ALL
    ),
    "position_sign": _position("the position and velocity of {where} have the wrong sign", *_BOTH),
    "position_unit": _position("the position and velocity of {where} are in {angle}", *_BOTH),
    "position_alone_sign": _position("the position of {where} has the wrong sign", *_ALONE),
    "position_alone_unit": _position("the position of {where} is in {angle}", *_ALONE),
    "position_zero": Kind(
        "the position of {where} has a zero offset of {off}",
        "Add {turn} to it, or turn the joint's origin in the model.",
        ("zero",),
        ("position", "command"),
    ),
    "velocity_factor": Kind(
        "the velocities of {where} are {inverse:.4g} times the derivatives of the positions",
        "They are not used; multiply them by {value:.4g} in the mapping, or remove them.",
        ("rate",),
        ("velocity",),
    ),
    "time": Kind(
        "time runs {inverse:.4g} times too fast",
        "Multiply time by {value:.4g} with `gain` in the mapping, or use --rate.",
        ("time",),
    ),
    "without_gravity": Kind("gravity has been subtracted from the efforts", _BY_MODEL),
    "without_friction": Kind("friction has been subtracted from the efforts", _BY_MODEL),
    "without_rotor_inertia": Kind(
        "the rotors' inertia has been subtracted from the efforts", _BY_MODEL
    ),
}
"""`ColumnFinding.kind` -> its description."""

_BY_UNITS = {
    "effort_unit": "effort=Nmm",
    "position_unit": "position=deg,velocity=deg/s",
    "position_alone_unit": "position=deg",
}
"""Values of `--units` where the numbers of all joints are too large."""


def words_of(
    kind: str, joints: Sequence[str], values: Sequence[float], *, all_joints: bool
) -> tuple[str, str]:
    """Return the mistake, beginning with a small letter, and the advice.

    `values` are the corrections at `joints`; `all_joints` states that the columns of all are wrong.
    """
    value = values[0] if values else 1.0
    small, sign = abs(value) < 1.0, kind.endswith("_sign")
    side = ": motor torques, or currents" if min(map(abs, values), default=0.0) > _GEARED else ""
    no_load = f" at rest, and 0 at a speed of {values[1]:.3g}" if len(values) > 1 else ""
    fields = {
        "where": "all joints" if all_joints else " and ".join(joints),
        "value": value,
        "inverse": 1.0 / value if value else math.inf,
        "number": f"one factor, {value:.3g}" if all_joints else f"{value:.3g}",
        "numbers": ", ".join(f"{gain:.3g}" for gain in values) + side,
        "gains": " ".join(f"--gain {j}={v:.4g}" for j, v in zip(joints, values, strict=False)),
        "effort": "N·mm or mN" if small else "kN·m or kN",
        "angle": "degrees" if small else "radians instead of degrees",
        "entry": "gain: -1" if sign else f"unit: {'deg' if small else 'rad'}",
        "limit": f"{value:.4g}{no_load}",
        "turn": _angle(value),
        "off": _angle(-value),
    }
    advice = KINDS[kind].advice.format(**fields)
    if all_joints and small and kind in _BY_UNITS:
        advice = f"Use --units {_BY_UNITS[kind]}."
    elif all_joints and kind in ("effort_gain", "effort_gains") and _is_thousandth(values):
        by_gains = advice[:1].lower() + advice[1:]
        advice = f"If they are in N·mm, use --units effort=Nmm. Otherwise {by_gains}"
    return KINDS[kind].words.format(**fields), advice


def _is_thousandth(values: Sequence[float]) -> bool:
    """Return whether gains are about 1/1000, within the error of an incomplete model."""
    typical = median(map(abs, values))
    return THOUSAND[0] / _UNSURE < typical < THOUSAND[0] * _UNSURE


def _angle(value: float) -> str:
    return f"{value:+.4g} rad ({math.degrees(value):+.1f}°)"
