"""Values of soft joints, their servos and motors, and their least squares by simulated motion.

Few values, positive, by steps from where they begin: of what each is known to, be that a deviation
or, by its logarithm, a factor of e. Departures are those of the rollout that the search begins
with, and how much they change near the measured motion (`linearized_motion`). They are compared
with the positions as they were logged, and what other states at the start of a window would make of
them does not count: those are smoothed, and never exact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from geodrake.control.rollout.linearized_motion import LinearizedMotion
from geodrake.effects import FittedEffect, Role
from geodrake.effects.deflection import DeflectionEffect
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.model.effort_signal import SERVO, EffortSignal
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import servos_of

_FARTHEST = 30.0  # times what a value begins with
_DELAY_DEVIATION = 0.01  # s, as much as servos usually are late
_TRIED = np.log([0.1, 0.2, 0.4, 0.7, 1.4, 2.5, 5.0, 10.0])  # steps of one value alone, at first
_STEP = 0.02  # of a step, for slopes
_MOST_ROUNDS = 12  # with what joints depart by, which falls, and with starts as values have them
_SETTLED = 2e-3  # of a step, by which the last round changes them at most
_MOST_EVALUATIONS = 20
_LEAST = 1e-9  # rad or m, by which joints depart at least


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
        """Return by how much one more step changes it."""
        return self.deviation or self.moved(steps)

    @property
    def is_beside_gain(self) -> bool:
        """Whether it is of a servo, and known beside its gain."""
        return self.at is None and self.name in ("damping", "integral")

    def in_effect(self, fitted: FittedEffect, now: float, deviation: float) -> FittedEffect:
        """Return its effect, of a motor, with another value."""
        at = [parameter.name for parameter in fitted.effect.parameters].index(self.name)
        parameters, unsure = fitted.parameters.copy(), np.zeros(len(fitted.parameters))
        if fitted.deviations is not None:
            unsure = fitted.deviations.copy()
        parameters[at], unsure[at] = now, deviation
        return replace(fitted, parameters=parameters, deviations=unsure)

    def in_servo(self, servo: EffortSignal, now: float, deviation: float) -> EffortSignal:
        """Return its servo with another value.

        A gain is known to the share that it was: the motion tells it for given inertias only.
        """
        known = {}
        if self.name == "gain":
            known = {"deviation": servo.uncertainty * now}
        elif self.is_beside_gain:
            known = {f"{self.name}_deviation": deviation}
        return replace(servo, **{self.name: now, **known})  # type: ignore[arg-type]


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
    gains = [shares.get(v.joint, 1.0) if v.is_beside_gain else 1.0 for v in values]
    found, changes = np.array(moved).T * gains
    return found, changes


def with_values(
    model: RobotModel,
    values: Sequence[RolloutValue],
    new: Sequence[float],
    deviations: Sequence[float],
) -> RobotModel:
    """Return the model with other values."""
    effects = [*model.effects]
    servos = {signal.joint: signal for signal in model.effort_signals}
    of_springs: dict[int, tuple[dict[str, float], dict[str, float]]] = {}
    for value, now, unsure in zip(values, new, deviations, strict=True):
        if value.at is None:
            servos[value.joint] = value.in_servo(servos[value.joint], now, unsure)
        elif isinstance(effects[value.at].effect, DeflectionEffect):
            own = of_springs.setdefault(value.at, ({}, {}))
            own[0][value.name], own[1][value.name] = now, unsure
        else:
            effects[value.at] = value.in_effect(effects[value.at], now, unsure)
    for at, both in of_springs.items():
        if isinstance(effect := effects[at].effect, DeflectionEffect):
            effects[at] = effect.with_rollout_values(*both)
    signals = tuple(servos[signal.joint] for signal in model.effort_signals)
    return replace(model, effects=tuple(effects), effort_signals=signals)


@dataclass(frozen=True, eq=False)
class MotionSearch:
    """W windows that values are fitted to."""

    model: RobotModel  # the model at the start
    values: tuple[RolloutValue, ...]
    windows: Sequence[LinearizedMotion]
    # Of each window (N, nv) simulated − logged positions at the start of the search, rad or m.
    departures: Sequence[Array]

    def fit(self) -> tuple[Array, Array]:
        """Return steps (k,) of values from the start, and their standard deviations."""
        lower, upper = np.transpose([value.bounds for value in self.values])
        x = self._tried(np.zeros(len(self.values)))
        for _ in range(_MOST_ROUNDS):
            before, found = x, self._blinds(x)
            x = least_squares(
                lambda y, blinds=found: np.concatenate([*self._residuals(y, blinds), y]),
                x,
                bounds=(lower, upper),
                diff_step=_STEP,
                max_nfev=_MOST_EVALUATIONS,
            ).x
            if np.abs(x - before).max() < _SETTLED:
                break
        return x, self._deviations(x, self._blinds(x))

    def near(self, x: Array, *, slopes: bool = False) -> list[tuple[Array, Array]]:
        """Return departures of the windows near their motion, and slopes with their starts.

        Args:
            x: (k,) steps of values from the start.
        """
        values = values_at(self.values, x)[0].tolist()
        model = with_values(self.model, self.values, values, values)
        # (The robot of a log is shared by its windows, as it has commands to prepare.)
        robots = {window.passage.log: window.robot.of(model) for window in self.windows}
        return [
            window.departure(robots[window.passage.log], slopes=slopes) for window in self.windows
        ]

    @cached_property
    def rest(self) -> list[Array]:
        """Of each window (N, nv) what departs beside what is simulated near its motion."""
        start = self.near(np.zeros(len(self.values)))
        return [whole - d for whole, (d, _) in zip(self.departures, start, strict=True)]

    def _blinds(self, x: Array) -> list[Blind]:
        """Return how departures count from now on, by where the search is."""
        here = self.near(x, slopes=True)
        departures = [r + d for r, (d, _) in zip(self.rest, here, strict=True)]
        return blinds([slopes for _, slopes in here], departures)

    def _residuals(self, x: Array, blinds: Sequence[Blind]) -> list[Array]:
        """Return residuals of each window."""
        each = zip(blinds, self.rest, self.near(x), strict=True)
        return [blind(rest + departure) for blind, rest, (departure, _) in each]

    def _tried(self, x: Array) -> Array:
        """Return the best of some values, one after another, each blind to starts as it has them.

        Other values ring otherwise: blind to starts as they are elsewhere, the best would be those
        that are not far.
        """
        scale = self._blinds(x)[0].scale

        def cost(y: Array) -> float:
            return float(sum(r @ r for r in self._free(y, scale)) + y @ y)

        for i in range(len(x)):
            tries = np.repeat(x[None], len(_TRIED) + 1, axis=0)
            tries[1:, i] = np.clip(x[i] + _TRIED, *self.values[i].bounds)
            x = tries[int(np.argmin([cost(each) for each in tries]))]
        return x

    def _free(self, x: Array, scale: Array) -> list[Array]:
        """Return residuals of each window, blind to starts as the values have them."""
        each = zip(self.rest, self.near(x, slopes=True), strict=True)
        return [blind_to(slopes, scale)(rest + d) for rest, (d, slopes) in each]

    def _deviations(self, x: Array, blinds: Sequence[Blind]) -> Array:
        """Return (k,) standard deviations of the steps.

        The search ends where pulls, slopes times residuals, are 0. They differ by noise, or from
        window to window, whichever is more; and change with the values only by what no start makes.
        """
        at, scale = self._residuals(x, blinds), blinds[0].scale
        J = _slopes(lambda y: self._residuals(y, blinds), x)
        free = _slopes(lambda y: self._free(y, scale), x)
        free = [f - b.basis @ (b.basis.T @ f) for f, b in zip(free, blinds, strict=True)]
        change = np.linalg.inv(sum((j.T @ f for j, f in zip(J, free, strict=True)), np.eye(len(x))))
        pulls = np.array([j.T @ r for j, r in zip(J, at, strict=True)])
        pulls = pulls - pulls.mean(axis=0)
        spread = pulls.T @ pulls * len(at) / max(len(at) - 1, 1)
        noise = sum((j.T @ j for j in J), np.eye(len(x)))
        both = [np.diag(change @ each @ change.T) for each in (noise, spread)]
        return np.asarray(np.sqrt(np.maximum(*both)))


def _slopes(residuals: Callable[[Array], list[Array]], x: Array) -> list[Array]:
    """Return (N nv, k) slopes of the residuals of each window."""
    columns = []
    for unit in _STEP * np.eye(len(x)):
        ahead, behind = residuals(x + unit), residuals(x - unit)
        columns.append([(a - b) / (2.0 * _STEP) for a, b in zip(ahead, behind, strict=True)])
    return [np.column_stack(each) for each in zip(*columns, strict=True)]


@dataclass(frozen=True, eq=False)
class Blind:
    """A window, blind to other states at its start."""

    scale: Array  # (nv,) what joints depart by, over the root of what a window is worth, rad or m
    basis: Array  # (N nv, k) orthonormal: what other states make, each joint over its scale

    def __call__(self, departure: Array) -> Array:
        """Return (N nv,) the part of a departure (N, nv) that no other start explains."""
        whole = np.ravel(departure / self.scale)
        whole = whole - self.basis @ (self.basis.T @ whole)
        return np.asarray(whole / np.sqrt(len(departure)))

    def left(self, departure: Array) -> Array:
        """Return (N, nv) the same as a departure, rad or m."""
        whole = self(departure).reshape(departure.shape)
        return np.asarray(whole * self.scale * np.sqrt(len(departure)))


def blinds(slopes: Sequence[Array], departures: Sequence[Array]) -> list[Blind]:
    """Return windows that are blind to their starts, over how well they know what joints depart by.

    A window is worth all its samples where departures are noise of a sensor, which differs from
    sample to sample. What else is left varies with the motion, and is worth one.

    Args:
        slopes: Of each window (N, nv, k) departures that other states at its start make.
        departures: Of each (N, nv) departures, rad or m.
    """
    noise, scale = _noise(departures), _rms(departures)
    least = np.square(noise) * np.mean([1.0 / len(d) for d in departures])
    for _ in range(2):  # as what is explained depends on the scale
        found = [blind_to(each, scale) for each in slopes]
        left = _rms([blind.left(d) for blind, d in zip(found, departures, strict=True)])
        more = np.maximum(np.square(left) - np.square(noise), 0.0)
        scale = np.maximum(np.sqrt(more + least), _LEAST)
    return [blind_to(each, scale) for each in slopes]


def _noise(departures: Sequence[Array]) -> Array:
    """Return (nv,) RMS of the noise between samples, from fourth differences, which amplify it."""
    steps = [np.mean(np.square(np.diff(d, 4, axis=0)), axis=0) for d in departures if len(d) > 4]
    if not steps:
        return np.zeros(departures[0].shape[1])
    return np.asarray(np.sqrt(np.mean(steps, axis=0) / 70.0))


def _rms(departures: Sequence[Array]) -> Array:
    """Return (nv,) RMS of joints over windows."""
    mean = np.mean([np.mean(np.square(d), axis=0) for d in departures], axis=0)
    return np.asarray(np.maximum(np.sqrt(mean), _LEAST))


def blind_to(slopes: Array, scale: Array) -> Blind:
    """Return a window that is blind to its start.

    Args:
        slopes: (N, nv, k) departures that other states at its start make.
        scale: (nv,) what joints depart by, rad or m.
    """
    columns = (slopes / scale[:, None]).reshape(-1, slopes.shape[2])
    size = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    return Blind(scale, np.linalg.qr(columns / size)[0])
