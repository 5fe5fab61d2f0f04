"""Where a motion can begin: postures that a robot can hold, ramps, first motions within limits."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise

import numpy as np
from pydrake.solvers import ClpSolver, MathematicalProgram
from scipy.interpolate import PchipInterpolator

from geodrake.boundary.arguments import real_array
from geodrake.errors import ArgumentError
from geodrake.excitation.collisions import FLOOR, CollisionWorld
from geodrake.excitation.families import SplineMotion
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.margins import COARSE, joint_use, keeps_limits, stays_clear
from geodrake.excitation.problem import DesignProblem, limit_motion
from geodrake.excitation.solve import UNLIMITED, Budget, SearchEndError
from geodrake.excitation.stance import Stance
from geodrake.excitation.trajectory import ExcitationTrajectory
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


def _held(model: RobotModel, stance: Stance | None, postures: Array) -> tuple[Array, Array, Array]:
    """Return motors' positions and efforts (N, m), and shares of the polygon (N,), of rest.

    Postures (N, nv) are by joint of the model. Dry friction is no help: what it would hold depends
    on how the robot came there.
    """
    still = at_rest(postures)
    if stance is None:
        return postures, model.effort(still), np.zeros(len(postures))
    q, _, _ = stance.motor_states(np.stack([still.q, still.v, still.vd]))
    return q, stance.efforts(still), stance.support(still)[0]


def check_start(problem: DesignProblem, start: Array, *, name: str = "start") -> None:
    """Refuse a start (nv,) by joint, rad or m, that the robot cannot hold."""
    stance, collisions = problem.stance, problem.collisions
    real_array(start, name, (len(problem.limits.joints),))
    (q,), (effort,), (polygon,) = _held(problem.model, stance, start[None])
    for limits, at in ((problem.limits, start), (problem.motor_limits, q)):
        slack = _ROUNDING * (1.0 + limits.reach)
        outside = (at < limits.lower - slack) | (at > limits.upper + slack)
        if outside.any():
            i = int(np.argmax(outside))
            raise ArgumentError(
                f"The {name} is outside the limits: joint {limits.joints[i]!r} is at {at[i]:.4g}, "
                f"but its range is {limits.lower[i]:.4g} to {limits.upper[i]:.4g}.",
                advice="Move the robot inside first, or omit the start.",
                joint=limits.joints[i],
            )
    if stance is not None and not polygon <= stance.margin:
        raise ArgumentError(
            f"The robot falls over at the {name}: its centre of mass is over "
            f"{100 * polygon:.0f} % of the way from the middle of its feet to their edge, "
            f"of which {100 * stance.margin:.0f} % are allowed.",
            advice="Let it stand so that its centre of mass is over its feet.",
        )
    limits, effort = problem.motor_limits, np.abs(effort)
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
    shares = np.linspace(0.0, 0.95, _POSTURES)[:, None]  # the middle, and then further out
    shares = shares * random.uniform(-1.0, 1.0, (_POSTURES, len(limits.joints)))
    postures = limits.middle + limits.reach * shares
    if stance is not None:
        there = np.clip(stance.posture, limits.lower, limits.upper)
        shares = np.linspace(0.0, 1.0, _POSTURES)[:, None]
        postures = stance.balanced(there + shares * (postures - there), limits)
        limits = stance.motor_limits
    q, efforts, polygon = _held(model, stance, postures)
    efforts = np.abs(efforts)
    if stance is not None:
        within = (q >= limits.lower) & (q <= limits.upper)
        inside = (polygon <= stance.margin) & within.all(axis=1)
        if not inside.any():
            raise ArgumentError(
                f"The robot is in balance in none of {_POSTURES} postures within its limits: in "
                f"the best, its centre of mass is {100 * float(polygon.min()):.0f} % of the way "
                f"from the middle of its feet to their edge, of which {100 * stance.margin:.0f} % "
                "are allowed.",
                advice="Let it stand in another posture (--stand), or on more feet.",
            )
        postures, efforts = postures[inside], efforts[inside]
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
    return postures[:most] if collisions is None else _apart(postures, collisions, most)


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
            advice="Check the geometry and the poses of obstacles. The floor that a command "
            "assumes is left out with --no-floor.",
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
    position = basis[0] @ problem.free

    def nearest(q: Array) -> Array:
        """Return the motion nearest to positions at the instants of efforts."""
        left = q - basis[0] @ problem.offset
        return np.asarray(np.linalg.lstsq(position, left, rcond=1e-6)[0] / problem.scale)

    q = postures[rng.integers(len(postures), size=count + 1)]
    q[0] = begin
    found = nearest(PchipInterpolator(at, q)(np.linspace(0.0, 1.0, len(position))))
    for _ in range(_ROUNDS):
        motion = problem.motion(found, basis)
        share = _INNER * stance.margin
        found = nearest(stance.balanced(motion.q, problem.limits, motion, share=share))
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
    lower, upper = (np.stack(side)[:, None] for side in zip(*problem.bounds, strict=True))
    room, size = np.where(change > 0, upper - states, states - lower), np.abs(change)
    moving = size > _NOTHING * size.max(axis=1, keepdims=True)
    ratio = np.where(moving, room, np.inf) / np.where(moving, size, 1.0)
    return np.asarray(np.maximum(ratio.min(axis=(0, 1)), 0.0))


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
    with suppress(SearchEndError):
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
# Of derivatives of 10 x³ − 15 x⁴ + 6 x⁵, a spline with thrice the same point at either end.
_PEAKS = 1.875, 10.0 / np.sqrt(3.0), 60.0
_LEAST = 1.0  # s, of a way
_SLOWER, _TIMES = 1.5, 8  # where efforts are too large
_VIA = 100  # postures by way of which a ramp may lead


def with_ramps(
    problem: DesignProblem, trajectory: ExcitationTrajectory, stand: Array
) -> ExcitationTrajectory:
    """Return a motion with ramps from and to where the robot stands, (nv,) by joint.

    They take half of the limits of speed, acceleration and jerk, and at least a second. A ramp is
    straight in the joints; where something is in the way, it goes by way of one more posture.
    """
    begin, end = trajectory.free_states([0.0, trajectory.length])[0]
    there = _ramp(problem, trajectory, stand, begin)
    back = _ramp(problem, trajectory, end, stand)
    parts = [part for part in (there, trajectory, back) if part is not None]
    return parts[0].followed_by(*parts[1:])


def _ramp(
    problem: DesignProblem, like: ExcitationTrajectory, begin: Array, end: Array
) -> ExcitationTrajectory | None:
    """Return the ramp between postures (nv,); None if they are the same."""
    if np.array_equal(begin, end):
        return None
    limits, world = problem.limits, problem.collisions
    bounds = limits.velocity, limits.acceleration, limits.jerk
    for postures in _ways(problem, begin, end):
        changes = np.abs(np.diff(postures, axis=0))
        needed = [
            (peak * changes / (_SHARE * bound)) ** (1.0 / order)
            for order, (peak, bound) in enumerate(zip(_PEAKS, bounds, strict=True), 1)
        ]
        durations = np.maximum(np.max(needed, axis=(0, 2)), _LEAST)
        for slower in _SLOWER ** np.arange(_TIMES):
            families = [SplineMotion(slower * duration, 6) for duration in durations]
            ways = [
                replace(like, family=family, coefficients=np.repeat(ends, 3, axis=0))
                for family, ends in zip(families, pairwise(postures), strict=True)
            ]
            way = ways[0].followed_by(*ways[1:])
            use, motion = joint_use(problem, way)
            if use.is_within:
                if world is None or stays_clear(world, motion.q):
                    return way
                break
    raise ArgumentError(
        "No ramp leads from the rest position to the start of the motion: neither a "
        f"straight one nor one through {_VIA} postures satisfies clearance, "
        f"{'balance ' * (like.stance is not None)}and efforts.",
        advice="Start the motion at the rest position instead: --start.",
    )


def _ways(problem: DesignProblem, begin: Array, end: Array) -> Iterator[Array]:
    """Yield the straight way, and then those by way of another posture, the shortest first."""
    yield np.array([begin, end])
    limits = problem.limits
    via = possible_postures(
        problem.model, limits, problem.collisions, stance=problem.stance, most=_VIA
    )
    sizes = [np.abs((via - p) / limits.reach).max(axis=1) for p in (begin, end)]
    for k in np.argsort(sizes[0] + sizes[1]):
        if sizes[0][k] > 0 and sizes[1][k] > 0:
            yield np.array([begin, via[k], end])
