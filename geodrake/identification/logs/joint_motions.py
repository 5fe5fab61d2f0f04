"""One joint along stretches of logs: what simulations of it alone need, and what they say.

Residuals are simulated − measured positions. Some windows are kept for tests, and searches see
pieces of long logs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
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
"""Commands are late by no more, s."""

_WINDOWS = 8  # of all logs, two of a stretch at least; every other one is left out for a test
_SOUGHT, _PIECE = 40.0, 10.0  # s of all stretches that searches see, in pieces of so many
_NOTHING = float(np.finfo(float).tiny)  # rad² or m², of a joint that stands exactly still
_LINEAR_DELAYS = tuple(np.linspace(0.0, LONGEST_DELAY, 7).tolist())  # s, that linear fits try


@dataclass(frozen=True, eq=False)
class JointMotions:
    """One joint along S stretches of logs: what a simulation of it alone needs."""

    rows: tuple[Array, ...]  # per stretch (N, 8) b, M, K, D, and smooth q, q̇, q̈, command
    positions: tuple[Array, ...]  # per stretch (N,) positions as logged, rad or m
    periods: tuple[float, ...]  # per stretch the time between rows, s

    def servo(
        self, parameters: Sequence[float], *, limit: float = np.inf, rate_share: float = 1.0
    ) -> Array:
        """Return the numbers (12 + S,) of a servo with some first parameters, and zeros beyond.

        Limit and share of the rate are those of a `ServoFit`.
        """
        numbers = np.zeros(BEGUN + len(self.rows))
        numbers[: len(parameters)], numbers[LIMIT] = parameters, limit
        own = (1.0 - rate_share) * numbers[RATE]
        if own > 0.0:
            numbers[RATE] -= own
            numbers[DAMPING] += own
            numbers[SHARE] = own / numbers[DAMPING]
        return numbers

    def simulated(self, servo: Array) -> Array:
        """Return positions (N,) under the commands, rad or m."""
        x = np.empty(len(self.measured))
        calc_servo_motions(*self._whole, servo, (x, np.empty((0, 0))))
        return x

    def with_slopes(self, servo: Array, free: Mask) -> tuple[Array, Array]:
        """Return the residual (N,), and its slopes (N, f) with numbers (12 + S,) that are free."""
        count = len(free) if free[INTEGRAL:].any() else INTEGRAL
        x, J = np.empty(len(self.measured)), np.zeros((len(self.measured), count))
        calc_servo_motions(*self._whole, servo, (x, J))
        return x - self.measured, J[:, free[:count]]

    def with_integral(self, servo: Array, integral: float) -> Array:
        """Return a servo with an integral that begins as bodies need it in the mean."""
        found = servo.copy()
        found[INTEGRAL] = integral
        for k, (rows, period) in enumerate(zip(self.rows, self.periods, strict=True)):
            ahead, summed = _late_error(rows, period, float(servo[DELAY]))
            effort = servo[0] * ahead + integral * summed
            found[BEGUN + k] = np.mean(rows[:, 0] - effort)
        return found

    def linear_servo(self, signal: EffortSignal) -> EffortSignal:
        """Return gain, delay and integral of a servo by a linear fit of what it is behind.

        That is what bodies, friction and inertia need, over the gain. Where no servo pulls to where
        it is told to go, it is the signal itself, if anything is known of its gain. There is no
        integral unless one explains much more.
        """
        parts = list(zip(self.rows, self.periods, strict=True))
        ones = np.repeat(np.eye(len(parts)), [len(rows) for rows, _ in parts], axis=0)
        b, v, vd = np.concatenate(self.rows)[:, [0, 5, 6]].T
        sides, found = np.column_stack([b, v, np.sign(v), vd, ones]), list[_Linear]()
        for delay in _LINEAR_DELAYS:
            told = [_late_error(rows, period, delay) for rows, period in parts]
            behind = np.concatenate([error for error, _ in told])
            for more in ((), (np.concatenate([summed for _, summed in told]),)):
                columns = np.column_stack([sides, *more])
                x = np.linalg.lstsq(columns, behind, rcond=None)[0]
                gain = 1.0 / x[0] if x[0] > 0.0 else 0.0
                integral = -gain * x[-1] if more else 0.0
                if gain and (integral > 0.0 or not more):
                    found.append(_Linear(behind - columns @ x, gain, delay, integral))
        best = None
        for with_it in (False, True):
            some = [each for each in found if bool(each.integral) == with_it]
            if some:
                other = min(some, key=lambda each: float(each.left @ each.left))
                if best is None or self.gain_of(best.left, other.left) >= PENALTY:
                    best = other
        if best is None and signal.uncertainty < 1.0:
            return signal
        if best is None:  # about what bodies need, over how far it is behind
            behind = np.concatenate([_late_error(rows, period, 0.0)[0] for rows, period in parts])
            return replace(signal, gain=float(np.std(b) / max(np.std(behind), _NOTHING)))
        return replace(signal, gain=best.gain, delay=best.delay, integral=best.integral)

    def residual(self, servo: Array) -> Array:
        """Return (N,) simulated − measured positions of all stretches."""
        return self._residual(servo.tobytes())

    @cached_property
    def _residual(self) -> Callable[[bytes], Array]:
        """Residuals (N,) by the bytes of a servo's parameters; the last four are kept."""

        @lru_cache(maxsize=4)
        def residual(servo: bytes) -> Array:
            return self.simulated(np.frombuffer(servo).copy()) - self.measured

        return residual

    def rms(self, servo: Array, rows: Mask | None = None) -> float:
        """Return the RMS of simulated − measured positions at some rows (N,), or all."""
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
        """Return twice the log-likelihood that one servo gains over another at some rows (N,)."""
        return self.gain_of(self.residual(before), self.residual(after), rows)

    def gain_of(self, before: Array, after: Array, rows: Mask | None = None) -> float:
        """Return the same of residuals (N,), less the mean of each stretch.

        By that a joint is off where bodies are a little too heavy or a zero is another one. It says
        nothing of a servo, but would make all residuals go together, as if they were one.
        """
        kept = self._split(np.ones(len(after), bool) if rows is None else rows)

        def centered(residual: Array) -> list[Array]:
            pieces = zip(self._split(residual), kept, strict=True)
            return [
                b
                for x, own in pieces
                for b in _runs(x - np.mean(x[own] if own.any() else 0.0), own)
            ]

        blocks = centered(before), centered(after)
        squares = [max(sum(float(b @ b) for b in each), _NOTHING) for each in blocks]
        return effective_samples(blocks[1]) * float(np.log(squares[0] / squares[1]))

    def noise(self, residual: Array) -> float:
        """Return the variance of a residual (N,) as it counts in deviations of parameters.

        Noise counts by the samples that it is worth. What varies smoothly with the motion does so
        whenever the motion repeats, and is worth `WORTH` samples however many there are; it is
        taken to be at least as much as cannot be told from chance.
        """
        rows = np.concatenate(self.rows)
        q, v, vd = ((column - column.mean()) / (np.std(column) or 1.0) for column in rows[:, 4:7].T)
        ahead = rows[:, 7] - rows[:, 4]
        error = (ahead - ahead.mean()) / (np.std(ahead) or 1.0)
        terms = q, v, vd, error, q * q, v * v, v * abs(v), v**3, np.sign(v), np.sign(v) * q, q * v
        columns = np.stack([np.ones_like(q), *terms, abs(v), vd * v, vd * q], 1)
        left = residual - columns @ np.linalg.lstsq(columns, residual)[0]
        count, k = effective_samples(self._split(left)), columns.shape[1]
        square = max(float(residual @ residual), _NOTHING)
        share = 1.0 - float(left @ left) / square - k / count
        share = min(max(share, float(np.sqrt(2.0 * k)) / count), 1.0)
        return square * ((1.0 - share) / count + share / WORTH)

    def pieces(self) -> JointMotions:
        """Return what a search sees of long logs: pieces, spread evenly over the stretches."""
        lengths = [period * len(q) for q, period in zip(self.positions, self.periods, strict=True)]
        if sum(lengths) <= _SOUGHT:
            return self
        cut = [
            (k, at)
            for k, (q, period) in enumerate(zip(self.positions, self.periods, strict=True))
            for at in _even(len(q), max(1, round(_PIECE / period)))
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
        """The stretches up to where a test alone needs them, and rows (N,) that a fit sees.

        A row more says how commands go on.
        """
        shown = self._split(~self.tested)
        kept = [slice(np.max(np.flatnonzero(own), initial=-1) + 2) for own in shown]
        motions = JointMotions(
            tuple(contiguous(rows[at]) for rows, at in zip(self.rows, kept, strict=True)),
            tuple(q[at] for q, at in zip(self.positions, kept, strict=True)),
            self.periods,
        )
        return motions, np.concatenate([own[at] for own, at in zip(shown, kept, strict=True)])

    def _split(self, values: NDArray[T]) -> list[NDArray[T]]:
        """Return values (N,) of each stretch."""
        return np.split(values, np.cumsum([len(each) for each in self.rows])[:-1])

    @cached_property
    def tested(self) -> Mask:
        """(N,) rows of every other window, which a test leaves out of the fit.

        Each stretch begins in a window that the fit sees: what its integral begins with shows only
        there, and a servo that was left to guess it would not be told from one without.
        """
        counts = np.array([len(each) for each in self.rows])
        pairs = np.maximum(1, np.rint(0.5 * _WINDOWS * counts / max(counts.sum(), 1)).astype(int))
        windows = zip(counts.tolist(), pairs.tolist(), strict=True)
        return np.concatenate([np.arange(n) * 2 * k // max(n, 1) % 2 == 1 for n, k in windows])


class _Linear(NamedTuple):
    """A servo by a linear fit."""

    left: Array  # (N,) what stays unexplained of what it is behind, rad or m
    gain: float
    delay: float
    integral: float


def _late_error(rows: Array, period: float, delay: float) -> tuple[Array, Array]:
    """Return how far late commands (N,) are ahead of positions, and the integral of that."""
    time = period * np.arange(len(rows))
    ahead = np.interp(time - delay, time, rows[:, 7]) - rows[:, 4]
    return ahead, period * np.cumsum(ahead)


def _even(count: int, length: int) -> list[slice]:
    """Return slices of about some length that cover so many rows."""
    ends = np.linspace(0, count, max(1, round(count / length)) + 1).round().astype(int).tolist()
    return [slice(*pair) for pair in pairwise(ends)]


def _runs(values: Array, kept: Mask) -> list[Array]:
    """Return pieces of values that are kept one after another."""
    cuts = np.flatnonzero(np.diff(kept)) + 1
    pieces = zip(np.split(values, cuts), np.split(kept, cuts), strict=True)
    return [piece for piece, there in pieces if len(there) and there[0]]


def motions_of(
    model: RobotModel,
    logs: Sequence[JointLog],
    trajectories: Sequence[Trajectory],
    joints: Sequence[int],
) -> dict[int, JointMotions]:
    """Return what simulations of some joints, each alone, need, by the index of the joint."""
    rows: dict[int, list[Array]] = {j: [] for j in joints}
    positions: dict[int, list[Array]] = {j: [] for j in joints}
    periods = []
    for log, trajectory in zip(logs, trajectories, strict=True):
        command = np.full_like(log.position, np.nan) if log.command is None else log.command
        robot = carrying(model, log.payloads)
        for stretch in trajectory.segments:
            chunks = [(part.time, _about(robot, part)) for _, part in stretch.chunks()]
            time = np.concatenate([instants for instants, _ in chunks])
            columns = np.concatenate([values for _, values in chunks])  # (N, 7, n)
            for j in joints:
                told = _read(log.time, command[:, j], time)
                rows[j].append(contiguous(np.column_stack([columns[:, :, j], told])))
                positions[j].append(_read(log.time, log.position[:, j], time))
            periods.append(stretch.period)
    return {j: JointMotions(tuple(rows[j]), tuple(positions[j]), tuple(periods)) for j in joints}


def _about(model: RobotModel, part: Segment) -> Array:
    """Return (N, 7, n) b, M, K, D, q, q̇ and q̈ of every joint alone."""
    motion = (model.positions(part.position), part.velocity, part.acceleration)
    slopes = effort_slopes(model.tree, *motion, model.total_phi)
    kinds = (slopes.acceleration, slopes.position, slopes.velocity)
    own = (np.diagonal(slope, axis1=1, axis2=2) for slope in kinds)
    b = inverse_dynamics(model.tree, *motion, model.total_phi)
    return np.stack([b, *own, part.position, part.velocity, part.acceleration], 1)


def _read(time: Array, values: Array, instants: Array) -> Array:
    """Return values of a log at other instants, between those that are there."""
    known = np.isfinite(time) & np.isfinite(values)
    return np.interp(instants, time[known], values[known])
