"""Data for simulating one joint along logs, and comparisons with its measured motion.

Residuals are simulated − measured positions. Some windows are held out, and searches use pieces of
long logs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import contiguous
from geodrake.identification.logs.criteria import PENALTY, WORTH
from geodrake.identification.logs.evidence import effective_samples
from geodrake.identification.logs.servo_motion import (
    BEGUN,
    DAMPING,
    DELAY,
    INTEGRAL,
    LIMIT,
    RATE,
    SHARE,
    calc_servo_motions,
)
from geodrake.logs.motion import JointLog, Trajectory
from geodrake.logs.smoothing import Segment
from geodrake.model.carried_payloads import carrying
from geodrake.model.effort_signal import EffortSignal
from geodrake.model.robot_model import RobotModel
from geodrake.robot.effort_slopes import effort_slopes
from geodrake.robot.regressor import inverse_dynamics

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
T = TypeVar("T", np.float64, np.bool_)

LONGEST_DELAY = 0.06
"""Largest delay of commands, s."""

_WINDOWS = 8  # of all logs, at least two of a stretch; every other one is held out
_SOUGHT, _PIECE = 40.0, 10.0  # total time that searches use, and length of its pieces, s
_NOTHING = float(np.finfo(float).tiny)  # rad² or m²
_RESIDUALS_KEPT = 8
_LINEAR_DELAYS = tuple(np.linspace(0.0, LONGEST_DELAY, 7).tolist())  # candidates, s


@dataclass(frozen=True, eq=False)
class JointMotions:
    """Data for simulating one joint along S stretches of logs."""

    rows: tuple[Array, ...]  # per stretch (N, 8) b, M, K, D, smoothed q, q̇, q̈, and command
    positions: tuple[Array, ...]  # per stretch (N,) positions as logged, rad or m
    periods: tuple[float, ...]  # per stretch the time between rows, s

    def servo(
        self, parameters: Sequence[float], *, limit: float = np.inf, rate_share: float = 1.0
    ) -> Array:
        """Return servo parameters (12 + S,) from the first few of them; the others are zero.

        `limit` and `rate_share` are those of a `ServoFit`.
        """
        numbers = np.zeros(BEGUN + len(self.rows))
        numbers[: len(parameters)], numbers[LIMIT] = parameters, limit
        servo_damping = (1.0 - rate_share) * numbers[RATE]
        if servo_damping > 0.0:
            numbers[RATE] -= servo_damping
            numbers[DAMPING] += servo_damping
            numbers[SHARE] = servo_damping / numbers[DAMPING]
        return numbers

    def simulated(self, servo: Array) -> Array:
        """Return simulated positions (N,), rad or m."""
        x = np.empty(len(self.measured))
        calc_servo_motions(*self._whole, servo, (x, np.empty((0, 0))))
        return x

    def with_slopes(self, servo: Array, free: Mask) -> tuple[Array, Array]:
        """Return the residual (N,) and its slopes (N, f) with respect to the free parameters."""
        count = len(free) if free[INTEGRAL:].any() else INTEGRAL
        x, J = np.empty(len(self.measured)), np.zeros((len(self.measured), count))
        calc_servo_motions(*self._whole, servo, (x, J))
        return self._keep(servo.tobytes(), x - self.measured), J[:, free[:count]]

    def with_integral(self, servo: Array, integral: float) -> Array:
        """Return a servo with an integral whose initial effort matches the bodies on average."""
        found = servo.copy()
        found[INTEGRAL] = integral
        for k, (rows, period) in enumerate(zip(self.rows, self.periods, strict=True)):
            ahead, summed = _late_error(rows, period, float(servo[DELAY]))
            effort = servo[0] * ahead + integral * summed
            found[BEGUN + k] = np.mean(rows[:, 0] - effort)
        return found

    def linear_servo(self, signal: EffortSignal) -> EffortSignal:
        """Estimate gain, delay and integral of a servo by a linear fit of its tracking error.

        The tracking error is the effort of bodies, friction and inertia over the gain. If no fit
        has a positive gain, keep the signal if its gain is known. Add an integral only if that
        explains much more.
        """
        parts = list(zip(self.rows, self.periods, strict=True))
        ones = np.repeat(np.eye(len(parts)), [len(rows) for rows, _ in parts], axis=0)
        b, v, vd = np.concatenate(self.rows)[:, [0, 5, 6]].T
        base_columns, fits = np.column_stack([b, v, np.sign(v), vd, ones]), list[_LinearServo]()
        for delay in _LINEAR_DELAYS:
            errors = [_late_error(rows, period, delay) for rows, period in parts]
            error = np.concatenate([error for error, _ in errors])
            for integrals in ((), (np.concatenate([integral for _, integral in errors]),)):
                columns = np.column_stack([base_columns, *integrals])
                x = np.linalg.lstsq(columns, error, rcond=None)[0]
                gain = 1.0 / x[0] if x[0] > 0.0 else 0.0
                integral = -gain * x[-1] if integrals else 0.0
                if gain and (integral > 0.0 or not integrals):
                    fits.append(_LinearServo(error - columns @ x, gain, delay, integral))
        best = None
        for has_integral in (False, True):
            candidates = [fit for fit in fits if bool(fit.integral) == has_integral]
            if candidates:
                candidate = min(candidates, key=lambda fit: float(fit.residual @ fit.residual))
                if best is None or self.gain_of(best.residual, candidate.residual) >= PENALTY:
                    best = candidate
        if best is None and signal.uncertainty < 1.0:
            return signal
        if best is None:  # the bodies' effort over the tracking error
            error = np.concatenate([_late_error(rows, period, 0.0)[0] for rows, period in parts])
            return replace(signal, gain=float(np.std(b) / max(np.std(error), _NOTHING)))
        return replace(signal, gain=best.gain, delay=best.delay, integral=best.integral)

    def residual(self, servo: Array) -> Array:
        """Return simulated − measured positions (N,) of all stretches; the latest are cached."""
        key = servo.tobytes()
        known = self._residuals.pop(key, None)
        return self._keep(key, self.simulated(servo) - self.measured if known is None else known)

    def _keep(self, servo: bytes, residual: Array) -> Array:
        """Cache a residual (N,) instead of the least recently used one, and return it."""
        self._residuals[servo] = residual
        if len(self._residuals) > _RESIDUALS_KEPT:
            del self._residuals[next(iter(self._residuals))]
        return residual

    @cached_property
    def _residuals(self) -> dict[bytes, Array]:
        """Residuals (N,) by the bytes of the servo's parameters."""
        return {}

    def rms(self, servo: Array, rows: Mask | None = None) -> float:
        """Return the RMS of the residual at the marked rows (N,), or at all."""
        residual = self.residual(servo)
        return float(np.sqrt(np.mean((residual if rows is None else residual[rows]) ** 2)))

    @cached_property
    def measured(self) -> Array:
        """(N,) positions of all stretches, rad or m."""
        return np.concatenate(self.positions)

    @cached_property
    def needed(self) -> Array:
        """(N,) efforts of the bodies along the measured motion, N·m or N."""
        return self._whole[0][:, 0]

    @cached_property
    def _whole(self) -> tuple[Array, Indices, Array]:
        """(N, 8) rows of all stretches, where each ends, and periods, s."""
        return (
            np.concatenate(self.rows),
            np.cumsum(list(map(len, self.rows))),
            np.array(self.periods),
        )

    def gain(self, before: Array, after: Array, rows: Mask | None = None) -> float:
        """Return twice the log-likelihood ratio of two servos at some rows (N,), or at all."""
        return self.gain_of(self.residual(before), self.residual(after), rows)

    def gain_of(self, before: Array, after: Array, rows: Mask | None = None) -> float:
        """Return twice the log-likelihood ratio of two residuals (N,) centred in each stretch.

        Slightly wrong bodies or zeros shift a whole stretch. The mean carries no information about
        the servo, but would correlate all residuals.
        """
        kept = self._split(np.ones(len(after), bool) if rows is None else rows)

        def centered(residual: Array) -> list[Array]:
            pieces = zip(self._split(residual), kept, strict=True)
            return [
                b
                for x, mask in pieces
                for b in _runs(x - np.mean(x[mask] if mask.any() else 0.0), mask)
            ]

        blocks = centered(before), centered(after)
        squares = [max(sum(float(b @ b) for b in each), _NOTHING) for each in blocks]
        return effective_samples(blocks[1]) * float(np.log(squares[0] / squares[1]))

    def noise(self, residual: Array) -> float:
        """Return the residual variance that scales the parameter covariance.

        Noise counts with its effective samples. The part that varies smoothly with the motion
        repeats with the motion and counts as `WORTH` samples in any log; it is taken to be at least
        its chance level.
        """
        rows = np.concatenate(self.rows)
        q, v, vd = ((column - column.mean()) / (np.std(column) or 1.0) for column in rows[:, 4:7].T)
        ahead = rows[:, 7] - rows[:, 4]
        error = (ahead - ahead.mean()) / (np.std(ahead) or 1.0)
        terms = q, v, vd, error, q * q, v * v, v * abs(v), v**3, np.sign(v), np.sign(v) * q, q * v
        columns = np.stack([np.ones_like(q), *terms, abs(v), vd * v, vd * q], 1)
        noise = residual - columns @ np.linalg.lstsq(columns, residual)[0]
        count, k = effective_samples(self._split(noise)), columns.shape[1]
        square = max(float(residual @ residual), _NOTHING)
        share = 1.0 - float(noise @ noise) / square - k / count
        share = min(max(share, float(np.sqrt(2.0 * k)) / count), 1.0)
        return square * ((1.0 - share) / count + share / WORTH)

    def pieces(self) -> JointMotions:
        """Return evenly spread pieces of long logs, for a search."""
        lengths = [period * len(q) for q, period in zip(self.positions, self.periods, strict=True)]
        if sum(lengths) <= _SOUGHT:
            return self
        cut = [
            (k, at)
            for k, (q, period) in enumerate(zip(self.positions, self.periods, strict=True))
            for at in _equal_slices(len(q), max(1, round(_PIECE / period)))
        ]
        count = max(1, round(_SOUGHT / _PIECE))
        kept = [cut[i] for i in np.unique(np.linspace(0, len(cut) - 1, count).round().astype(int))]
        return JointMotions(
            tuple(contiguous(self.rows[k][at]) for k, at in kept),
            tuple(self.positions[k][at] for k, at in kept),
            tuple(self.periods[k] for k, _ in kept),
        )

    @cached_property
    def seen(self) -> tuple[JointMotions, Mask]:
        """The stretches without trailing held-out rows, and a mask (N,) of rows to fit.

        One row more is kept to interpolate commands.
        """
        masks = self._split(~self.tested)
        kept = [slice(np.max(np.flatnonzero(mask), initial=-1) + 2) for mask in masks]
        motions = JointMotions(
            tuple(contiguous(rows[part]) for rows, part in zip(self.rows, kept, strict=True)),
            tuple(q[part] for q, part in zip(self.positions, kept, strict=True)),
            self.periods,
        )
        return motions, np.concatenate([mask[part] for mask, part in zip(masks, kept, strict=True)])

    def _split(self, values: NDArray[T]) -> list[NDArray[T]]:
        """Return the values (N,) split by stretch."""
        return np.split(values, np.cumsum([len(each) for each in self.rows])[:-1])

    @cached_property
    def tested(self) -> Mask:
        """(N,) mask of held-out rows, those of every other window.

        The first window of each stretch is fitted, as only it identifies the initial integral.
        """
        counts = np.array([len(each) for each in self.rows])
        pairs = np.maximum(1, np.rint(0.5 * _WINDOWS * counts / max(counts.sum(), 1)).astype(int))
        windows = zip(counts.tolist(), pairs.tolist(), strict=True)
        return np.concatenate([np.arange(n) * 2 * k // max(n, 1) % 2 == 1 for n, k in windows])


class _LinearServo(NamedTuple):
    """A linear fit of a servo."""

    residual: Array  # (N,) unexplained tracking error, rad or m
    gain: float
    delay: float
    integral: float


def _late_error(rows: Array, period: float, delay: float) -> tuple[Array, Array]:
    """Return the tracking error (N,) of delayed commands, and its integral."""
    time = period * np.arange(len(rows))
    ahead = np.interp(time - delay, time, rows[:, 7]) - rows[:, 4]
    return ahead, period * np.cumsum(ahead)


def _equal_slices(count: int, length: int) -> list[slice]:
    """Return consecutive slices of about equal `length` that cover `count` rows."""
    ends = np.linspace(0, count, max(1, round(count / length)) + 1).round().astype(int).tolist()
    return [slice(*pair) for pair in pairwise(ends)]


def _runs(values: Array, kept: Mask) -> list[Array]:
    """Return runs of consecutive kept values."""
    cuts = np.flatnonzero(np.diff(kept)) + 1
    pieces = zip(np.split(values, cuts), np.split(kept, cuts), strict=True)
    return [piece for piece, there in pieces if len(there) and there[0]]


def motions_of(
    model: RobotModel,
    logs: Sequence[JointLog],
    trajectories: Sequence[Trajectory],
    joints: Sequence[int],
) -> dict[int, JointMotions]:
    """Return the simulation data of some joints, by joint index."""
    rows: dict[int, list[Array]] = {j: [] for j in joints}
    positions: dict[int, list[Array]] = {j: [] for j in joints}
    periods = []
    for log, trajectory in zip(logs, trajectories, strict=True):
        command = np.full_like(log.position, np.nan) if log.command is None else log.command
        robot = carrying(model, log.payloads)
        for stretch in trajectory.segments:
            chunks = [(part.time, _linearized_rows(robot, part)) for _, part in stretch.chunks()]
            time = np.concatenate([instants for instants, _ in chunks])
            columns = np.concatenate([values for _, values in chunks])  # (N, 7, n)
            for j in joints:
                commands = _interpolated(log.time, command[:, j], time)
                rows[j].append(contiguous(np.column_stack([columns[:, :, j], commands])))
                positions[j].append(_interpolated(log.time, log.position[:, j], time))
            periods.append(stretch.period)
    return {j: JointMotions(tuple(rows[j]), tuple(positions[j]), tuple(periods)) for j in joints}


def _linearized_rows(model: RobotModel, part: Segment) -> Array:
    """Return b, M, K, D, q, q̇ and q̈ (N, 7, n) of every joint."""
    motion = (model.positions(part.position), part.velocity, part.acceleration)
    slopes = effort_slopes(model.tree, *motion, model.total_phi)
    kinds = (slopes.acceleration, slopes.position, slopes.velocity)
    own = (np.diagonal(slope, axis1=1, axis2=2) for slope in kinds)
    b = inverse_dynamics(model.tree, *motion, model.total_phi)
    return np.stack([b, *own, part.position, part.velocity, part.acceleration], 1)


def _interpolated(time: Array, values: Array, instants: Array) -> Array:
    """Return values of a log interpolated at other instants."""
    known = np.isfinite(time) & np.isfinite(values)
    return np.interp(instants, time[known], values[known])
