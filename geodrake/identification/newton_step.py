"""Primal–dual Newton steps on the central path of an entropic fit.

With dual matrices Z_i and multipliers λ, the minimum of a `WeightedProgram` is where

    F'(F z − f) + γ svec(I) − svec(Z) − Gᵀ λ − Eᵀ ν = 0,   S_i Z_i = γ_i I,   s λ = 0,   s = G z − h

so the entropic divergence is the point γ on the central path of S ⪰ 0, and a method that follows
the path stops there: it needs as few steps for a tiny γ, which leaves S nearly singular, as for a
large one. Steps are those of Nesterov and Todd with Mehrotra's predictor and corrector; S, Z, s
and λ stay strictly positive. The Newton matrix is never formed: its triangular factor is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg.lapack import dtpqrt, dtrtrs

from geodrake.identification.newton_program import WeightedProgram, smat, svec
from geodrake.inertia import Array

_PANEL = 16


@dataclass(frozen=True, eq=False)
class Iterate:
    """A point between start and solution, or a step from it.

    Attributes:
        z: (p,) coordinates.
        Z: (n, 4, 4) dual matrices of the blocks.
        slack: (m,) slacks s of the inequalities.
        multipliers: (m,) multipliers λ of the inequalities.
        forces: (l,) multipliers ν of the equalities.
    """

    z: Array
    Z: Array
    slack: Array
    multipliers: Array
    forces: Array

    def moved(self, step: Iterate, length: float) -> Iterate:
        """This point, a length of a step further."""
        return Iterate(
            self.z + length * step.z,
            self.Z + length * step.Z,
            self.slack + length * step.slack,
            self.multipliers + length * step.multipliers,
            self.forces + length * step.forces,
        )


@dataclass(frozen=True, eq=False)
class Direction:
    """A step and what it does to the scaled matrices.

    Attributes:
        step: The step.
        primal: (n, 4, 4) change of the scaled S.
        dual: (n, 4, 4) change of the scaled Z.
    """

    step: Iterate
    primal: Array
    dual: Array


class Linearization:
    """The optimality conditions of a program linearized at a point, factored once.

    Attributes:
        dual_error: (p,) error of the stationarity.
        slack_error: (m,) error G z − h − s.
        equality_error: (l,) error E z − e.
        products: (n, 4) eigenvalues of S_i Z_i.
    """

    def __init__(self, weighted: WeightedProgram, at: Iterate) -> None:
        program = weighted.program
        self._weighted, self._at = weighted, at
        G, h = program.inequalities
        E, e = program.equalities
        self.dual_error = weighted.slope(at.z) - G.T @ at.multipliers - E.T @ at.forces
        self.dual_error[program.blocks] -= svec(at.Z)
        self.slack_error = G @ at.z - h - at.slack
        self.equality_error = E @ at.z - e
        # Nesterov–Todd scaling: T⁻¹ S T⁻ᵀ = Tᵀ Z T = diag(d).
        root_S = np.linalg.cholesky(program.matrices(at.z))
        root_Z = np.linalg.cholesky(at.Z)
        _, self._d, V = np.linalg.svd(np.swapaxes(root_Z, 1, 2) @ root_S)
        self.products = self._d**2
        T = root_S @ np.swapaxes(V, 1, 2) / np.sqrt(self._d)[:, None, :]
        self._scaling = np.linalg.inv(T)
        # K_i, the map from z_i to the scaled change of S_i: K_iᵀK_i is the curvature of S_i.
        turned = np.swapaxes(self._scaling, 1, 2)[:, None]
        self._K = np.swapaxes(svec(self._scaling[:, None] @ _BASIS @ turned), 1, 2)
        self._stiffness = at.multipliers / at.slack
        self._R = self._factor(G)
        self._spread = _solve(self._R, E.T, transposed=True)

    def _factor(self, G: Array) -> Array:
        """R with RᵀR = FᵀF + KᵀK + Gᵀ(λ/s)G."""
        program = self._weighted.program
        rows = np.zeros_like(self._weighted.factor)
        places = program.blocks
        rows[places[:, :, None], places[:, None, :]] = np.triu(np.linalg.qr(self._K, mode="r"))
        p = len(rows)
        R, _, _, _ = dtpqrt(p, min(_PANEL, p), self._weighted.factor, rows, overwrite_b=True)
        if len(G):
            stiff = np.asfortranarray(np.sqrt(self._stiffness)[:, None] * G)
            R, _, _, _ = dtpqrt(0, min(_PANEL, p), R, stiff, overwrite_a=True, overwrite_b=True)
        return R

    def gap(self) -> float:
        """Distance of the cost from its minimum, to first order."""
        gamma = self._weighted.gamma
        ratio = self.products / gamma[:, None]
        logs = (gamma[:, None] * (ratio - 1.0 - np.log(ratio))).sum()
        error = _solve(self._R, self.dual_error, transposed=True)
        return float(logs + self._at.slack @ self._at.multipliers + 0.5 * error @ error)

    def direction(self, centre: float, predicted: Direction | None = None) -> Direction:
        """Step to S Z = (γ + centre) I and s λ = centre, with the predicted second order.

        Args:
            centre: How far from the solution on the path to stay.
            predicted: A first step, whose second-order terms are taken along.
        """
        at, d = self._at, self._d
        aim = self._weighted.gamma[:, None] + centre
        wanted = (aim - self.products)[:, :, None] * np.eye(4)
        slack_wanted = centre - at.slack * at.multipliers
        if predicted is not None:
            product = predicted.primal @ predicted.dual
            wanted = wanted - 0.5 * (product + np.swapaxes(product, 1, 2))
            slack_wanted = slack_wanted - predicted.step.slack * predicted.step.multipliers
        return self._solved(
            2.0 * wanted / (d[:, :, None] + d[:, None, :]), slack_wanted, self.dual_error
        )

    def tangent(self) -> Array:
        """Change (p,) of the minimum with the logarithm of the prior's weight."""
        weighted, at = self._weighted, self._at
        program = weighted.program
        change = 2.0 * weighted.weight * (program.prior.T @ (program.prior @ at.z))
        change[program.blocks] += weighted.gamma[:, None] * svec(np.eye(4))
        wanted = weighted.gamma[:, None, None] * np.eye(4) / self._d[:, :, None]
        right = self._right(wanted, np.zeros_like(at.slack)) - change
        return self._constrained(right, np.zeros(len(program.equalities[1])))[0]

    def _right(self, M: Array, forced: Array) -> Array:
        """Right side of Newton's equation that M and a force on the inequalities make."""
        program = self._weighted.program
        right = program.inequalities[0].T @ forced
        right[program.blocks] += (svec(M)[:, None, :] @ self._K)[:, 0]
        return right

    def _constrained(self, right: Array, equality: Array) -> tuple[Array, Array]:
        """The x with H x − Eᵀ ν = right and E x = equality, and ν."""
        half = _solve(self._R, right, transposed=True)
        spread = self._spread
        if not len(equality):
            return _solve(self._R, half), np.empty(0)
        forces = np.linalg.lstsq(spread.T @ spread, equality - spread.T @ half)[0]
        return _solve(self._R, half + spread @ forces), forces

    def _solved(self, M: Array, slack_wanted: Array, dual_error: Array) -> Direction:
        at, program = self._at, self._weighted.program
        G = program.inequalities[0]
        forced = slack_wanted / at.slack - self._stiffness * self.slack_error
        right = self._right(M, forced) - dual_error
        dz, forces = self._constrained(right, -self.equality_error)
        dS = smat((self._K @ dz[program.blocks][:, :, None])[:, :, 0])
        dZ = M - dS
        change = G @ dz
        slack = change + self.slack_error
        step = Iterate(
            z=dz,
            Z=np.swapaxes(self._scaling, 1, 2) @ dZ @ self._scaling,
            slack=slack,
            multipliers=forced - self._stiffness * change,
            forces=forces,
        )
        return Direction(step, dS, dZ)

    def reach(self, direction: Direction) -> float:
        """Length of a step at which S, Z, s or λ reach the boundary; inf if they never do."""
        root = 1.0 / np.sqrt(self._d)
        scale = root[:, :, None] * root[:, None, :]
        both = np.concatenate([direction.primal * scale, direction.dual * scale])
        falls = [
            -np.linalg.eigvalsh(both)[:, 0].min(initial=0.0),
            -(direction.step.slack / self._at.slack).min(initial=0.0),
            -(direction.step.multipliers / self._at.multipliers).min(initial=0.0),
        ]
        return 1.0 / max(falls) if max(falls) > 0 else np.inf

    def excess(self, direction: Direction | None = None, length: float = 0.0) -> float:
        """Mean of what S Z has beyond γ and of s λ, after a length of a step."""
        D = self._d[:, :, None] * np.eye(4)
        S, Z, s, y = D, D, self._at.slack, self._at.multipliers
        if direction is not None:
            S, Z = S + length * direction.primal, Z + length * direction.dual
            s, y = s + length * direction.step.slack, y + length * direction.step.multipliers
        beyond = np.maximum((S * Z).sum((1, 2)) - 4.0 * self._weighted.gamma, 0.0)
        return float(beyond.sum() + max(s @ y, 0.0)) / max(self._d.size + len(s), 1)


_BASIS = smat(np.eye(10))


def _solve(R: Array, right: Array, *, transposed: bool = False) -> Any:
    """R⁻¹ right, or R⁻ᵀ right, for an upper triangular R."""
    if not right.size:
        return np.zeros(right.shape)
    return dtrtrs(R, right, trans=int(transposed))[0]
