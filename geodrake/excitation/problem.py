"""The design problem in scaled solver variables.

The coefficients of all joints are C = C₀ + Z (s ∘ Y). C₀ meets the end conditions, the columns of Z
span their null space, and the scale s is such that a single variable of one reaches a limit of its
joint. All variables are then of similar size, and the ends need no constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.solvers import MathematicalProgram
from scipy.linalg import null_space

from geodrake.boundary.arguments import instance, instances, integer, number, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.excitation.collisions import CollisionWorld
from geodrake.excitation.families import MotionFamily
from geodrake.excitation.limits import MotionLimits, motion_limits
from geodrake.excitation.objective import Objective
from geodrake.excitation.regressor_gradient import effort_gradient
from geodrake.excitation.stance import Stance
from geodrake.excitation.trajectory import ExcitationTrajectory
from geodrake.inertia import Array
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel

Constraint = tuple[Callable[[Array], tuple[Array, Array]], int, float, float]

_MOST, _MOST_SAMPLES = 1_000_000, 10_000
_EFFORT_SHARE = 0.1  # interval between effort constraints, of the family's shortest time
_COLLISION_SHARE = 0.05  # interval between collision constraints, likewise
_AFTER_START = np.array([0.02, 0.05, 0.1, 0.2, 0.4, 0.7])  # of the first interval
_CORNERS, _NEAR = 200, 0.8  # number of states, and share of a limit from which an effort is close
_STILL = 1e-8  # relative error of a constant motion
_NEGLIGIBLE = 1e-12  # relative size attributed to rounding
_WITHIN = {1: 0.992, 2: 0.96}  # share of limits, by stride between instants
_MANY = 40  # variables from which a quick search constrains derivatives at every second instant


@dataclass(frozen=True, eq=False)
class DesignOptions(Short):
    """Options of a design.

    Attributes:
        samples: Number of samples of the information matrix.
        stance: The feet on which the robot stands; None if its base is fixed. Limits, start and
            stand are then those of the motors.
        rest: Whether the motion starts and ends at rest, without a jump of acceleration.
        start: (nv,) positions at the start by joint, rad or m; free if None. Ignored for free
            samples.
        stand: (nv,) positions where the robot stands, from and to which ramps lead; no ramps if
            None.
        solver: "snopt" or "ipopt". With many possible collisions, one may succeed where the other
            gets stuck.
        iterations: Maximum number of solver iterations in each stage.
        seconds: Maximum time of the whole design, shared by its starts, s.
        sharpness: Stages of the smooth forms of E-optimality and condition number; see
            `Criterion`. If None, 24 in a quick search, otherwise 8 and then 64.
        guess: (count, nv) coefficients of an initial motion, besides the random ones. It is scaled
            down to the limits.
        quick: Whether a stage ends once the value changes by less than 5 % in twelve evaluations,
            since solvers spend minutes on the last digits. Speeds and accelerations of many joints
            are then constrained at half as many instants, to 96 % of their limits. The final check
            is the same.
    """

    samples: int = 300
    stance: Stance | None = None
    rest: bool = True
    start: ArrayLike | None = None
    stand: ArrayLike | None = None
    collisions: CollisionWorld | None = None
    solver: str = "snopt"
    iterations: int = 300
    seconds: float = 180.0
    sharpness: tuple[float, ...] | None = None
    guess: Array | None = None
    quick: bool = True

    def __post_init__(self) -> None:
        integer(self.samples, "samples", lower=1, upper=_MOST_SAMPLES)
        integer(self.iterations, "iterations", lower=1, upper=_MOST)
        number(self.seconds, "seconds", lower=0.0, upper=_MOST, strict=True)
        instance(self.quick, "quick", bool)
        instance(self.solver, "solver", str)
        if self.stance is not None:
            instance(self.stance, "stance", Stance)
        for sharpness in instances(self.sharpness or (), "sharpness", object):
            number(sharpness, "sharpness", lower=0.0, finite=False)
        for name in ("start", "stand"):
            if getattr(self, name) is not None:
                real_array(getattr(self, name), name, ("nv",))
        if self.guess is not None:
            real_array(self.guess, "guess")
        if self.collisions is not None:
            instance(self.collisions, "collisions", CollisionWorld)


@dataclass(frozen=True, eq=False)
class DesignProblem(Short):
    """The most informative motion of a family within limits, as a function of variables.

    Limits are those of the model's joints.
    """

    objective: Objective
    limits: MotionLimits
    family: MotionFamily
    options: DesignOptions

    @property
    def model(self) -> RobotModel:
        """The robot."""
        return self.objective.target.model

    @property
    def stance(self) -> Stance | None:
        """The feet on which the robot stands; None if its base is fixed."""
        return self.options.stance

    @property
    def collisions(self) -> CollisionWorld | None:
        """Obstacles and collision geometry."""
        return self.options.collisions

    @property
    def sign_width(self) -> Array:
        """(nv,) speed over which friction changes sign."""
        return self.objective.target.sign_width

    @property
    def motor_limits(self) -> MotionLimits:
        """Limits of the motors, which are the model's joints unless the robot stands on feet."""
        return self.limits if self.stance is None else self.stance.motor_limits

    @cached_property
    def start(self) -> Array | None:
        """(nv,) positions at the start by joint; None if free, as for free samples."""
        return self._placed("start") if self.family.timed else None

    @cached_property
    def stand(self) -> Array | None:
        """(nv,) positions where ramps begin and end, by joint; None without ramps."""
        return self._placed("stand") if self.family.timed else None

    def _placed(self, name: str) -> Array | None:
        """Return an option as positions (nv,) of the model's joints."""
        if (given := getattr(self.options, name)) is None:
            return None
        given = np.asarray(given, float)
        return given if self.stance is None else self.stance.free(given, name)

    @cached_property
    def conditions(self) -> Array:
        """(k, count) rows E; E c is zero except for the last row, a given start."""
        return self.family.conditions(rest=self.options.rest, start=self.start is not None)

    @cached_property
    def free(self) -> Array:
        """(count, f) orthonormal Z."""
        if not len(self.conditions):
            return np.eye(self.family.count)
        sizes = np.linalg.norm(self.conditions, axis=1, keepdims=True)
        return np.asarray(null_space(self.conditions / sizes))

    @cached_property
    def offset(self) -> Array:
        """(count, nv) C₀, which meets a given start; otherwise zero."""
        nv = len(self.limits.joints)
        if self.start is None:
            return np.zeros((self.family.count, nv))
        values = np.zeros((len(self.conditions), nv))
        values[-1] = self.start
        return np.asarray(np.linalg.lstsq(self.conditions, values)[0])

    @cached_property
    def times(self) -> Array:
        """(N,) instants of the samples."""
        return self.family.times(self.options.samples)

    @cached_property
    def basis(self) -> Array:
        """(3, N, count) basis of the samples."""
        return self.family.basis(self.times)

    @cached_property
    def limit_basis(self) -> Array:
        """(3 or 4, n, count) basis at the limited instants, including jerks if one is limited.

        Instants are closer after a given start, which may be at a limit.
        """
        times = self.family.limit_times()
        if self.start is not None:
            times = np.union1d(times, _AFTER_START * times[1])
        return self.family.basis(times, orders=len(self.bounds))

    @cached_property
    def bounds(self) -> tuple[tuple[Array, Array], ...]:
        """Bounds of positions, velocities, accelerations, and of jerks if one is limited."""
        limits = self.limits
        sizes = [limits.velocity, limits.acceleration]
        if self.family.timed and np.isfinite(limits.jerk).any():
            sizes.append(np.asarray(limits.jerk))
        return (limits.lower, limits.upper), *((-size, size) for size in sizes)

    @cached_property
    def effort_basis(self) -> Array:
        """(3, n, count) basis at the instants of effort constraints."""
        return self.family.basis(self.family.limit_times(_EFFORT_SHARE))

    @cached_property
    def collision_basis(self) -> Array:
        """(3, n, count) basis at the instants of collision constraints."""
        return self.family.basis(self.family.limit_times(_COLLISION_SHARE))

    @cached_property
    def scale(self) -> Array:
        """(f, nv) scale s of the variables."""
        reach = np.abs(self.limit_basis[:3] @ self.free).max(axis=1)  # (3, f)
        bounds = np.stack([self.limits.reach, self.limits.velocity, self.limits.acceleration])
        ratios = bounds[:, None, :] / np.maximum(reach, 1e-300)[:, :, None]
        return np.asarray(ratios.min(axis=0))

    @cached_property
    def still(self) -> Array | None:
        """(count,) coefficients of the constant one; None if the family does not contain it."""
        constant = np.repeat([1.0, 0.0, 0.0], self.basis.shape[1])
        stacked = self.basis.reshape(-1, self.family.count)
        solution = np.asarray(np.linalg.lstsq(stacked, constant)[0])
        return solution if np.abs(stacked @ solution - constant).max() < _STILL else None

    def resting(self, posture: Array) -> Array:
        """Return the variables (f, nv) of resting in a posture (nv,)."""
        if self.still is None:
            outside = (self.limits.lower > 0) | (self.limits.upper < 0)
            if outside.any():
                raise ArgumentError(
                    f"A {self.family.name} motion without an offset is around zero, which "
                    f"joint {self.limits.joints[int(np.argmax(outside))]!r} cannot reach.",
                    advice="Allow an offset in the family.",
                )
            return np.zeros_like(self.scale)
        return self.variables(np.outer(self.still, posture))

    def variables(self, coefficients: Array) -> Array:
        """Return variables Y (f, nv) closest to coefficients (count, nv)."""
        return np.asarray(self.free.T @ (coefficients - self.offset) / self.scale)

    def coefficients(self, variables: Array) -> Array:
        """Return the coefficients C (count, nv) of variables, (f, nv) or flat."""
        return np.asarray(
            self.offset + self.free @ (self.scale * variables.reshape(self.scale.shape))
        )

    def trajectory(self, variables: Array) -> ExcitationTrajectory:
        """Return the trajectory of variables."""
        coefficients = self.coefficients(variables)
        joints = self.motor_limits.joints
        return ExcitationTrajectory(self.family, coefficients, joints, self.stance)

    def motion(self, variables: Array, basis: Array) -> Motion:
        """Return the motion of variables at the instants of a basis.

        With several feet, positions are clipped to the limits: solvers may try poses of the base
        that the legs cannot reach.
        """
        states = basis @ self.coefficients(variables)
        if self.stance is not None and len(self.stance.following):
            states[0] = np.clip(states[0], self.limits.lower, self.limits.upper)
        return Motion(*states)

    def cost(self, variables: Array) -> tuple[float, Array]:
        """Return the cost and its gradient (f nv,)."""
        motion = self.motion(variables, self.basis)
        value, gradient = self.objective.value_and_gradient(motion)
        by_coefficients = np.einsum("dnc,dnj->cj", self.basis, np.stack(gradient))
        return value, (self.scale * (self.free.T @ by_coefficients)).ravel()

    @cached_property
    def loaded(self) -> NDArray[np.intp]:
        """(k,) joints whose efforts may approach their limits; only these are constrained.

        They are found in random postures with every joint at its largest speed and acceleration.
        The final check covers the efforts of all joints.
        """
        limits, nv = self.limits, len(self.limits.joints)
        random, shape = np.random.default_rng(0), (_CORNERS, nv)
        signs = [random.choice([-1.0, 1.0], shape) for _ in range(2)]
        fastest = np.minimum(limits.acceleration, self.family.steepness * limits.velocity)
        unlimited = ~np.isfinite(fastest)
        q = limits.middle + limits.reach * random.uniform(-1.0, 1.0, shape)
        vd = signs[1] * np.where(unlimited, 0.0, fastest)
        motion = Motion(q, signs[0] * limits.velocity, vd)
        efforts = np.abs(self.model.effort(motion, sign_width=self.sign_width)).max(axis=0)
        close = unlimited.any() | (efforts > _NEAR * limits.effort)
        return np.flatnonzero(close & np.isfinite(limits.effort))

    @property
    def constraints(self) -> list[Constraint]:
        """Nonlinear functions of the variables, with number of values and their bounds."""
        constraints: list[Constraint] = []
        instants = self.effort_basis.shape[1]
        if self.stance is not None:
            constraints.append((self.excess, instants, -np.inf, 0.0))
        elif len(self.loaded):
            constraints.append((self.efforts, instants * len(self.loaded), -1.0, 1.0))
        if self.collisions is not None:
            constraints.append((self.nearness, self.collision_basis.shape[1], -np.inf, 1.0))
        return constraints

    def efforts(self, variables: Array) -> tuple[Array, Array]:
        """Return efforts (n k,) of `loaded` joints over their limits, and Jacobian (n k, f nv)."""
        motion, width = self.motion(variables, self.effort_basis), self.sign_width
        (n, nv), k, limits = motion.v.shape, len(self.loaded), self.limits.effort[self.loaded]
        effort = self.model.effort(motion, sign_width=width)[:, self.loaded]
        repeated = Motion(*(np.repeat(x, k, axis=0) for x in (motion.q, motion.v, motion.vd)))
        weights = np.tile(np.eye(nv)[self.loaded] / limits[:, None], (n, 1))
        seen = self.model.motion(repeated, sign_width=width)
        gradient = effort_gradient(self.model, repeated, seen, weights)
        return (effort / limits).ravel(), self._jacobian(self.effort_basis, gradient)

    def excess(self, variables: Array) -> tuple[Array, Array]:
        """Return the values (n,) of `Stance.excess`, and their Jacobian (n, f nv)."""
        if self.stance is None:
            return np.zeros(0), np.zeros((0, self.scale.size))
        motion = self.motion(variables, self.effort_basis)
        values, gradient = self.stance.excess(motion, self.sign_width)
        return values, self._jacobian(self.effort_basis, gradient)

    def nearness(self, variables: Array) -> tuple[Array, Array]:
        """Return the values (n,) of `CollisionWorld.constraint`, and their Jacobian (n, f nv)."""
        if self.collisions is None:
            return np.zeros(0), np.zeros((0, self.scale.size))
        values, by_q = self.collisions.constraint(self.motion(variables, self.collision_basis).q)
        return values, self._jacobian(self.collision_basis, [by_q])

    def _jacobian(self, basis: Array, gradients: Sequence[Array]) -> Array:
        """Return the Jacobian (n k, f nv) of k values at each of the n instants of a basis.

        Gradients (n k, nv) are with respect to positions and, optionally, their derivatives.
        """
        free, nv = basis @ self.free, self.scale.shape[1]
        jacobian = sum(
            np.einsum("nij,nk->nikj", part.reshape(len(order), -1, nv), order)
            for part, order in zip(gradients, free, strict=False)
        )
        return (np.asarray(jacobian) * self.scale).reshape(-1, self.scale.size)


def make_problem(
    objective: Objective,
    limits: MotionLimits | None,
    family: MotionFamily,
    options: DesignOptions,
) -> DesignProblem:
    """Return the checked design problem of an objective and options."""
    model, stance = objective.target.model, options.stance
    model.positions(np.zeros((1, len(model.joints))))  # rejects joints with several degrees
    if stance is None and model.base_joints:
        raise ArgumentError(
            f"The base of {model.path.name} is free, but nothing supports it.",
            advice="Name the feet that it stands on: --feet LINK,LINK (options.stance). For a "
            "robot whose base is fixed, omit --floating.",
        )
    if stance is not None:
        if model is not stance.model:
            raise ArgumentError(
                "The target belongs to another robot than the stance.",
                advice="Create it with stance.model.",
            )
        stance = stance if limits is None else stance.within(limits)
        limits, options = stance.limits(), replace(options, stance=stance)
    limits = motion_limits(model, bounded=True) if limits is None else limits
    if limits.joints != model.joints:
        raise ArgumentError(
            f"The limits have joints {limits.joints}, but the robot has {model.joints}."
        )
    if not family.timed and not np.isfinite(limits.acceleration).all():
        joint = limits.joints[int(np.argmin(np.isfinite(limits.acceleration)))]
        raise ArgumentError(
            f"The acceleration of joint {joint!r} is unlimited, and free samples have no "
            "other bound for it.",
            advice=f"Limit it, such as acceleration={{{joint!r}: 5.0}}.",
            joint=joint,
        )
    return DesignProblem(objective, limits, family, options)


def limit_motion(
    program: MathematicalProgram, problem: DesignProblem, variables: NDArray[np.object_]
) -> None:
    """Add the linear constraints of every joint on the program's variables (f, nv).

    A derivative is not constrained if the limits of the lower order already imply its own.
    """
    # Between its 20 or 10 samples a period, a sine exceeds them by less than this reserve.
    stride = 2 if problem.options.quick and variables.size >= _MANY else 1
    for j in range(len(problem.limits.joints)):
        largest = np.inf
        for order, (Phi, (lower, upper)) in enumerate(
            zip(problem.limit_basis, problem.bounds, strict=True)
        ):
            within, step = (_WITHIN[stride], stride) if order else (1.0, 1)
            low, high = within * lower[j], within * upper[j]
            largest *= problem.family.steepness
            if largest <= high:  # both are infinite for unlimited derivatives
                continue
            largest = 0.5 * (upper[j] - lower[j])
            A = Phi[::step] @ problem.free * problem.scale[:, j]
            fixed = Phi[::step] @ problem.offset[:, j]
            reach = np.abs(A).max(axis=1)
            moving = reach > _NEGLIGIBLE * reach.max()  # excludes a given start
            A, fixed, reach = A[moving], fixed[moving], reach[moving]
            program.AddLinearConstraint(
                A / reach[:, None], (low - fixed) / reach, (high - fixed) / reach, variables[:, j]
            )
