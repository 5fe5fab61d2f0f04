"""Joints of plants: names, couplings, and motions of all supported types in one form.

A joint's motion subspace is constant in its inboard frame F, so no joint has a bias acceleration of
its own. A universal joint, for which this fails, is represented by two joints with a massless frame
between. Positions and velocities are Drake's.

A joint that follows another one, θ = r θ_leader + θ₀, such as a gripper's finger, is not a
coordinate of the robot. The leader moves the bodies of both, so its effort is τ_q = Jᵀ τ_θ
([Lee2019] Eq. (3.6.57)).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    Joint,
    PlanarJoint,
    PrismaticJoint,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RpyFloatingJoint,
    ScrewJoint,
    UniversalJoint,
)

from geodrake.boundary.arguments import typed
from geodrake.errors import ModelError
from geodrake.inertia import Array

_IDENTITY = np.eye(3)
_ZERO = np.zeros((3, 3))
_X_AXIS, _Y_AXIS, _Z_AXIS = _IDENTITY


class Features(IntEnum):
    """Functions of a joint's positions in which its rotation is linear.

    A constant; 1, cos and sin of the last position; the entries of Rz(yaw) Ry(pitch) Rx(roll); or
    the entries of the rotation of the normalized quaternion w, x, y, z.
    """

    CONSTANT = 0
    ANGLE = 1
    RPY = 2
    QUATERNION = 3


@dataclass(frozen=True)
class FrameMotion:
    """Motion of a frame in another one, with a constant motion subspace in the inboard one.

    For a joint, these are frame M in frame F. For a mobilizer, they are the frame of the outboard
    body B, displaced to Mo, in the frame of the inboard body P.
    """

    features: Features  # f functions of the positions
    rotation: Array  # (9, f) matrix C with vec(R) = C features(q), row by row
    translation: Array  # (3, nq_j) matrix T: the position of Mo is offset + T q, m
    angular: Array  # (3, nv_j) matrix S: the angular velocity is S v, rad/s
    linear: Array  # (3, nv_j) matrix S: the velocity of Mo is S v, m/s
    offset: Array = field(default_factory=lambda: np.zeros(3))  # (3,) position of Mo at q = 0, m

    def between(self, X_PF: RigidTransform, R_MB: Array) -> FrameMotion:
        """Return the motion in P of a frame B fixed to M with the rotation R_MB (3, 3)."""
        R_PF = X_PF.rotation().matrix()
        return FrameMotion(
            features=self.features,
            rotation=np.kron(R_PF, R_MB.T) @ self.rotation,
            translation=R_PF @ self.translation,
            angular=R_PF @ self.angular,
            linear=R_PF @ self.linear,
            offset=X_PF.multiply(self.offset),
        )


def joint_motions(joint: Joint, sign: float) -> list[FrameMotion]:
    """Return the motion of a joint, or two motions for a universal one.

    The sign −1 swaps the frames F and M, if M is on the inboard side. Drake permits this only for
    joints with one axis, for which it reverses the axis.
    """
    match joint:
        case RevoluteJoint():
            motions = [axis_motion(sign * joint.revolute_axis())]
        case PrismaticJoint():
            motions = [slide_motion(sign * joint.translation_axis())]
        case ScrewJoint():
            slide = joint.screw_pitch() / (2.0 * np.pi)
            axis = _screw_axis(joint)
            motions = [axis_motion(axis, translation=slide * axis[:, None])]
        case UniversalJoint():
            motions = [axis_motion(_X_AXIS), axis_motion(_Y_AXIS)]
        case PlanarJoint():
            turn = np.diag(_Z_AXIS)
            motions = [axis_motion(_Z_AXIS, translation=_IDENTITY - turn, angular=turn)]
        case BallRpyJoint():
            motions = [FrameMotion(Features.RPY, np.eye(9), _ZERO, _IDENTITY, _ZERO)]
        case RpyFloatingJoint():
            motions = [_floating_motion(Features.RPY, rotation_positions=3)]
        case QuaternionFloatingJoint():
            motions = [_floating_motion(Features.QUATERNION, rotation_positions=4)]
        case _:
            raise ModelError(
                f"Joint {joint.name()!r} has the unsupported type {type(joint).__name__}.",
                advice="Use a revolute, prismatic, screw, universal, planar, ball or floating "
                "joint, or weld it.",
            )
    return motions


def axis_motion(
    axis: Array, *, translation: Array | None = None, angular: Array | None = None
) -> FrameMotion:
    """Return the rotation about an axis (3,) by the last position, with a translation T q.

    Args:
        translation: (3, nq) T; zero if None.
        angular: (3, nv) matrix from v to the angular velocity; the axis if None.
    """
    angular = axis[:, None] if angular is None else angular
    translation = np.zeros_like(angular) if translation is None else translation
    along = np.outer(axis, axis)
    parts = (along, _IDENTITY - along, np.cross(_IDENTITY, axis))  # of 1, cos, sin
    rotation = np.stack([part.ravel() for part in parts], axis=-1)
    return FrameMotion(Features.ANGLE, rotation, translation, angular, translation)


def slide_motion(axis: Array) -> FrameMotion:
    """Return the translation along an axis (3,)."""
    along = axis[:, None]
    return FrameMotion(Features.CONSTANT, _IDENTITY.reshape(9, 1), along, 0.0 * along, along)


def _screw_axis(joint: ScrewJoint) -> Array:
    """Return the axis of a screw, which Drake does not expose, from its motion at 1 rad/s."""
    context = joint.GetParentPlant().CreateDefaultContext()
    joint.set_angular_velocity(context, 1.0)
    frame_F = joint.frame_on_parent()
    V_FM_F = joint.frame_on_child().CalcSpatialVelocity(context, frame_F, frame_F)
    return V_FM_F.rotational()


def _floating_motion(rotation: Features, *, rotation_positions: int) -> FrameMotion:
    """Return a free motion: q is the rotation, then p_FoMo_F; v is w_FM_F, then v_FMo_F."""
    translation = np.hstack([np.zeros((3, rotation_positions)), _IDENTITY])
    angular, linear = np.hstack([_IDENTITY, _ZERO]), np.hstack([_ZERO, _IDENTITY])
    return FrameMotion(rotation, np.eye(9), translation, angular, linear)


Indices = NDArray[np.intp]

_MOST = 1e12
"""Largest valid ratio or offset of a following joint."""


def scoped(joint: Joint) -> str:
    """Return the name of a joint with its model instance as a prefix."""
    instance = joint.GetParentPlant().GetModelInstanceName(joint.model_instance())
    return f"{instance}::{joint.name()}"


def joints_of(plant: MultibodyPlant) -> list[Joint]:
    """Return the joints of a plant, welds included."""
    return [plant.get_joint(index) for index in plant.GetJointIndices()]


def single_joints(plant: MultibodyPlant) -> list[Joint]:
    """Return joints of one degree of freedom, in the order of their velocities."""
    single = [j for j in joints_of(plant) if j.num_velocities() == j.num_positions() == 1]
    return sorted(single, key=lambda joint: int(joint.velocity_start()))


@typed
def joint_names(plant: MultibodyPlant) -> tuple[str, ...]:
    """Return names of the velocities (nv): the joint's, with a suffix for each of several.

    An ambiguous name has its model instance as a prefix, such as `left_elbow`, even if the joint is
    fixed in the other instances.
    """
    names = plant.GetVelocityNames(add_model_instance_prefix=False, always_add_suffix=False)
    full = plant.GetVelocityNames(add_model_instance_prefix=True, always_add_suffix=False)
    held = [joint.name() for joint in joints_of(plant) if not joint.num_velocities()]
    return tuple(
        long if names.count(short) > 1 or short in held else short
        for short, long in zip(names, full, strict=True)
    )


class Following(NamedTuple):
    """A position that is ratio q + offset of a coordinate q; ratio 0 for a fixed joint."""

    of: Any  # name of a coordinate, or index of a velocity
    ratio: float = 1.0
    offset: float = 0.0


class Tie(NamedTuple):
    """Coupling of a joint θ of one degree of freedom to another one, θ = Σ cₖ θ_leaderᵏ."""

    leader: str  # scoped name
    coefficients: tuple[float, ...]  # c₀, c₁, …

    @property
    def is_linear(self) -> bool:
        """Return whether the ratio is constant."""
        return not any(self.coefficients[2:])

    def at(self, position: float) -> float:
        """Return the position for a position of the leader."""
        return float(Polynomial(self.coefficients)(position))

    def leader_at(self, position: float) -> float:
        """Return the leader's position nearest to 0 for a position of the joint, or NaN."""
        roots = Polynomial([self.coefficients[0] - position, *self.coefficients[1:]]).roots()
        return float(min(roots[np.isreal(roots)].real, key=abs, default=np.nan))


def resolved(stated: Mapping[str, Tie], joints: Collection[str]) -> dict[str, Tie]:
    """Return joint -> tie to an independent leader, without invalid ties.

    Names are scoped; `joints` are those of one degree of freedom.
    """
    known = {
        joint: tie
        for joint, tie in stated.items()
        if {joint, tie.leader} <= set(joints)
        and any(tie.coefficients[1:])
        and all(abs(c) <= _MOST for c in tie.coefficients)
    }
    result = dict[str, Tie]()
    for joint, first in known.items():
        tie, visited = first, {joint}
        while tie.leader in known and tie.leader not in visited:
            visited.add(tie.leader)
            inner = known[tie.leader]
            composed = Polynomial(tie.coefficients)(Polynomial(inner.coefficients))
            tie = Tie(inner.leader, tuple(composed.coef.tolist()))
        if tie.leader not in visited:
            result[joint] = tie
    return result
