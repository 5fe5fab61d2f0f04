"""Where a motion can begin: postures that a robot can hold, ramps, first motions within limits."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from pydrake.solvers import ClpSolver, MathematicalProgram
from scipy.interpolate import PchipInterpolator

from geodrake.boundary.arguments import real_array
from geodrake.errors import ArgumentError
from geodrake.excitation.collisions import FLOOR, CollisionWorld
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.margins import COARSE, keeps_limits, stays_clear
from geodrake.excitation.problem import DesignProblem, limit_motion
from geodrake.excitation.solve import UNLIMITED, Budget, OutOfTimeError
from geodrake.excitation.stance import Stance
from geodrake.excitation.trajectory import ExcitationTrajectory, Ramp, RampedTrajectory
from geodrake.inertia import Array
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel

_POSTURES, _TRIED = 400, 5
_ROUNDING, _NOTHING = 1e-9, 1e-9
_FILL = (0.6, 0.95)  # share of the limits that a random motion uses
_CORNERS = 2
_ROUNDS, _INNER = 3, 0.9  # of moving a random motion into balance, and how far inside
_SHRINK, _STEPS = 0.8, 20
_FIRST_STEP_BACK, _NEAR = 1e-3, 1.1e-3  # of the way from one motion to the other


def at_rest(postures: Array) -> Motion:
    """Return the motion of a robot that is still in postures (N, nv) by joint."""
    still = np.zeros_like(postures)
    return Motion(postures, still, still)


def holding_efforts(model: RobotModel, postures: Array, stance: Stance | None) -> Array:
    """Return efforts (N, ·) that hold a robot still in postures (N, nv) by joint, N·m or N.

    Dry friction is no help: what it would hold depends on how the robot came there.
    """
    still = at_rest(postures)
    return np.asarray(model.effort(still) if stance is None else stance.efforts(still))


def check_start(problem: DesignProblem, start: Array, *, name: str = "start") -> None:
    """Refuse a start (nv,) by joint, rad or m, that the robot cannot hold."""
    model, stance, collisions = problem.model, problem.stance, problem.collisions
    real_array(start, name, (len(problem.limits.joints),))
    for limits, at in _by_limits(problem, start[None]):
        slack = _ROUNDING * (1.0 + limits.reach)
        outside = (at[0] < limits.lower - slack) | (at[0] > limits.upper + slack)
        if outside.any():
            i = int(np.argmax(outside))
            raise ArgumentError(
                f"The {name} is outside the limits: joint {limits.joints[i]!r} is at "
                f"{at[0, i]:.4g}, but its range is {limits.lower[i]:.4g} to "
                f"{limits.upper[i]:.4g}.",
                advice="Move the robot inside first, or omit the start.",
                joint=limits.joints[i],
            )
    if stance is not None:
        polygon, _ = stance.support(at_rest(start[None]))
        if not polygon[0] <= stance.margin:
            raise ArgumentError(
                f"The robot falls over at the {name}: its centre of mass is over "
                f"{100 * polygon[0]:.0f} % of the way from the middle of its feet to their edge, "
                f"of which {100 * stance.margin:.0f} % are allowed.",
                advice="Let it stand so that its centre of mass is over its feet.",
            )
    limits = problem.motor_limits
    effort = np.abs(holding_efforts(model, start[None], stance)[0])
    if (effort > limits.effort).any():
        i = int(np.argmax(effort / limits.effort))
        raise ArgumentError(
            f"Joint {limits.joints[i]!r} needs an effort of {effort[i]:.4g} to hold the "
            f"robot at the {name}, but its limit is {limits.effort[i]:.4g}.",
            advice="Start from a posture with less gravity load, or raise the limit.",
            joint=limits.joints[i],
        )
    if collisions is not None:
        distance, names = collisions.distances(start[None])
        if distance[0] < collisions.clearance:
            raise ArgumentError(
                f"The {name} is in collision: {names[0]} are {distance[0]:.4g} m apart, less "
                f"than the clearance of {collisions.clearance:g} m.",
                advice="Start elsewhere, or check the geometry.",
            )


def _by_limits(problem: DesignProblem, postures: Array) -> list[tuple[MotionLimits, Array]]:
    """Return limits with the positions (N, ·) that they are of, in postures (N, nv)."""
    found = [(problem.limits, postures)]
    if problem.stance is not None:
        still = np.stack([postures, 0.0 * postures, 0.0 * postures])
        found.append((problem.motor_limits, problem.stance.motor_states(still)[0]))
    return found


def possible_postures(
    model: RobotModel,
    limits: MotionLimits,
    collisions: CollisionWorld | None,
    *,
    stance: Stance | None = None,
    most: int = _POSTURES,
) -> Array:
    """Return postures (n, nv) by joint that a robot can hold, the middle of its ranges first.

    Those of a robot on its feet are about its posture, with the centre of mass over them.
    """
    random = np.random.default_rng(0)
    shares = random.uniform(-1.0, 1.0, (_POSTURES, len(limits.joints)))
    shares *= np.linspace(0.0, 0.95, _POSTURES)[:, None]  # the middle, and then further out
    postures = limits.middle + limits.reach * shares
    if stance is not None:
        postures = _on_feet(stance, limits, postures)
        limits = stance.motor_limits
    efforts = np.abs(holding_efforts(model, postures, stance))
    holds = (efforts <= limits.effort).all(axis=1)
    if not holds.any():
        least = int(np.argmin((efforts / limits.effort).max(axis=1)))
        i = int(np.argmax(efforts[least] / limits.effort))
        at = ", ".join(
            f"{n} {x:.3g}" for n, x in zip(model.joints, postures[least].tolist(), strict=True)
        )
        raise ArgumentError(
            f"The robot cannot hold itself against gravity: in the best of {_POSTURES} "
            f"postures ({at}), joint {limits.joints[i]!r} needs an effort of "
            f"{efforts[least, i]:.4g}, but its limit is {limits.effort[i]:.4g}.",
            advice="Raise the effort limits, or check masses and units of the model.",
            joint=limits.joints[i],
        )
    postures = postures[holds]
    if collisions is None:
        return postures[:most]
    return _apart(postures, collisions, most)


def _on_feet(stance: Stance, limits: MotionLimits, postures: Array) -> Array:
    """Return postures (n, nv) in balance, of random ones (N, nv)."""
    there = np.clip(stance.posture, limits.lower, limits.upper)
    shares = np.linspace(0.0, 1.0, len(postures))[:, None]
    postures = stance.balanced(there + shares * (postures - there), limits)
    still = at_rest(postures)
    polygon, _ = stance.support(still)
    own = stance.motor_limits
    q = stance.motor_states(np.stack([still.q, still.v, still.vd]))[0]
    inside = (polygon <= stance.margin) & ((q >= own.lower) & (q <= own.upper)).all(axis=1)
    if not inside.any():
        least = float(polygon.min())
        raise ArgumentError(
            f"The robot is in balance in none of {len(postures)} postures within its limits: in "
            f"the best, its centre of mass is {100 * least:.0f} % of the way from the middle of "
            f"its feet to their edge, of which {100 * stance.margin:.0f} % are allowed.",
            advice="Let it stand in another posture (--stand), or on more feet.",
        )
    return np.asarray(postures[inside])


def below_floor(
    world: CollisionWorld, model: RobotModel, limits: MotionLimits, start: Array | None
) -> str:
    """Say why the floor of a world cannot be: the robot hangs below it, or starts there (nv,)."""
    if start is not None:
        distance, (names, *_) = world.distances(start[None])
        pair = names.split(" and ")
        if FLOOR not in pair or distance[0] >= world.clearance:
            return ""
        return f"{next(name for name in pair if name != FLOOR)} is below the base at the start"
    try:
        possible_postures(model, limits, world, most=1)
    except ArgumentError:
        return "the robot is below its base in every posture"
    return ""


def _apart(postures: Array, collisions: CollisionWorld, most: int) -> Array:
    """Return the first postures in which nothing collides; the others are not looked at."""
    free: list[Array] = []
    best, nearest = -np.inf, ""
    for posture in postures:
        distance, names = collisions.distances(posture[None])
        if distance[0] >= collisions.clearance:
            free.append(posture)
        if distance[0] > best:
            best, nearest = float(distance[0]), names[0]
        if len(free) == most:
            break
    if not free:
        raise ArgumentError(
            f"The robot collides in all of {len(postures)} postures; in the best one, "
            f"{nearest} are {best:.4g} m apart, less than the clearance of "
            f"{collisions.clearance:g} m.",
            advice="Check the geometry and the poses of obstacles.",
        )
    return np.array(free)


def random_guess(
    problem: DesignProblem,
    postures: Array,
    rng: np.random.Generator,
    budget: Budget = UNLIMITED,
) -> Array:
    """Return variables (f, nv) of a random motion within limits about one of postures (n, nv)."""
    for _ in range(_TRIED):
        posture = postures[int(rng.integers(len(postures)))]
        resting = problem.resting(posture)
        if problem.stance is not None and problem.family.timed:
            moving = _through(problem, problem.stance, posture, postures, rng)
        elif problem.start is None:
            direction = rng.uniform(-1.0, 1.0, resting.shape)
            moving = resting + rng.uniform(*_FILL) * _room(problem, resting, direction) * direction
        else:
            moving = _from_corners(problem, rng)
        share = 1.0
        for _ in range(_STEPS):
            guess = resting + share * (moving - resting)
            if keeps_limits(problem, guess, stride=COARSE, budget=budget):
                return np.asarray(guess)
            budget.check()
            share *= _SHRINK
    raise ArgumentError(
        "The robot can rest within its limits, but hardly move: no random motion around "
        f"{_TRIED} postures satisfies them.",
        advice="Widen the limits that are nearly reached at rest, or start elsewhere.",
    )


def _through(
    problem: DesignProblem,
    stance: Stance,
    begin: Array,
    postures: Array,
    rng: np.random.Generator,
) -> Array:
    """Return a motion (f, nv) from a posture (nv,) through others in balance, and nearly in it.

    Most random directions lead out of balance at once. At each instant the joints move as they
    would at rest, which changes accelerations as well: a few times will do.
    """
    count = max(2, int(problem.family.length / problem.family.fastest))
    at, basis = np.linspace(0.0, 1.0, count + 1), problem.effort_basis
    q = postures[rng.integers(len(postures), size=count + 1)]
    q[0] = begin
    path = PchipInterpolator(at, q)(np.linspace(0.0, 1.0, basis.shape[1]))
    found = _nearest(problem, path)
    for _ in range(_ROUNDS):
        trajectory = problem.trajectory(found)
        motion = trajectory.motion_of(basis @ trajectory.coefficients)
        q = stance.balanced(motion.q, problem.limits, motion, share=_INNER * stance.margin)
        found = _nearest(problem, q)
    return found


def _nearest(problem: DesignProblem, q: Array) -> Array:
    """Return the motion (f, nv) nearest to positions (n, nv) at the instants of efforts."""
    position, found = problem.effort_basis[0], np.empty(problem.scale.shape)
    left = q - position @ problem.offset
    for j, scale in enumerate(problem.scale.T):
        found[:, j] = np.linalg.lstsq(position @ problem.free * scale, left[:, j], rcond=1e-6)[0]
    return found


def _from_corners(problem: DesignProblem, rng: np.random.Generator) -> Array:
    """Return a random mean (f, nv) of a few motions that go as far as joint limits let them.

    A start may be at a limit, from where most random directions lead out at once. A linear program
    finds motions that do not.
    """
    program = MathematicalProgram()
    variables = program.NewContinuousVariables(*problem.scale.shape)
    limit_motion(program, problem, variables)
    cost = program.AddLinearCost(np.zeros(variables.size), variables.ravel())
    corners = []
    aims = rng.normal(size=(_CORNERS, variables.size))
    for aim in (*aims, *-aims):  # one of the two ways may be none, from a start at a limit
        cost.evaluator().UpdateCoefficients(aim)
        result = ClpSolver().Solve(program)
        if not result.is_success():
            raise ArgumentError(
                "No motion of the family begins at the start and satisfies the limits.",
                advice="Use more coefficients or a longer motion, or start elsewhere.",
            )
        corners.append(result.GetSolution(variables))
    weights = rng.dirichlet(np.ones(len(corners)), size=problem.scale.shape[1])  # a joint
    return np.asarray(np.einsum("jc,cfj->fj", weights, np.array(corners)))


def _room(problem: DesignProblem, around: Array, direction: Array) -> Array:
    """Return (nv,) multiples of a direction by which each joint can move within its limits."""
    states = problem.limit_basis @ problem.coefficients(around)
    change = problem.limit_basis @ (problem.free @ (problem.scale * direction))
    rooms = [
        _multiple(by, upper - now, now - lower)
        for by, now, (lower, upper) in zip(change, states, problem.bounds, strict=True)
    ]
    return np.asarray(np.min(rooms, axis=0))


def _multiple(change: Array, above: Array, below: Array) -> Array:
    """Return (nv,) largest multiple of a change (n, nv) within the room on either side."""
    size = np.abs(change)
    moving = size > _NOTHING * size.max(axis=0)
    room = np.where(change > 0, above, below)
    ratio = np.where(moving, room, np.inf) / np.where(moving, size, 1.0)
    return np.asarray(np.maximum(ratio.min(axis=0), 0.0))


def within_limits(
    problem: DesignProblem,
    variables: Array,
    inside: Array,
    budget: Budget = UNLIMITED,
    *,
    stride: int = 1,
) -> Array:
    """Return the motion nearest to one, on the way from another within limits, that keeps them too.

    Args:
        variables: (f, nv) variables of a motion that keeps the limits, or nearly so.
        budget: When it is up, the nearest one found by then counts.
    """
    least, step = 0.0, _FIRST_STEP_BACK
    most = 1.0
    with suppress(OutOfTimeError):
        if keeps_limits(problem, variables, stride=stride, budget=budget):
            return variables
        while most - least > _NEAR:
            share = most - step if most - step > least else 0.5 * (least + most)
            tried = inside + share * (variables - inside)
            if keeps_limits(problem, tried, stride=stride, budget=budget):
                least = share
            else:
                most, step = share, 4.0 * step
    return np.asarray(inside + least * (variables - inside))


_SHARE = 0.5  # of the limits of speed, acceleration and jerk
_PEAKS = 1.875, 10.0 / np.sqrt(3.0), 60.0  # of 10 x³ − 15 x⁴ + 6 x⁵ and its derivatives
_LEAST = 1.0  # s, of a way
_STEP = 0.02  # rad or m, of the joint that goes farthest, between looks at collisions
_EFFORT_STEPS = 50
_SLOWER, _TIMES = 1.5, 8  # where efforts are too large
_VIA = 100  # postures by way of which a ramp may lead


@dataclass(frozen=True, eq=False)
class RampPlanner:
    """Plan ramps of half of the limits of speed, acceleration and jerk, of at least a second.

    A ramp is straight in the joints; where something is in the way, it goes by way of one more
    posture.
    """

    problem: DesignProblem

    def ramped(self, trajectory: ExcitationTrajectory, stand: Array) -> RampedTrajectory:
        """Return a motion with ramps from and to where the robot stands, (nv,) by joint."""
        q = trajectory.free_states([0.0, trajectory.length])[0]
        first = self._ramp(stand, q[0], trajectory)
        if np.allclose(q[0], q[1]):
            last = replace(first, postures=first.postures[::-1], durations=first.durations[::-1])
        else:
            last = self._ramp(q[1], stand, trajectory)
        parts = [part for part in (first, trajectory, last) if part.length]
        return RampedTrajectory(tuple(parts), trajectory.joints, trajectory.stance)

    def _ramp(self, begin: Array, end: Array, like: ExcitationTrajectory) -> Ramp:
        if np.array_equal(begin, end):
            return Ramp(np.array([begin, end]), np.zeros(1), like.joints, like.stance)
        collisions = self.problem.collisions
        for postures in self._ways(begin, end):
            way = Ramp(postures, self._durations(postures), like.joints, like.stance)
            if collisions is not None and not _is_clear(way, collisions):
                continue
            for _ in range(_TIMES):
                if self._is_kept(way):
                    return way
                way = replace(way, durations=_SLOWER * way.durations)
        raise ArgumentError(
            "No ramp leads from the rest position to the start of the motion: neither a "
            f"straight one nor one through {_VIA} postures satisfies clearance, "
            f"{'balance ' * (like.stance is not None)}and efforts.",
            advice="Start the motion at the rest position instead: --start.",
        )

    def _is_kept(self, way: Ramp) -> bool:
        """Return whether a ramp keeps the limits of efforts and, on feet, of balance."""
        limits, stance = self.problem.motor_limits, self.problem.stance
        times = np.linspace(0.0, way.length, _EFFORT_STEPS * len(way.durations))
        if (np.abs(way.efforts(self.problem.model, times)) > limits.effort).any():
            return False
        if stance is None:
            return True
        (q, v, vd), motion = way.states(times), way.motion(times)
        polygon, friction = stance.support(motion)
        kept = polygon.max() <= stance.margin and friction.max() <= 1.0
        inside = (q >= limits.lower - _NEAR) & (q <= limits.upper + _NEAR)
        within = (np.abs(v) <= limits.velocity) & (np.abs(vd) <= limits.acceleration)
        return bool(kept and (inside & within).all())

    def _ways(self, begin: Array, end: Array) -> Iterator[Array]:
        """Yield the straight way, and then those by way of another posture, the shortest first."""
        yield np.array([begin, end])
        limits, own = self.problem.limits, (self.problem.model, self.problem.limits)
        via = possible_postures(
            *own, self.problem.collisions, stance=self.problem.stance, most=_VIA
        )
        sizes = [np.abs((via - p) / limits.reach).max(axis=1) for p in (begin, end)]
        for k in np.argsort(sizes[0] + sizes[1]):
            if sizes[0][k] > 0 and sizes[1][k] > 0:
                yield np.array([begin, via[k], end])

    def _durations(self, postures: Array) -> Array:
        """Return the durations (k,) of ways between postures at half of the limits, s."""
        ways = np.abs(np.diff(postures, axis=0))
        limits = self.problem.limits
        bounds = limits.velocity, limits.acceleration, limits.jerk
        needed = [
            (peak * ways / (_SHARE * bound)) ** (1.0 / order)
            for order, (peak, bound) in enumerate(zip(_PEAKS, bounds, strict=True), 1)
        ]
        return np.maximum(np.max(needed, axis=(0, 2)), _LEAST)


def _is_clear(way: Ramp, collisions: CollisionWorld) -> bool:
    steps = [
        np.linspace(a, b, int(np.ceil(np.abs(b - a).max() / _STEP)) + 2)
        for a, b in zip(way.postures[:-1], way.postures[1:], strict=True)
    ]
    return stays_clear(collisions, np.concatenate(steps))
