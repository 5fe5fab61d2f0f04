"""Rigid bodies at one sample: Y φ, Yᵀ r and Y of the Slotine–Li regressor.

    M(q) a + C(q, q̇) v − τ_g(q) = Y(q, q̇, v, a) φ                      [Lee2019] Eq. (5.2.10)

For a body with spatial inertia G, velocity V of the motion q̇ and U of the motion v, the wrench is

    F = G A' + ½ (V ×* G U + U ×* G V),   A' = A − ½ V × U,

where A = J a + J̇ v is an acceleration, less gravity. Then Ṁ − 2 C is skew symmetric, and where
velocities are rates of positions C is the matrix of Christoffel symbols, C(q, q̇) v = C(q, v) q̇.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geodrake.control.regressor.online_tree import OnlineTree, Placement
from geodrake.control.regressor.spatial_algebra import (
    INERTIA,
    MOMENTUM,
    MOTION_CROSS,
    SLOTINE_LI,
    motion_cross,
)
from geodrake.inertia import PARAMETERS_PER_BODY, Array


@dataclass(frozen=True, eq=False)
class RigidSample:
    """The bodies at one (q, q̇, v, a), ready for any inertial parameters and any r.

    Attributes:
        tree: What is constant.
        placement: What depends on q.
        motions: (nb, 6, 3) columns A, U and V of each body about Bo, in B.
        subspace_rate: (nv, 6) rate of the placement's subspace along the motion q̇.
    """

    tree: OnlineTree
    placement: Placement
    motions: Array
    subspace_rate: Array

    @classmethod
    def at(cls, tree: OnlineTree, q: Array, qd: Array, v: Array, a: Array) -> RigidSample:
        """Kinematics at positions q (nq,), velocities q̇ and v (nv,), and accelerations a (nv,).

        Args:
            tree: The kinematic tree.
            q: (nq,) positions in Drake's order.
            qd: (nv,) velocities q̇.
            v: (nv,) velocities that take the place of one q̇ in products of two.
            a: (nv,) accelerations.
        """
        placement = tree.place(q)
        S, sums = placement.subspace, np.empty((len(v), 6, 3))
        np.multiply(S[:, :, None], np.array((a, v, qd)).T[:, None], out=sums)
        carried = motion_cross(tree.moves_inboard @ sums[:, :, 2])
        subspace_rate = (carried @ S[:, :, None])[:, :, 0]
        if tree.swings:
            swing = placement.inboard[:, :3, :3].transpose(0, 2, 1) @ (tree.swing @ qd)[:, :, None]
            subspace_rate[:, 3:] += swing[:, :, 0]
        sums[:, :, 0] += subspace_rate * v[:, None]
        motions = (tree.moves @ sums.reshape(-1, 18)).reshape(-1, 6, 3)
        motions[:, :, 0] += tree.reaction
        return cls(tree, placement, placement.transforms @ motions, subspace_rate)

    @cached_property
    def wrench_maps(self) -> Array:
        """Matrices X (nb, 10, 6): φᵀ X is the wrench F of a body about Bo, in B."""
        count = len(self.motions)
        features = np.empty((count, 42))
        features[:, :6] = self.motions[:, :, 0]
        U, V = self.motions[:, :, 1, None], self.motions[:, None, :, 2]
        np.multiply(U, V, out=features[:, 6:].reshape(count, 6, 6))
        return (features @ SLOTINE_LI).reshape(count, PARAMETERS_PER_BODY, 6)

    def effort(self, phi: Array) -> Array:
        """Y φ (nv,) for φ (nb, 10), in a number of operations that grows with nb, not nb nv."""
        wrenches = (phi[:, None] @ self.wrench_maps) @ self.placement.transforms
        total = self.tree.moves.T @ wrenches[:, 0]
        return np.einsum("ij,ij->i", self.placement.subspace, total)

    def covector(self, r: Array) -> Array:
        """Yᵀ r (nb, 10) for r (nv,), from spatial velocities alone."""
        along = self.tree.moves @ (self.placement.subspace * r[:, None])
        return (self.wrench_maps @ (self.placement.transforms @ along[:, :, None]))[:, :, 0]

    @cached_property
    def regressor(self) -> Array:
        """Y (nv, 10 nb)."""
        product = self.placement.subspace @ self._in_world(self.wrench_maps).T
        product *= self.tree.moves_columns
        return product

    @cached_property
    def momentum_regressors(self) -> Array:
        """Regressors (2, nv, 10 nb) of M q̇ = Σ Jᵀ G V and of Cᵀ q̇ + τ_g = Σ J̇ᵀ G V + τ_g."""
        # (All products at once: the cost is in the number of calls. One of the four is not needed.)
        V, S = self.motions[:, :, 2], self.placement.subspace
        reaction = (self.placement.transforms @ self.tree.reaction[:, :, None])[:, :, 0]
        maps = (np.concatenate((V, reaction)) @ MOMENTUM).reshape(2, -1, PARAMETERS_PER_BODY, 6)
        product = np.concatenate((S, self.subspace_rate)) @ self._in_world(maps).T
        moves, (nv, n) = self.tree.moves_columns, self.tree.moves_columns.shape
        product[nv:, :n] -= product[:nv, n:]
        return product[:, :n].reshape(2, nv, n) * moves

    def mass_matrix(self, phi: Array) -> Array:
        """M (nv, nv) for φ (nb, 10)."""
        J = self._jacobian(self.placement.subspace)
        return _sum_of_products(J, J @ (phi @ INERTIA).reshape(-1, 6, 6))

    def coriolis_matrix(self, phi: Array) -> Array:
        """C(q, q̇) (nv, nv) for φ (nb, 10), with Ṁ − 2 C skew symmetric."""
        J, J_rate = (self._jacobian(x) for x in (self.placement.subspace, self.subspace_rate))
        G = (phi @ INERTIA).reshape(-1, 6, 6)
        V = self.motions[:, :, 2]
        turned = G @ motion_cross(V)
        pushed = np.einsum("kij,ni->njk", MOTION_CROSS.reshape(6, 6, 6), (V[:, None] @ G)[:, 0])
        B = -0.5 * (turned + turned.transpose(0, 2, 1) + pushed)
        return _sum_of_products(J, J_rate @ G + J @ B.transpose(0, 2, 1))

    def _in_world(self, maps: Array) -> Array:
        """Wrenches of unit parameters (k nb 10, 6) in W about Wo, from maps (k, nb, 10, 6) in B."""
        return (maps @ self.placement.transforms).reshape(-1, 6)

    def _jacobian(self, subspace: Array) -> Array:
        """Rows (nb, nv, 6) of the bodies' velocities in B, from directions (nv, 6) in W."""
        along = self.tree.moves[:, :, None] * subspace
        return along @ self.placement.transforms.transpose(0, 2, 1)


def _sum_of_products(J: Array, F: Array) -> Array:
    """Σ J Fᵀ over bodies, both (nb, nv, 6)."""
    return np.asarray(np.tensordot(J, F, ((0, 2), (0, 2))))
