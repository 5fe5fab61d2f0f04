"""Initial motions of a design: postures that a robot can hold, random motions and ramps."""

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

_POSTURES, _TRIALS = 400, 5
_ROUNDING, _NEGLIGIBLE = 1e-9, 1e-9
_FILL = (0.6, 0.95)  # share of the limits that a random motion uses
_CORNERS = 2
_ROUNDS, _INNER = 3, 0.9  # steps to balance a random motion, and target share of the margin
_SHRINK, _STEPS = 0.8, 20
_FIRST_STEP_BACK, _CLOSE = 1e-3, 1.1e-3  # shares of the line between two motions


def at_rest(postures: Array) -> Motion:
    """Return the motion of a robot at rest in postures (N, nv) by joint."""
    still = np.zeros_like(postures)
    return Motion(postures, still, still)


def _held(model: RobotModel, stance: Stance | None, postures: Array) -> tuple[Array, Array, Array]:
    """Return motor positions and efforts (N, m), and used shares of the polygon (N,), at rest.

    Postures (N, nv) are by joint of the model. Dry friction is ignored, as its static value is
    unknown.
    """
    still = at_rest(postures)
    if stance is None:
        return postures, model.effort(still), np.zeros(len(postures))
    q, _, _ = stance.motor_states(np.stack([still.q, still.v, still.vd]))
    return q, stance.efforts(still), stance.support(still)[0]


def check_start(problem: DesignProblem, start: Array, *, name: str = "start") -> None:
    """Raise if the robot cannot hold a start (nv,) by joint, rad or m."""
    stance, collisions = problem.stance, problem.collisions
    real_array(start, name, (len(problem.limits.joints),))
    (q,), (effort,), (polygon,) = _held(problem.model, stance, start[None])
    for limits, position in ((problem.limits, start), (problem.motor_limits, q)):
        slack = _ROUNDING * (1.0 + limits.reach)
        outside = (position < limits.lower - slack) | (position > limits.upper + slack)
        if outside.any():
            i = int(np.argmax(outside))
            raise ArgumentError(
                f"The {name} is outside the limits: joint {limits.joints[i]!r} is at "
                f"{position[i]:.4g}, but its range is {limits.lower[i]:.4g} to "
                f"{limits.upper[i]:.4g}.",
                advice="Move the robot inside first, or omit the start.",
                joint=limits.joints[i],
            )
    if stance is not None and not polygon <= stance.margin:
        raise ArgumentError(
            f"The robot falls over at the {name}: its centre of mass is over "
            f"{100 * polygon:.0f} % of the way from the middle of its feet to their edge; "
            f"{100 * stance.margin:.0f} % are allowed.",
            advice="Choose a posture with the centre of mass over the feet.",
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
    """Return postures (n, nv) by joint that a robot can hold, from the middle of its ranges.

    Postures of a robot on its feet start from its stance, with the centre of mass over the feet.
    """
    random = np.random.default_rng(0)
    shares = np.linspace(0.0, 0.95, _POSTURES)[:, None]  # from the middle outwards
    shares = shares * random.uniform(-1.0, 1.0, (_POSTURES, len(limits.joints)))
    postures = limits.middle + limits.reach * shares
    if stance is not None:
        center = np.clip(stance.posture, limits.lower, limits.upper)
        shares = np.linspace(0.0, 1.0, _POSTURES)[:, None]
        postures = stance.balanced(center + shares * (postures - center), limits)
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
                f"from the middle of its feet to their edge; {100 * stance.margin:.0f} % are "
                "allowed.",
                advice="Let it stand in another posture (--stand), or on more feet.",
            )
        postures, efforts = postures[inside], efforts[inside]
    holds = (efforts <= limits.effort).all(axis=1)
    if not holds.any():
        least = int(np.argmin((efforts / limits.effort).max(axis=1)))
        i = int(np.argmax(efforts[least] / limits.effort))
        words = ", ".join(
            f"{n} {x:.3g}" for n, x in zip(model.joints, postures[least].tolist(), strict=True)
        )
        raise ArgumentError(
            f"The robot cannot hold itself against gravity: in the best of {_POSTURES} "
            f"postures ({words}), joint {limits.joints[i]!r} needs an effort of "
            f"{efforts[least, i]:.4g}, but its limit is {limits.effort[i]:.4g}.",
            advice="Raise the effort limits, or check masses and units of the model.",
            joint=limits.joints[i],
        )
    postures = postures[holds]
    return postures[:most] if collisions is None else _apart(postures, collisions, most)


def below_floor(
    world: CollisionWorld, model: RobotModel, limits: MotionLimits, start: Array | None
) -> str:
    """Return why a floor at the base is impossible, or "": the robot hangs or starts below it."""
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
    """Return the first postures without collisions, without checking the others."""
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
            advice="Check the geometry and the poses of obstacles. Use --no-floor to omit the "
            "assumed floor.",
        )
    return np.array(free)


def random_guess(
    problem: DesignProblem,
    postures: Array,
    rng: np.random.Generator,
    budget: Budget = UNLIMITED,
) -> Array:
    """Return variables (f, nv) of a random motion within limits around one of the postures."""
    for _ in range(_TRIALS):
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
        f"{_TRIALS} postures satisfies them.",
        advice="Widen the limits that are nearly reached at rest, or start elsewhere.",
    )


def _through(
    problem: DesignProblem,
    stance: Stance,
    begin: Array,
    postures: Array,
    rng: np.random.Generator,
) -> Array:
    """Return a nearly balanced motion (f, nv) from a posture (nv,) through other postures.

    Most random directions lose balance at once. Each round balances all instants with the current
    accelerations, which the new positions change again.
    """
    count = max(2, int(problem.family.length / problem.family.fastest))
    knots, basis = np.linspace(0.0, 1.0, count + 1), problem.effort_basis
    position = basis[0] @ problem.free

    def fit(q: Array) -> Array:
        """Return the motion closest to positions at the instants of the basis."""
        change = q - basis[0] @ problem.offset
        return np.asarray(np.linalg.lstsq(position, change, rcond=1e-6)[0] / problem.scale)

    q = postures[rng.integers(len(postures), size=count + 1)]
    q[0] = begin
    variables = fit(PchipInterpolator(knots, q)(np.linspace(0.0, 1.0, len(position))))
    for _ in range(_ROUNDS):
        motion = problem.motion(variables, basis)
        share = _INNER * stance.margin
        variables = fit(stance.balanced(motion.q, problem.limits, motion, share=share))
    return variables


def _from_corners(problem: DesignProblem, rng: np.random.Generator) -> Array:
    """Return a random mean (f, nv) of a few motions at the limits of the joints.

    From a start at a limit most random directions leave the limits at once. A linear program finds
    motions that do not.
    """
    program = MathematicalProgram()
    variables = program.NewContinuousVariables(*problem.scale.shape)
    limit_motion(program, problem, variables)
    cost = program.AddLinearCost(np.zeros(variables.size), variables.ravel())
    corners = []
    directions = rng.normal(size=(_CORNERS, variables.size))
    for direction in (*directions, *-directions):  # one sign may be blocked at a limit
        cost.evaluator().UpdateCoefficients(direction)
        result = ClpSolver().Solve(program)
        if not result.is_success():
            raise ArgumentError(
                "No motion of the family begins at the start and satisfies the limits.",
                advice="Use more coefficients or a longer motion, or start elsewhere.",
            )
        corners.append(result.GetSolution(variables))
    weights = rng.dirichlet(np.ones(len(corners)), size=problem.scale.shape[1])  # per joint
    return np.asarray(np.einsum("jc,cfj->fj", weights, np.array(corners)))


def _room(problem: DesignProblem, around: Array, direction: Array) -> Array:
    """Return the multiples (nv,) of a direction by which each joint can move within its limits."""
    states = problem.limit_basis @ problem.coefficients(around)
    change = problem.limit_basis @ (problem.free @ (problem.scale * direction))
    lower, upper = (np.stack(side)[:, None] for side in zip(*problem.bounds, strict=True))
    room, size = np.where(change > 0, upper - states, states - lower), np.abs(change)
    moving = size > _NEGLIGIBLE * size.max(axis=1, keepdims=True)
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
    """Return the last motion within limits on the line from one inside them to another.

    Args:
        variables: (f, nv) variables of the other motion, within the limits or close to them.
        inside: (f, nv) variables of the motion within the limits.
        budget: When time is up, the last one found so far is returned.
    """
    least, step = 0.0, _FIRST_STEP_BACK
    most = 1.0
    with suppress(SearchEndError):
        if keeps_limits(problem, variables, stride=stride, budget=budget):
            return variables
        while most - least > _CLOSE:
            share = most - step if most - step > least else 0.5 * (least + most)
            candidate = inside + share * (variables - inside)
            if keeps_limits(problem, candidate, stride=stride, budget=budget):
                least = share
            else:
                most, step = share, 4.0 * step
    return np.asarray(inside + least * (variables - inside))


_SHARE = 0.5  # of the limits of speed, acceleration and jerk
# Maxima of the derivatives of 10 x³ − 15 x⁴ + 6 x⁵, a spline with triple end points.
_PEAKS = 1.875, 10.0 / np.sqrt(3.0), 60.0
_LEAST = 1.0  # s, duration of a ramp segment
_SLOWER, _TIMES = 1.5, 8  # slow-down factor if efforts are too large, and maximum count
_VIA = 100  # candidates for an intermediate posture of a ramp


def with_ramps(
    problem: DesignProblem, trajectory: ExcitationTrajectory, stand: Array
) -> ExcitationTrajectory:
    """Return a motion with ramps from and to where the robot stands, (nv,) by joint.

    They use half of the limits of speed, acceleration and jerk, and take at least a second. A ramp
    is straight in joint space; if that violates a limit, it passes through another posture.
    """
    begin, end = trajectory.free_states([0.0, trajectory.length])[0]
    ramp_in = _ramp(problem, trajectory, stand, begin)
    ramp_out = _ramp(problem, trajectory, end, stand)
    parts = [part for part in (ramp_in, trajectory, ramp_out) if part is not None]
    return parts[0].followed_by(*parts[1:])


def _ramp(
    problem: DesignProblem, like: ExcitationTrajectory, begin: Array, end: Array
) -> ExcitationTrajectory | None:
    """Return the ramp between postures (nv,); None if they are the same."""
    if np.array_equal(begin, end):
        return None
    limits, world = problem.limits, problem.collisions
    bounds = limits.velocity, limits.acceleration, limits.jerk
    for postures in _paths(problem, begin, end):
        changes = np.abs(np.diff(postures, axis=0))
        times = [
            (peak * changes / (_SHARE * bound)) ** (1.0 / order)
            for order, (peak, bound) in enumerate(zip(_PEAKS, bounds, strict=True), 1)
        ]
        durations = np.maximum(np.max(times, axis=(0, 2)), _LEAST)
        for slower in _SLOWER ** np.arange(_TIMES):
            families = [SplineMotion(slower * duration, 6) for duration in durations]
            segments = [
                replace(like, family=family, coefficients=np.repeat(ends, 3, axis=0))
                for family, ends in zip(families, pairwise(postures), strict=True)
            ]
            ramp = segments[0].followed_by(*segments[1:])
            use, motion = joint_use(problem, ramp)
            if use.is_within:
                if world is None or stays_clear(world, motion.q):
                    return ramp
                break
    raise ArgumentError(
        "No ramp leads from the rest position to the start of the motion: neither a "
        f"straight one nor one through {_VIA} postures satisfies clearance, "
        f"{'balance ' * (like.stance is not None)}and efforts.",
        advice="Start the motion at the rest position instead: --start.",
    )


def _paths(problem: DesignProblem, begin: Array, end: Array) -> Iterator[Array]:
    """Yield the straight path, and then paths through another posture, the shortest first."""
    yield np.array([begin, end])
    limits = problem.limits
    via = possible_postures(
        problem.model, limits, problem.collisions, stance=problem.stance, most=_VIA
    )
    sizes = [np.abs((via - p) / limits.reach).max(axis=1) for p in (begin, end)]
    for k in np.argsort(sizes[0] + sizes[1]):
        if sizes[0][k] > 0 and sizes[1][k] > 0:
            yield np.array([begin, via[k], end])
