"""Slopes of the needed effort with respect to the motion of every joint, for many samples at once.

The derivatives of τ = M(q) v̇ + C(q, v) v − τ_g(q) with respect to q_j, v_j and v̇_j of a joint j of
one degree of freedom. Let P be the body inboard of j, B a body outboard of it, s and t the angular
and linear part of j's motion subspace about Bo, in B, and ω_r, v_r the velocity of B in P. Seen
from B, moving q_j moves P, and nothing that the joints between P and B add:

    δω = ω_P × s,   δα = α_P × s + δω × ω_r,
    δa = a_P × s + α_P × t + ω_P × (ω_P × t) + 2 δω × v_r,

with a_P the acceleration, less gravity, of the point of P that is at Bo. The efforts of joints
inboard of j change also because the wrench on B moves along. A change of v_j gives

    δω = s,   δα = ω_P × s + s × ω_r,   δa = 2 (ω_P × t + s × v_r),

and one of v̇_j δα = s, δa = t, so that the slope is a column of M. Arrays are laid out as in
`geodrake.robot.recursion`: the components x y z x y of vectors first, samples last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant

from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY, Array, spatial_inertia_matrix
from geodrake.robot.kinematics import KinematicTree, Mobilizer
from geodrake.robot.recursion import motion_pieces
from geodrake.robot.regressor import checked_samples


@dataclass(frozen=True, eq=False)
class EffortSlopes:
    """Derivatives [:, i, j] of the effort of velocity i; NaN for j of joints of several degrees.

    Attributes:
        position: (N, nv, nv) ∂τ_i/∂q_j.
        velocity: (N, nv, nv) ∂τ_i/∂v_j.
        acceleration: (N, nv, nv) ∂τ_i/∂v̇_j = M_ij.
    """

    position: Array
    velocity: Array
    acceleration: Array


def effort_slopes(
    plant: MultibodyPlant | KinematicTree,
    q: ArrayLike,
    v: ArrayLike,
    vd: ArrayLike,
    phi: ArrayLike,
) -> EffortSlopes:
    """Slopes of `geodrake.robot.regressor.inverse_dynamics`.

    Args:
        plant: A finalized plant, or its tree where the same plant is used many times.
        q: (N, nq) positions in Drake's order.
        v: (N, nv) velocities.
        vd: (N, nv) accelerations v̇.
        phi: (nb, 10) inertial parameters.

    Raises:
        ArgumentError: A shape does not fit the plant, or a value is not finite.
    """
    tree, samples = checked_samples(plant, q, v, vd)
    phi, expected = np.asarray(phi, float), (len(tree.bodies), PARAMETERS_PER_BODY)
    if phi.shape != expected:
        raise ArgumentError(f"phi has the shape {phi.shape}, but the plant needs {expected}.")
    nv = tree.num_velocities
    found = np.zeros((3, nv, nv, len(samples[0])))
    for part, (_, speed, rate), motions in motion_pieces(tree, samples):
        for mobilizer, motion in zip(tree.mobilizers, motions, strict=True):
            if mobilizer.body >= 0 and phi[mobilizer.body].any():
                body = _Body.of(tree, mobilizer, motion, (speed, rate))
                wrenches, follow = body.changes(phi[mobilizer.body])
                slopes = np.einsum("cin,ckjn->kijn", body.subspace, wrenches)
                inboard = np.tri(len(mobilizer.dofs), k=-1).T[:, :, None]
                slopes[0] += inboard * np.einsum("cin,cjn->ijn", body.subspace, follow)
                dofs = np.array(mobilizer.dofs)
                found[:, dofs[:, None], dofs, part] += slopes
    for mobilizer in tree.mobilizers:
        own = mobilizer.velocities
        if own.stop - own.start > 1:
            found[:, :, own] = np.nan
    position, velocity, acceleration = found.transpose(0, 3, 1, 2)
    return EffortSlopes(position, velocity, acceleration)


@dataclass(frozen=True, eq=False)
class _Body:
    """A body B, and for each of the k velocities that move it the body P inboard of its joint.

    Attributes:
        motion: (5, 3, n) ω, α and a of B.
        turn: (5, k, n) s of every velocity.
        slide: (5, k, n) t.
        inboard: (3, 5, k, n) ω_P, α_P and a_P.
        across: (2, 5, k, n) ω_r and v_r.
    """

    motion: Array
    turn: Array
    slide: Array
    inboard: Array
    across: Array

    @classmethod
    def of(
        cls, tree: KinematicTree, mobilizer: Mobilizer, motion: Array, rates: tuple[Array, Array]
    ) -> _Body:
        """From the body's motion (5, 3 + 2k, n) and the rates v and v̇ (nv, n) of a piece."""
        k = len(mobilizer.dofs)
        turn, slide = motion[:, 3 : 3 + k], motion[:, 3 + k :]
        inboard = np.empty((3, 5, k, motion.shape[2]))
        across = np.empty((2, 5, k, motion.shape[2]))
        w, wd, a = (motion[:, i : i + 1] for i in range(3))
        speed = np.zeros_like(w)
        last, step = k, mobilizer
        while True:
            # From the outboard to the inboard side of one joint.
            own = slice(last - (step.velocities.stop - step.velocities.start), last)
            v, vd = (x[step.velocities] for x in rates)
            s, t = turn[:, own], slide[:, own]
            u, w_r, shift = ((x * v).sum(1, keepdims=True) for x in (t, s, t * _slides(step)))
            w_P = w - w_r
            a = a - (t * vd).sum(1, keepdims=True)
            a -= _cyclic(2.0 * _cross(w_P, u) + _cross(w_r, u - shift))
            wd = wd - (s * vd).sum(1, keepdims=True) - _cyclic(_cross(w_P, w_r))
            w, speed = w_P, speed + u
            for values, now in zip(
                (*inboard, *across), (w, wd, a, motion[:, :1] - w, speed), strict=True
            ):
                values[:, own] = now
            if step.parent < 0:
                return cls(motion[:, :3], turn, slide, inboard, across)
            last, step = own.start, tree.mobilizers[step.parent]

    @property
    def subspace(self) -> Array:
        """(6, k, n) s and t."""
        return np.concatenate([self.turn[:3], self.slide[:3]])

    def changes(self, phi: Array) -> tuple[Array, Array]:
        """What moments and forces on B change with the motion of every velocity's joint.

        Args:
            phi: (10,) parameters of B.

        Returns:
            (6, 3, k, n) slopes with q, v and v̇, seen from B, and (6, k, n) what of that with q
            joints inboard see beyond, as the wrench moves along.
        """
        s, t, (w_P, wd_P, a_P), (w_r, v_r) = self.turn, self.slide, self.inboard, self.across
        turned, slid = _cyclic(_cross(w_P, s)), _cyclic(_cross(w_P, t))
        dw = np.stack([turned, s], 1)  # with q and with v
        dwd = np.stack(
            [_cross(wd_P, s) + _cross(turned, w_r), turned[:3] + _cross(s, w_r), s[:3]], 1
        )
        da = np.stack(
            [
                _cross(a_P, s) + _cross(wd_P, t) + _cross(w_P, slid) + 2.0 * _cross(turned, v_r),
                2.0 * (slid[:3] + _cross(s, v_r)),
                t[:3],
            ],
            1,
        )
        inertia = spatial_inertia_matrix(phi)
        changed = np.tensordot(inertia, np.concatenate([dwd, da]), 1)
        # The parts quadratic in ω: ω × I ω and ω × (ω × h).
        w = self.motion[:, :1]
        momentum = np.tensordot(inertia[:, :3], w[:3], 1)
        turning = np.tensordot(inertia[:, :3], dw[:3], 1)
        for i in (0, 3):
            before, after = _cyclic(momentum[i : i + 3]), _cyclic(turning[i : i + 3])
            changed[i : i + 3, :2] += _cross(dw, before[:, None]) + _cross(w[:, None], after)
        wrench = np.tensordot(
            inertia, np.concatenate([self.motion[:3, 1:2], self.motion[:3, 2:]]), 1
        )
        for i in (0, 3):
            wrench[i : i + 3] += _cross(w, _cyclic(momentum[i : i + 3]))
        moment, force = _cyclic(wrench[:3]), _cyclic(wrench[3:])
        follow = np.concatenate([_cross(s, moment) + _cross(t, force), _cross(s, force)])
        return changed, follow


def _slides(mobilizer: Mobilizer) -> Array:
    """(k, 1) 1 for own velocities that turn nothing."""
    return np.where(mobilizer.motion.angular.any(0), 0.0, 1.0)[:, None]


def _cyclic(vector: Array) -> Array:
    """Vectors x y z (3, …) as x y z x y (5, …)."""
    return np.concatenate([vector, vector[:2]])


def _cross(a: Array, b: Array) -> Array:
    """Cross products (3, …) of cyclic vectors (5, …)."""
    return np.asarray(a[1:4] * b[2:5] - a[2:5] * b[1:4])
