"""Gains of servos by the motion itself: each joint simulated under its commands, and compared.

What a stiff servo makes of its command hardly shows in inverse dynamics: it moves its joint almost
as it is told, so that its stiffness times how far it lags, its damping and its delay all look like
friction. It shows in how the joint moves. Each joint is therefore simulated alone, while all others
move as they were measured to. Near the measured motion the bodies' effort is linear,

    b + M (ẍ − q̈) + D (ẋ − q̇) + K (x − q),

with slopes of the recursion, and the joint's motion x follows from

    … + I ẍ + d ẋ + F sgn ẋ = kp (c(t − δ) − x) + kr (dc/dt(t − δ) − ẋ) + w + ki ∫(c(t − δ) − x) dt.

Its parameters are those of least squares of x − q, by SciPy, from a linear fit on. They count
only if windows of the log that the fit did not see are predicted better than from where it began.

An integral that goes on since before the log has left an effort w where a stretch begins, of which
nobody knows; without an integral w would be a constant effort. A servo therefore has an integral
only if windows that a fit did not see are predicted better with ki than with such a constant alone,
and if all of them then say that there is one.

A servo saturates in the simulation, its integral held, where such windows are predicted better for
it: at the limit of effort that the model states, or at one of its own, which is sought like another
parameter, from what bodies need at most on. Damping d is the joint's, beyond the limit, or the
servo's own, within: only a servo at its limit tells them apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from geodrake.compiling import compiled, contiguous
from geodrake.identification.logs.criteria import PENALTY, WORTH
from geodrake.identification.logs.evidence import effective_samples
from geodrake.logs.motion import JointLog, Trajectory
from geodrake.logs.smoothing import Segment
from geodrake.model.carried_payloads import carrying
from geodrake.model.effort_signal import EffortSignal
from geodrake.model.robot_model import RobotModel
from geodrake.robot.effort_slopes import effort_slopes
from geodrake.robot.regressor import inverse_dynamics

Array = NDArray[np.float64]
T = TypeVar("T", np.float64, np.bool_)
Servo = tuple[float, float, float, float, float, float, float, float, float, float]

PARAMETERS = ("stiffness", "rate", "damping", "coulomb", "armature", "delay", "integral")
"""kp, kr, d, F, I, δ and ki; of joints that turn in N·m/rad, N·m·s/rad (twice), N·m, kg·m², s and
N·m/(rad·s).

d is viscous friction, which damps the joint beside the servo. The efforts w that an integral begins
with follow, one for each stretch.
"""

LONGEST_DELAY = 0.06
"""Commands are late by no more, s."""

# Steps of simulations, s: a share of the time between rows, from and up to so much; of all, and of
# first searches.
_STEPS, _COARSE_STEPS = (0.05, 2.5e-4, 1e-3), (0.2, 1e-3, 4e-3)
_WINDOWS = 8  # of all logs, two of a stretch at least; every other one is left out for a test
_MOST_EVALUATIONS, _FIRST_EVALUATIONS = 60, 20
_LIMIT_STEP = 1e-3  # of a limit's size, for differences
_INSIDE = 0.01  # of parameters' sizes from their bounds, where searches begin
_RATE, _DELAY, _INTEGRAL = 1, 5, 6  # which parameter is which
_PLAIN = _INTEGRAL  # parameters of servos without an integral, which come first
_RESETS = (1.0, 5.0)  # ki / kp, 1/s, that searches begin from
_NOTHING = float(np.finfo(float).tiny)  # rad² or m², of a joint that stands exactly still
_FAR = 1e3  # rad or m, from the measured motion, and no farther: squares stay numbers
_TRIED_DELAYS = (0.0, 0.01, 0.03)  # s, that searches begin from


@dataclass(frozen=True, eq=False)
class ServoFit:
    """A servo and what its joint has beside the bodies, by the joint's motion.

    Attributes:
        parameters: (6,) values of `PARAMETERS`, all but the last.
        deviations: (6,) their standard deviations, for bodies that are known exactly.
        error: RMS of simulated − measured positions, rad or m.
        start: The same where the search began.
        moved: Deviation of the measured positions, rad or m.
        integral: The last of `PARAMETERS`; 0 for a servo without an integral.
        limit: Effort at which the servo saturates; infinite where the motion shows none.
        own: Whether the servo makes the viscous damping, within its limit.
    """

    parameters: Array
    deviations: Array
    error: float
    start: float
    moved: float
    integral: float = 0.0
    integral_deviation: float = 0.0
    limit: float = np.inf
    own: bool = False


@dataclass(frozen=True, eq=False)
class JointMotions:
    """One joint along the stretches of logs: what a simulation of it alone needs.

    Attributes:
        rows: Per stretch (N, 8) b, M, K, D, and smooth q, q̇, q̈, and the command.
        positions: Per stretch (N,) positions as logged, rad or m.
        periods: Per stretch the time between rows, s.
        limit: Largest effort of the servo, N·m or N.
        own: Whether the servo makes the damping d, within its limit.
    """

    rows: tuple[Array, ...]
    positions: tuple[Array, ...]
    periods: tuple[float, ...]
    limit: float = np.inf
    own: bool = False

    def simulated(
        self, parameters: Array, *, coarse: bool = False, slopes: bool = False
    ) -> tuple[Array, Array]:
        """Positions (N,) under the commands, rad or m, and their slopes (N, p) with parameters.

        Args:
            parameters: (p,) values of `PARAMETERS`, and efforts w of the stretches; or the first
                six of a servo without an integral.
            coarse: Whether long steps will do.
            slopes: Whether slopes are asked for; there are none (0, p) if not.
        """
        count = len(parameters)
        positions, tangents = [], []
        kp, kr, d, F, armature, delay, *more = parameters.tolist()
        ki, *began = more or (0.0, *np.zeros(len(self.rows)))
        stretches = zip(self.rows, self.periods, began, strict=True)
        for k, (rows, period, w) in enumerate(stretches):
            servo: Servo = (kp, kr, d, F, armature, delay, ki, w, self.limit, float(self.own))
            share, least, most = _COARSE_STEPS if coarse else _STEPS
            steps = max(1, int(np.ceil(period / min(max(share * period, least), most))))
            x = np.empty(len(rows))
            own = min(count, len(PARAMETERS) + 1)
            tangent = np.empty((len(rows) if slopes else 0, own))
            calc_servo_motion(rows, period, steps, servo, (x, tangent))
            positions.append(x)
            whole = np.zeros((len(tangent), count))
            whole[:, : min(count, len(PARAMETERS))] = tangent[:, : len(PARAMETERS)]
            if count > len(PARAMETERS):
                whole[:, len(PARAMETERS) + k] = tangent[:, -1]
            tangents.append(whole)
        return np.concatenate(positions), np.concatenate(tangents)

    def begun(self, parameters: Array) -> Array:
        """(S,) efforts w of the stretches with which servos give what bodies need in the mean.

        Args:
            parameters: (7,) values of `PARAMETERS`.
        """
        found = []
        for rows, period in zip(self.rows, self.periods, strict=True):
            time = period * np.arange(len(rows))
            ahead = np.interp(time - parameters[_DELAY], time, rows[:, 7]) - rows[:, 4]
            since = period * np.cumsum(ahead)
            effort = parameters[0] * ahead + parameters[_INTEGRAL] * since
            found.append(np.mean(rows[:, 0] - effort))
        return np.array(found)

    def residual(self, parameters: Array) -> Array:
        """(N,) simulated − measured positions of all stretches."""
        return self.simulated(parameters)[0] - self.measured

    @cached_property
    def measured(self) -> Array:
        """(N,) positions of all stretches, rad or m."""
        return np.concatenate(self.positions)

    def gain(self, before: Array, after: Array, rows: NDArray[np.bool_]) -> float:
        """Twice the log-likelihood that parameters gain over others on some rows.

        Args:
            before: (p,) parameters, as of `simulated`.
            after: (p,) the others.
            rows: (N,) which rows count.
        """
        return self.gain_of(self.residual(before), self.residual(after), rows)

    def gain_of(self, before: Array, after: Array, rows: NDArray[np.bool_] | None = None) -> float:
        """The same of residuals (N,), less the mean of each stretch.

        By that a joint is off where bodies are a little too heavy or a zero is another one. It says
        nothing of a servo, but would make all residuals go together, as if they were one.

        Args:
            rows: Which rows count; all if None.
        """
        rows = np.ones(len(after), bool) if rows is None else rows
        before, after = (self._centered(each, rows) for each in (before, after))
        pieces = zip(self._stretches(after), self._stretches(rows), strict=True)
        blocks = [block for piece, kept in pieces for block in _runs(piece, kept)]
        squares = [max(float(each[rows] @ each[rows]), _NOTHING) for each in (before, after)]
        return effective_samples(blocks) * float(np.log(squares[0] / squares[1]))

    def _stretches(self, values: NDArray[T]) -> list[NDArray[T]]:
        """Values (N,) of each stretch."""
        return np.split(values, np.cumsum([len(each) for each in self.rows])[:-1])

    def _centered(self, residual: Array, rows: NDArray[np.bool_]) -> Array:
        """(N,) a residual less its mean over some rows of each stretch."""
        pieces = zip(self._stretches(residual), self._stretches(rows), strict=True)
        means = [np.full(len(r), r[kept].mean() if kept.any() else 0.0) for r, kept in pieces]
        return residual - np.concatenate(means)

    @property
    def tested(self) -> NDArray[np.bool_]:
        """(N,) rows of every other window, which a test leaves out of the fit.

        Each stretch begins in a window that the fit sees: what its integral begins with shows only
        there, and a servo that was left to guess it would not be told from one without.
        """
        counts = np.array([len(each) for each in self.rows])
        pairs = np.maximum(1, np.rint(0.5 * _WINDOWS * counts / max(counts.sum(), 1)).astype(int))
        windows = zip(counts.tolist(), pairs.tolist(), strict=True)
        return np.concatenate([np.arange(n) * 2 * k // max(n, 1) % 2 == 1 for n, k in windows])


def _runs(values: Array, kept: NDArray[np.bool_]) -> list[Array]:
    """Pieces of values that are kept one after another."""
    cuts = np.flatnonzero(np.diff(kept)) + 1
    pieces = zip(np.split(values, cuts), np.split(kept, cuts), strict=True)
    return [piece for piece, there in pieces if len(there) and there[0]]


def motions_of(
    model: RobotModel,
    logs: Sequence[JointLog],
    trajectories: Sequence[Trajectory],
    joints: Sequence[int],
) -> dict[int, JointMotions]:
    """What simulations of some joints, each alone, need; see `JointMotions`.

    Returns:
        Index of the joint -> its motions.
    """
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
    """(N, 7, n) b, M, K, D, q, q̇ and q̈ of every joint alone."""
    motion = (model.positions(part.position), part.velocity, part.acceleration)
    slopes = effort_slopes(model.tree, *motion, model.total_phi)
    kinds = (slopes.acceleration, slopes.position, slopes.velocity)
    own = (np.diagonal(slope, axis1=1, axis2=2) for slope in kinds)
    b = inverse_dynamics(model.tree, *motion, model.total_phi)
    return np.stack([b, *own, part.position, part.velocity, part.acceleration], 1)


def _read(time: Array, values: Array, instants: Array) -> Array:
    """Values of a log at other instants, between those that are there."""
    known = np.isfinite(time) & np.isfinite(values)
    return np.interp(instants, time[known], values[known])


def fit_servo(
    motions: JointMotions, signal: EffortSignal, limit: float = np.inf
) -> ServoFit | None:
    """The servo that moves a joint as it was measured to.

    Args:
        signal: The servo by a linear fit, at which the search begins.
        limit: Largest effort of the joint, N·m or N, by the model: the servo may keep it, or
            another one, or none.

    Returns:
        The servo; None if windows that the fit did not see are predicted no better than from where
        it began, or than by a joint that stands still.
    """
    rows, stiffness = np.concatenate(motions.rows), signal.gain
    friction, inertia = 0.1 * np.std(rows[:, 0]), 0.2 * np.mean(rows[:, 1])
    damping = 0.05 * stiffness
    start = np.array([stiffness, signal.damping, damping, friction, inertia, signal.delay])
    found = _limited(motions, start, signal.integral, limit)
    fit = _fitted(found, start, signal.integral)
    if fit is not None and fit.integral**2 < PENALTY * fit.integral_deviation**2:
        half = replace(found, servo=found.servo[:_PLAIN], scale=found.scale[:_PLAIN])
        return _fitted(half, start, 0.0)
    return fit


def _fitted(found: _Half, start: Array, told: float) -> ServoFit | None:
    """The fit to all rows, from that to half of the windows on; see `fit_servo`.

    Args:
        start: (6,) the servo by a linear fit.
        told: The integral gain by that; 0 if it has none.
    """
    motions, half, scale = found.motions, found.servo, found.scale
    tested, every = motions.tested, np.ones(len(motions.measured), bool)
    summed = len(half) > _INTEGRAL
    began = _with_integral(motions, start, told) if summed and told else start
    moved = float(np.std(motions.measured))
    if not _rms(motions, half, tested) < min(_rms(motions, began, tested), moved):
        return None
    best = _best(motions, [half], scale, every)
    free = np.arange(len(best)) != _RATE
    bare = _best(motions, [np.where(free, best, 0.0)], scale, every, free=free)
    if motions.gain(bare, best, every) < PENALTY:
        best = bare
    if not _rms(motions, best, every) < min(_rms(motions, began, every), moved):
        return None
    deviations = _deviations(motions, best, scale)
    return ServoFit(
        best[:_PLAIN],
        deviations[:_PLAIN],
        _rms(motions, best, every),
        _rms(motions, began, every),
        moved,
        float(best[_INTEGRAL]) if summed else 0.0,
        float(deviations[_INTEGRAL]) if summed else 0.0,
        motions.limit,
        motions.own,
    )


@dataclass(frozen=True, eq=False)
class _Half:
    """A servo by the windows that a test does not need.

    Attributes:
        motions: The joint, and at which effort the servo saturates.
        servo: (p,) its parameters.
        scale: (p,) their sizes.
    """

    motions: JointMotions
    servo: Array
    scale: Array

    @classmethod
    def of(cls, motions: JointMotions, start: Array, told: float) -> _Half:
        """That of a joint; see `_by_half`."""
        return cls(motions, *_by_half(motions, start, told))

    def gain(self, motions: JointMotions, servo: Array) -> float:
        """What another joint and servo gain on the other windows."""
        residuals = self.motions.residual(self.servo), motions.residual(servo)
        return motions.gain_of(*residuals, motions.tested)


def _limited(motions: JointMotions, start: Array, told: float, limit: float) -> _Half:
    """The servo by half of the windows, at the limit that the others ask for: of the model, or own.

    Args:
        start: (6,) where searches begin.
        told: The integral gain by a linear fit; 0 if it has none.
        limit: Largest effort of the joint by the model, N·m or N.
    """
    best = _Half.of(motions, start, told)
    held, plain = replace(motions, limit=limit), best.servo
    if any((held.residual(each) != motions.residual(each)).any() for each in (start, plain)):
        for limited in (held, replace(held, own=True)):
            other = _Half.of(limited, start, told)
            if best.gain(limited, other.servo) >= PENALTY:
                best = other
    integrals = (told,) if told else (0.0, start[0])
    starts = [best.servo, *(_with_integral(motions, start, each) for each in integrals)]
    scale = _scale(motions, start, told)
    for free in (motions, replace(motions, own=True)):
        limited, servo = _with_limit(free, starts, scale, first=True)
        starts = [servo]
        if best.gain(limited, servo) >= PENALTY:
            summed = float(servo[_INTEGRAL]) if len(servo) > _INTEGRAL else told
            other = _Half.of(limited, servo[:_PLAIN], summed)
            limited, servo = _with_limit(limited, [other.servo], scale, first=False)
            if best.gain(limited, servo) >= PENALTY:
                best = _Half(limited, servo, other.scale)
    return best


def _with_limit(
    motions: JointMotions, starts: Sequence[Array], scale: Array, *, first: bool
) -> tuple[JointMotions, Array]:
    """The joint whose servo saturates where windows that a fit sees ask for it, and this servo.

    Args:
        motions: The joint, with a limit to begin with; else it is what bodies need at most.
        scale: (7 + S,) sizes of parameters.
        first: Whether it is a first search, which need not settle.
    """
    most = _FIRST_EVALUATIONS if first else _MOST_EVALUATIONS
    needed = float(np.abs(np.concatenate(motions.rows)[:, 0]).max()) or 1.0
    limit = motions.limit if np.isfinite(motions.limit) else needed
    found = []
    for start in starts:
        sizes = np.append(scale[: len(start)], needed)
        search = _LimitSearch(motions, sizes, first)
        lower, upper = _bounds(sizes[:-1])
        lower, upper = np.append(lower, _INSIDE), np.append(upper, np.inf)
        begin = np.append(start, limit) / sizes
        fit = least_squares(
            search.residual,
            np.clip(begin, lower + _INSIDE, upper - _INSIDE),
            search.slopes,
            bounds=(lower, upper),
            max_nfev=most,
        )
        found.append((fit.cost, fit.x * sizes))
    *servo, limit = min(found, key=lambda each: each[0])[1].tolist()
    return replace(motions, limit=limit), np.array(servo)


@dataclass(frozen=True, eq=False)
class _LimitSearch:
    """Residuals and slopes of a search that moves the limit, too.

    Attributes:
        sizes: (p + 1,) of parameters, and of the limit, by which they are divided.
        coarse: Whether simulations take long steps.
    """

    motions: JointMotions
    sizes: Array
    coarse: bool

    def _simulated(self, x: Array, *, slopes: bool = False) -> tuple[Array, Array]:
        *servo, limit = (x * self.sizes).tolist()
        limited = replace(self.motions, limit=limit)
        return limited.simulated(np.array(servo), coarse=self.coarse, slopes=slopes)

    def residual(self, x: Array) -> Array:
        """Residuals of rows that no test needs, rad or m."""
        return (self._simulated(x)[0] - self.motions.measured)[~self.motions.tested]

    def slopes(self, x: Array) -> Array:
        """Their slopes with parameters in their sizes; those with the limit are differences."""
        found, J = self._simulated(x, slopes=True)
        step = np.append(np.zeros(len(x) - 1), _LIMIT_STEP)
        along = (self._simulated(x + step)[0] - found) / _LIMIT_STEP
        return np.column_stack([J * self.sizes[:-1], along])[~self.motions.tested]


def _scale(motions: JointMotions, start: Array, told: float) -> Array:
    """(7 + S,) sizes of parameters.

    Args:
        start: (6,) the servo by a linear fit.
        told: Its integral gain; 0 if it has none.
    """
    plain = np.maximum(start, [0.0, 0.02 * start[0], 0.0, 1e-3, 1e-4, 0.01])
    effort = float(np.std(np.concatenate(motions.rows)[:, 0])) or 1.0  # of none, any size
    return np.concatenate([plain, [max(told, start[0])], np.full(len(motions.rows), effort)])


def _bounds(scale: Array) -> tuple[Array, Array]:
    """(p,) least and largest values of parameters in their sizes."""
    upper, lower = np.full((2, len(scale)), np.inf)
    upper[_DELAY] = LONGEST_DELAY / scale[_DELAY]
    lower[: len(PARAMETERS)], lower[len(PARAMETERS) :] = 0.0, -np.inf
    return lower, upper


def _by_half(motions: JointMotions, start: Array, told: float) -> tuple[Array, Array]:
    """A servo by the windows that a test does not need, and sizes of its parameters (p,).

    Args:
        start: (6,) where searches begin.
        told: The integral gain by a linear fit; 0 if it has none.
    """
    whole = _scale(motions, start, told)
    scale = whole[:_PLAIN]
    begun = _best(motions, _starts(start), scale, ~motions.tested, coarse=True)
    half = _best(motions, [begun], scale, ~motions.tested)
    return _integral(motions, (start, half), whole, told) or (half, scale)


def _with_integral(motions: JointMotions, servo: Array, integral: float) -> Array:
    """(7 + S,) a servo with an integral, which begins as bodies need it."""
    found = np.append(servo[:_PLAIN], integral)
    return np.append(found, motions.begun(found))


def _integral(
    motions: JointMotions, known: tuple[Array, Array], scale: Array, told: float
) -> tuple[Array, Array] | None:
    """A servo with an integral by the windows that a fit sees, if the others ask for one.

    Args:
        known: (6,) the servo by a linear fit, and without an integral by the same windows.
        scale: (7 + S,) sizes of its parameters.
        told: The integral gain by a linear fit; 0 if it has none.

    Returns:
        Parameters and sizes (7 + S,); None if windows that the fit did not see are predicted no
        better than by a servo with a constant effort.
    """
    start, plain = known
    tested, zero = motions.tested, np.zeros(len(motions.rows))
    constant = np.concatenate([plain, [0.0], zero])
    if told:
        starts = [_with_integral(motions, each, told) for each in _starts(start)]
    elif _promised(motions, constant, scale) < PENALTY:
        return None
    else:
        starts = [_with_integral(motions, plain, ratio * plain[0]) for ratio in _RESETS]
    begun = _best(motions, starts, scale, ~tested, coarse=True)
    best = _best(motions, [begun], scale, ~tested)
    free = np.arange(len(best)) != _INTEGRAL
    constants = [constant, np.where(free, best, 0.0)]
    constant = _best(motions, constants, scale, ~tested, free=free)
    return (best, scale) if motions.gain(constant, best, tested) >= PENALTY else None


def _promised(motions: JointMotions, constant: Array, scale: Array) -> float:
    """What an integral would gain beside a constant effort, as far as motions are linear in both.

    Args:
        constant: (7 + S,) a servo without an integral.
        scale: (7 + S,) sizes of parameters.
    """
    J = motions.simulated(constant, coarse=True, slopes=True)[1] * scale
    left, free = motions.residual(constant), np.arange(len(constant)) != _INTEGRAL
    before, after = (left - A @ np.linalg.lstsq(A, left, rcond=None)[0] for A in (J[:, free], J))
    return motions.gain_of(before, after)


def _starts(start: Array) -> list[Array]:
    """Where searches begin: with several delays, and the damping known to the command or not."""
    begins = []
    for delay in _TRIED_DELAYS:
        begin = start.copy()
        begin[_RATE], begin[_DELAY] = 0.0 if delay else 0.5 * start[2], delay
        begins.append(begin)
    return [start, *begins]


def _rms(motions: JointMotions, parameters: Array, rows: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.mean(motions.residual(parameters)[rows] ** 2)))


def _best(
    motions: JointMotions,
    starts: Sequence[Array],
    scale: Array,
    rows: NDArray[np.bool_],
    *,
    free: NDArray[np.bool_] | None = None,
    coarse: bool = False,
) -> Array:
    """Least squares over some rows, from several starts on.

    Args:
        starts: Parameters (p,) to begin with.
        scale: (p,) sizes of parameters.
        rows: (N,) which rows count.
        free: (p,) which parameters move; all if None.
        coarse: Whether simulations take long steps.
    """
    free = np.ones(len(scale), bool) if free is None else free
    lower, upper = _bounds(scale)
    found = []
    for start in starts:
        search = _MotionSearch(motions, start, scale, free, rows, coarse)
        fit = least_squares(
            search.residual,
            np.clip(start / scale, lower + _INSIDE, upper - _INSIDE)[free],
            search.slopes,
            bounds=(lower[free], upper[free]),
            max_nfev=_MOST_EVALUATIONS,
        )
        found.append((fit.cost, search.parameters(fit.x)))
    return min(found, key=lambda each: each[0])[1]


@dataclass(eq=False)
class _MotionSearch:
    """Residuals and slopes of one search; both are had from one simulation.

    Attributes:
        start: (p,) parameters, of which those that are not free stay.
        scale: (p,) sizes of parameters, by which they are divided.
        free: (p,) which parameters move.
        rows: (N,) which rows count.
        coarse: Whether simulations take long steps.
    """

    motions: JointMotions
    start: Array
    scale: Array
    free: NDArray[np.bool_]
    rows: NDArray[np.bool_]
    coarse: bool
    _last: tuple[bytes, Array, Array] | None = None

    def parameters(self, x: Array) -> Array:
        """(p,) all parameters, for values of those that are free in their sizes."""
        found = self.start.copy()
        found[self.free] = x * self.scale[self.free]
        return found

    def residual(self, x: Array) -> Array:
        """Residuals of the rows that count, rad or m."""
        return self._simulated(x)[1]

    def slopes(self, x: Array) -> Array:
        """Their slopes with the values of what is free."""
        return self._simulated(x)[2]

    def _simulated(self, x: Array) -> tuple[bytes, Array, Array]:
        if self._last is None or self._last[0] != x.tobytes():
            found, slopes = self.motions.simulated(
                self.parameters(x), coarse=self.coarse, slopes=True
            )
            J = slopes[:, self.free][self.rows] * self.scale[self.free]
            self._last = x.tobytes(), (found - self.motions.measured)[self.rows], J
        return self._last


def _deviations(motions: JointMotions, best: Array, scale: Array) -> Array:
    """(p,) standard deviations.

    What is left goes with the motion: it is worth few samples, however long logs are.
    """
    residual, size = motions.residual(best), np.maximum(best, scale)
    J = motions.simulated(best, slopes=True)[1] * size
    noise = residual @ residual / WORTH
    # What the motion does not show is known to its own size.
    covariance = np.linalg.inv(J.T @ J / noise + np.eye(len(best)))
    return np.asarray(size * np.sqrt(np.diag(covariance)))


@compiled
def calc_servo_motion(
    rows: Array, period: float, steps: int, servo: Servo, out: tuple[Array, Array]
) -> None:
    """Writes the positions (N,) of a joint under its commands, by implicit Euler steps.

    Dry friction is a set at rest: a joint sticks until more than F pulls at it. Slopes are those of
    the steps themselves, while a joint that sticks goes on doing so. One that a weak servo lets run
    away is held where it is far from the measured motion.

    Args:
        rows: (N, 8) b, M, K, D, q, q̇, q̈ and the command.
        period: Time between rows, s.
        servo: kp, kr, d, F, I, δ, ki, w, the largest effort, and the share of d within it.
        out: (N,) positions, and (N, p) their slopes with the first six of the servo's numbers, or
            all eight; (0, p) if those are not asked for.
    """
    positions, slopes = out
    kp, kr, d, F, armature, delay, ki, w, limit, own = servo
    dt = period / steps
    x, v, z, before, rise_before = rows[0, 4], rows[0, 5], 0.0, rows[0, 7], 0.0
    X, V, Z, change = np.zeros(8), np.zeros(8), np.zeros(8), np.zeros(8)
    count = slopes.shape[1] if len(slopes) > 0 else 0
    positions[0] = x
    slopes[:1] = 0.0
    for k in range(len(rows) - 1):
        for s in range(steps):
            f = (s + 1.0) / steps
            b, M, K, D, q, qd, qdd = calc_bodies_between(rows, k, f)
            c, rise = calc_command_before(rows, k + f - delay / period, period)
            drive = kp * (c - x) + kr * (c - before) / dt + ki * (z + (c - x) * dt) + w
            rest = (M + armature) * v / dt - b - K * (x - q) + D * qd + M * qdd
            heavy, reach = (M + armature) / dt + K * dt + D + (1.0 - own) * d, kp + ki * dt
            soft, gives = reach * dt + kr + own * d, 1.0
            now, way = calc_velocity_after(drive + rest, heavy + soft, F)
            effort = drive - soft * now
            if effort > limit or effort < -limit:
                gives, bound = 0.0, limit if effort > 0.0 else -limit
                now, way = calc_velocity_after(bound + rest, heavy, F)
            stiff = heavy + gives * soft
            grows = gives > 0.0 or effort * (c - x - now * dt) < 0.0
            if count > 0:
                change[0] = gives * (c - x - now * dt)
                change[1] = gives * ((c - before) / dt - now)
                change[2] = -(1.0 - own + own * gives) * now
                change[3] = -way
                change[4] = (v - now) / dt
                change[5] = -gives * (reach * rise + kr * (rise - rise_before) / dt)
                change[6] = gives * (z + (c - x - now * dt) * dt)
                change[7] = gives
                for i in range(count):
                    change[i] += (M + armature) / dt * V[i] - (K + gives * reach) * X[i]
                    change[i] += gives * ki * Z[i]
                    V[i] = change[i] / stiff if way != 0.0 else 0.0
                    X[i] += dt * V[i]
                    Z[i] -= dt * X[i] if grows else 0.0
                Z[5] -= dt * rise if grows else 0.0
            v, before, rise_before = now, c, rise
            x += dt * v
            z += dt * (c - x) if grows else 0.0
        if abs(x - rows[k + 1, 4]) > _FAR:
            x, v = rows[k + 1, 4] + np.copysign(_FAR, x - rows[k + 1, 4]), 0.0
            X[:], V[:] = 0.0, 0.0
        positions[k + 1] = x
        if count > 0:
            slopes[k + 1] = X[:count]


@compiled
def calc_velocity_after(pull: float, stiff: float, F: float) -> tuple[float, float]:
    """The velocity after an implicit step, and its direction; 0 and 0 of a joint that sticks.

    Args:
        pull: What moves the joint at rest, N·m or N.
        stiff: How much of it a velocity takes away, N·m·s/rad or N·s/m.
        F: Dry friction, N·m or N.
    """
    way = 1.0 if pull > F else -1.0 if pull < -F else 0.0
    return ((pull - way * F) / stiff if way != 0.0 else 0.0), way


@compiled
def calc_bodies_between(
    rows: Array, k: int, f: float
) -> tuple[float, float, float, float, float, float, float]:
    """b, M, K, D, q, q̇ and q̈ between two rows.

    Args:
        rows: (N, 8) as of `calc_servo_motion`.
        k: Number of the first of the two.
    """
    g = 1.0 - f
    return (
        g * rows[k, 0] + f * rows[k + 1, 0],
        g * rows[k, 1] + f * rows[k + 1, 1],
        g * rows[k, 2] + f * rows[k + 1, 2],
        g * rows[k, 3] + f * rows[k + 1, 3],
        g * rows[k, 4] + f * rows[k + 1, 4],
        g * rows[k, 5] + f * rows[k + 1, 5],
        g * rows[k, 6] + f * rows[k + 1, 6],
    )


@compiled
def calc_command_before(rows: Array, at: float, period: float) -> tuple[float, float]:
    """The command at a row's number, which may be between two, and its rate.

    Args:
        rows: (N, 8) as of `calc_servo_motion`.
        at: The number; before the first row the command is as it is there.
        period: Time between rows, s.
    """
    if at <= 0.0:
        return rows[0, 7], 0.0
    low = int(at)
    high, g = min(low + 1, len(rows) - 1), at - low
    return (1.0 - g) * rows[low, 7] + g * rows[high, 7], (rows[high, 7] - rows[low, 7]) / period
