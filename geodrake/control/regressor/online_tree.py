"""Kinematics of a tree for one sample, with as few array operations as possible.

At one sample the cost is in the number of calls, not in arithmetic. So nothing goes joint by joint:
poses are composed by doubling, and all that follows is expressed in the world about its origin,
where the motion of a body is a plain sum over the velocities that move it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.control.regressor.spatial_algebra import SWAP, motion_transform, skew
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.robot.joints import Features
from geodrake.robot.kinematics import KinematicTree, Mobilizer
from geodrake.robot.recursion import joint_rotations

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a tree is at one q.

    Attributes:
        transforms: (nb, 6, 6) matrices X that take a motion about Wo in W to one about Bo in B, as
            a column. Wrenches F go the other way as rows: Fᵀ X is about Wo in W.
        subspace: (nv, 6) motion of each velocity in W, about Wo.
        inboard: (nv, 6, 6) the same matrices for the body inboard of each velocity.
    """

    transforms: Array
    subspace: Array
    inboard: Array


@dataclass(frozen=True, eq=False)
class OnlineTree:
    """What is constant about a tree of nm mobilizers; the world comes last in all (nm + 1, ...).

    Attributes:
        moves: (nb, nv) one where a velocity moves a body.
        moves_inboard: (nv, nv) one where a velocity moves the body inboard of another's joint.
        reaction: (nb, 6) acceleration of the bodies at rest that stands in for gravity.
        moves_columns: (nv, 10 nb) one where a velocity moves the body of a parameter.
        swing: (nv, 3, nv) linear part of what a joint's motion does to its own axes, for joints
            that slide and turn; zero for all that have one velocity.
        swings: Whether any of that is not zero.
    """

    moves: Array
    moves_inboard: Array
    reaction: Array
    moves_columns: Array
    swing: Array
    swings: bool
    _transforms: Array
    _angles: Indices
    _slides: Array
    _general: tuple[tuple[int, Mobilizer], ...]
    _jumps: tuple[Indices, ...]
    _columns: Array
    _column_slides: Array
    _inboard: Indices
    _body_mobilizers: Indices
    _sliding: bool

    @classmethod
    def of(cls, tree: KinematicTree) -> OnlineTree:
        """Reads a tree once."""
        mobilizers, count = tree.mobilizers, len(tree.mobilizers)
        nb, nq, nv = len(tree.bodies), tree.num_positions, tree.num_velocities
        moves, moves_inboard = np.zeros((nb, nv)), np.zeros((nv, nv))
        reaction, bodies = np.zeros((nb, 6)), np.zeros(nb, int)
        transforms = np.zeros((3, count + 1, 6, 6))
        transforms[0] = np.eye(6)
        angles, slides = np.zeros(count + 1, int), np.zeros((count + 1, 3, nq))
        columns, column_slides = np.zeros((nv, 6)), np.zeros((nv, 3, nq))
        inboard, swing = np.zeros(nv, int), np.zeros((nv, 3, nv))
        general = []
        for i, mobilizer in enumerate(mobilizers):
            joint, own = mobilizer.motion, mobilizer.velocities
            if mobilizer.body >= 0:
                moves[mobilizer.body, list(mobilizer.dofs)] = 1.0
                bodies[mobilizer.body] = i
                reaction[mobilizer.body, 3:] = -mobilizer.gravity * tree.gravity
            before = [dof for dof in mobilizer.dofs if not own.start <= dof < own.stop]
            moves_inboard[own, before] = 1.0
            if joint.features in (Features.CONSTANT, Features.ANGLE):
                angles[i] = mobilizer.positions.stop - 1
                transforms[:, i] = _transform_features(mobilizer)
            else:
                general.append((i, mobilizer))
            slides[i, :, mobilizer.positions] = joint.translation
            s, t = joint.angular.T, joint.linear.T
            columns[own] = np.hstack([t + np.cross(joint.offset, s), s])
            column_slides[own, :, mobilizer.positions] = np.cross(
                joint.translation.T, s[:, None]
            ).transpose(0, 2, 1)
            swing[own, :, own] = np.cross(t, s[:, None]).transpose(0, 2, 1)
            inboard[own] = mobilizer.parent if mobilizer.parent >= 0 else count
        parents = [m.parent if m.parent >= 0 else count for m in mobilizers]
        return cls(
            moves,
            moves_inboard,
            reaction,
            np.repeat(moves.T, PARAMETERS_PER_BODY, axis=1),
            swing,
            bool(swing.any()),
            transforms,
            angles,
            slides,
            tuple(general),
            _doublings(np.array([*parents, count])),
            columns,
            column_slides,
            inboard,
            bodies,
            bool(slides.any()),
        )

    def place(self, q: Array) -> Placement:
        """Poses and subspace at positions q (nq,)."""
        angle = q.take(self._angles)[:, None, None]
        still, by_cos, by_sin = self._transforms
        X = still + by_cos * np.cos(angle) + by_sin * np.sin(angle)
        for i, mobilizer in self._general:
            joint = mobilizer.motion
            R_PB = joint_rotations(joint, q[None, mobilizer.positions])[0]
            X[i] = motion_transform(R_PB, joint.offset + R_PB @ mobilizer.p_MoBo_B)
        columns = self._columns
        if self._sliding:
            X[:, 3:, :3] -= X[:, :3, :3] @ skew(self._slides @ q)
            columns = columns.copy()
            columns[:, :3] += self._column_slides @ q
        for jump in self._jumps:
            X = X @ X.take(jump, 0)
        # A motion with its halves exchanged is transformed as a wrench is.
        inboard = X.take(self._inboard, 0)
        subspace = (columns[:, None] @ inboard)[:, 0].take(SWAP, 1)
        return Placement(X.take(self._body_mobilizers, 0), subspace, inboard)


def _transform_features(mobilizer: Mobilizer) -> Array:
    """(3, 6, 6) factors of 1, cos and sin in X of B from P, of a joint about or along one axis."""
    joint, factors = mobilizer.motion, np.zeros((3, 6, 6))
    R = joint.rotation.T.reshape(-1, 3, 3)
    R_BP = R.transpose(0, 2, 1)
    factors[: len(R), :3, :3] = factors[: len(R), 3:, 3:] = R_BP
    # [offset + R p] R = [offset] R + R [p] is as linear in the features as R is.
    product = skew(joint.offset) @ R + R @ skew(mobilizer.p_MoBo_B)
    factors[: len(R), 3:, :3] = product.transpose(0, 2, 1)
    return factors


def _doublings(parents: Indices) -> tuple[Indices, ...]:
    """Ancestors 1, 2, 4, … steps inboard of every mobilizer, the world being its own."""
    jumps = []
    while (parents[:-1] != len(parents) - 1).any():
        jumps.append(parents)
        parents = parents[parents]
    return tuple(jumps)
