"""Parsing of option values: numbers by joint, limits, effects by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.cli.input_options import pairs
from geodrake.errors import ArgumentError
from geodrake.excitation import MotionLimits, motion_limits
from geodrake.excitation.feet import Foot
from geodrake.excitation.limits import motors_of, signal_limits
from geodrake.inertia import Array
from geodrake.logs.motion import SIGNAL_KINDS
from geodrake.model.robot_model import RobotModel

_QUANTITIES = ("position", "velocity", "acceleration", "effort", "jerk", *SIGNAL_KINDS)
_JOINTS = "joint_1=0.1,joint_2=0.2"
_EXAMPLE = "Write 0.5, velocity=1.5, velocity=50% or JOINT.position=-1:0.5."


def split_effects(given: Sequence[Path] | None) -> tuple[list[Path], list[str]]:
    """Return the files and the names among the values of --effects."""
    files = [path for path in given or () if path.suffix == ".py"]
    names = [path for path in given or () if path.suffix != ".py"]
    return files, [name for path in names for name in str(path).split(",") if name]


def joint_values(text: str, joints: Sequence[str], option: str) -> Array:
    """Return (n,) values of joints from `0.1`, which is for all of them, or `a=0.1,b=0.2`."""
    if "=" not in text and "," not in text:
        return np.full(len(joints), _number(text, option))
    values: dict[str, float] = {}
    for joint, value in pairs(option, [text], _JOINTS):
        _check_joint(joint, joints, option)
        values[joint] = _number(value, option)
    missing = [joint for joint in joints if joint not in values]
    if missing:
        raise ArgumentError(
            f"{option} has no value for {', '.join(missing)}.",
            advice="Give one number for all joints, or one for each.",
        )
    return np.array([values[joint] for joint in joints])


_FEET = (
    "Write --feet LINK,LINK; a link without collision geometry has its size, LINK=LENGTHxWIDTH in "
    "m, or LINK=point."
)


def feet_in(text: str) -> list[str | Foot]:
    """Return feet from `l_foot,r_foot`, of which each may have a size: `l_foot=0.26x0.12`."""
    found: list[str | Foot] = []
    for part in text.split(","):
        link, sized, size = (each.strip() for each in part.partition("="))
        if not link or (sized and not size):
            raise ArgumentError(f"--feet takes links; got {text!r}.", advice=_FEET)
        if not sized:
            found.append(link)
        elif size == "point":
            found.append(Foot(link, np.zeros((1, 3))))
        else:
            length, _, width = size.partition("x")
            try:
                sides = float(length), float(width)
            except ValueError:
                raise ArgumentError(
                    f"{size!r} of --feet {text!r} is no size.", advice=_FEET
                ) from None
            found.append(Foot.sole(link, *sides))
    return found


def limits_of(
    given: Sequence[str] | None, model: RobotModel, *, bounded: bool = False
) -> MotionLimits:
    """Return the model's limits, overridden by options.

    Args:
        given: `0.5` for a share of all limits; `velocity=1.5` for all joints, `velocity=50%` for a
            share of the model's; `current=8` (A; also voltage and pwm) for joints whose efforts the
            model computes from currents; `joint.effort=40` and `joint.position=-1:0.5` for one
            joint. Each may hold several, separated by commas; later ones win.
        bounded: As for `motion_limits`.
    """
    motors = motors_of(model)
    scale, said = 1.0, {quantity: dict[str, Any]() for quantity in _QUANTITIES}
    for text in filter(None, ",".join(given or ()).split(",")):
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            scale *= _amount(text)[0]
            continue
        joint, _, quantity = key.rpartition(".")
        if quantity not in _QUANTITIES:
            raise ArgumentError(
                f"--limits {text!r}: unknown quantity {quantity!r}.",
                advice=f"Quantities are {', '.join(_QUANTITIES)}. {_EXAMPLE}",
            )
        if joint:
            _check_joint(joint, motors, "--limits")
        joints = motors
        if quantity in SIGNAL_KINDS:
            joints = tuple(each.joint for each in model.effort_signals if each.kind == quantity)
            if value.endswith("%"):
                raise ArgumentError(
                    f"--limits {text!r}: the model has no {quantity} limit to take a share of.",
                    advice=f"Give a number, such as {quantity}=8.",
                )
        if not joints or (joint and joint not in joints):
            raise ArgumentError(
                f"--limits {text!r}: the model computes no efforts from a "
                f"{quantity}{f' of {joint}' * bool(joint)}.",
                advice="Limit the effort, or use a model that was fitted to such a log.",
            )
        limit = _range(value) if quantity == "position" else _amount(value)
        said[quantity] |= dict.fromkeys([joint] if joint else joints, limit)
    position = said.pop("position")
    signals = {j: most for kind in SIGNAL_KINDS for j, (most, _) in said.pop(kind).items()}
    absolute = {
        quantity: {j: most for j, (most, is_share) in own.items() if not is_share}
        for quantity, own in said.items()
    }
    limits = motion_limits(model, position=position, bounded=bounded, **absolute)
    for quantity, own in said.items():
        shares = [
            most if is_share else 1.0
            for most, is_share in (own.get(j, (1.0, True)) for j in motors)
        ]
        limits = replace(limits, **{quantity: np.array(shares) * getattr(limits, quantity)})
    # After the shares, which are of the model's limits: the lesser counts.
    most = np.minimum(limits.effort, signal_limits(model, signals))
    return replace(limits, effort=most).scaled(scale)


def _amount(text: str) -> tuple[float, bool]:
    """Return a number, and whether it is a share of a limit, as of `50%`."""
    if text.strip().endswith("%"):
        return 0.01 * _number(text.strip().rstrip("%"), "--limits"), True
    return _number(text, "--limits"), False


def _range(text: str) -> tuple[float, float]:
    low, colon, high = text.partition(":")
    if not colon:
        raise ArgumentError(f"--limits has position={text}, not a range.", advice=_EXAMPLE)
    return _number(low, "--limits"), _number(high, "--limits")


def _number(text: str, option: str) -> float:
    try:
        return float(text)
    except ValueError:
        advice = _EXAMPLE if option == "--limits" else f"Write 0.1, or {_JOINTS}."
        message = f"{option} got {text.strip()!r}, which is not a number."
        raise ArgumentError(message, advice=advice) from None


def _check_joint(joint: str, joints: Sequence[str], option: str) -> None:
    if joint not in joints:
        raise ArgumentError(
            f"{option} names {joint!r}, which is not a joint of the model.",
            advice=f"Joints are: {', '.join(joints)}.",
        )
