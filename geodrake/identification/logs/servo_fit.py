"""Gains of servos by the motion itself: each joint simulated under its commands, and compared.

What a stiff servo makes of its command hardly shows in inverse dynamics: it moves its joint almost
as it is told, so that its stiffness times how far it lags, its damping and its delay all look like
friction. It shows in how the joint moves. Each joint is therefore simulated alone, while all others
move as they were measured to. Near the measured motion the bodies' effort is linear,

    b + M (ẍ − q̈) + D (ẋ − q̇) + K (x − q),

with slopes of the recursion, and the joint's motion x follows from

    … + I ẍ + d ẋ + F sgn ẋ = kp (c(t − δ) − x) + kr (dc/dt(t − δ) − ẋ).

Its six parameters are those of least squares of x − q, by SciPy, from a linear fit on. They count
only if windows of the log that the fit did not see are predicted better than from where it began.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

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
Servo = tuple[float, float, float, float, float, float]

PARAMETERS = ("stiffness", "rate", "damping", "coulomb", "armature", "delay")
"""kp, kr, d, F, I and δ; of joints that turn in N·m/rad, N·m·s/rad (twice), N·m, kg·m² and s.

d is viscous friction, which damps the joint beside the servo.
"""

LONGEST_DELAY = 0.06
"""Commands are late by no more, s."""

_STEP, _COARSE_STEP = 2.5e-4, 1e-3  # s, of simulations at most: of all, and of first searches
_WINDOWS = 8  # of a log, of which every other one is left out for a test
_MOST_EVALUATIONS = 60
_INSIDE = 0.01  # of parameters' sizes from their bounds, where searches begin
_RATE = 1  # which parameter is that of the command's rate
_FREE = np.arange(len(PARAMETERS)) != _RATE
_TRIED_DELAYS = (0.0, 0.01, 0.03)  # s, that searches begin from


@dataclass(frozen=True, eq=False)
class ServoFit:
    """A servo and what its joint has beside the bodies, by the joint's motion.

    Attributes:
        parameters: (6,) values of `PARAMETERS`.
        deviations: (6,) their standard deviations, for bodies that are known exactly.
        error: RMS of simulated − measured positions, rad or m.
        start: The same where the search began.
        moved: Deviation of the measured positions, rad or m.
    """

    parameters: Array
    deviations: Array
    error: float
    start: float
    moved: float


@dataclass(frozen=True, eq=False)
class JointMotions:
    """One joint along the stretches of logs: what a simulation of it alone needs.

    Attributes:
        rows: Per stretch (N, 8) b, M, K, D, and smooth q, q̇, q̈, and the command.
        positions: Per stretch (N,) positions as logged, rad or m.
        periods: Per stretch the time between rows, s.
    """

    rows: tuple[Array, ...]
    positions: tuple[Array, ...]
    periods: tuple[float, ...]

    def simulated(
        self, parameters: Array, *, step: float = _STEP, slopes: bool = False
    ) -> tuple[Array, Array]:
        """Positions (N,) under the commands, rad or m, and their slopes (N, 6) with parameters.

        Args:
            parameters: (6,) values of `PARAMETERS`.
            step: Of the simulation at most, s.
            slopes: Whether slopes are asked for; there are none (0, 6) if not.
        """
        found, tangents = [], []
        kp, kr, d, F, armature, delay = parameters.tolist()
        servo: Servo = (kp, kr, d, F, armature, delay)
        for rows, period in zip(self.rows, self.periods, strict=True):
            steps = max(1, int(np.ceil(period / step)))
            x = np.empty(len(rows))
            tangent = np.empty((len(rows) if slopes else 0, len(PARAMETERS)))
            calc_servo_motion(rows, period, steps, servo, (x, tangent))
            found.append(x)
            tangents.append(tangent)
        return np.concatenate(found), np.concatenate(tangents)

    def residual(self, parameters: Array) -> Array:
        """(N,) simulated − measured positions of all stretches."""
        return self.simulated(parameters)[0] - self.measured

    @cached_property
    def measured(self) -> Array:
        """(N,) positions of all stretches, rad or m."""
        return np.concatenate(self.positions)

    @property
    def tested(self) -> NDArray[np.bool_]:
        """(N,) rows of every other window, which a test leaves out of the fit."""
        count = sum(map(len, self.rows))
        return (np.arange(count) * _WINDOWS // max(count, 1)) % 2 == 1


def motions_of(
    model: RobotModel,
    logs: Sequence[JointLog],
    trajectories: Sequence[Trajectory],
    joints: Sequence[int],
) -> dict[int, JointMotions]:
    """What simulations of some joints, each alone, need; see `JointMotions`.

    Args:
        model: The model, with the inertias that count.
        logs: Logs with commands.
        trajectories: The same, prepared.
        joints: Indices of the joints.

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


def fit_servo(motions: JointMotions, signal: EffortSignal) -> ServoFit | None:
    """The servo that moves a joint as it was measured to.

    Args:
        motions: The joint.
        signal: The servo by a linear fit, at which the search begins.

    Returns:
        The servo; None if windows that the fit did not see are predicted no better than from where
        it began.
    """
    rows, stiffness = np.concatenate(motions.rows), signal.gain
    friction, inertia = 0.1 * np.std(rows[:, 0]), 0.2 * np.mean(rows[:, 1])
    damping = 0.05 * stiffness
    start = np.array([stiffness, signal.damping, damping, friction, inertia, signal.delay])
    scale = np.maximum(start, [0.0, 0.02 * stiffness, 0.0, 1e-3, 1e-4, 0.01])
    tested, every = motions.tested, np.ones(len(rows), bool)
    begun = _best(motions, _starts(start), scale, ~tested, step=_COARSE_STEP)
    half = _best(motions, [begun], scale, ~tested)
    if not _rms(motions, half, tested) < _rms(motions, start, tested):
        return None
    best = _best(motions, [half], scale, every)
    bare = _best(motions, [np.where(_FREE, best, 0.0)], scale, every, free=_FREE)
    errors = [motions.residual(each) for each in (bare, best)]
    ends = np.cumsum([len(each) for each in motions.rows])[:-1]
    worth = effective_samples(np.split(errors[1], ends))
    squares = [float(each @ each) for each in errors]
    if worth * np.log(squares[0] / squares[1]) < PENALTY:
        best, errors[1] = bare, errors[0]
    if not _rms(motions, best, every) < _rms(motions, start, every):
        return None
    return ServoFit(
        best,
        _deviations(motions, best, scale),
        float(np.sqrt(np.mean(errors[1] ** 2))),
        _rms(motions, start, every),
        float(np.std(motions.measured)),
    )


def _starts(start: Array) -> list[Array]:
    """Where searches begin: with several delays, and the damping known to the command or not."""
    begins = []
    for delay in _TRIED_DELAYS:
        begin = start.copy()
        begin[_RATE], begin[-1] = 0.0 if delay else 0.5 * start[2], delay
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
    step: float = _STEP,
) -> Array:
    """Least squares over some rows, from several starts on.

    Args:
        motions: The joint.
        starts: Parameters (6,) to begin with.
        scale: (6,) sizes of parameters.
        rows: (N,) which rows count.
        free: (6,) which parameters move; all if None.
        step: Of simulations at most, s.
    """
    free = np.ones(len(scale), bool) if free is None else free
    upper = np.append(np.full(len(scale) - 1, np.inf), LONGEST_DELAY) / scale
    found = []
    for start in starts:
        search = _MotionSearch(motions, start, scale, free, rows, step)
        fit = least_squares(
            search.residual,
            np.clip(start / scale, _INSIDE, upper - _INSIDE)[free],
            search.slopes,
            bounds=(0.0, upper[free]),
            max_nfev=_MOST_EVALUATIONS,
        )
        found.append((fit.cost, search.parameters(fit.x)))
    return min(found, key=lambda each: each[0])[1]


@dataclass(eq=False)
class _MotionSearch:
    """Residuals and slopes of one search; both are had from one simulation.

    Attributes:
        motions: The joint.
        start: (6,) parameters, of which those that are not free stay.
        scale: (6,) sizes of parameters, by which they are divided.
        free: (6,) which parameters move.
        rows: (N,) which rows count.
        step: Of simulations at most, s.
    """

    motions: JointMotions
    start: Array
    scale: Array
    free: NDArray[np.bool_]
    rows: NDArray[np.bool_]
    step: float
    _last: tuple[bytes, Array, Array] | None = None

    def parameters(self, x: Array) -> Array:
        """(6,) all parameters, for values of those that are free in their sizes."""
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
            found, slopes = self.motions.simulated(self.parameters(x), step=self.step, slopes=True)
            J = slopes[:, self.free][self.rows] * self.scale[self.free]
            self._last = x.tobytes(), (found - self.motions.measured)[self.rows], J
        return self._last


def _deviations(motions: JointMotions, best: Array, scale: Array) -> Array:
    """(6,) standard deviations.

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
    the steps themselves, while a joint that sticks goes on doing so.

    Args:
        rows: (N, 8) b, M, K, D, q, q̇, q̈ and the command.
        period: Time between rows, s.
        steps: Of the simulation between two rows.
        servo: kp, kr, d, F, I and δ.
        out: (N,) positions, and (N, 6) their slopes with the servo's numbers; (0, 6) if those are
            not asked for.
    """
    positions, slopes = out
    kp, kr, d, F, armature, delay = servo
    count, dt = len(rows), period / steps
    x, v, before = rows[0, 4], rows[0, 5], rows[0, 7]
    sloping, rise_before = len(slopes) > 0, 0.0
    X, V, change = np.zeros(6), np.zeros(6), np.zeros(6)
    positions[0] = x
    slopes[:1] = 0.0
    for k in range(count - 1):
        for s in range(steps):
            f = (s + 1.0) / steps
            b = (1.0 - f) * rows[k, 0] + f * rows[k + 1, 0]
            M = (1.0 - f) * rows[k, 1] + f * rows[k + 1, 1]
            K = (1.0 - f) * rows[k, 2] + f * rows[k + 1, 2]
            D = (1.0 - f) * rows[k, 3] + f * rows[k + 1, 3]
            q = (1.0 - f) * rows[k, 4] + f * rows[k + 1, 4]
            qd = (1.0 - f) * rows[k, 5] + f * rows[k + 1, 5]
            qdd = (1.0 - f) * rows[k, 6] + f * rows[k + 1, 6]
            c, rise, at = rows[0, 7], 0.0, k + f - delay / period
            if at > 0.0:
                low = int(at)
                high, g = min(low + 1, count - 1), at - low
                c = (1.0 - g) * rows[low, 7] + g * rows[high, 7]
                rise = (rows[high, 7] - rows[low, 7]) / period
            pull = kp * (c - x) + kr * (c - before) / dt - b - K * (x - q) + D * qd + M * qdd
            pull += (M + armature) * v / dt
            stiff = (M + armature) / dt + (K + kp) * dt + D + d + kr
            way = 1.0 if pull > F else -1.0 if pull < -F else 0.0
            now = (pull - way * F) / stiff if way != 0.0 else 0.0
            if sloping:
                change[0] = c - x - now * dt
                change[1] = (c - before) / dt - now
                change[2] = -now
                change[3] = -way
                change[4] = (v - now) / dt
                change[5] = -kp * rise - kr * (rise - rise_before) / dt
                for i in range(6):
                    change[i] += (M + armature) / dt * V[i] - (K + kp) * X[i]
                    V[i] = change[i] / stiff if way != 0.0 else 0.0
                    X[i] += dt * V[i]
            v, before, rise_before = now, c, rise
            x += dt * v
        positions[k + 1] = x
        if sloping:
            slopes[k + 1] = X
