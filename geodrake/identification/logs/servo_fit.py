"""Gains of servos by the motion itself: each joint simulated under its commands, and compared.

What a stiff servo makes of its command hardly shows in inverse dynamics: it moves its joint almost
as it is told, so that its stiffness times how far it lags, its damping and its delay all look like
friction. It shows in how the joint moves. Each joint is therefore simulated alone, while all others
move as they were measured to. Near the measured motion the bodies' effort is linear,

    b + M (ẍ − q̈) + D (ẋ − q̇) + K (x − q),

with slopes of the recursion, and the joint's motion x follows from

    … + o + I ẍ + d ẋ + (F + k l²) sgn ẋ
        = kp e + kr (dc/dt(t − δ) − ẋ) + w + ki ∫e dt,    e = dead(c(t − δ) − x),

where dead takes a dead band b off an error, and the load l of the bodies is the first line: a gear
rubs by all that goes through it, or where it brakes by so much of that that it does not lock
(`SquaredLoadFriction`).

Its parameters are those of least squares of x − q by Levenberg and Marquardt's method, from a
linear fit on; what a data sheet says of them, and a usual delay, count like further samples. They
count only if windows of the log that the fit did not see are predicted better than from where it
began.

An integral that goes on since before the log has left an effort w where a stretch begins, of which
nobody knows; without an integral w would be a constant effort. A servo therefore has an integral
only if windows that a fit did not see are predicted better with ki than with such a constant alone,
and if all of them then say that there is one.

A servo saturates in the simulation, its integral held, where such windows are predicted better for
it: at the limit of effort that the model states, or at one of its own, which is sought like another
parameter, from what bodies need at most on. A share of the damping d is the servo's own, within the
limit, and the rest the joint's: only a servo at its limit tells them apart.

Friction by the load is rarer than all else: it must predict such windows better, too, and a dead
band by far.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, contiguous, inlined
from geodrake.effects.of_files import BRAKING_SHARE
from geodrake.identification.logs.criteria import PENALTY, WORTH
from geodrake.identification.logs.effort_gains import ALIKE
from geodrake.identification.logs.evidence import effective_samples
from geodrake.logs.motion import JointLog, Trajectory
from geodrake.logs.smoothing import Segment
from geodrake.model.carried_payloads import carrying
from geodrake.model.effort_signal import EffortSignal
from geodrake.model.robot_model import RobotModel
from geodrake.model.signal_efforts import calc_beyond
from geodrake.robot.effort_slopes import effort_slopes
from geodrake.robot.regressor import inverse_dynamics

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
T = TypeVar("T", np.float64, np.bool_)

PARAMETERS = (
    "stiffness",
    "rate",
    "damping",
    "coulomb",
    "armature",
    "delay",
    "offset",
    "load",
    "integral",
    "dead_band",
)
"""kp, kr, d, F, I, δ, o, k, ki and b; of joints that turn in N·m/rad, N·m·s/rad (twice), N·m,
kg·m², s, N·m, 1/(N·m), N·m/(rad·s) and rad.

Numbers of a servo are these, its limit (infinite for none), the share of d within it, and the
efforts w that an integral begins with, one for each stretch.
"""

LONGEST_DELAY, USUAL_DELAY = 0.06, 0.01
"""Commands are late by no more, and in the mean, s."""

USUAL_PERIOD = 1e-3
"""Servos compute their effort about so often, s: the motion that they feel is late by as much.

As a servo's damping and the joint's inertia make up for that exactly, no motion tells it.
"""

_RATE, _DAMPING, _COULOMB, _ARMATURE, _DELAY, _OFFSET, _LOAD, _INTEGRAL = 1, 2, 3, 4, 5, 6, 7, 8
_BAND, _LIMIT, _SHARE, _BEGUN = 9, 10, 11, 12
_PLACES = {name: at for at, name in enumerate((*PARAMETERS, "limit"))}
_STEPS, _LONGEST_STEP = 4, 5e-3  # of simulations between two rows at least, and at most so long, s
_THETA = 0.55  # how far within a step forces are as they are there
_WINDOWS = 8  # of all logs, two of a stretch at least; every other one is left out for a test
_SOUGHT, _PIECE = 40.0, 10.0  # s of all stretches that searches see, in pieces of so many
_MOST_EVALUATIONS, _FIRST_EVALUATIONS = 60, 8
_SETTLED = 1e-4  # share of its sum of squares that the last step of a search takes off
_FIRST_DAMPING, _LEAST_DAMPING = 1e-3, 1e-9  # of steps, over squares of slopes
_FARTHEST = 3.0  # deviations of a number from what is expected
_LEAST_LIMIT = 0.01  # of its size
LOWERED = 0.7  # deviation of the logarithm of a limit from a stall torque: servos are set to less
_USUAL_LOAD, _MOST_LOAD = 0.2, 2.0  # of the largest load, that friction by its square is there
_USUAL_BAND = 0.01  # rad or m
_IDLE_LEAVES = 0.5  # share of what is left of positions, that a dead band leaves at most
_NOTHING = float(np.finfo(float).tiny)  # rad² or m², of a joint that stands exactly still
_SMOOTHER = 1.0 / 24.0 / np.sqrt(3.0)  # of second differences of commands: deviation
_FAR = 1e3  # rad or m, from the measured motion, and no farther: squares stay numbers
_TRIED_DELAYS = (0.0, 0.01, 0.03)  # s, that searches begin from
_LINEAR_DELAYS = tuple(np.linspace(0.0, LONGEST_DELAY, 7).tolist())  # and linear fits try, s


@dataclass(frozen=True, eq=False)
class ServoFit:
    """A servo and what its joint has beside the bodies, by the joint's motion."""

    # (10,) values of `PARAMETERS`: the rate's with all damping that the servo makes, damping that
    # of the joint alone; the last two are 0 for a servo without an integral, and a dead band
    parameters: Array
    # (10,) their standard deviations; of all but kp for bodies that are known exactly. Counted are
    # feedback that acts late, and commands between the rows of a log, which no log shows
    deviations: Array
    error: float  # RMS of simulated − measured positions, rad or m
    start: float  # the same where the search began
    moved: float  # deviation of the measured positions, rad or m
    limit: float  # effort at which the servo saturates; infinite where the motion shows none
    rate_share: float  # of the command's rate, that the servo's damping knows

    def with_gain_uncertainty(self, share: float) -> ServoFit:
        """Return the fit with deviations no smaller than its gain's, as a share.

        The motion tells ratios of forces: all but times and positions scale with the stiffness.
        """
        forces = ~np.isin(PARAMETERS, ("delay", "dead_band"))
        least = share * forces * np.abs(self.parameters)
        return replace(self, deviations=np.maximum(self.deviations, least))


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
        numbers = np.zeros(_BEGUN + len(self.rows))
        numbers[: len(parameters)], numbers[_LIMIT] = parameters, limit
        own = (1.0 - rate_share) * numbers[_RATE]
        if own > 0.0:
            numbers[_RATE] -= own
            numbers[_DAMPING] += own
            numbers[_SHARE] = own / numbers[_DAMPING]
        return numbers

    def simulated(self, servo: Array) -> Array:
        """Return positions (N,) under the commands, rad or m."""
        x = np.empty(len(self.measured))
        calc_servo_motions(*self._whole, servo, (x, np.empty((0, 0))))
        return x

    def with_slopes(self, servo: Array, free: Mask) -> tuple[Array, Array]:
        """Return the residual (N,), and its slopes (N, f) with numbers (12 + S,) that are free."""
        count = len(free) if free[_INTEGRAL:].any() else _INTEGRAL
        x, J = np.empty(len(self.measured)), np.zeros((len(self.measured), count))
        calc_servo_motions(*self._whole, servo, (x, J))
        return x - self.measured, J[:, free[:count]]

    def with_integral(self, servo: Array, integral: float) -> Array:
        """Return a servo with an integral that begins as bodies need it in the mean."""
        found = servo.copy()
        found[_INTEGRAL] = integral
        for k, (rows, period) in enumerate(zip(self.rows, self.periods, strict=True)):
            ahead, summed = _late_error(rows, period, float(servo[_DELAY]))
            effort = servo[0] * ahead + integral * summed
            found[_BEGUN + k] = np.mean(rows[:, 0] - effort)
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


@dataclass(frozen=True, eq=False)
class _Servo:
    """A servo in a search: its numbers (12 + S,), and which of them (12 + S,) move."""

    numbers: Array
    free: Mask

    @classmethod
    def of(cls, numbers: Array, *, summed: bool = False) -> _Servo:
        """Return one with an integral, or a constant effort w in each stretch, or without."""
        free = np.arange(len(numbers)) < _LOAD
        free[_INTEGRAL], free[_SHARE] = summed, np.isfinite(numbers[_LIMIT])
        free[_OFFSET], free[_BEGUN:] = not summed, summed  # w has it
        return cls(numbers, free)

    @property
    def summed(self) -> bool:
        """Whether each stretch has an effort w."""
        return bool(self.free[_BEGUN])

    def freed(self, which: int) -> _Servo:
        """Return the servo with one more of its numbers free."""
        free = self.free.copy()
        free[which] = True
        return _Servo(self.numbers, free)

    def without(self, which: int) -> _Servo:
        """Return the servo with one of its numbers zero for good."""
        numbers, free = self.numbers.copy(), self.free.copy()
        numbers[which], free[which] = 0.0, False
        return _Servo(numbers, free)

    def plain(self) -> _Servo:
        """Return the servo without an integral."""
        numbers, free = self.numbers.copy(), self.free.copy()
        numbers[_INTEGRAL], numbers[_BEGUN:] = 0.0, 0.0
        free[_INTEGRAL], free[_BEGUN:], free[_OFFSET] = False, False, True
        return _Servo(numbers, free)

    def along(self, motions: JointMotions) -> _Servo:
        """Return the servo along other stretches; its integral begins as bodies need it."""
        plain = self.numbers[:_BEGUN]
        numbers = motions.servo(plain.tolist(), limit=float(plain[_LIMIT]))
        if self.summed:
            numbers = motions.with_integral(numbers, float(plain[_INTEGRAL]))
        numbers[_SHARE] = plain[_SHARE]
        free = np.append(self.free[:_BEGUN], np.full(len(motions.rows), self.summed))
        return _Servo(numbers, free)

    def limited(self, limit: float, share: float, *, sought: bool = False) -> _Servo:
        """Return the servo with another limit, and a share of its damping within it to be found."""
        numbers, free = self.numbers.copy(), self.free.copy()
        numbers[[_LIMIT, _SHARE]] = limit, share
        free[_LIMIT], free[_SHARE] = sought, np.isfinite(limit)
        return _Servo(numbers, free)


Expected = Mapping[str, tuple[float, float]]
"""Parameter above 0, or `limit` -> what is expected of it, and the deviation of its logarithm."""


def fit_servo(
    motions: JointMotions,
    signal: EffortSignal,
    limit: float = np.inf,
    *,
    expected: Expected | None = None,
    bodies: float = 0.0,
) -> ServoFit | None:
    """Return the servo that moves a joint as it was measured to, from that by a linear fit on.

    The `limit` is the largest effort of the joint, N·m or N, by the model: the servo may keep it,
    or another one, or none. Of the stiffness and other parameters values may be `expected`, by
    default of the stiffness about that by the linear fit; `bodies` are known to a share. A limit
    that is expected is the servo's where the motion does not reach it. None if windows that the fit
    did not see are predicted no better than from where it began, or than by a joint that stands
    still.
    """
    inertia, some = np.concatenate(motions.rows)[:, 1], motions.pieces()
    begin = [
        signal.gain,
        signal.damping,
        0.05 * signal.gain,
        0.1 * float(np.std(motions.needed)),
        0.2 * float(np.mean(inertia)),
        signal.delay,
        *np.zeros(_BAND - _OFFSET),
        signal.dead_band,
    ]
    expected = {"stiffness": (signal.gain, ALIKE), **(expected or {})}
    told = signal.integral or some.linear_servo(signal).integral
    first = _Search(some, told, expected)
    found = first.with_dead_band(first.at_its_limit(some.servo(begin), limit))
    loaded = first.best([found.freed(_LOAD)], seen=True)
    if some is not motions:
        found, loaded = found.along(motions), loaded.along(motions)
    search, start = replace(first, motions=motions), motions.servo(begin)
    fit = search.fitted(found, loaded, start, bodies)
    if (
        fit is not None
        and fit.parameters[_INTEGRAL] ** 2 < PENALTY * fit.deviations[_INTEGRAL] ** 2
    ):
        plain = search.best([found.plain()], seen=True)
        return search.fitted(plain, plain.freed(_LOAD), start, bodies)
    return fit


@dataclass(frozen=True, eq=False)
class _Search:
    """Searches for the servo of a joint, from servos (12 + S,) on."""

    motions: JointMotions
    told: float  # the integral gain by a linear fit; 0 if it has none
    expected: Expected

    def fitted(self, half: _Servo, loaded: _Servo, start: Array, bodies: float) -> ServoFit | None:
        """Return the fit to all rows, from those to half of the windows on; see `fit_servo`.

        One of these has friction by the load.
        """
        motions, began = self.motions, start.copy()
        began[[_LIMIT, _SHARE]] = half.numbers[[_LIMIT, _SHARE]]
        sought, limited = half.free[_LIMIT], began[[_LIMIT, _SHARE]].tolist()
        half, loaded = half.limited(*limited), loaded.limited(*limited)
        tested, moved = motions.tested, float(np.std(motions.measured))
        if not motions.rms(half.numbers, tested) < min(motions.rms(began, tested), moved):
            return None
        loaded = self.best([loaded], seen=True)
        if motions.gain(half.numbers, loaded.numbers, tested) >= PENALTY:
            half = loaded
        best = self.best([half])
        usual, spread = self.expected.get("limit", (np.inf, np.inf))
        if sought:
            never = self.best([best.limited(np.inf, 0.0), _Servo.of(start)])
            odd = np.log(best.numbers[_LIMIT] / usual) / spread if np.isfinite(usual) else 0.0
            if motions.gain(never.numbers, best.numbers) < PENALTY + odd**2:
                best = never
        for which in (_OFFSET, _LOAD, _BAND, _RATE, _DELAY, _SHARE):
            bare = best.without(which)
            if best.numbers[which]:
                bare = self.best([bare])
            if motions.gain(bare.numbers, best.numbers) < PENALTY:
                best = bare
        error, first = motions.rms(best.numbers), motions.rms(began)
        if not error < min(first, moved):
            return None
        if np.isfinite(usual):
            # Of what a servo gives, friction takes its part before the shaft of a data sheet.
            dry = float(best.numbers[_COULOMB] + best.numbers[_LOAD] * usual**2)
            held = best.limited(usual + dry, 0.0)
            if (motions.residual(held.numbers) == motions.residual(best.numbers)).all():
                best = held
        parameters, limit, rate_share = _with_own_damping(best.numbers)
        deviations = self._deviations(best)
        # Bodies that are heavier move as these do with a stiffness that is larger by as much.
        whole = np.hypot(deviations[0], bodies * parameters[0])
        deviations[0] = min(whole, self.expected["stiffness"][1] * parameters[0])
        return ServoFit(parameters, deviations, error, first, moved, limit, rate_share)

    def at_its_limit(self, start: Array, limit: float) -> _Servo:
        """Return the servo by half of the windows, saturating as the others ask for.

        That is never, or at a limit of the joint, or at one that is found.
        """
        motions, begin, best = self.motions, _Servo.of(start), self._by_half(start)

        def is_better(servo: _Servo) -> bool:
            gain = motions.gain(best.numbers, servo.numbers, motions.tested)
            return gain >= PENALTY * (1 + int(servo.summed) - int(best.summed))

        tried = [(each.numbers, each.limited(limit, 0.0).numbers) for each in (begin, best)]
        if any((motions.simulated(free) != motions.simulated(held)).any() for free, held in tried):
            hidden = replace(self, told=self.told or float(start[0]))  # an integral by its limit
            other = hidden._by_half(begin.limited(limit, 0.0).numbers)
            best = other if is_better(other) else best
        starts = [best]
        for integral in (0.0, self.told or start[0]):
            starts.append(_Servo.of(motions.with_integral(start, integral), summed=True))
        starts = [
            each.limited(self._most, share, sought=True) for share in (0.0, 1.0) for each in starts
        ]
        found = self.best(starts, seen=True)
        if is_better(found):
            told = float(found.numbers[_INTEGRAL]) or self.told
            other = replace(self, told=told)._by_half(found.plain().numbers)
            found = self.best([other.freed(_LIMIT)], seen=True)
            best = found if is_better(found) else best
        return best

    def with_dead_band(self, servo: _Servo) -> _Servo:
        """Return the servo with a dead band, if that predicts the other windows far better.

        One that takes away little of what is left of positions is not told from what else is
        lacking, such as the steps of a servo's clock. It is sought where slopes promise enough.
        """
        motions, tried = self.motions, servo.freed(_BAND)
        seen, rows = motions.seen
        left, J = (each[rows] for each in seen.with_slopes(servo.numbers, tried.free))
        unexplained = left - J @ np.linalg.lstsq(J, left)[0]
        if np.std(unexplained) > np.sqrt(_IDLE_LEAVES) * np.std(left):
            return servo
        idle, tested = self.best([tried], seen=True), motions.tested
        far = motions.rms(idle.numbers, tested) <= _IDLE_LEAVES * motions.rms(servo.numbers, tested)
        worth = motions.gain(servo.numbers, idle.numbers, tested) >= PENALTY
        return idle if far and worth else servo

    @cached_property
    def _most(self) -> float:
        """The most effort that bodies need, N·m or N; 1 if they need none."""
        return float(np.abs(self.motions.needed).max()) or 1.0

    def _by_half(self, start: Array) -> _Servo:
        """Return a servo by the windows that a test does not need.

        It has an integral if the others are predicted better with it than with a constant effort.
        """
        motions = self.motions
        starts = [start]  # with several delays, and damping known to the command or not
        for delay in _TRIED_DELAYS:
            starts.append(start.copy())
            starts[-1][[_RATE, _DELAY]] = 0.0 if delay else 0.5 * start[2], delay
        if np.isfinite(start[_LIMIT]):
            starts = [_with_share(each, share) for share in (0.0, 1.0) for each in starts]
        plain = self.best([_Servo.of(each) for each in starts], seen=True)
        constant = _Servo.of(plain.numbers, summed=True)
        if not self.told:
            return plain
        resets = [motions.with_integral(each, self.told) for each in starts]
        best = self.best([_Servo.of(each, summed=True) for each in resets], seen=True)
        constant = self.best([each.without(_INTEGRAL) for each in (constant, best)], seen=True)
        worth = motions.gain(constant.numbers, best.numbers, motions.tested)
        return best if worth >= PENALTY else plain

    def best(self, starts: Sequence[_Servo], *, seen: bool = False) -> _Servo:
        """Return the least squares over all rows, or those that a fit sees, from several starts on.

        Of several the one that is best after a few steps is followed to its end. What is expected
        of numbers bounds them in searches, and counts over all rows.
        """
        whole, size = self.motions, len(starts[0].numbers)
        most = _MOST_EVALUATIONS if len(starts) == 1 else _FIRST_EVALUATIONS
        motions, rows = whole.seen if seen else (whole, np.ones(len(whole.measured), bool))
        expected = {_PLACES[name]: value for name, value in self.expected.items()}
        places = [at for at in expected if starts[0].free[at] or at != _LIMIT]
        usual, spread = np.transpose([expected[at] for at in places])
        weights, late = 0.0 * spread, 0.0
        if not seen:  # on the scale of what is left of positions
            left = motions.residual(starts[0].numbers)
            noise = np.sqrt(left @ left / WORTH)
            weights, late = noise / spread, noise / USUAL_DELAY * np.sqrt(2.0 / np.pi)
        upper, lower = np.full((2, size), np.inf)
        upper[[_DELAY, _LOAD]] = LONGEST_DELAY, _MOST_LOAD / self._most
        lower[:_BEGUN], lower[_LIMIT], lower[_BEGUN:] = 0.0, _LEAST_LIMIT * self._most, -np.inf
        lower[_OFFSET], upper[_SHARE] = -np.inf, 1.0
        farthest = np.exp(_FARTHEST * spread)
        lower[places], upper[places] = usual / farthest, usual * farthest

        def search(start: _Servo) -> tuple[float, _Servo]:
            free = start.free

            def numbers(x: Array) -> Array:
                found = start.numbers.copy()
                found[free] = x
                return found

            def residual(x: Array) -> Array:
                return beside(numbers(x), motions.simulated(numbers(x)) - motions.measured)

            def beside(at: Array, left: Array) -> Array:
                known = weights * np.log(at[places] / usual)
                return np.hstack([left[rows], known, late * at[_DELAY]])

            def with_slopes(x: Array) -> tuple[Array, Array]:
                at, own = numbers(x), np.zeros((len(places) + 1, size))
                own[range(len(places)), places] = weights / at[places]
                own[-1, _DELAY] = late
                left, J = motions.with_slopes(at, free)
                return beside(at, left), np.vstack([J[rows], own[:, free]])

            begin = np.clip(start.numbers, lower, upper)[free]
            x, cost = _descend((residual, with_slopes), begin, (lower[free], upper[free]), most)
            return cost, replace(start, numbers=numbers(x))

        best = min(map(search, starts), key=lambda each: each[0])[1]
        return best if len(starts) == 1 else self.best([best], seen=seen)

    def _deviations(self, best: _Servo) -> Array:
        """Return (10,) standard deviations of parameters that are free.

        Each is that with all others unknown, and with what no log shows; see `_unobservable`.
        """
        numbers, free, gain = best.numbers, best.free, best.numbers[0]
        least = np.full(len(numbers), float(np.std(self.motions.needed)) or 1.0)
        least[:_OFFSET] = 0.0, 0.02 * gain, 0.01 * gain, 1e-3, 1e-4, 0.01
        least[_LOAD], least[_INTEGRAL], least[_SHARE] = _USUAL_LOAD / self._most, gain, 0.5
        least[_BAND] = _USUAL_BAND
        size = np.maximum(np.abs(numbers), least)[free]
        J = self.motions.with_slopes(numbers, free)[1]
        columns = np.column_stack([J * size, *self._unobservable(numbers, J, free)])
        # What the motion does not show is known to its own size.
        known = np.ones(columns.shape[1])
        for name, (_, spread) in self.expected.items():
            known[: len(size)][np.flatnonzero(free) == _PLACES[name]] = spread**-2.0
        H = columns.T @ columns / self.motions.noise(self.motions.residual(numbers))
        values, vectors = np.linalg.eigh(H + np.diag(known))
        # (Rounding may leave less than what is known.)
        covariance = vectors / np.maximum(values, known.min()) @ vectors.T
        moves = np.zeros((len(free), len(known)))
        moves[free, : len(size)] = np.diag(size)
        d, share = numbers[[_DAMPING, _SHARE]]
        own = share * moves[_DAMPING] + d * moves[_SHARE]
        moves[_RATE] += own
        moves[_DAMPING] -= own
        return np.sqrt(np.einsum("ij,jk,ik->i", moves, covariance, moves))[:_LIMIT]

    def _unobservable(self, numbers: Array, J: Array, free: Mask) -> tuple[Array, Array]:
        """Return changes (N,) of positions by one deviation of each quantity that no log shows.

        Feedback that acts late by τ takes kp τ off the damping and d τ off the inertia. How
        commands go on between rows of period T matters too: one that a servo holds is, but for a
        delay, a smooth one c with T² c̈ / 24 more in the mean; any share of that is as likely.
        `J` (N, f) are slopes with the numbers that are `free`.
        """
        motions, at = self.motions, np.flatnonzero(free).searchsorted([_DAMPING, _ARMATURE])
        late = J[:, at] @ [numbers[0], numbers[_RATE] + numbers[_DAMPING]]
        rows = tuple(each.copy() for each in motions.rows)
        for each in rows:
            each[1:-1, 7] -= _SMOOTHER * np.diff(each[:, 7], 2)
        rounded = replace(motions, rows=rows).simulated(numbers)
        return -USUAL_PERIOD * late, rounded - motions.measured - motions.residual(numbers)


def _with_share(numbers: Array, share: float) -> Array:
    """Return numbers of a servo that makes a share of the damping."""
    found = numbers.copy()
    found[_SHARE] = share
    return found


def _with_own_damping(numbers: Array) -> tuple[Array, float, float]:
    """Return parameters (10,) of a servo that makes its share of the damping, and two numbers more.

    These are its limit, and how much of the command's rate its damping knows.
    """
    parameters, share = numbers[:_LIMIT].copy(), float(numbers[_SHARE])
    own, known = share * float(parameters[_DAMPING]), float(parameters[_RATE])
    parameters[[_RATE, _DAMPING]] = known + own, parameters[_DAMPING] - own
    return parameters, float(numbers[_LIMIT]), known / (known + own) if own else 1.0


def _descend(
    functions: tuple[Callable[[Array], Array], Callable[[Array], tuple[Array, Array]]],
    x: Array,
    bounds: tuple[Array, Array],
    most: int,
) -> tuple[Array, float]:
    """Return the least squares of residuals by their slopes, from x on within bounds, and the sum.

    Steps are those of Levenberg and Marquardt. Numbers may lie on bounds, such as dry friction that
    is not there, where SciPy's `least_squares` goes on and on. Functions return residuals, and
    these with their slopes; after a step that failed the next may fail, too, and needs none.
    """
    residual, with_slopes = functions
    (left, J), damping = with_slopes(x), _FIRST_DAMPING
    cost = float(left @ left)
    for _ in range(most):
        with np.errstate(over="ignore", invalid="ignore"):
            H, pull = J.T @ J, J.T @ left
        if not np.isfinite(H).all():  # of a servo that makes its joint swing up
            break
        gain, failed = 0.0, False
        while not gain > 0.0:  # nor if it is no number
            damped = H + np.diag(damping * np.diag(H) + _NOTHING)
            step = _bounded(damped, pull, bounds[0] - x, bounds[1] - x)
            promised = -float(step @ (2.0 * pull + H @ step))
            if promised <= _SETTLED * cost:
                return x, cost
            left, J = (residual(x + step), J) if failed else with_slopes(x + step)
            gain = cost - float(left @ left)
            failed = failed or not gain > 0.0
            damping *= 0.1 if gain > 0.5 * promised else 1.0 if gain > 0.0 else 10.0
            damping = max(damping, _LEAST_DAMPING)
        x, cost = x + step, cost - gain
        if gain <= _SETTLED * cost:  # dry friction lets slopes promise more, again and again
            break
        if failed:
            left, J = with_slopes(x)
    return x, cost


def _bounded(H: Array, pull: Array, lower: Array, upper: Array) -> Array:
    """Return a step within bounds that lowers xᵀ H x / 2 + pullᵀ x, what meets a bound stays there.

    What a bound holds from the beginning does not move.
    """
    step = np.zeros(len(pull))
    free = ~((lower >= 0.0) & (pull >= 0.0) | (upper <= 0.0) & (pull <= 0.0))
    while free.any():
        way = np.zeros(len(pull))
        way[free] = np.linalg.solve(H[np.ix_(free, free)], -(pull + H @ step)[free])
        bound = np.where(way < 0.0, lower, upper)
        room = np.divide(bound - step, way, out=np.full(len(way), np.inf), where=way != 0.0)
        share = min(1.0, float(room.min()))
        step = np.where(room <= share, bound, step + share * way)
        if share == 1.0:
            break
        free &= room > share
    return step


@compiled
def calc_servo_motions(
    rows: Array, ends: Indices, periods: Array, servo: Array, out: tuple[Array, Array]
) -> None:
    """Write the positions of a joint along stretches, one after the other; see the next.

    Args:
        rows: (N, 8) of all stretches.
        ends: (S,) where each ends.
        periods: (S,) s.
        servo: (12 + S,) numbers of a servo, an effort w for each stretch.
        out: (N,) positions, and (N, 8 or 11 + S) their slopes with these numbers; or none.
    """
    positions, slopes = out
    here, begin = servo[: _BEGUN + 1].copy(), 0
    for k in range(len(ends)):
        at = slice(begin, ends[k])
        here[_BEGUN] = servo[_BEGUN + k]
        calc_servo_motion(rows[at], periods[k], here, (positions[at], slopes[at]))
        if slopes.shape[1] > _INTEGRAL and k > 0:
            slopes[at, _BEGUN + k] = slopes[at, _BEGUN]
            slopes[at, _BEGUN] = 0.0
        begin = ends[k]


@compiled
def calc_servo_motion(rows: Array, period: float, servo: Array, out: tuple[Array, Array]) -> None:
    """Write the positions (N,) of a joint under its commands, by steps of the theta method.

    Forces are those between both ends of a step, where the error is of second order but for what
    damps stiff joints. Dry friction is that of the velocity and of the load afterwards, and a set
    at rest: a joint sticks until more than F + k l² pulls at it. Slopes are those of the steps
    themselves, while a joint that sticks goes on doing so. One that a weak servo lets
    run away is held where it is far from the measured motion.

    Args:
        rows: (N, 8) b, M, K, D, q, q̇, q̈ and the command.
        period: Time between rows, s.
        servo: (13,) kp, kr, d, F, I, δ, o, k, ki, b, the largest effort, the share of d within it,
            and w.
        out: (N,) positions, and (N, p) their slopes with the first 8 of these numbers, or with all
            but the share; (0, p) if those are not asked for.
    """
    positions, slopes = out
    steps = max(_STEPS, int(np.ceil(period / _LONGEST_STEP)))
    kp, kr, d, F, armature, delay, offset, load, ki, band, limit, own, w = servo
    dt, per, late = period / steps, steps / period, delay / period
    x, v, z = rows[0, 4], rows[0, 5], 0.0
    c, rise = calc_command_before(rows, -late, period)
    count = min(slopes.shape[1], _BEGUN + 1) if len(slopes) > 0 else 0
    at_numbers, direct, ahead = np.zeros((3, count)), np.zeros(13), _THETA * dt
    reach, least = kp + ki * ahead, -BRAKING_SHARE / load  # (minus infinity without any)
    positions[0], slopes[:1, :count] = x, 0.0
    for k in range(len(rows) - 1):
        for s in range(steps):
            b, M, K, D, q, qd, qdd = calc_between(rows[k], rows[k + 1], (s + _THETA) / steps)
            before, rise_before = c, rise
            c, rise = calc_command_before(rows, k + (s + 1.0) / steps - late, period)
            told = (1.0 - _THETA) * before + _THETA * c
            inertia, free, old = (M + armature) * per, D + (1.0 - own) * d, (1.0 - _THETA) * v
            at = x + ahead * old
            side = np.sign(calc_beyond(told - x - ahead * v, band))
            acts = 1.0 if band == 0.0 else abs(side)
            soft = (acts * reach * ahead + kr + own * d) * _THETA
            drive = acts * reach * (told - at - side * band) + ki * z + w
            drive += kr * ((c - before) * per - old) - own * d * old
            held = b + K * (at - q) + D * (old - qd) - M * qdd
            rest = inertia * v - held - offset - (free - D) * old
            heavy = inertia + K * ahead * _THETA + free * _THETA
            gear = F, load, least, held - M * per * v, M * per + D * _THETA
            now, way, stiff, bound = calc_within(limit, (drive, soft), (rest, heavy), gear)
            gives = 1.0 if bound == 0.0 else 0.0
            mean = old + _THETA * now
            error = acts * (told - x - ahead * mean - side * band)
            grows = gives > 0.0 or bound * error < 0.0
            if count > 0:
                later = (1.0 - _THETA) * rise_before + _THETA * rise
                through, rubs = calc_rubbing(gear, now, way)
                direct[:] = (
                    gives * error,
                    gives * ((c - before) * per - mean),
                    -(1.0 - own + own * gives) * mean,
                    -way,
                    (v - now) * per,
                    -gives * (acts * reach * later + kr * (rise - rise_before) * per),
                    -1.0,
                    -way * through**2,
                    gives * (z + ahead * error),
                    -gives * acts * reach * side,
                    np.sign(bound),
                    (1.0 - gives) * d * mean,
                    gives,
                )
                pushes, damps = inertia + rubs * M * per, free + rubs * D + gives * (kr + own * d)
                pulls, moves = K * (1.0 + rubs) + gives * acts * reach, abs(way) / stiff
                growing = dt * acts if grows else 0.0
                step = pushes, damps, pulls, gives * ki, moves, growing, dt
                move_slopes(at_numbers, direct, step)
                at_numbers[2, 5] -= growing * later
                if count > 9:
                    at_numbers[2, 9] -= growing * side
            v, x, z = now, x + dt * mean, z + (dt * error if grows else 0.0)
        if abs(x - rows[k + 1, 4]) > _FAR:
            x, v = rows[k + 1, 4] + np.copysign(_FAR, x - rows[k + 1, 4]), 0.0
            at_numbers[:2] = 0.0
        positions[k + 1] = x
        if count > 0:
            slopes[k + 1, :count] = at_numbers[0]


@compiled
def move_slopes(
    slopes: Array,
    direct: Array,
    step: tuple[float, float, float, float, float, float, float],
) -> None:
    """Take a step of slopes (3, p) of position, velocity and integral with numbers of a servo.

    Args:
        direct: Forces by which these numbers, and others after them, act by themselves.
        step: How much force a velocity before adds, what damps, what holds, what an integral gives,
            how much a force moves the joint (0 where it sticks), how long the integral grows, s,
            and the time, s.
    """
    inertia, damps, holds, gives, moves, grows, dt = step
    by_x, by_z = -moves * holds, moves * gives
    by_v = moves * (inertia - (1.0 - _THETA) * (damps + holds * _THETA * dt))
    xs, vs, zs = slopes[0], slopes[1], slopes[2]
    for i in range(len(xs)):
        x, v = xs[i], vs[i]
        now = moves * direct[i] + by_v * v + by_x * x + by_z * zs[i]
        mean = (1.0 - _THETA) * v + _THETA * now
        zs[i] -= grows * (x + _THETA * dt * mean)
        xs[i], vs[i] = x + dt * mean, now


@inlined
def calc_between(
    a: Array, b: Array, share: float
) -> tuple[float, float, float, float, float, float, float]:
    """Return b, M, K, D, q, q̇ and q̈ between two rows."""
    left = 1.0 - share
    return (
        left * a[0] + share * b[0],
        left * a[1] + share * b[1],
        left * a[2] + share * b[2],
        left * a[3] + share * b[3],
        left * a[4] + share * b[4],
        left * a[5] + share * b[5],
        left * a[6] + share * b[6],
    )


@inlined
def calc_within(
    limit: float,
    servo: tuple[float, float],
    joint: tuple[float, float],
    gear: tuple[float, float, float, float, float],
) -> tuple[float, float, float, float]:
    """Return the next three with a servo, and its effort where that is at its limit, or 0.

    Args:
        limit: The largest effort of the servo, N·m or N.
        servo: What it gives at rest, and how much of that a velocity takes away.
        joint: What else moves the joint at rest, and how much of that a velocity takes away.
        gear: See `calc_velocity_after`.
    """
    (drive, soft), (rest, heavy) = servo, joint
    now, way, stiff = calc_velocity_after(drive + rest, heavy + soft, gear)
    effort, bound = drive - soft * now, 0.0
    if effort > limit or effort < -limit:
        bound = limit if effort > 0.0 else -limit
        now, way, stiff = calc_velocity_after(bound + rest, heavy, gear)
    return now, way, stiff, bound


@inlined
def calc_rubbing(
    gear: tuple[float, float, float, float, float], v: float, way: float
) -> tuple[float, float]:
    """Return the load that counts for friction, along the velocity, and how much that grows."""
    _, load, least, held, grows = gear
    through = max(way * (held + grows * v), least)
    return through, 2.0 * load * through if through > least else 0.0


@inlined
def calc_velocity_after(
    pull: float, stiff: float, gear: tuple[float, float, float, float, float]
) -> tuple[float, float, float]:
    """Return the velocity after an implicit step, its direction, and how it resists more force.

    Velocity and direction are 0 if the joint sticks. There is one such velocity: where the load
    brakes, friction grows by less than the load does.

    Args:
        pull: What moves the joint at rest, N·m or N.
        stiff: How much of that a velocity takes away.
        gear: F and k of friction F + k l²; the least load l, along the velocity, that it grows
            with; the load of bodies that stop, and how it grows with the velocity.
    """
    F, load, least, held, grows = gear
    way = 1.0 if pull > 0.0 else -1.0
    if load == 0.0:
        most = way * pull - F
        return (way * most / stiff, way, stiff) if most > 0.0 else (0.0, 0.0, stiff)
    still = way * held
    most = way * pull - F - load * max(still, least) ** 2
    if most <= 0.0:
        return 0.0, 0.0, stiff
    speed, resists = most / stiff, stiff
    if load * grows > 0.0 and still + grows * speed > least:
        begins = (least - still) / grows if still < least else 0.0
        left = most - stiff * begins
        linear = stiff + 2.0 * load * max(still, least) * grows
        resists = np.sqrt(linear**2 + 4.0 * load * grows**2 * left)
        speed = begins + 2.0 * left / (linear + resists)
    return way * speed, way, resists


@compiled
def calc_command_before(rows: Array, at: float, period: float) -> tuple[float, float]:
    """Return the command at a row's number, which may be between two, and its rate.

    Between rows it is a cubic with the rates of central differences: straight lines would bend
    less than commands do, which a servo that knows their rate, and acts later, makes up for. Before
    the first row the command is as it is there.
    """
    if at <= 0.0:
        return rows[0, 7], 0.0
    last = len(rows) - 1
    low = min(int(at), last)
    high, g = min(low + 1, last), at - low
    a, b = rows[low, 7], rows[high, 7]
    left, right = 0.5 * (b - rows[max(low - 1, 0), 7]), 0.5 * (rows[min(high + 1, last), 7] - a)
    bend, twist = 3.0 * (b - a) - 2.0 * left - right, left + right - 2.0 * (b - a)
    rise = left + g * (2.0 * bend + 3.0 * g * twist)
    return a + g * (left + g * (bend + g * twist)), rise / period
