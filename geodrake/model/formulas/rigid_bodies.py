"""The rigid bodies of a robot as formulas: inverse dynamics, poses and Jacobians.

The same equations as the compiled ones of `geodrake.robot.recursion`, where the reference motion is
the motion itself, in arrays of symbols (Newton and Euler).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from geodrake.effects.body_motion import BodyMotion, RobotBodies
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.model.formulas.symbols import Formulas, Symbols
from geodrake.robot.joints import Features
from geodrake.robot.kinematics import KinematicTree, Mobilizer

_DIGITS = 15  # of a rotation, whose zeros and ones come out with rounding errors


def joint_formulas(tree: KinematicTree, q: Formulas) -> Formulas:
    """Return positions (nq of the tree of joints) as formulas of the robot's (nq)."""
    if (actuation := tree.actuation) is None:
        return q
    if actuation.constant is None:
        raise ModelError(
            "Source code cannot have a closed loop, or a transmission whose ratios change with the "
            "position.",
            advice="Write the formula of the joints, and map it in your own code.",
        )
    whole = Symbols.of(np.zeros(actuation.sizes[0]))
    own, joints = actuation.kept_q
    whole[joints] = q[own]
    for place in actuation.places:
        J, still = place.drive.map.constant_jacobian, np.zeros((1, len(place.actuator_q)))
        shift = place.drive.map.joint_positions(still)[0]
        whole[place.joint_q] = J @ q[place.actuator_q] + shift
    return whole


def inverse_dynamics_formula(
    tree: KinematicTree, q: Formulas, v: Formulas, vd: Formulas, phi: Array
) -> Formulas:
    """Return the effort (nv,) of the bodies φ (nb, 10), at the actuators if there are any."""
    if tree.actuation is None:
        return _joint_efforts(tree, q, v, vd, phi)
    theta, J = joint_formulas(tree, q), tree.actuation.jacobian(np.zeros((1, len(q))))[0]
    return Symbols.of(J.T @ _joint_efforts(tree.joints, theta, J @ v, J @ vd, phi))


def _joint_efforts(
    tree: KinematicTree, q: Formulas, v: Formulas, vd: Formulas, phi: Array
) -> Formulas:
    """Effort (nv,) of the joints."""
    motions: list[_MovedBody] = []
    for mobilizer in tree.mobilizers:
        inboard = motions[mobilizer.parent] if mobilizer.parent >= 0 else _world(tree, mobilizer)
        motions.append(_moved(mobilizer, inboard, (q, v, vd)))
    effort = Symbols.of(np.zeros(tree.num_velocities))
    none = np.zeros(phi.shape[1])  # of a frame within a joint
    own_phi = [phi[m.body] if m.body >= 0 else none for m in tree.mobilizers]
    wrenches = [(m.force(x), m.moment(x)) for m, x in zip(motions, own_phi, strict=True)]
    for index in range(len(motions) - 1, -1, -1):
        mobilizer, motion, (f, n) = tree.mobilizers[index], motions[index], wrenches[index]
        n = n + cross(mobilizer.p_MoBo_B, f)
        f, n = motion.R_PB @ f, motion.R_PB @ n
        joint = mobilizer.motion
        own = joint.angular.T @ n + joint.linear.T @ f
        effort[mobilizer.velocities] = effort[mobilizer.velocities] + own
        if mobilizer.parent >= 0:
            f_P, n_P = wrenches[mobilizer.parent]
            wrenches[mobilizer.parent] = f_P + f, n_P + n + cross(motion.p_PMo, f)
    return effort


def cross(a: Any, b: Any) -> Formulas:
    """Return the cross product of two vectors (3,)."""
    return Symbols.of(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


@dataclass(frozen=True, eq=False)
class _MovedBody:
    """How a body B stands to P inboard of it; ω, α, and the acceleration of Bo, in B."""

    R_PB: Formulas
    p_PMo: Formulas  # noqa: N815
    w: Formulas
    wd: Formulas
    a: Formulas

    def force(self, phi: Array) -> Formulas:
        """The force m a + α × h + ω × (ω × h), in B."""
        h = phi[1:4]
        return phi[0] * self.a + cross(self.wd, h) + cross(self.w, cross(self.w, h))

    def moment(self, phi: Array) -> Formulas:
        """The moment I α + ω × I ω + h × a about Bo, in B."""
        xx, yy, zz, xy, yz, zx = phi[4:]
        inertia = np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
        turning = inertia @ self.wd + cross(self.w, inertia @ self.w)
        return Symbols.of(turning + cross(phi[1:4], self.a))


def _world(tree: KinematicTree, mobilizer: Mobilizer) -> _MovedBody:
    """The world, which is accelerated against gravity."""
    still, unit = Symbols.of(np.zeros(3)), Symbols.of(np.eye(3))
    return _MovedBody(unit, still, still, still, Symbols.of(-tree.gravity * mobilizer.gravity))


def _moved(
    mobilizer: Mobilizer, inboard: _MovedBody, samples: tuple[Formulas, Formulas, Formulas]
) -> _MovedBody:
    q, v, vd = samples
    R, p = _pose(mobilizer, q)
    joint, own = mobilizer.motion, mobilizer.velocities
    w_P, wd_P, a_P = inboard.w, inboard.wd, inboard.a
    turned, slide = joint.angular @ v[own], joint.linear @ v[own]
    wd = wd_P + joint.angular @ vd[own] + cross(w_P, turned)
    a = a_P + joint.linear @ vd[own] + cross(wd_P, p)
    a = a + cross(w_P, cross(w_P, p) + slide) + cross(w_P, slide)
    w, wd, a = R.T @ (w_P + turned), R.T @ wd, R.T @ a
    shift = mobilizer.p_MoBo_B
    return _MovedBody(R, p, w, wd, a + cross(wd, shift) + cross(w, cross(w, shift)))


def _pose(mobilizer: Mobilizer, q: Formulas) -> tuple[Formulas, Formulas]:
    """R_PB (3, 3) and the position of Mo in P (3,)."""
    joint, own = mobilizer.motion, q[mobilizer.positions]
    C = np.round(joint.rotation, _DIGITS) + 0.0
    R = (C @ _features(joint.features, own, joint.ratio)).reshape(3, 3)
    return R, joint.offset + joint.translation @ own


def _features(kind: Features, q: Formulas, ratio: float) -> Formulas:
    """The functions of a joint's positions that its rotation is linear in."""
    if kind is Features.CONSTANT:
        return Symbols.of([1.0])
    if kind is Features.ANGLE:
        angle = q[-1] if ratio == 1.0 else ratio * q[-1]
        return Symbols.of([1.0, np.cos(angle), np.sin(angle)])
    if kind is Features.RPY:
        (sr, sp, sy), (cr, cp, cy) = np.sin(q[:3]), np.cos(q[:3])
        rows = (
            (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
            (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
            (-sp, cp * sr, cp * cr),
        )
        return Symbols.of(rows).ravel()
    w, x, y, z = q[:4] * np.sqrt(2.0 / (q[:4] @ q[:4]))
    rows = (
        (1.0 - y * y - z * z, x * y - w * z, x * z + w * y),
        (x * y + w * z, 1.0 - x * x - z * z, y * z - w * x),
        (x * z - w * y, y * z + w * x, 1.0 - x * x - y * y),
    )
    return Symbols.of(rows).ravel()


@dataclass(frozen=True, eq=False)
class BodyFormulas(RobotBodies):
    """The bodies of a robot in one configuration of symbols; `q` is (1, nq)."""

    def tree_samples(self, v: Array, vd: Array) -> tuple[Array, Array, Array, Array]:
        """Positions, velocities and accelerations (1, ·) of the joints of the tree, and J."""
        theta = joint_formulas(self.tree, Symbols.of(self.q)[0])
        J = np.eye(v.shape[1])
        if self.tree.actuation is not None:
            J = self.tree.actuation.jacobian(np.zeros(self.q.shape))[0]
        rates, accelerations = (Symbols.of([J @ x[0]]) for x in (v, vd))
        return theta[None], rates, accelerations, J[None]

    @cached_property
    def _motions(self) -> dict[str, BodyMotion]:
        """Poses and Jacobians from the world outwards."""
        found: list[BodyMotion] = []
        tree, q = self.tree.joints, joint_formulas(self.tree, Symbols.of(self.q)[0])
        for mobilizer in tree.mobilizers:
            inboard = found[mobilizer.parent] if mobilizer.parent >= 0 else self._world(tree)
            found.append(_carried(mobilizer, inboard, q))
        both = zip(tree.mobilizers, found, strict=True)
        return {tree.bodies[m.body]: self._driven(motion) for m, motion in both if m.body >= 0}

    def _driven(self, motion: BodyMotion) -> BodyMotion:
        """The Jacobians with the velocities of actuators."""
        if self.tree.actuation is None:
            return motion
        J = self.tree.actuation.jacobian(np.zeros(self.q.shape))[0]
        return replace(
            motion,
            angular=Symbols.of([motion.angular[0] @ J]),
            linear=Symbols.of([motion.linear[0] @ J]),
            dofs=self.tree.actuation.moved_by(motion.dofs),
        )

    def _world(self, tree: KinematicTree) -> BodyMotion:
        zero = Symbols.of(np.zeros((1, 3, tree.num_velocities)))
        rotation, position = Symbols.of(np.eye(3)[None]), Symbols.of(np.zeros((1, 3)))
        return BodyMotion(rotation, position, zero, zero, ())


def _carried(mobilizer: Mobilizer, inboard: BodyMotion, q: Formulas) -> BodyMotion:
    """The motion of the body outboard of a joint."""
    R, p = _pose(mobilizer, q)
    R_WP, joint = inboard.rotation[0], mobilizer.motion
    R_WB, arm = R_WP @ R, R_WP @ p
    angular, linear = inboard.angular[0].copy(), inboard.linear[0].copy()
    for k in set(inboard.dofs):
        linear[:, k] = linear[:, k] + cross(angular[:, k], arm)
    own = mobilizer.velocities
    angular[:, own] = angular[:, own] + R_WP @ joint.angular
    linear[:, own] = linear[:, own] + R_WP @ joint.linear
    shift = R_WB @ mobilizer.p_MoBo_B
    for k in set(mobilizer.dofs):
        linear[:, k] = linear[:, k] + cross(angular[:, k], shift)
    position = inboard.position[0] + arm + shift
    return BodyMotion(R_WB[None], position[None], angular[None], linear[None], mobilizer.dofs)
