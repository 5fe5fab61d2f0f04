"""Values of options as people write them: numbers by joint, limits, effects by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.cli.input_options import pairs
from geodrake.errors import ArgumentError
from geodrake.excitation import MotionLimits, motion_limits
from geodrake.excitation.limits import signal_limits
from geodrake.logs.motion import SIGNAL_KINDS
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_QUANTITIES = ("position", "velocity", "acceleration", "effort", "jerk", *SIGNAL_KINDS)
_JOINTS = "joint_1=0.1,joint_2=0.2"
_EXAMPLE = "Write 0.5, velocity=1.5, velocity=50% or JOINT.position=-1:0.5."


def split_effects(given: Sequence[Path] | None) -> tuple[list[Path], list[str]]:
    """Return the files among what --effects was given, and the names."""
    files = [path for path in given or () if path.suffix == ".py"]
    names = [path for path in given or () if path.suffix != ".py"]
    return files, [name for path in names for name in str(path).split(",") if name]


def joint_values(text: str, model: RobotModel, option: str) -> Array:
    """Return (nv,) values from `0.1`, which is for all joints, or `a=0.1,b=0.2`."""
    if "=" not in text and "," not in text:
        return np.full(len(model.joints), _number(text, option))
    values: dict[str, float] = {}
    for joint, value in pairs(option, [text], _JOINTS):
        _check_joint(joint, model, option)
        values[joint] = _number(value, option)
    missing = [joint for joint in model.joints if joint not in values]
    if missing:
        raise ArgumentError(
            f"{option} says nothing of {', '.join(missing)}.",
            advice="Give one number for all joints, or one for each.",
        )
    return np.array([values[joint] for joint in model.joints])


@dataclass
class _Limits:
    """What --limits said so far."""

    model: RobotModel
    scale: float = 1.0
    absolute: dict[str, dict[str, float]] = field(default_factory=dict)
    shares: dict[str, dict[str, float]] = field(default_factory=dict)
    position: dict[str, tuple[float, float]] = field(default_factory=dict)
    signals: dict[str, float] = field(default_factory=dict)

    def add(self, text: str) -> None:
        """Take one limit in; see `limits_of`."""
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            self.scale *= _share(text)
            return
        joint, _, quantity = key.rpartition(".")
        if quantity not in _QUANTITIES:
            raise ArgumentError(
                f"--limits has {text!r}, and there is no limit {quantity!r}.",
                advice=f"Limits are {', '.join(_QUANTITIES)}. {_EXAMPLE}",
            )
        if joint:
            _check_joint(joint, self.model, "--limits")
        joints = [joint] if joint else list(self.model.joints)
        if quantity == "position":
            self.position |= dict.fromkeys(joints, _range(value))
        elif quantity in SIGNAL_KINDS and value.endswith("%"):
            raise ArgumentError(
                f"--limits has {text!r}; there is no limit of {quantity}s that it is a share of.",
                advice=f"Write it as a number, such as {quantity}=8.",
            )
        elif quantity in SIGNAL_KINDS:
            self._add_signal(quantity, joint, _number(value, "--limits"))
        elif value.endswith("%"):
            self.shares.setdefault(quantity, {}).update(dict.fromkeys(joints, _share(value)))
        else:
            numbers = dict.fromkeys(joints, _number(value, "--limits"))
            self.absolute.setdefault(quantity, {}).update(numbers)

    def _add_signal(self, kind: str, joint: str, value: float) -> None:
        """Take in the limit of a current, voltage or duty cycle, of one joint or of all such."""
        own = [each.joint for each in self.model.effort_signals if each.kind == kind]
        if not own or (joint and joint not in own):
            raise ArgumentError(
                f"--limits has a {kind}{f' of {joint}' * bool(joint)}, and the model knows no "
                "efforts by it.",
                advice="Limit the effort, or start from a model that was fitted to such a log.",
            )
        self.signals.update(dict.fromkeys([joint] if joint else own, value))


def limits_of(
    given: Sequence[str] | None, model: RobotModel, *, bounded: bool = False
) -> MotionLimits:
    """Return the model's limits with others in their place.

    Args:
        given: `0.5` for a share of all limits; `velocity=1.5` for all joints, `velocity=50%` for a
            share of the model's; `current=8` for the efforts that a model knows by their currents,
            A (voltage, pwm alike); `joint.effort=40` and `joint.position=-1:0.5` for one joint.
            Each may hold several, with commas between them; later ones win.
        bounded: As for `motion_limits`.
    """
    said = _Limits(model)
    for text in given or ():
        for part in filter(None, text.split(",")):
            said.add(part)
    absolute: Mapping[str, Mapping[str, float]] = said.absolute
    limits = motion_limits(
        model,
        position=said.position,
        velocity=absolute.get("velocity"),
        acceleration=absolute.get("acceleration"),
        effort=absolute.get("effort"),
        jerk=absolute.get("jerk"),
        bounded=bounded,
    )
    for quantity, shares in said.shares.items():
        factors = np.array([shares.get(joint, 1.0) for joint in model.joints])
        limits = replace(limits, **{quantity: factors * getattr(limits, quantity)})
    # After the shares, which are of the model's limits: the lesser counts.
    effort = np.minimum(limits.effort, signal_limits(model, said.signals))
    return replace(limits, effort=effort).scaled(said.scale)


def _share(text: str) -> float:
    if text.strip().endswith("%"):
        return 0.01 * _number(text.strip().rstrip("%"), "--limits")
    return _number(text, "--limits")


def _range(text: str) -> tuple[float, float]:
    low, colon, high = text.partition(":")
    if not colon:
        raise ArgumentError(f"--limits has the position {text!r}.", advice=_EXAMPLE)
    return _number(low, "--limits"), _number(high, "--limits")


def _number(text: str, option: str) -> float:
    try:
        return float(text)
    except ValueError:
        advice = _EXAMPLE if option == "--limits" else f"Write 0.1, or {_JOINTS}."
        message = f"{option} is given {text.strip()!r}, which is not a number."
        raise ArgumentError(message, advice=advice) from None


def _check_joint(joint: str, model: RobotModel, option: str) -> None:
    if joint not in model.joints:
        raise ArgumentError(
            f"{option} names {joint!r}, which is no joint of the model.",
            advice=f"Joints are: {', '.join(model.joints)}.",
        )
