"""Values of a model that its simulated motion shows: of soft joints, their servos and motors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geodrake.effects import FittedEffect, Role
from geodrake.effects.deflection import DeflectionEffect, Give
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.model.effort_signal import SERVO, EffortSignal
from geodrake.model.robot_model import RobotModel
from geodrake.model.signal_efforts import servos_of

_FARTHEST = 30.0  # times what a value begins with
_BESIDE = ("damping", "integral")  # of a servo, known beside its gain
_DELAY_DEVIATION = 0.01  # s, as much as servos usually are late


@dataclass(frozen=True)
class RolloutValue:
    """One positive value of an effect, or of a servo.

    A search moves it in steps: of its deviation, or where it has none, of a factor of e.
    """

    at: int | None  # which of the model's effects has it; None for a servo
    effect: str  # name of the effect; "servo"
    joint: str
    name: str  # name of the value: of a parameter or a shape of the effect, or of an `EffortSignal`
    value: float
    deviation: float = 0.0  # how well it is known before, SI; 0 if to a factor of e

    @property
    def bounds(self) -> tuple[float, float]:
        """Fewest and most steps."""
        if self.deviation:
            return (1.0 / _FARTHEST - 1.0) * self.value / self.deviation, np.inf
        return -np.log(_FARTHEST), np.log(_FARTHEST)

    def moved(self, steps: float) -> float:
        """Return the value after some steps."""
        if self.deviation:
            return self.value + max(steps, self.bounds[0]) * self.deviation
        return self.value * float(np.exp(steps))

    def change(self, steps: float) -> float:
        """By how much one more step changes it."""
        return self.deviation or self.moved(steps)


def is_soft(model: RobotModel) -> bool:
    """Return whether a model has a soft joint or play."""
    return any(isinstance(fitted.effect, DeflectionEffect) for fitted in model.effects)


def rollout_values(model: RobotModel, *, commands: bool = False) -> tuple[RolloutValue, ...]:
    """Return what of a model its simulated motion shows, and efforts hardly do.

    Under commands soft joints would make up for what their servos are off by: what is not known
    exactly of these is such a value, too, and so is what is not known exactly of their motors'
    friction and inertia.
    """
    found = []
    for at, fitted in enumerate(model.effects):
        effect = fitted.effect
        if isinstance(effect, DeflectionEffect):
            values = effect.rollout_values(fitted.parameters).items()
            found += [RolloutValue(at, effect.name, effect.joint, *each) for each in values]
    if not found:
        raise ModelError(
            "The model has no elastic joint and no backlash to fit.",
            advice="Find them first: geodrake explain MODEL LOG… --save FILE.yaml. With "
            "--commands, servos and friction are fitted.",
        )
    if not commands:
        return tuple(found)
    soft = {value.joint for value in found}
    for servo in servos_of(model):
        if servo is not None and servo.joint in soft and (own := _servo_values(servo)):
            found += own
            for at, fitted in enumerate(model.effects):
                found += _motor_values(at, fitted) if fitted.effect.where == (servo.joint,) else ()
    return tuple(found)


def _motor_values(at: int, fitted: FittedEffect) -> Iterator[RolloutValue]:
    """Yield what resists a motor, friction, inertia and springs, as far as it is not known exactly.

    It was found with the servo, and is off as that is: by far more than its deviations say. What
    may be of either sign, as offsets may, is not.
    """
    effect, deviations = fitted.effect, fitted.deviations
    if deviations is None or not effect.at_motor or effect.role is not Role.FORCE:
        return
    for parameter, value, unsure in zip(
        effect.parameters, fitted.parameters.tolist(), deviations.tolist(), strict=True
    ):
        if parameter.lower == 0.0 and value > 0.0 and unsure > 0.0:
            yield RolloutValue(at, effect.name, effect.where[0], parameter.name, value)


def _servo_values(servo: EffortSignal) -> list[RolloutValue]:
    """Return what is not known exactly of a servo.

    Its delay is not where others are not. What is known beside the gain is known no better than
    that: a fit that knew of no spring made up for it by their ratio.
    """
    share = servo.uncertainty
    known = {
        "gain": (servo.gain, servo.deviation),
        "damping": (servo.damping, max(servo.damping_deviation, share * servo.damping)),
        "integral": (servo.integral, max(servo.integral_deviation, share * servo.integral)),
    }
    unsure = {name: each for name, each in known.items() if all(each)}
    if unsure:
        unsure["delay"] = servo.delay, _DELAY_DEVIATION
    return [RolloutValue(None, SERVO, servo.joint, name, *each) for name, each in unsure.items()]


def forces_at_motors(
    model: RobotModel, values: Sequence[RolloutValue]
) -> tuple[tuple[int, int], ...]:
    """Effects of values that forces at motors have, and which of their parameters they are."""
    found = []
    for value in values:
        if value.at is not None:
            effect = model.effects[value.at].effect
            names = [parameter.name for parameter in effect.parameters]
            if not isinstance(effect, DeflectionEffect):
                found.append((value.at, names.index(value.name)))
    return tuple(found)


def values_at(values: Sequence[RolloutValue], x: Array) -> tuple[Array, Array]:
    """Return (k,) values after steps x (k,) of each, and how much one more step changes each.

    Gains of servos take along what of these is known beside them.
    """
    pairs = list(zip(values, x.tolist(), strict=True))
    moved = [(value.moved(steps), value.change(steps)) for value, steps in pairs]
    shares = {
        value.joint: now / value.value
        for value, (now, _) in zip(values, moved, strict=True)
        if value.at is None and value.name == "gain"
    }
    beside = [value.at is None and value.name in _BESIDE for value in values]
    gains = [
        shares.get(v.joint, 1.0) if own else 1.0 for v, own in zip(values, beside, strict=True)
    ]
    found, changes = np.array(moved).T * gains
    return found, changes


def with_values(
    model: RobotModel,
    values: Sequence[RolloutValue],
    new: Sequence[float],
    deviations: Sequence[float],
) -> RobotModel:
    """Return the model with other values."""
    given: dict[int | str, tuple[dict[str, float], dict[str, float]]] = {}
    for value, now, unsure in zip(values, new, deviations, strict=True):
        own = given.setdefault(value.joint if value.at is None else value.at, ({}, {}))
        own[0][value.name], own[1][value.name] = float(now), float(unsure)
    effects = [
        _with_effect(fitted, *given[at]) if at in given else fitted
        for at, fitted in enumerate(model.effects)
    ]
    signals = [
        _with_servo(signal, *given[signal.joint]) if signal.joint in given else signal
        for signal in model.effort_signals
    ]
    return replace(model, effects=tuple(effects), effort_signals=tuple(signals))


def _with_effect(
    fitted: FittedEffect, given: dict[str, float], deviations: dict[str, float]
) -> FittedEffect:
    """Return an effect with other values; what is not given stays."""
    if isinstance(fitted.effect, DeflectionEffect):
        return fitted.effect.with_rollout_values(given, deviations)
    names = [parameter.name for parameter in fitted.effect.parameters]
    parameters, unsure = fitted.parameters.copy(), np.zeros(len(names))
    if fitted.deviations is not None:
        unsure = fitted.deviations.copy()
    for name, value in given.items():
        at = names.index(name)
        parameters[at], unsure[at] = value, deviations[name]
    return replace(fitted, parameters=parameters, deviations=unsure)


def _with_servo(
    servo: EffortSignal, given: dict[str, float], deviations: dict[str, float]
) -> EffortSignal:
    """Return a servo with other values.

    Its gain is known to the share that it was: the motion tells it for given inertias only.
    """
    known = {f"{name}_deviation": deviations[name] for name in _BESIDE if name in given}
    known["deviation"] = servo.uncertainty * given.get("gain", servo.gain)
    return replace(servo, **{**given, **known})  # type: ignore[arg-type]


def giving_way(effects: Sequence[FittedEffect]) -> dict[str, Give]:
    """Joint -> how far its link moves against its motor, of joints that are soft."""
    found: dict[str, Give] = {}
    for fitted in effects:
        effect = fitted.effect
        if isinstance(effect, DeflectionEffect):
            found[effect.joint] = found.get(effect.joint, Give()) + effect.give(fitted.parameters)
    return found
