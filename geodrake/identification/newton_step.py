"""Primal–dual Newton steps on the central path of an entropic fit.

With dual matrices Z_i and multipliers λ, the minimum of a `WeightedProgram` is where

    F'(F z − f) + γ svec(I) − svec(Z) + Gᵀ(γ − λ) − Eᵀ ν = 0,
    S_i Z_i = γ_i I,   s_k λ_k = γ_k,   s = G z − h

with γ_k = 0 for a mere inequality and the weight of its prior for a positive scalar s_k. So the
entropic divergence is the point γ on the central path of S ⪰ 0, and a method that follows
the path stops there: it needs as few steps for a tiny γ, which leaves S nearly singular, as for a
large one. Steps are those of Nesterov and Todd with Mehrotra's predictor and corrector; S, Z, s
and λ stay strictly positive.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg.lapack import dtpmqrt, dtpqrt, dtrtrs

from geodrake.identification.newton_program import WeightedProgram, smat, svec
from geodrake.inertia import Array

_PANEL = 16
_FLOOR = 1e-15
"""Products S Z, relative to the misfit, below which rounding would make Z or S indefinite."""


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
        """This point, a length of a step further.

        Args:
            step: A change of each field.
            length: Factor of the step.
        """
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

    With Newton's matrix FᵀF + KᵀK + Gᵀ(λ/s)G a step is the solution of a least squares problem
    with the rows F, K and √(λ/s) G. It is solved as such: its right side in products like Fᵀ f
    would lose a tiny γ next to strong data.

    Attributes:
        weighted: The program.
        at: The point.
        slack_error: (m,) error G z − h − s.
        equality_error: (l,) error E z − e.
        products: (n, 4) eigenvalues of S_i Z_i.
    """

    def __init__(self, weighted: WeightedProgram, at: Iterate) -> None:
        program = weighted.program
        self.weighted, self.at = weighted, at
        G, h = program.inequalities
        E, e = program.equalities
        self.slack_error = G @ at.z - h - at.slack
        self.equality_error = E @ at.z - e
        # Nesterov–Todd scaling: T⁻¹ S T⁻ᵀ = Tᵀ Z T = diag(d).
        root_S = np.linalg.cholesky(program.matrices(at.z))
        root_Z = np.linalg.cholesky(at.Z)
        _, self._d, V = np.linalg.svd(np.swapaxes(root_Z, 1, 2) @ root_S)
        self.products = self._d**2
        T = root_S @ np.swapaxes(V, 1, 2) / np.sqrt(self._d)[:, None, :]
        self._D = self._d[:, :, None] * np.eye(4)
        self._prior_pull = weighted.gamma[:, None, None] * (np.swapaxes(T, 1, 2) @ T)
        self._scaling = np.linalg.inv(T)
        self._errors = weighted.target - weighted.factor @ at.z
        floor = _FLOOR * float(self._errors @ self._errors)
        self._aim = np.maximum(weighted.gamma, floor)
        self._targets = np.where(weighted.targets > 0, np.maximum(weighted.targets, floor), 0.0)
        self._stiffness = at.multipliers / at.slack
        self._factor(T, G)
        self._spread = _solve(self._R, E.T, transposed=True)

    def _factor(self, T: Array, G: Array) -> None:
        """QR of the rows F, K and √(λ/s) G; the reflectors are kept for right sides.

        K_i takes z_i to the change of S_i scaled by U⁻¹ and U⁻ᵀ, where U Uᵀ = T Tᵀ is upper
        triangular, which makes K_i upper triangular too.
        """
        program = self.weighted.program
        flipped = (T @ np.swapaxes(T, 1, 2))[:, ::-1, ::-1]
        U = np.linalg.cholesky(flipped)[:, ::-1, ::-1]
        self._turn = self._scaling @ U
        inverse = np.triu(np.linalg.inv(U))[:, None]
        K = np.swapaxes(svec(inverse @ _BASIS @ np.swapaxes(inverse, 2, 3)), 1, 2)
        rows = np.zeros_like(self.weighted.factor)
        rows[program.blocks[:, :, None], program.blocks[:, None, :]] = K
        p = len(rows)
        R, V, t, _ = dtpqrt(p, min(_PANEL, p), self.weighted.factor, rows, overwrite_b=True)
        self._reflectors = [(p, V, t)]
        if len(G):
            stiff = np.asfortranarray(np.sqrt(self._stiffness)[:, None] * G)
            R, V, t, _ = dtpqrt(0, min(_PANEL, p), R, stiff, overwrite_a=True, overwrite_b=True)
            self._reflectors.append((0, V, t))
        self._R = R

    def _reduced(self, errors: Array, matrices: Array, rows: Array) -> Array:
        """Right side (p,) of R x = … for right sides of F, of K as (n, 4, 4), and of √(λ/s) G."""
        below = np.zeros(len(errors))
        turned = np.swapaxes(self._turn, 1, 2) @ matrices @ self._turn
        below[self.weighted.program.blocks] = svec(turned)
        top = errors[:, None]
        for (width, V, t), part in zip(self._reflectors, (below, rows), strict=False):
            top, _, _ = dtpmqrt(width, V, t, top, part[:, None], side="L", trans="T")
        return np.asarray(top[:, 0], float)

    def _constrained(self, right: Array, equality: Array) -> tuple[Array, Array]:
        """The x with R x = right + R⁻ᵀ Eᵀ ν and E x = equality, and ν."""
        if not len(equality):
            return _solve(self._R, right), np.empty(0)
        spread = self._spread
        forces = np.linalg.lstsq(spread.T @ spread, equality - spread.T @ right)[0]
        return _solve(self._R, right + spread @ forces), forces

    def gap(self) -> float:
        """Distance of the cost from its minimum, to first order."""
        at, aim = self.at, self._aim[:, None]
        ratio = self.products / aim
        logs = (aim * (ratio - 1.0 - np.log(ratio))).sum()
        pull = self._D - self._prior_pull
        rows = (at.multipliers - self.weighted.targets) / np.sqrt(self._stiffness)
        error = self._reduced(self._errors, pull, rows)
        error = error + self._spread @ at.forces
        products, weighty = at.slack * at.multipliers, self._targets > 0
        shares = products[weighty] / self._targets[weighty]
        logs += self._targets[weighty] @ (shares - 1.0 - np.log(shares))
        return float(logs + products[~weighty].sum() + 0.5 * error @ error)

    def direction(self, centre: float, predicted: Direction | None = None) -> Direction:
        """Step to S Z = (γ + centre) I and s λ = centre, with the predicted second order.

        Args:
            centre: How far from the solution on the path to stay.
            predicted: A first step, whose second-order terms are taken along.
        """
        at, d, G = self.at, self._d, self.weighted.program.inequalities[0]
        wanted = (self._aim[:, None] + centre - self.products)[:, :, None] * np.eye(4)
        force = (self._targets + centre) / at.slack
        if predicted is not None:
            product = predicted.primal @ predicted.dual
            wanted = wanted - 0.5 * (product + np.swapaxes(product, 1, 2))
            force = force - predicted.step.slack * predicted.step.multipliers / at.slack
        force = force - self._stiffness * self.slack_error
        M = 2.0 * wanted / (d[:, :, None] + d[:, None, :])
        pull = M + self._D - self._prior_pull
        rows = (force - self.weighted.targets) / np.sqrt(self._stiffness)
        right = self._reduced(self._errors, pull, rows)
        dz, forces = self._constrained(right, -self.equality_error)
        change = smat(dz[self.weighted.program.blocks])
        primal = self._scaling @ change @ np.swapaxes(self._scaling, 1, 2)
        dual = M - primal
        nearing = G @ dz
        step = Iterate(
            z=dz,
            Z=np.swapaxes(self._scaling, 1, 2) @ dual @ self._scaling,
            slack=nearing + self.slack_error,
            multipliers=force - at.multipliers - self._stiffness * nearing,
            forces=forces - at.forces,
        )
        return Direction(step, primal, dual)

    def tangent(self) -> Array:
        """Change (p,) of the minimum with the logarithm of the prior's weight."""
        weighted, at = self.weighted, self.at
        prior = weighted.program.prior
        moves = weighted.gamma > weighted.program.least  # a least barrier stays as it is
        pull = (weighted.gamma[:, None] / self._d)[:, :, None] * np.eye(4) - self._prior_pull
        pull = moves[:, None, None] * pull
        rows = weighted.targets * (1.0 / at.slack - 1.0) / np.sqrt(self._stiffness)
        right = self._reduced(np.zeros_like(at.z), pull, rows)
        change = 2.0 * weighted.weight * (prior.T @ (prior @ at.z))
        right = right - _solve(self._R, change, transposed=True)
        return self._constrained(right, np.zeros_like(at.forces))[0]

    def reach(self, direction: Direction) -> float:
        """Length of a step at which S, Z, s or λ reach the boundary; inf if they never do."""
        root = 1.0 / np.sqrt(self._d)
        scale = root[:, :, None] * root[:, None, :]
        both = np.concatenate([direction.primal * scale, direction.dual * scale])
        falls = [
            -np.linalg.eigvalsh(both)[:, 0].min(initial=0.0),
            -(direction.step.slack / self.at.slack).min(initial=0.0),
            -(direction.step.multipliers / self.at.multipliers).min(initial=0.0),
        ]
        return 1.0 / max(falls) if max(falls) > 0 else np.inf

    def excess(self, direction: Direction | None = None, length: float = 0.0) -> float:
        """Mean of what S Z and s λ have beyond γ, after a length of a step.

        Args:
            direction: The step; None to stay.
            length: Factor of the step.
        """
        S, Z, s, y = self._D, self._D, self.at.slack, self.at.multipliers
        if direction is not None:
            S, Z = S + length * direction.primal, Z + length * direction.dual
            s, y = s + length * direction.step.slack, y + length * direction.step.multipliers
        beyond = np.maximum((S * Z).sum((1, 2)) - 4.0 * self._aim, 0.0)
        mere = self._targets == 0
        scalars = np.maximum(s * y - self._targets, 0.0)[~mere]
        products = beyond.sum() + scalars.sum() + max(s[mere] @ y[mere], 0.0)
        return float(products) / max(self._d.size + len(s), 1)


_BASIS = smat(np.eye(10))


def _solve(R: Array, right: Array, *, transposed: bool = False) -> Any:
    """R⁻¹ right, or R⁻ᵀ right, for an upper triangular R."""
    if not right.size:
        return np.zeros(right.shape)
    return dtrtrs(R, right, trans=int(transposed))[0]
