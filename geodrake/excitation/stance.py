"""Robots that stand on feet at rest.

Feet at rest close loops between the robot and the ground (`geodrake.robot.loops`). On one foot the
motors are the free joints, and the base depends on them; on several the base is free, and the legs
depend on it. With θ̇ = G q̇ the efforts Gᵀ τ of the free joints contain no ground force, [Lee2019]
Eq. (3.6.57), so they are designed for like those of any other robot. If more motors act than
needed, τ minimizes the sum of squared efforts relative to their limits.

The robot is in balance if the ground's wrench (n, f) about the origin, z upwards, meets

    (−n_y, n_x)/f_z within a share of the polygon of the feet,       [Lee2019] §4.6.3
    |f_x| + |f_y| ≤ μ f_z,      |n_z about the polygon's middle| ≤ μ r f_z,

where r is the least distance of a side from the middle. Each condition is linear in the wrench.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.tree import RigidBody
from scipy.special import logsumexp

from geodrake.boundary.arguments import instance, number, one_or_each, real_array
from geodrake.boundary.showing import Short
from geodrake.effects import Effect, FittedEffect
from geodrake.errors import ArgumentError
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.regressor_gradient import (
    MotionGradient,
    at_actuators,
    base_wrench_regressor_gradient,
    effort_gradient,
)
from geodrake.excitation.target import Target, make_target
from geodrake.inertia import Array
from geodrake.logs.floating import QUATERNION
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel
from geodrake.robot.coordinates import DrivenCoordinates, RobotCoordinates
from geodrake.robot.joints import joint_names, single_joints
from geodrake.robot.regressor import base_wrench_regressor, zero_moment_point
from geodrake.robot.transmission import times

_SLACK = 0.005  # rad or m, tolerance on motor positions while the feet stay in place
_SHARP = 50.0  # sharpness of the smooth maximum, which exceeds the maximum by at most log(n)/50
_RANDOM = 200
_NEWTON, _CENTRAL, _ARRIVED = 12, 0.5, 1e-3  # steps to balance, share of the polygon, m
_DAMPING = 1e-12  # m², regularizes the Jacobian of the zero-moment point
_BATCH = 2000  # samples whose regressors are in memory at once


@dataclass(frozen=True, eq=False)
class Foot(Short):
    """A part of a robot that touches the ground: a sole, a rolling ball, or a point.

    Attributes:
        frame: Name of a link, or of another frame of the model file.
        points: (k, 3) corners of the sole in the frame, m; one point for a point foot or the
            center of a ball.
        radius: Radius of the ball, m; otherwise 0.
    """

    frame: str
    points: ArrayLike
    radius: float = 0.0

    def __post_init__(self) -> None:
        instance(self.frame, "frame", str)
        object.__setattr__(self, "points", real_array(self.points, "points", ("k", 3)))
        count = len(np.asarray(self.points))
        if count not in (1, *range(3, 10_000)):
            raise ArgumentError(
                f"Foot {self.frame!r} has {count} points.",
                advice="A foot is one point, or a sole of at least three corners.",
            )
        if number(self.radius, "radius", lower=0.0) and count > 1:
            raise ArgumentError(
                f"Foot {self.frame!r} has {count} points and a radius of {self.radius:g} m.",
                advice="A ball has one point, its center; a sole has no radius.",
            )

    @classmethod
    def sole(cls, frame: str, length: float, width: float) -> Foot:
        """Return a rectangular sole, centered in its frame, with its length along x."""
        for name, value in (("length", length), ("width", width)):
            number(value, name, lower=0.0, strict=True)
        signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        return cls(frame, np.hstack([0.5 * signs * [length, width], np.zeros((4, 1))]))

    @property
    def is_sole(self) -> bool:
        """Whether the ground can apply moments to it."""
        return len(np.asarray(self.points)) > 1


@dataclass(frozen=True, eq=False)
class MotorCoordinates(DrivenCoordinates):
    """The map from the free joints of a robot on its feet to its motors, θ = T(q)."""

    coordinates: RobotCoordinates
    motors: tuple[str, ...]

    @cached_property
    def free(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Indices of the free motors among the motors, and among the free joints."""
        names = self.coordinates.names
        pairs = [(k, names.index(n)) for k, n in enumerate(self.motors) if n in names]
        motors, joints = np.array(pairs, np.intp).reshape(-1, 2).T
        return motors, joints

    @cached_property
    def following(self) -> NDArray[np.intp]:
        """Indices of the motors that depend on the free joints."""
        return np.setdiff1d(np.arange(len(self.motors)), self.free[0])

    @property
    def driven(self) -> NDArray[np.intp]:
        """Indices of the free joints that are driven through a transmission."""
        return self.coordinates.driven

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of motors and of free joints."""
        return len(self.motors), len(self.coordinates.names)

    @cached_property
    def constant(self) -> Array | None:
        """G (m, nv) if no motor depends on the free joints; otherwise None."""
        return None if len(self.following) else np.eye(self.shape[1])[self.free[1]]

    def along(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return the positions (N, m) of the motors, G and its rate."""
        theta, (motors, joints) = np.empty((len(q), self.shape[0])), self.free
        G, rate = np.zeros((2, len(q), *self.shape))
        theta[:, motors] = q[:, joints]
        G[:, motors, joints] = 1.0
        if len(following := self.following):
            behind = [self.coordinates.behind[self.motors[k]] for k in following]
            sources = self.coordinates.along_all(q, v)
            for values, source in zip((theta, G, rate), sources, strict=True):
                values[:, following] = source[:, behind]
        return theta, G, rate


@dataclass(frozen=True, eq=False)
class Stance(Short):
    """A robot on feet at rest.

    Attributes:
        robot: The robot with a floating base.
        model: The robot on its feet, with the free joints.
        posture: (nv,) positions of the free joints when the feet were placed, rad or m.
        placed: (m,) positions of the motors in that posture.
        corners: (k, 2) corners of the feet's polygon on the ground, counterclockwise, m.
        friction: Friction coefficient μ between feet and ground.
        margin: Share of the polygon, from its middle, in which the zero-moment point stays.
        motor_limits: Limits of the motors.
    """

    robot: RobotModel
    model: RobotModel
    feet: tuple[Foot, ...]
    posture: Array
    placed: Array
    corners: Array
    friction: float
    margin: float
    motor_limits: MotionLimits

    @property
    def motors(self) -> tuple[str, ...]:
        """Names of all joints except those of the base."""
        return self.motor_limits.joints

    def within(self, limits: MotionLimits) -> Stance:
        """Return the stance with other motor limits."""
        if instance(limits, "limits", MotionLimits).joints != self.motors:
            raise ArgumentError(
                f"The limits have joints {limits.joints}, but the motors are {self.motors}."
            )
        return replace(self, motor_limits=limits)

    # Motion of the motors.

    @cached_property
    def coordinates(self) -> MotorCoordinates:
        """The map to the motors."""
        return MotorCoordinates(self.model.coordinates, self.motors)

    @property
    def following(self) -> NDArray[np.intp]:
        """Indices of the motors that depend on the free joints."""
        return self.coordinates.following

    def motor_states(self, states: Array) -> Array:
        """Return the states (3, N, m) of the motors for states (3, N, nv) of the free joints."""
        return self._states_and_ratios(*states)[0]

    def _states_and_ratios(self, q: Array, v: Array, vd: Array) -> tuple[Array, Array]:
        """Return the states (3, N, m) of the motors, and G (N, m, nv)."""
        theta, G, rate = self.coordinates.along(q, v)
        return np.stack([theta, times(G, v), times(G, vd) + times(rate, v)]), G

    def free(self, motors: Array, name: str) -> Array:
        """Return positions (nv,) of the free joints for motor positions (m,), rad or m."""
        motors = real_array(motors, name, (len(self.motors),))
        q, (free_motors, joints) = self.posture.copy(), self.coordinates.free
        q[joints] = motors[free_motors]
        placed = self.coordinates.joint_positions(q[None])[0]
        error = np.abs(placed - motors)
        if error.max() > _SLACK:
            k = int(np.argmax(error))
            raise ArgumentError(
                f"The {name} has joint {self.motors[k]!r} at {motors[k]:.4g}, but with the feet "
                f"in place it is at {placed[k]:.4g}.",
                advice="A robot on several feet starts where it stands: give one posture.",
            )
        return q

    def base_columns(self, motion: Motion) -> dict[str, Array]:
        """Return the pose of the base as log columns (N,)."""
        body = root_of(self.robot)
        context, rows = self.robot.plant.CreateDefaultContext(), []
        for q in self.model.plant_positions(motion.q):
            self.robot.plant.SetPositions(context, q)
            X = self.robot.plant.EvalBodyPoseInWorld(context, body)
            rows.append([*X.translation(), *X.rotation().ToQuaternion().wxyz()])
        names = [f"base.position.{axis}" for axis in "xyz"]
        names += [f"base.orientation.{axis}" for axis in QUATERNION]
        return dict(zip(names, np.array(rows).T, strict=True))

    def limits(self) -> MotionLimits:
        """Return the limits of the free joints.

        A base has the position range in which its feet can stay, and the velocities and
        accelerations along each single axis at which the dependent motors keep their limits.
        """
        own, joints, (motors, free) = self.motor_limits, self.model.joints, self.coordinates.free
        sides = own.lower, own.upper, own.velocity, own.acceleration, own.effort, own.jerk
        limits = np.full((len(sides), len(joints)), np.inf)
        limits[:2] = np.nan
        limits[:, free] = np.stack(np.broadcast_arrays(*sides))[:, motors]
        base = np.flatnonzero(np.isin(joints, self.robot.base_joints))
        if len(base):
            low, high = self.model.position_limits  # ranges in which the feet can stay
            limits[0], limits[1] = np.fmax(limits[0], low), np.fmin(limits[1], high)
            random = np.random.default_rng(0)
            q = random.uniform(limits[0], limits[1], (_RANDOM, len(joints)))
            G = np.abs(self.coordinates.jacobian(q)).max(axis=0)[:, base]
            with np.errstate(divide="ignore"):
                for values, limit in zip(limits[2:4], sides[2:4], strict=True):
                    values[base] = (limit[:, None] / G).min(axis=0)
        return MotionLimits(joints, *limits)

    # Efforts.

    def efforts(self, motion: Motion, sign_width: ArrayLike = 0.0) -> Array:
        """Return the motor efforts (N, m) for a motion of the free joints, N·m or N."""
        needed = self.model.effort(motion, sign_width=sign_width)
        return self._shared(self.coordinates.jacobian(motion.q), needed)[0]

    @cached_property
    def _weights(self) -> Array:
        """(m,) squared effort limits relative to the largest; 1 without limits."""
        limits = self.motor_limits.effort
        largest = limits[np.isfinite(limits)].max(initial=0.0) or 1.0
        return np.square(np.where(np.isfinite(limits), limits, largest) / largest)

    def _shared(self, G: Array, needed: Array) -> tuple[Array, Array, Array]:
        """Return motor efforts D G b (N, m) for the efforts e = C b (N, nv) needed, b and C."""
        D = self._weights
        C = np.asarray(np.swapaxes(G, 1, 2) @ (D[:, None] * G))
        b = _solved(C, needed)
        return D * times(G, b), b, C

    def _effort_gradient(
        self, motion: Motion, sign_width: Array, G: Array, needed: Array, weights: Array
    ) -> MotionGradient:
        """Return the gradient of Σ w ∘ τ for w (N, m), with the efforts needed (N, nv)."""
        seen, D = self.model.motion(motion, sign_width=sign_width), self._weights
        tau, b, C = self._shared(G, needed)
        a = _solved(C, times(np.swapaxes(G, 1, 2), D * weights))
        gradient = effort_gradient(self.model, motion, seen, a)
        if self.coordinates.constant is None:
            # The share of dG in dτ is D dG b − D G C⁻¹ (dGᵀ D G + Gᵀ D dG) b.
            residual = D * (weights - times(G, a))
            products = residual[:, :, None] * b[:, None] - tau[:, :, None] * a[:, None]
            gradient.q[:] += self.coordinates.bend(motion.q, products)
        return gradient

    def target(
        self,
        *,
        noise: ArrayLike | None = None,
        bodies: Sequence[str] | None = None,
        effects: Sequence[FittedEffect | Effect] | None = None,
        on_plate: bool = False,
    ) -> Target:
        """Return the parameters that a motion of the robot on its feet should identify.

        Its base parameters are those that random motions within the limits excite.

        Args:
            noise: Standard deviations of the motor efforts, one or one per motor, N·m or N; on a
                plate those of its wrench, as for `make_target`.
            on_plate: Whether a force plate under all feet measures instead of the motors. Its
                frame is that of the ground, amid the feet.
        """
        if noise is not None and not on_plate:
            noise = self.noise(noise)
        X_WP = RigidTransform() if on_plate else None
        target = make_target(self.model, noise=noise, bodies=bodies, effects=effects, X_WP=X_WP)
        return replace(target, trial=self.random_motion())

    def random_motion(self) -> Motion:
        """Return random states within the limits, balanced at rest.

        Their speed is scaled so that inertial forces reach the friction limit on average.
        """
        limits, random = self.limits(), np.random.default_rng(0)
        count, nv = max(_RANDOM, 10 * len(self.model.bodies)), len(limits.joints)
        q = self.balanced(random.uniform(limits.lower, limits.upper, (count, nv)), limits)
        v, vd = random.uniform(-1.0, 1.0, (2, count, nv)) * limits.reach
        static = self.wrenches(Motion(q, 0 * v, 0 * v))[:, 3:]
        inertial = self.wrenches(Motion(q, v, vd))[:, 3:] - static
        rate = np.sqrt(self.friction * np.linalg.norm(static) / np.linalg.norm(inertial))
        v = np.clip(rate * v, -limits.velocity, limits.velocity)
        return Motion(q, v, np.clip(rate**2 * vd, -limits.acceleration, limits.acceleration))

    def noise(self, noise: ArrayLike) -> Array:
        """Return the effort noise (nv,) of the free joints in the posture, from motor noise."""
        given = one_or_each(noise, "noise", len(self.motors), strict=True)
        G = self.coordinates.jacobian(self.posture[None])[0]
        return np.sqrt(np.square(given[:, None] * G).sum(axis=0))

    # Balance.

    @cached_property
    def middle(self) -> Array:
        """(2,) centroid of the polygon, m."""
        p, q = self.corners, np.roll(self.corners, -1, axis=0)
        areas = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
        return np.asarray(((p + q) * areas[:, None]).sum(axis=0) / (3.0 * areas.sum()))

    @cached_property
    def _sides(self) -> Array:
        """(k, 2) outward normals of the sides, divided by their distances from the middle."""
        along = np.roll(self.corners, -1, axis=0) - self.corners
        normals = np.stack([along[:, 1], -along[:, 0]], -1)
        return normals / ((self.corners - self.middle) * normals).sum(axis=1, keepdims=True)

    @cached_property
    def weight(self) -> float:
        """The robot's weight, N."""
        mass = self.model.total_phi[:, 0].sum()
        return float(mass * np.linalg.norm(self.model.tree.gravity))

    @cached_property
    def _uses(self) -> Array:
        """(k + 6, 6) rows U; U w/f_z are the used shares of the polygon, then of the friction."""
        (x, y), mu = self.middle, self.friction
        polygon = [[a[1], -a[0], 0, 0, 0, -(a @ self.middle)] for a in self._sides]
        sliding = [np.array([0, 0, 0, i, j, 0]) / mu for i, j in product((1, -1), repeat=2)]
        least = 1.0 / np.linalg.norm(self._sides, axis=1).max()
        turning = np.array([0, 0, 1, y, -x, 0]) / (mu * least)
        return np.array([*polygon, *sliding, turning, -turning])

    def wrenches(self, motion: Motion) -> Array:
        """Return the ground wrenches (N, 6) on the robot about the origin, N·m and N."""
        phi, parts = self.model.total_phi.ravel(), []
        for start in range(0, len(motion), _BATCH):
            part = motion[start : start + _BATCH]
            parts.append(base_wrench_regressor(self.model.tree, part.q, part.v, part.vd) @ phi)
        return np.concatenate(parts)

    def zero_moment_points(self, motion: Motion) -> Array:
        """Return the zero-moment points (N, 2) on the ground, m; NaN without ground contact."""
        return zero_moment_point(self.wrenches(motion))

    def support(self, motion: Motion) -> tuple[Array, Array]:
        """Return the used shares (N,) of the polygon and of the friction, infinite at lift-off."""
        wrenches, count = self.wrenches(motion), len(self.corners)
        lifted = np.isnan(zero_moment_point(wrenches)[:, 0])
        shares = wrenches @ self._uses.T / np.where(lifted, 1.0, wrenches[:, 5])[:, None]
        shares[lifted] = np.inf
        return shares[:, :count].max(axis=1), shares[:, count:].max(axis=1)

    def excess(self, motion: Motion, sign_width: Array) -> tuple[Array, MotionGradient]:
        """Return a smooth maximum (N,) of the limit violations, and its gradient.

        It is at most 0 where the robot is in balance, and the dependent motors and all efforts
        keep their limits. Violations are relative to the limits.
        """
        limits, following, tree = self.motor_limits, self.following, self.model.tree
        allowed = np.where(np.arange(len(self._uses)) < len(self.corners), self.margin, 1.0)
        rows = (self._uses - allowed[:, None] * [0, 0, 0, 0, 0, 1.0]) / self.weight
        scales = limits.reach[following], limits.velocity[following], limits.acceleration[following]
        samples = motion.q, motion.v, motion.vd
        states, G = self._states_and_ratios(*samples)
        states = states[:, :, following]
        states[0] -= limits.middle[following]
        needed = self.model.effort(motion, sign_width=sign_width)
        efforts = self._shared(G, needed)[0] / limits.effort
        shares = np.hstack([x / scale for x, scale in zip(states, scales, strict=True)])
        shares = np.hstack([shares, efforts])
        values = _SHARP * np.hstack([self.wrenches(motion) @ rows.T, shares - 1.0, -shares - 1.0])
        total = logsumexp(values, axis=1)
        by = np.exp(values - total[:, None])
        by_balance, above, below = np.split(by, [len(rows), len(rows) + shares.shape[1]], axis=1)
        *by_states, by_efforts = np.split(above - below, len(following) * np.arange(1, 4), axis=1)
        weights = (by_balance @ rows)[:, :, None] * self.model.total_phi.ravel()
        parts = [
            base_wrench_regressor_gradient(tree, *samples, weights),
            self._effort_gradient(motion, sign_width, G, needed, by_efforts / limits.effort),
        ]
        if len(following):
            motors = np.zeros((3, len(motion), len(self.motors)))
            for values, slope, scale in zip(motors, by_states, scales, strict=True):
                values[:, following] = slope / scale
            parts.append(at_actuators(self.coordinates, G, motion, MotionGradient(*motors)))
        return total / _SHARP, parts[0].plus(*parts[1:])

    def balanced(
        self,
        q: Array,
        limits: MotionLimits,
        motion: Motion | None = None,
        *,
        share: float = _CENTRAL,
    ) -> Array:
        """Return postures (N, nv) with zero-moment points in an inner share of the polygon.

        They are balanced at rest, or with the velocities and accelerations of a motion. Joints move
        as little as possible relative to their ranges. Postures that cannot be balanced come as
        close as possible.
        """
        q, active = q.copy(), np.arange(len(q))
        zeros = np.zeros_like(q)
        v, vd = (zeros, zeros) if motion is None else (motion.v, motion.vd)
        for _ in range(_NEWTON):
            points = self.zero_moment_points(Motion(q[active], v[active], vd[active]))
            shift = points - self.middle
            used = (shift @ self._sides.T).max(axis=1, keepdims=True)
            shift *= 1.0 - np.minimum(1.0, share / np.maximum(used, 1e-9))
            unbalanced = np.linalg.norm(shift, axis=1) > _ARRIVED
            active, shift = active[unbalanced], shift[unbalanced]
            if not len(active):
                break
            q[active] -= self._balance_step(q[active], shift, limits.reach)
            q[active] = np.clip(q[active], limits.lower, limits.upper)
        return q

    def _balance_step(self, q: Array, shift: Array, reach: Array) -> Array:
        """Return the least changes (N, nv) that shift zero-moment points by (N, 2) at rest.

        Changes are measured relative to `reach`.
        """
        rows = np.array([[0, -1.0, 0, 0, 0, 0], [1.0, 0, 0, 0, 0, 0]]) / self.weight
        pairs, W = np.repeat(q, 2, axis=0), np.tile(rows, (len(q), 1))[:, :, None]
        zeros = np.zeros_like(pairs)
        W = W * self.model.total_phi.ravel()
        J = base_wrench_regressor_gradient(self.model.tree, pairs, zeros, zeros, W).q
        J = J.reshape(len(q), 2, -1) * reach
        transposed = np.swapaxes(J, 1, 2)
        return reach * times(transposed, _solved(J @ transposed + _DAMPING * np.eye(2), shift))


def _solved(C: Array, e: Array) -> Array:
    return np.asarray(np.linalg.solve(C, e[:, :, None])[:, :, 0])


def root_of(robot: RobotModel) -> RigidBody:
    """Return the floating link."""
    names = joint_names(robot.plant)
    last = next(
        j for j in single_joints(robot.plant) if names[j.velocity_start()] == robot.base_joints[-1]
    )
    return last.child_body()
