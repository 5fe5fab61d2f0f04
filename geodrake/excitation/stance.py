"""A robot that stands on feet which do not move.

Feet at rest close loops between the robot and the ground. So a standing robot is one with closed
loops (`geodrake.robot.loops`): on one foot its motors are free, and the base follows them; on
several the base is free, and the legs follow. With θ̇ = G q̇ no ground force is in the efforts
Gᵀ τ of the free joints, [Lee2019] Eq. (3.6.57), and all that other robots' designs do holds for
them. Where more motors stand than are needed, τ is the one that has the least sum of squared shares
of its limits.

Balance is a matter of the wrench (n, f) of the ground about its origin, z upwards:

    (−n_y, n_x)/f_z within a share of the polygon of the feet,       [Lee2019] §4.6.3
    |f_x| + |f_y| ≤ μ f_z,      |n_z about the polygon's middle| ≤ μ r f_z,

where r is the least distance of a side from the middle. Each is linear in the wrench.
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

_SLACK = 0.005  # rad or m, by which motors may be off the posture in which feet stand
_SHARP = 50.0  # of the smooth maximum of shares, which exceeds them by log(n)/50 at most
_RANDOM = 200
_NEWTON, _CENTRAL, _ARRIVED = 12, 0.5, 1e-3  # steps to balance, share of the polygon, m
_NOTHING = 1e-12  # m², of what postures move the centre of mass by
_BATCH = 2000  # samples whose regressors are in memory


@dataclass(frozen=True, eq=False)
class Foot(Short):
    """A part of a robot that stands on the ground: a sole, a ball that rolls, or a point.

    Attributes:
        frame: Name of a link, or of another frame of the model file.
        points: (k, 3) corners of the sole in the frame, m; one for a foot that turns about it, or
            for the center of a ball.
        radius: Of the ball, m; 0 without.
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
        """Return a sole, length along x and width along y of the frame, about its origin."""
        for name, value in (("length", length), ("width", width)):
            number(value, name, lower=0.0, strict=True)
        signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        return cls(frame, np.hstack([0.5 * signs * [length, width], np.zeros((4, 1))]))

    @property
    def is_sole(self) -> bool:
        """Whether moments act on it, too."""
        return len(np.asarray(self.points)) > 1


@dataclass(frozen=True, eq=False)
class MotorCoordinates(DrivenCoordinates):
    """The map from the free joints of a robot on its feet to its motors, θ = T(q)."""

    coordinates: RobotCoordinates
    motors: tuple[str, ...]

    @cached_property
    def free(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Numbers of the motors that are free, and of the free joints that they are."""
        names = self.coordinates.names
        pairs = [(k, names.index(n)) for k, n in enumerate(self.motors) if n in names]
        motors, at = np.array(pairs, np.intp).reshape(-1, 2).T
        return motors, at

    @cached_property
    def following(self) -> NDArray[np.intp]:
        """Numbers of the motors that follow the free joints."""
        return np.setdiff1d(np.arange(len(self.motors)), self.free[0])

    @property
    def driven(self) -> NDArray[np.intp]:
        """Velocities of the free joints that are those of actuators of drives."""
        return self.coordinates.driven

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of motors and of free joints."""
        return len(self.motors), len(self.coordinates.names)

    @cached_property
    def constant(self) -> Array | None:
        """G (m, nv) if no motor follows; else None."""
        return None if len(self.following) else np.eye(self.shape[1])[self.free[1]]

    def along(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return positions (N, m) of the motors, G and its rate."""
        theta, (motors, at) = np.empty((len(q), self.shape[0])), self.free
        G, rate = np.zeros((2, len(q), *self.shape))
        theta[:, motors] = q[:, at]
        G[:, motors, at] = 1.0
        if len(follow := self.following):
            behind = [self.coordinates.behind[self.motors[k]] for k in follow]
            every = self.coordinates.along_all(q, v)
            for own, found in zip((theta, G, rate), every, strict=True):
                own[:, follow] = found[:, behind]
        return theta, G, rate


@dataclass(frozen=True, eq=False)
class Stance(Short):
    """A robot on feet that do not move.

    Attributes:
        robot: The robot with a floating base.
        model: The robot on its feet, whose joints are the free ones.
        posture: (nv,) positions of these when the feet were placed, rad or m.
        placed: (m,) positions of the motors then.
        corners: (k, 2) corners of the feet's polygon on the ground, counterclockwise, m.
        friction: Coefficient μ of friction between feet and ground.
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
        """Names of all joints but those of the base."""
        return self.motor_limits.joints

    def within(self, limits: MotionLimits) -> Stance:
        """Return the same with other limits of its motors."""
        if instance(limits, "limits", MotionLimits).joints != self.motors:
            raise ArgumentError(
                f"The limits have joints {limits.joints}, but the motors are {self.motors}."
            )
        return replace(self, motor_limits=limits)

    # Where motors are.

    @cached_property
    def coordinates(self) -> MotorCoordinates:
        """The map to the motors."""
        return MotorCoordinates(self.model.coordinates, self.motors)

    @property
    def following(self) -> NDArray[np.intp]:
        """Numbers of the motors that follow the free joints."""
        return self.coordinates.following

    def motor_states(self, states: Array) -> Array:
        """Return positions and their derivatives (3, N, m) of motors, of those (3, N, nv)."""
        return self._states_and_ratios(*states)[0]

    def _states_and_ratios(self, q: Array, v: Array, vd: Array) -> tuple[Array, Array]:
        """Return the states of motors (3, N, m), and G (N, m, nv)."""
        theta, G, rate = self.coordinates.along(q, v)
        return np.stack([theta, times(G, v), times(G, vd) + times(rate, v)]), G

    def free(self, motors: Array, name: str) -> Array:
        """Return positions (nv,) of the free joints where motors are at (m,), rad or m."""
        motors = real_array(motors, name, (len(self.motors),))
        q, (own, at) = self.posture.copy(), self.coordinates.free
        q[at] = motors[own]
        placed = self.coordinates.joint_positions(q[None])[0]
        off = np.abs(placed - motors)
        if off.max() > _SLACK:
            k = int(np.argmax(off))
            raise ArgumentError(
                f"With joint {self.motors[k]!r} at {motors[k]:.4g} of the {name}, the feet are "
                f"elsewhere than the robot stands, which has it at {placed[k]:.4g}.",
                advice="A robot on several feet starts where it stands: give one posture.",
            )
        return q

    def base_columns(self, motion: Motion) -> dict[str, Array]:
        """Return the pose of the base as columns of a log, (N,) each."""
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

        Those of a base are a range in which its feet can stay, and speeds and accelerations at
        which each of the motors that follow keeps its own, if the base moves along one axis.
        """
        own, joints, (motors, at) = self.motor_limits, self.model.joints, self.coordinates.free
        sides = own.lower, own.upper, own.velocity, own.acceleration, own.effort, own.jerk
        found = np.full((len(sides), len(joints)), np.inf)
        found[:2] = np.nan
        found[:, at] = np.stack(np.broadcast_arrays(*sides))[:, motors]
        base = np.flatnonzero(np.isin(joints, self.robot.base_joints))
        if len(base):
            low, high = self.model.position_limits  # ranges in which the feet can stay
            found[0], found[1] = np.fmax(found[0], low), np.fmin(found[1], high)
            random = np.random.default_rng(0)
            q = random.uniform(found[0], found[1], (_RANDOM, len(joints)))
            G = np.abs(self.coordinates.jacobian(q)).max(axis=0)[:, base]
            with np.errstate(divide="ignore"):
                for values, limit in zip(found[2:4], sides[2:4], strict=True):
                    values[base] = (limit[:, None] / G).min(axis=0)
        return MotionLimits(joints, *found)

    # Efforts.

    def efforts(self, motion: Motion, sign_width: ArrayLike = 0.0) -> Array:
        """Return efforts (N, motors) of a motion of the free joints, N·m or N."""
        needed = self.model.effort(motion, sign_width=sign_width)
        return self._shared(self.coordinates.jacobian(motion.q), needed)[0]

    @cached_property
    def _weights(self) -> Array:
        """(m,) squared limits of efforts, in units of the largest; 1 without limits."""
        limits = self.motor_limits.effort
        most = limits[np.isfinite(limits)].max(initial=0.0) or 1.0
        return np.square(np.where(np.isfinite(limits), limits, most) / most)

    def _shared(self, G: Array, needed: Array) -> tuple[Array, Array, Array]:
        """Return motors' efforts D G b (N, m) for those needed (N, nv), e = C b, with b and C."""
        D = self._weights
        C = np.asarray(np.swapaxes(G, 1, 2) @ (D[:, None] * G))
        b = _solved(C, needed)
        return D * times(G, b), b, C

    def _effort_gradient(
        self, motion: Motion, sign_width: Array, G: Array, needed: Array, weights: Array
    ) -> MotionGradient:
        """Return the gradient of Σ w ∘ τ for w (N, motors), with efforts needed (N, nv)."""
        seen, D = self.model.motion(motion, sign_width=sign_width), self._weights
        tau, b, C = self._shared(G, needed)
        a = _solved(C, times(np.swapaxes(G, 1, 2), D * weights))
        found = effort_gradient(self.model, motion, seen, a)
        if self.coordinates.constant is None:
            # dτ also has dG: D dG b − D G C⁻¹ (dGᵀ D G + Gᵀ D dG) b.
            rest = D * (weights - times(G, a))
            products = rest[:, :, None] * b[:, None] - tau[:, :, None] * a[:, None]
            found.q[:] += self.coordinates.bend(motion.q, products)
        return found

    def target(
        self,
        *,
        noise: ArrayLike | None = None,
        bodies: Sequence[str] | None = None,
        effects: Sequence[FittedEffect | Effect] | None = None,
        on_plate: bool = False,
    ) -> Target:
        """Return the parameters that a motion of the robot on its feet should identify.

        What is identifiable at all is what random motions within the limits excite.

        Args:
            noise: Deviations of the efforts of motors, one or one for each, N·m or N; on a plate
                those of its wrench, as for `make_target`.
            on_plate: Whether a force plate under all feet is what measures, in place of the motors.
                Its frame is that of the ground, amid the feet.
        """
        if noise is not None and not on_plate:
            noise = self.noise(noise)
        X_WP = RigidTransform() if on_plate else None
        target = make_target(self.model, noise=noise, bodies=bodies, effects=effects, X_WP=X_WP)
        return replace(target, trial=self.random_motion())

    def random_motion(self) -> Motion:
        """Return states within the limits, in balance at rest.

        They are so fast that accelerations matter as much as friction lets them.
        """
        limits, random = self.limits(), np.random.default_rng(0)
        count, nv = max(_RANDOM, 10 * len(self.model.bodies)), len(limits.joints)
        q = self.balanced(random.uniform(limits.lower, limits.upper, (count, nv)), limits)
        v, vd = random.uniform(-1.0, 1.0, (2, count, nv)) * limits.reach
        held = self.wrenches(Motion(q, 0 * v, 0 * v))[:, 3:]
        moved = self.wrenches(Motion(q, v, vd))[:, 3:] - held
        rate = np.sqrt(self.friction * np.linalg.norm(held) / np.linalg.norm(moved))
        v = np.clip(rate * v, -limits.velocity, limits.velocity)
        return Motion(q, v, np.clip(rate**2 * vd, -limits.acceleration, limits.acceleration))

    def noise(self, noise: ArrayLike) -> Array:
        """Return deviations (nv,) of free joints' efforts in the posture, of those of motors."""
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
        """(k, 2) outward normals of the polygon's sides over their distances from its middle."""
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
        """(k + 6, 6) rows U such that U w/f_z are shares of the polygon, then of the friction."""
        (x, y), mu = self.middle, self.friction
        polygon = [[a[1], -a[0], 0, 0, 0, -(a @ self.middle)] for a in self._sides]
        sliding = [np.array([0, 0, 0, i, j, 0]) / mu for i, j in product((1, -1), repeat=2)]
        least = 1.0 / np.linalg.norm(self._sides, axis=1).max()
        turning = np.array([0, 0, 1, y, -x, 0]) / (mu * least)
        return np.array([*polygon, *sliding, turning, -turning])

    def wrenches(self, motion: Motion) -> Array:
        """Return the ground's wrenches (N, 6) on the robot about the origin, N·m and N."""
        phi, parts = self.model.total_phi.ravel(), []
        for start in range(0, len(motion), _BATCH):
            part = motion[start : start + _BATCH]
            parts.append(base_wrench_regressor(self.model.tree, part.q, part.v, part.vd) @ phi)
        return np.concatenate(parts)

    def zero_moment_points(self, motion: Motion) -> Array:
        """Return (N, 2) zero-moment points on the ground, m; NaN where nothing presses on it."""
        return zero_moment_point(self.wrenches(motion))

    def support(self, motion: Motion) -> tuple[Array, Array]:
        """Return the shares (N,) of the polygon and of the friction that a motion uses.

        Infinite where the feet would lift off.
        """
        wrenches, count = self.wrenches(motion), len(self.corners)
        lifted = np.isnan(zero_moment_point(wrenches)[:, 0])
        shares = wrenches @ self._uses.T / np.where(lifted, 1.0, wrenches[:, 5])[:, None]
        shares[lifted] = np.inf
        return shares[:, :count].max(axis=1), shares[:, count:].max(axis=1)

    def excess(self, motion: Motion, sign_width: Array) -> tuple[Array, MotionGradient]:
        """Return a smooth maximum (N,) of what is beyond the limits, and its gradient.

        At most 0 where the robot is in balance, and limits of motors that follow and of all efforts
        are kept. These are in shares of themselves.
        """
        limits, follow, tree = self.motor_limits, self.following, self.model.tree
        most = np.where(np.arange(len(self._uses)) < len(self.corners), self.margin, 1.0)
        rows = (self._uses - most[:, None] * [0, 0, 0, 0, 0, 1.0]) / self.weight
        scales = limits.reach[follow], limits.velocity[follow], limits.acceleration[follow]
        samples = motion.q, motion.v, motion.vd
        states, G = self._states_and_ratios(*samples)
        states = states[:, :, follow]
        states[0] -= limits.middle[follow]
        needed = self.model.effort(motion, sign_width=sign_width)
        efforts = self._shared(G, needed)[0] / limits.effort
        shares = np.hstack([x / scale for x, scale in zip(states, scales, strict=True)])
        shares = np.hstack([shares, efforts])
        values = _SHARP * np.hstack([self.wrenches(motion) @ rows.T, shares - 1.0, -shares - 1.0])
        total = logsumexp(values, axis=1)
        by = np.exp(values - total[:, None])
        by_balance, above, below = np.split(by, [len(rows), len(rows) + shares.shape[1]], axis=1)
        *by_states, by_efforts = np.split(above - below, len(follow) * np.arange(1, 4), axis=1)
        weights = (by_balance @ rows)[:, :, None] * self.model.total_phi.ravel()
        parts = [
            base_wrench_regressor_gradient(tree, *samples, weights),
            self._effort_gradient(motion, sign_width, G, needed, by_efforts / limits.effort),
        ]
        if len(follow):
            motors = np.zeros((3, len(motion), len(self.motors)))
            for own, slope, scale in zip(motors, by_states, scales, strict=True):
                own[:, follow] = slope / scale
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

        Those of a motion, if one is given, otherwise of rest. Joints move as little as possible in
        shares of their ranges; where balance is out of reach, they go as near as they can.
        """
        q, left = q.copy(), np.arange(len(q))
        still = np.zeros_like(q)
        v, vd = (still, still) if motion is None else (motion.v, motion.vd)
        for _ in range(_NEWTON):
            off = self.zero_moment_points(Motion(q[left], v[left], vd[left])) - self.middle
            used = (off @ self._sides.T).max(axis=1, keepdims=True)
            off *= 1.0 - np.minimum(1.0, share / np.maximum(used, 1e-9))
            far = np.linalg.norm(off, axis=1) > _ARRIVED
            left, off = left[far], off[far]
            if not len(left):
                break
            q[left] -= self._moving_weight(q[left], off, limits.reach)
            q[left] = np.clip(q[left], limits.lower, limits.upper)
        return q

    def _moving_weight(self, q: Array, off: Array, reach: Array) -> Array:
        """Return least changes (N, nv) of postures that move zero-moment points by (N, 2) at rest.

        Changes are in shares of `reach`.
        """
        rows = np.array([[0, -1.0, 0, 0, 0, 0], [1.0, 0, 0, 0, 0, 0]]) / self.weight
        each, W = np.repeat(q, 2, axis=0), np.tile(rows, (len(q), 1))[:, :, None]
        none = np.zeros_like(each)
        W = W * self.model.total_phi.ravel()
        J = base_wrench_regressor_gradient(self.model.tree, each, none, none, W).q
        J = J.reshape(len(q), 2, -1) * reach
        transposed = np.swapaxes(J, 1, 2)
        return reach * times(transposed, _solved(J @ transposed + _NOTHING * np.eye(2), off))


def _solved(C: Array, e: Array) -> Array:
    return np.asarray(np.linalg.solve(C, e[:, :, None])[:, :, 0])


def root_of(robot: RobotModel) -> RigidBody:
    """Return the link that floats."""
    names = joint_names(robot.plant)
    last = next(
        j for j in single_joints(robot.plant) if names[j.velocity_start()] == robot.base_joints[-1]
    )
    return last.child_body()
