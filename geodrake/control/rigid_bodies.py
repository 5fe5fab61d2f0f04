"""Rigid bodies at one sample: the Slotine–Li regressor, mass matrix and momentum regressors.

    M(q) a + C(q, q̇) v − τ_g(q) = Y(q, q̇, v, a) φ                      [Lee2019] Eq. (5.2.10)

with Ṁ − 2 C skew symmetric; see `geodrake.robot.recursion`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geodrake.compiling import compiled, inlined
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.recursion import (
    MOTION,
    Samples,
    TreeRecords,
    calc_inverse_dynamics,
    carried,
    find_subspaces,
    move,
    subspace_room,
)
from geodrake.robot.regressor import put_regressor
from geodrake.robot.vectors import (
    Vector,
    add,
    column,
    combination,
    cross,
    dot,
    put_row,
    row,
    transposed_times,
    vector,
)


@dataclass(frozen=True, eq=False)
class RigidSample:
    """The bodies at one (q, q̇, v, a), for any inertial parameters.

    With a transmission these are motions of the actuators, and those of the joints are θ̇ = J q̇, J v
    and J a + J̇ v, so that C = Jᵀ (C_θ J + M_θ J̇) and Ṁ − 2 C remains skew symmetric.
    """

    tree: KinematicTree  # of the joints
    motion: Samples  # of the joints, with one row in each array
    jacobian: tuple[Array, Array] | None = None  # (nv of the tree, nv) J and J̇ of a transmission

    @classmethod
    def at(cls, tree: KinematicTree, q: Array, qd: Array, v: Array, a: Array) -> RigidSample:
        """Return the bodies at positions q (nq,), velocities q̇ and v, and accelerations a (nv,).

        v replaces one q̇ in each product of two velocities.
        """
        # Copies, as compiled code expects contiguous, writable arrays.
        motion = (np.array(q, float, ndmin=2), np.array(qd, float, ndmin=2))
        reference = (np.array(v, float, ndmin=2), np.array(a, float, ndmin=2))
        if (actuation := tree.actuation) is None:
            return cls(tree, (*motion, *reference))
        v, a = reference
        J, rate = actuation.jacobian(motion[0])[0], actuation.jacobian_rate(*motion)[0]
        rates = motion[1] @ J.T, v @ J.T, a @ J.T + v @ rate.T
        return cls(tree.joints, (actuation.joint_positions(motion[0]), *rates), (J, rate))

    def effort(self, phi: Array) -> Array:
        """Return Y φ (nv,) for φ (nb, 10), in O(nb) operations."""
        effort = np.zeros_like(self.motion[1])
        calc_inverse_dynamics(self.tree.records, self.motion, np.array(phi, float), effort)
        return self._at_actuators(effort[0])

    def regressor(self, columns: int) -> Array:
        """Return Y (nv, columns); columns beyond 10 nb are zero."""
        Y = np.zeros((1, self.motion[1].shape[1], columns))
        put_regressor(self.tree, self.motion, Y)
        return self._at_actuators(Y[0])

    def momentum_regressors(self, columns: int) -> Array:
        """Return regressors (2, nv, columns) of M q̇ = Σ Jᵀ G V and Cᵀ q̇ + τ_g = Σ J̇ᵀ G V + τ_g.

        With a transmission, the second one includes J̇ᵀ p of d/dt (Jᵀ p). Columns beyond 10 nb are
        zero.
        """
        q, qd, _, _ = self.motion
        momentum, drift = regressors = np.zeros((2, 1, qd.shape[1], columns))
        calc_momentum_regressors(self.tree.records, (q, qd, qd, qd), momentum, drift)
        if self.jacobian is None:
            return np.asarray(regressors[:, 0])
        J, rate = self.jacobian
        return np.stack([J.T @ momentum[0], J.T @ drift[0] + rate.T @ momentum[0]])

    def mass_matrix(self, phi: Array) -> Array:
        """Return M (nv, nv) for φ (nb, 10): efforts of unit accelerations minus those of none."""
        q, qd, _, _ = self.motion
        nv = qd.shape[1]
        zero, accelerations = np.zeros((nv + 1, nv)), np.eye(nv + 1, nv)
        samples = (np.repeat(q, nv + 1, axis=0), zero, zero, accelerations)
        efforts = np.zeros((nv + 1, nv))
        calc_inverse_dynamics(self.tree.records, samples, np.array(phi, float), efforts)
        M = efforts[:-1] - efforts[-1]
        M = 0.5 * (M + M.T)
        return np.asarray(M if self.jacobian is None else self.jacobian[0].T @ M @ self.jacobian[0])

    def _at_actuators(self, rows: Array) -> Array:
        """Return Jᵀ times rows (nv of the tree, ...)."""
        return np.asarray(rows if self.jacobian is None else self.jacobian[0].T @ rows)


@compiled
def calc_momentum_regressors(
    tree: TreeRecords, samples: Samples, momentum: Array, drift: Array
) -> None:
    """Add regressors (N, nv, 10 nb) of M q̇ and of Cᵀ q̇ + τ_g to zeros.

    The second uses the rates of the joints' motion subspaces due to the motion of inboard bodies,
    in the world frame.
    """
    mobilizers, dofs = tree
    q, qd, _, _ = samples
    motions, features = np.empty(len(mobilizers), MOTION), np.empty(9)
    subspace = subspace_room(dofs)
    rates = subspace_room(dofs)
    velocities, gravities = np.empty((len(mobilizers), 1, 3)), np.empty((len(mobilizers), 1, 3))
    zero = (0.0, 0.0, 0.0)
    for n in range(len(q)):
        move(mobilizers, samples, n, features, motions)
        find_subspaces(mobilizers, motions, subspace[0], subspace[1])
        for i in range(len(mobilizers)):
            mobilizer, motion = mobilizers[i], motions[i]
            parent, p = mobilizer.parent, vector(motion.p_PMo)
            w_P = v_P = zero
            g_P, inboard_count = vector(mobilizer.gravity), 0
            if parent >= 0:
                w_P, v_P = vector(motions[parent].w), row(velocities, parent, 0)
                g_P, inboard_count = row(gravities, parent, 0), mobilizers[parent].count
            slide = combination(mobilizer.linear, qd, n, mobilizer.velocities)
            v_Mo = add(v_P, add(cross(w_P, p), slide))
            for k in range(mobilizer.count):
                if k < inboard_count:
                    s, t = row(rates[0], parent, k), row(rates[1], parent, k)
                    t = add(t, cross(s, p))
                else:
                    local = k - inboard_count
                    axis = column(mobilizer.angular, local)
                    s, t = cross(w_P, axis), cross(w_P, column(mobilizer.linear, local))
                    t = add(t, cross(v_Mo, axis))
                s, t = carried(mobilizer, motion, s, t)
                put_row(rates[0], i, k, s)
                put_row(rates[1], i, k, t)
            R, w = motion.R_PB, vector(motion.w)
            v = add(transposed_times(R, v_Mo), cross(w, vector(mobilizer.p_MoBo_B)))
            g = transposed_times(R, g_P)
            put_row(velocities, i, 0, v)
            put_row(gravities, i, 0, g)
            if mobilizer.body < 0:
                continue
            first = PARAMETERS_PER_BODY * mobilizer.body
            for k in range(mobilizer.count):
                twist = row(subspace[0], i, k), row(subspace[1], i, k)
                add_momentum(twist, (w, v), momentum[n, dofs[i, k]], first)
                add_momentum(twist, (zero, g), drift[n, dofs[i, k]], first)
                twist = row(rates[0], i, k), row(rates[1], i, k)
                add_momentum(twist, (w, v), drift[n, dofs[i, k]], first)


@inlined
def add_momentum(
    twist: tuple[Vector, Vector], velocity: tuple[Vector, Vector], out: Array, first: int
) -> None:
    """Add the ten coefficients of φ in a body's momentum along a twist (s, t) to out[first:].

    The momentum is m v + ω × h, and I ω + h × v about Bo.
    """
    (s, t), (w, v) = twist, velocity
    h = add(cross(t, w), cross(v, s))
    out[first] += dot(t, v)
    out[first + 1] += h[0]
    out[first + 2] += h[1]
    out[first + 3] += h[2]
    out[first + 4] += s[0] * w[0]
    out[first + 5] += s[1] * w[1]
    out[first + 6] += s[2] * w[2]
    out[first + 7] += s[0] * w[1] + s[1] * w[0]
    out[first + 8] += s[1] * w[2] + s[2] * w[1]
    out[first + 9] += s[2] * w[0] + s[0] * w[2]
