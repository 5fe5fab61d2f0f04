"""Efforts of rigid bodies without their regressor: Newton and Euler's recursion, samples together.

A point of body B that lies at r from its origin Bo is accelerated by A r + a, with the acceleration
a of Bo less gravity and A = [α]× + [ω]×[ω]×. So the rates at which B takes up momentum are moments
of [A a] over its mass, which its pseudo-inertia P(φ) has:

    [A a] P(φ) = [A Σ + a hᵀ,  A h + a m]

The last column is the force, and the skew part of the others the moment about Bo. Motion is carried
outwards, wrenches inwards; vectors are in the frame of their body, samples the last axis.
"""

from __future__ import annotations

import numpy as np

from geodrake.inertia import Array
from geodrake.inertia.kernels import calc_pseudo_inertia
from geodrake.robot.kinematics import KinematicTree, Mobilizer
from geodrake.robot.recursion import Samples

_OMEGA, _ALPHA, _ACCEL = 0, 1, 2


def efforts(tree: KinematicTree, piece: Samples, phi: Array) -> Array:
    """Efforts (nv, n) that a motion needs.

    Args:
        tree: The kinematic tree.
        piece: Positions (nq, n), velocities (nv, n) and accelerations (nv, n).
        phi: (nb, 10) inertial parameters.
    """
    q, v, vd = piece
    inertias = calc_pseudo_inertia(phi)
    motions, wrenches, ways = list[Array](), list[Array](), list[tuple[Array, Array]]()
    for mobilizer in tree.mobilizers:
        own = mobilizer.velocities
        parent = motions[mobilizer.parent] if mobilizer.parent >= 0 else _world(tree, mobilizer)
        way = _way(mobilizer, q[mobilizer.positions])
        motion = _moved(mobilizer, parent, way, (v[own], vd[own]))
        motions.append(motion)
        ways.append(way)
        wrenches.append(
            _wrench(motion, inertias[mobilizer.body])
            if mobilizer.body >= 0
            else np.zeros((2, 3, q.shape[1]))
        )
    effort = np.empty_like(v)
    backwards = zip(tree.mobilizers[::-1], wrenches[::-1], ways[::-1], strict=True)
    for mobilizer, wrench, (R_PB, p) in backwards:
        joint, (force, moment) = mobilizer.motion, wrench
        if mobilizer.p_MoBo_B.any():
            moment = moment + _cross(mobilizer.p_MoBo_B[:, None], force)
        force, moment = ((R_PB * each).sum(1) for each in (force, moment))
        effort[mobilizer.velocities] = joint.angular.T @ moment + joint.linear.T @ force
        if mobilizer.parent >= 0:
            wrenches[mobilizer.parent][0] += force
            wrenches[mobilizer.parent][1] += moment + _cross(p, force)
    return effort


def _world(tree: KinematicTree, mobilizer: Mobilizer) -> Array:
    """Motion (3, 3, 1) of the world: at rest, accelerated against gravity."""
    motion = np.zeros((3, 3, 1))
    motion[:, _ACCEL, 0] = -mobilizer.gravity * tree.gravity
    return motion


def _way(mobilizer: Mobilizer, q: Array) -> tuple[Array, Array]:
    """The rotation R_PB (3, 3, n or 1) and the position (3, n or 1) of Mo in P."""
    joint = mobilizer.motion
    p = joint.offset[:, None]
    if joint.translation.any():
        p = p + joint.translation @ q
    return (joint.rotation @ joint.features(q)).reshape(3, 3, -1), p


def _moved(
    mobilizer: Mobilizer, parent: Array, way: tuple[Array, Array], rates: tuple[Array, Array]
) -> Array:
    """Motion (3, 3, n) of B about Bo in B, its columns ω, α and a, from that of P about Po in P."""
    joint, (R_PB, p), (v, vd) = mobilizer.motion, way, rates
    w_P, wd_P, a_P = (parent[:, k] for k in (_OMEGA, _ALPHA, _ACCEL))
    turn = joint.angular @ v
    seen = np.empty((3, 3, v.shape[1]))  # of B about Mo, in P
    np.add(w_P, turn, out=seen[:, _OMEGA])
    np.add(wd_P + joint.angular @ vd, _cross(w_P, turn), out=seen[:, _ALPHA])
    rest = _cross(w_P, p)
    seen[:, _ACCEL] = a_P + _cross(wd_P, p)
    if joint.linear.any():
        rest = rest + 2.0 * (joint.linear @ v)
        seen[:, _ACCEL] += joint.linear @ vd
    seen[:, _ACCEL] += _cross(w_P, rest)
    motion = R_PB[0][:, None] * seen[0]
    motion += R_PB[1][:, None] * seen[1]
    motion += R_PB[2][:, None] * seen[2]
    if mobilizer.p_MoBo_B.any():
        w, wd, shift = motion[:, _OMEGA], motion[:, _ALPHA], mobilizer.p_MoBo_B[:, None]
        motion[:, _ACCEL] += _cross(wd, shift) + _cross(w, _cross(w, shift))
    return motion


def _wrench(motion: Array, inertia: Array) -> Array:
    """Force and moment (2, 3, n) about Bo that give a body of P(φ) (4, 4) its motion."""
    w, (x, y, z) = motion[:, _OMEGA], motion[:, _ALPHA]
    fields = np.empty((3, 4, motion.shape[2]))  # [A a]
    np.multiply(w[:, None], w, out=fields[:, :3])
    xx, yy, zz = (fields[i, i].copy() for i in range(3))
    fields[0, 0], fields[1, 1], fields[2, 2] = -(yy + zz), -(xx + zz), -(xx + yy)
    for i, j, rate in ((2, 1, x), (0, 2, y), (1, 0, z)):
        fields[i, j] += rate
        fields[j, i] -= rate
    fields[:, 3] = motion[:, _ACCEL]
    moments = inertia @ fields
    wrench = np.empty((2, 3, motion.shape[2]))
    wrench[0] = moments[:, 3]
    for k, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        np.subtract(moments[i, j], moments[j, i], out=wrench[1, k])
    return wrench


def _cross(a: Array, b: Array) -> Array:
    """Cross products of vectors (3, n or 1)."""
    (x, y, z), (u, v, w) = a, b
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u])
