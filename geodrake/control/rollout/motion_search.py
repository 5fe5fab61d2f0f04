"""Least-squares fit of soft joints, their servos and motors to simulated motion.

The few positive values are parameterized by steps from their initial values, relative to their
prior standard deviations or, for unknown values, logarithmically. Departures are those of the
initial rollout, plus their changes near the measured motion (`linearized_motion`), compared with
the logged positions. The part that other initial states of a window would explain is projected out,
as initial states are smoothed and never exact.
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

_FARTHEST = 30.0  # bound of values, relative to their initial values
_DELAY_DEVIATION = 0.01  # s, prior standard deviation of a servo's delay
_GRID = np.log([0.1, 0.2, 0.4, 0.7, 1.4, 2.5, 5.0, 10.0])  # initial steps of single values
_DIFFERENCE = 0.02  # steps, for derivatives
_MOST_ROUNDS = 12  # of reweighting and projection
_TOLERANCE = 2e-3  # steps
_MOST_EVALUATIONS = 20
_LEAST = 1e-9  # rad or m, lower bound of departures


@dataclass(frozen=True)
class RolloutValue:
    """A positive value of an effect or servo, changed in steps.

    A step is its prior standard deviation, or a factor of e if that is unknown.
    """

    index: int | None  # of its effect in the model; None for a servo
    effect: str  # name of the effect, or "servo"
    joint: str
    name: str  # parameter or shape of the effect, or field of `EffortSignal`
    value: float
    deviation: float = 0.0  # prior standard deviation, SI; 0 for a factor of e

    @property
    def bounds(self) -> tuple[float, float]:
        """Minimum and maximum steps."""
        if self.deviation:
            return (1.0 / _FARTHEST - 1.0) * self.value / self.deviation, np.inf
        return -np.log(_FARTHEST), np.log(_FARTHEST)

    def moved(self, steps: float) -> float:
        """Return the value after some steps."""
        if self.deviation:
            return self.value + max(steps, self.bounds[0]) * self.deviation
        return self.value * float(np.exp(steps))

    def change(self, steps: float) -> float:
        """Return the derivative of the value with respect to steps."""
        return self.deviation or self.moved(steps)

    @property
    def scales_with_gain(self) -> bool:
        """Whether it is a value of a servo that is proportional to its gain."""
        return self.index is None and self.name in ("damping", "integral")

    def in_effect(self, fitted: FittedEffect, value: float, deviation: float) -> FittedEffect:
        """Return the fitted effect of a motor with a new value."""
        i = [parameter.name for parameter in fitted.effect.parameters].index(self.name)
        parameters, deviations = fitted.parameters.copy(), np.zeros(len(fitted.parameters))
        if fitted.deviations is not None:
            deviations = fitted.deviations.copy()
        parameters[i], deviations[i] = value, deviation
        return replace(fitted, parameters=parameters, deviations=deviations)

    def in_servo(self, servo: EffortSignal, value: float, deviation: float) -> EffortSignal:
        """Return the servo with a new value.

        The relative uncertainty of a gain does not change: the motion determines it only for given
        inertias.
        """
        deviations = {}
        if self.name == "gain":
            deviations = {"deviation": servo.uncertainty * value}
        elif self.scales_with_gain:
            deviations = {f"{self.name}_deviation": deviation}
        return replace(servo, **{self.name: value, **deviations})  # type: ignore[arg-type]


def is_soft(model: RobotModel) -> bool:
    """Return whether a model has elastic joints or backlash."""
    return any(isinstance(fitted.effect, DeflectionEffect) for fitted in model.effects)


def rollout_values(model: RobotModel, *, commands: bool = False) -> tuple[RolloutValue, ...]:
    """Return the values of a model that its simulated motion determines better than efforts do.

    Under commands, soft joints would compensate for errors of their servos. Uncertain values of
    these servos, and of their motors' friction and inertia, are therefore included.
    """
    values = []
    for i, fitted in enumerate(model.effects):
        effect = fitted.effect
        if isinstance(effect, DeflectionEffect):
            items = effect.rollout_values(fitted.parameters).items()
            values += [RolloutValue(i, effect.name, effect.joint, *item) for item in items]
    if not values:
        raise ModelError(
            "The model has no elastic joint and no backlash to fit.",
            advice="Find them first: geodrake explain MODEL LOG… --save FILE.yaml. With "
            "--commands, servos and friction are fitted.",
        )
    if not commands:
        return tuple(values)
    soft_joints = {value.joint for value in values}
    for servo in servos_of(model):
        if servo is None or servo.joint not in soft_joints:
            continue
        if servo_values := _servo_values(servo):
            values += servo_values
            for i, fitted in enumerate(model.effects):
                if fitted.effect.where == (servo.joint,):
                    values += _motor_values(i, fitted)
    return tuple(values)


def _motor_values(index: int, fitted: FittedEffect) -> Iterator[RolloutValue]:
    """Yield uncertain values of a motor's friction, inertia and springs.

    They were fitted together with the servo and share its error, which by far exceeds their
    standard deviations. Values of either sign, such as offsets, are not included.
    """
    effect, deviations = fitted.effect, fitted.deviations
    if deviations is None or not effect.at_motor or effect.role is not Role.FORCE:
        return
    for parameter, value, deviation in zip(
        effect.parameters, fitted.parameters.tolist(), deviations.tolist(), strict=True
    ):
        if parameter.lower == 0.0 and value > 0.0 and deviation > 0.0:
            yield RolloutValue(index, effect.name, effect.where[0], parameter.name, value)


def _servo_values(servo: EffortSignal) -> list[RolloutValue]:
    """Return the uncertain values of a servo, and its delay if there are any.

    Damping and integral gain are at least as uncertain as the gain: an earlier fit without a spring
    compensated for it by their ratio.
    """
    relative = servo.uncertainty
    candidates = {
        "gain": (servo.gain, servo.deviation),
        "damping": (servo.damping, max(servo.damping_deviation, relative * servo.damping)),
        "integral": (servo.integral, max(servo.integral_deviation, relative * servo.integral)),
    }
    uncertain = {name: pair for name, pair in candidates.items() if all(pair)}
    if uncertain:
        uncertain["delay"] = servo.delay, _DELAY_DEVIATION
    return [RolloutValue(None, SERVO, servo.joint, name, *pair) for name, pair in uncertain.items()]


def values_at(values: Sequence[RolloutValue], x: Array) -> tuple[Array, Array]:
    """Return (k,) values after steps x (k,), and their derivatives with respect to steps.

    Damping and integral gain of a servo scale with its gain.
    """
    pairs = list(zip(values, x.tolist(), strict=True))
    results = [(value.moved(steps), value.change(steps)) for value, steps in pairs]
    gain_ratios = {
        value.joint: new / value.value
        for value, (new, _) in zip(values, results, strict=True)
        if value.index is None and value.name == "gain"
    }
    scales = [gain_ratios.get(v.joint, 1.0) if v.scales_with_gain else 1.0 for v in values]
    new_values, changes = np.array(results).T * scales
    return new_values, changes


def with_values(
    model: RobotModel,
    values: Sequence[RolloutValue],
    new: Sequence[float],
    deviations: Sequence[float],
) -> RobotModel:
    """Return the model with new values and standard deviations."""
    effects = [*model.effects]
    servos = {signal.joint: signal for signal in model.effort_signals}
    deflections: dict[int, tuple[dict[str, float], dict[str, float]]] = {}
    for value, new_value, deviation in zip(values, new, deviations, strict=True):
        if (i := value.index) is None:
            servos[value.joint] = value.in_servo(servos[value.joint], new_value, deviation)
        elif isinstance(effects[i].effect, DeflectionEffect):
            by_name = deflections.setdefault(i, ({}, {}))
            by_name[0][value.name], by_name[1][value.name] = new_value, deviation
        else:
            effects[i] = value.in_effect(effects[i], new_value, deviation)
    for i, by_name in deflections.items():
        if isinstance(effect := effects[i].effect, DeflectionEffect):
            effects[i] = effect.with_rollout_values(*by_name)
    signals = tuple(servos[signal.joint] for signal in model.effort_signals)
    return replace(model, effects=tuple(effects), effort_signals=signals)


@dataclass(frozen=True, eq=False)
class MotionSearch:
    """Fit of values to W windows."""

    model: RobotModel  # the initial model
    values: tuple[RolloutValue, ...]
    windows: Sequence[LinearizedMotion]
    departures: Sequence[Array]  # (N, nv) initial simulated − logged positions, rad or m

    def fit(self) -> tuple[Array, Array]:
        """Return steps (k,) of the values, and their standard deviations."""
        lower, upper = np.transpose([value.bounds for value in self.values])
        x = self._grid_search(np.zeros(len(self.values)))
        for _ in range(_MOST_ROUNDS):
            previous, projections = x, self._projections(x)
            x = least_squares(
                lambda y, fixed=projections: np.concatenate([*self._residuals(y, fixed), y]),
                x,
                bounds=(lower, upper),
                diff_step=_DIFFERENCE,
                max_nfev=_MOST_EVALUATIONS,
            ).x
            if np.abs(x - previous).max() < _TOLERANCE:
                break
        return x, self._deviations(x, self._projections(x))

    def linearized(self, x: Array, *, slopes: bool = False) -> list[tuple[Array, Array]]:
        """Return each window's linearized departure, and its slopes by the initial state."""
        values = values_at(self.values, x)[0].tolist()
        model = with_values(self.model, self.values, values, values)
        # The windows of a log share its robot, which prepares its commands.
        robots = {window.passage.log: window.robot.of(model) for window in self.windows}
        return [
            window.departure(robots[window.passage.log], slopes=slopes) for window in self.windows
        ]

    @cached_property
    def _offsets(self) -> list[Array]:
        """Difference (N, nv) of each window's departure and its linearization, at the start."""
        start = self.linearized(np.zeros(len(self.values)))
        return [total - d for total, (d, _) in zip(self.departures, start, strict=True)]

    def _projections(self, x: Array) -> list[StartProjection]:
        """Return the projections for the departures at steps x."""
        linearized = self.linearized(x, slopes=True)
        departures = [r + d for r, (d, _) in zip(self._offsets, linearized, strict=True)]
        return start_projections([slopes for _, slopes in linearized], departures)

    def _residuals(self, x: Array, projections: Sequence[StartProjection]) -> list[Array]:
        rows = zip(projections, self._offsets, self.linearized(x), strict=True)
        return [project(offset + departure) for project, offset, (departure, _) in rows]

    def _grid_search(self, x: Array) -> Array:
        """Return the best steps on a grid, one value after another.

        The projections are updated for each candidate, as its vibrations differ. Fixed projections
        would favour nearby candidates.
        """
        scale = self._projections(x)[0].scale

        def cost(y: Array) -> float:
            return float(sum(r @ r for r in self._updated_residuals(y, scale)) + y @ y)

        for i in range(len(x)):
            candidates = np.repeat(x[None], len(_GRID) + 1, axis=0)
            candidates[1:, i] = np.clip(x[i] + _GRID, *self.values[i].bounds)
            x = candidates[int(np.argmin([cost(candidate) for candidate in candidates]))]
        return x

    def _updated_residuals(self, x: Array, scale: Array) -> list[Array]:
        """Return the residuals of each window, with projections updated to steps x."""
        rows = zip(self._offsets, self.linearized(x, slopes=True), strict=True)
        return [start_projection(slopes, scale)(offset + d) for offset, (d, slopes) in rows]

    def _deviations(self, x: Array, projections: Sequence[StartProjection]) -> Array:
        """Return (k,) standard deviations of the steps, by a sandwich estimate.

        The covariance of the windows' gradients Jᵀ r is that of noise, or the empirical one,
        whichever is larger. Derivatives of the gradients account for the updated projections.
        """
        residuals, scale = self._residuals(x, projections), projections[0].scale
        J = _jacobians(lambda y: self._residuals(y, projections), x)
        updated = _jacobians(lambda y: self._updated_residuals(y, scale), x)
        updated = [
            f - project.basis @ (project.basis.T @ f)
            for f, project in zip(updated, projections, strict=True)
        ]
        hessian = sum((j.T @ f for j, f in zip(J, updated, strict=True)), np.eye(len(x)))
        inverse = np.linalg.inv(hessian)
        gradients = np.array([j.T @ r for j, r in zip(J, residuals, strict=True)])
        gradients = gradients - gradients.mean(axis=0)
        count = len(residuals)
        spread = gradients.T @ gradients * count / max(count - 1, 1)
        noise = sum((j.T @ j for j in J), np.eye(len(x)))
        variances = [np.diag(inverse @ middle @ inverse.T) for middle in (noise, spread)]
        return np.asarray(np.sqrt(np.maximum(*variances)))


def _jacobians(residuals: Callable[[Array], list[Array]], x: Array) -> list[Array]:
    """Return derivatives (N nv, k) of the residuals of each window."""
    columns = []
    for step in _DIFFERENCE * np.eye(len(x)):
        forward, backward = residuals(x + step), residuals(x - step)
        pairs = zip(forward, backward, strict=True)
        columns.append([(a - b) / (2.0 * _DIFFERENCE) for a, b in pairs])
    return [np.column_stack(window) for window in zip(*columns, strict=True)]


@dataclass(frozen=True, eq=False)
class StartProjection:
    """Scaling of a window's departures, and removal of the part due to its initial state."""

    scale: Array  # (nv,) size of departures, over the root of the effective samples, rad or m
    basis: Array  # (N nv, k) orthonormal basis of scaled departures due to the initial state

    def __call__(self, departure: Array) -> Array:
        """Return (N nv,) the scaled part of a departure (N, nv) that no initial state explains."""
        scaled = np.ravel(departure / self.scale)
        scaled = scaled - self.basis @ (self.basis.T @ scaled)
        return np.asarray(scaled / np.sqrt(len(departure)))

    def remainder(self, departure: Array) -> Array:
        """Return (N, nv) the part of a departure that no initial state explains, rad or m."""
        scaled = self(departure).reshape(departure.shape)
        return np.asarray(scaled * self.scale * np.sqrt(len(departure)))


def start_projections(
    slopes: Sequence[Array], departures: Sequence[Array]
) -> list[StartProjection]:
    """Return the projections of all windows, scaled by the size of their departures.

    Sensor noise is independent between samples, so that all samples of a window count. Other
    departures vary with the motion, and a window counts as one sample of them.

    Args:
        slopes: (N, nv, k) derivatives of each window's departure by its initial state.
        departures: (N, nv) departures of each window, rad or m.
    """
    noise, scale = _noise(departures), _rms(departures)
    noise_variance = np.square(noise) * np.mean([1.0 / len(d) for d in departures])
    for _ in range(2):  # as the explained part depends on the scale
        projections = [start_projection(window, scale) for window in slopes]
        pairs = zip(projections, departures, strict=True)
        remainder = _rms([project.remainder(d) for project, d in pairs])
        model_variance = np.maximum(np.square(remainder) - np.square(noise), 0.0)
        scale = np.maximum(np.sqrt(model_variance + noise_variance), _LEAST)
    return [start_projection(window, scale) for window in slopes]


def _noise(departures: Sequence[Array]) -> Array:
    """Return (nv,) RMS of the sensor noise, from fourth differences, which amplify it."""
    squares = [np.mean(np.square(np.diff(d, 4, axis=0)), axis=0) for d in departures if len(d) > 4]
    if not squares:
        return np.zeros(departures[0].shape[1])
    return np.asarray(np.sqrt(np.mean(squares, axis=0) / 70.0))


def _rms(departures: Sequence[Array]) -> Array:
    """Return (nv,) RMS of joints over windows."""
    mean = np.mean([np.mean(np.square(d), axis=0) for d in departures], axis=0)
    return np.asarray(np.maximum(np.sqrt(mean), _LEAST))


def start_projection(slopes: Array, scale: Array) -> StartProjection:
    """Return the projection of a window, with slopes (N, nv, k) as in `start_projections`."""
    columns = (slopes / scale[:, None]).reshape(-1, slopes.shape[2])
    size = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    return StartProjection(scale, np.linalg.qr(columns / size)[0])
