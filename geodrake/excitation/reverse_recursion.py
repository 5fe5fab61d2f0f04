"""The recursion of the regressor backwards: from weights of its entries to the motion.

Per body, W's block is a regressor's inner product with "parameters" c (m, h, I) of its own for
every velocity, so that with the row τ = t·f + s·n of `geodrake.robot.recursion`

    ∂τ/∂t = m a + α × h + ω × (ω × h),       ∂τ/∂s = I α + ω × I ω + h × a,
    ∂τ/∂a = m t + s × h,                     ∂τ/∂α = h × t + I s,
    ∂τ/∂ω = t (ω·h) + h (ω·t) − 2 ω (t·h) + I (s × ω) + I ω × s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.robot.joints import FrameMotion
from geodrake.robot.kinematics import KinematicTree, Mobilizer
from geodrake.robot.recursion import Samples, motion_pieces, world_motion

_CYCLE = [0, 1, 2, 0, 1]
_BEFORE = [2, 0, 1]
_IMAGINARY_STEP = 1e-30  # so small that its square is nothing: the derivative is exact


@dataclass(frozen=True, eq=False)
class MotionGradient:
    """Gradient of a number with respect to the motion, sample by sample.

    Attributes:
        q: (N, nq) with respect to the positions.
        v: (N, nv) with respect to the velocities.
        vd: (N, nv) with respect to the accelerations.
    """

    q: Array
    v: Array
    vd: Array


def reverse_recursion(tree: KinematicTree, samples: Samples, weights: Array) -> MotionGradient:
    """Gradient of Σ W ∘ Y with respect to samples, for weights W (N, nv, 10 nb).

    Args:
        tree: The kinematic tree.
        samples: Positions (N, nq), velocities (N, nv) and accelerations (N, nv) in Drake's order.
        weights: (N, nv, 10 nb) W.
    """
    result = MotionGradient(*(np.zeros(x.shape) for x in samples))
    for part, (q, v, _), motions in motion_pieces(tree, samples):
        covectors: list[Array | float] = [0.0] * len(motions)
        for i in reversed(range(len(motions))):
            mobilizer, motion = tree.mobilizers[i], motions[i]
            covector = covectors[i]
            if mobilizer.body >= 0:
                first = PARAMETERS_PER_BODY * mobilizer.body
                block = weights[part, :, first : first + PARAMETERS_PER_BODY]
                covector = covector + _body_covector(motion, block[:, mobilizer.dofs])
            if isinstance(covector, float):
                continue  # a massless frame that carries nothing
            own, parent = mobilizer.velocities, mobilizer.parent
            inboard = motions[parent] if parent >= 0 else world_motion(tree, mobilizer)
            sample = (q[mobilizer.positions], v[own])
            passed_on, by_q, by_v, by_vd = _move_back(mobilizer, inboard, sample, motion, covector)
            result.q[part, mobilizer.positions] = by_q.T
            result.v[part, own], result.vd[part, own] = by_v.T, by_vd.T
            if parent >= 0:
                covectors[parent] = covectors[parent] + passed_on
    return result


def _body_covector(motion: Array, weights: Array) -> Array:
    """Gradient (3, 3 + 2k, n) of a body's share of Σ W ∘ Y with respect to its motion."""
    k = weights.shape[1]
    c = np.ascontiguousarray(weights.transpose(2, 1, 0))
    m, h, diagonal, product = c[0], c[1:4][_CYCLE], c[4:7], c[7:]
    w, wd, a = motion[:, 0:1], motion[:, 1:2], motion[:, 2:3]
    s, t = motion[:, 3 : 3 + k], motion[:, 3 + k :]

    def inertia(x: Array) -> Array:
        """I x (3, …) of a cyclic x."""
        return diagonal * x[:3] + product * x[1:4] + product[_BEFORE] * x[2:5]

    hw, hh = _dot(h, w), h[:3]
    Iw = inertia(w)[_CYCLE]
    out = np.empty((3, 3 + 2 * k, motion.shape[2]))
    out[:, 3 : 3 + k] = inertia(wd) + _cross(w, Iw) + _cross(h, a)
    out[:, 3 + k :] = m * a[:3] + _cross(wd, h) + w[:3] * hw - hh * _dot(w, w)
    out[:, 2] = (m * t[:3] + _cross(s, h)).sum(1)
    out[:, 1] = (_cross(h, t) + inertia(s)).sum(1)
    turning = t[:3] * hw + hh * _dot(t, w) + inertia(_cross(s, w)[_CYCLE]) + _cross(Iw, s)
    out[:, 0] = turning.sum(1) - 2.0 * w[:3, 0] * _dot(t, h).sum(0)
    return out


def _move_back(
    mobilizer: Mobilizer, parent: Array, sample: tuple[Array, Array], motion: Array, covector: Array
) -> tuple[Array, Array, Array, Array]:
    """The reverse of `geodrake.robot.recursion._move`.

    Args:
        mobilizer: What moves B in P.
        parent: (5, 3 + 2j, n) motion of P.
        sample: The mobilizer's own q and v, each (·, n).
        motion: (5, 3 + 2k, n) motion of B.
        covector: (3, 3 + 2k, n) gradient with respect to it.

    Returns:
        The gradients with respect to the motion of P, and to q, v and v̇.
    """
    (q, v), joint, k = sample, mobilizer.motion, len(mobilizer.dofs)
    at_Mo, covector = _shift_back(mobilizer.p_MoBo_B, motion, covector)
    spin = _cross(covector[_CYCLE], at_Mo).sum(1)  # of a rotation of B, in B
    R_PB = (joint.rotation @ joint.features(q)).reshape(3, 3, 1, -1)
    by_seen = (R_PB * covector).sum(1)[_CYCLE]

    old = (parent.shape[1] - 3) // 2
    s_P, w_P, wd_P = parent[:, 3 : 3 + old], parent[:, 0], parent[:, 1]
    w, t = ((x[_CYCLE] @ v) for x in (joint.angular, joint.linear))
    p = joint.offset[_CYCLE, None] + joint.translation[_CYCLE] @ q
    by_w, by_wd, by_a, by_t = by_seen[:, 0], by_seen[:, 1], by_seen[:, 2], by_seen[:, 3 + k :]
    by_t_P = by_t[:, :old]
    twice = _cross(w_P, _cross(w_P, by_a)[_CYCLE])
    by_p = _cross(by_a, wd_P) + twice + _cross(by_t_P, s_P).sum(1)
    by_v = joint.angular.T @ (by_w[:3] + _cross(by_wd, w_P))
    by_v += joint.linear.T @ (2.0 * _cross(by_a, w_P))
    by_vd = joint.angular.T @ by_wd[:3] + joint.linear.T @ by_a[:3]
    by_q = joint.translation.T @ by_p + _by_rotation(joint, q, R_PB[:, :, 0], spin)

    passed_on = np.empty((3, 3 + 2 * old, by_a.shape[1]))
    passed_on[:, 3 : 3 + old] = by_seen[:3, 3 : 3 + old] + _cross(p[:, None], by_t_P)
    passed_on[:, 3 + old :] = by_t_P[:3]
    passed_on[:, 2] = by_a[:3]
    passed_on[:, 1] = by_wd[:3] + _cross(p, by_a)
    passed_on[:, 0] = by_w[:3] + _cross(w, by_wd) + 2.0 * _cross(t, by_a)
    passed_on[:, 0] += _by_turning(by_a, w_P, p)
    return passed_on, by_q, by_v, by_vd


def _shift_back(p_MoBo_B: Array, motion: Array, covector: Array) -> tuple[Array, Array]:
    """The motion of B about Mo from that about Bo, and the gradient with respect to it."""
    if not p_MoBo_B.any():
        return motion, covector
    k = (motion.shape[1] - 3) // 2
    p, w, wd = p_MoBo_B[_CYCLE, None, None], motion[:, 0:1], motion[:, 1:2]
    at_Mo, moved = motion.copy(), covector.copy()
    at_Mo[:, 2:3] -= (_cross(wd, p) + _cross(w, _cross(w, p)[_CYCLE]))[_CYCLE]
    at_Mo[:, 3 + k :] -= _cross(motion[:, 3 : 3 + k], p)[_CYCLE]
    by_a = covector[_CYCLE, 2:3]
    moved[:, 0:1] += _by_turning(by_a, w, p)
    moved[:, 1:2] += _cross(p, by_a)
    moved[:, 3 : 3 + k] += _cross(p, covector[_CYCLE, 3 + k :])
    return at_Mo, moved


def _by_rotation(joint: FrameMotion, q: Array, R_PB: Array, spin: Array) -> Array:
    """Gradient (nq_j, n) with respect to positions, from that with respect to a rotation in B.

    The features are differentiated by a complex step, which is exact and the same for all joints.
    """
    gradient = np.zeros(q.shape)
    if joint.rotation.shape[1] == 1:
        return gradient  # the joint does not rotate
    for j in range(len(q)):
        moved = q.astype(complex)
        moved[j] += 1j * _IMAGINARY_STEP
        slopes = np.asarray(joint.features(moved)).imag / _IMAGINARY_STEP
        rates = (joint.rotation @ slopes).reshape(3, 3, -1)
        skew = np.einsum("abn,acn->bcn", R_PB, rates)  # Rᵀ ∂R/∂q, the cross product of a rate
        gradient[j] = skew[2, 1] * spin[0] + skew[0, 2] * spin[1] + skew[1, 0] * spin[2]
    return gradient


def _by_turning(by_a: Array, w: Array, p: Array) -> Array:
    """Gradient (3, …) of by_a · (ω × (ω × p)) with respect to ω, of cyclic vectors."""
    return by_a[:3] * _dot(w, p) + p[:3] * _dot(w, by_a) - 2.0 * w[:3] * _dot(by_a, p)


def _dot(a: Array, b: Array) -> Array:
    """Inner products of the first three components."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Array, b: Array) -> Array:
    """Cross products (3, …) of cyclic vectors (5, …)."""
    return a[1:4] * b[2:5] - a[2:5] * b[1:4]
