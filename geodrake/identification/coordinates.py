"""Dimensionless coordinates of a fit, for well-scaled solvers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.errors import ArgumentError
from geodrake.identification.problem import FitProblem
from geodrake.inertia import Array, from_pseudo_inertia, pseudo_inertia

Rows = tuple[Array, Array]
"""Rows (m, p) of linear constraints, and their values (m,)."""

_ROWS, _COLUMNS = np.tril_indices(4)
_UNITS = np.eye(4)[_ROWS][:, :, None] * np.eye(4)[_COLUMNS][:, None]
SYMMETRIC_BASIS = (_UNITS + np.swapaxes(_UNITS, 1, 2)) / np.where(
    _ROWS == _COLUMNS, 2.0, np.sqrt(2.0)
)[:, None, None]
"""Orthonormal basis of the symmetric 4×4 matrices; shape (10, 4, 4)."""

_FLAT = SYMMETRIC_BASIS.reshape(10, 16)
IDENTITY = _FLAT @ np.eye(4).ravel()
"""Coordinates svec(I) of the 4×4 identity; shape (10,)."""

_CENTRE_FLOOR = 0.01
"""Share of the reference in a centred scale, which keeps the scale regular at the boundary."""


def smat(coordinates: Array) -> Array:
    """Return the symmetric matrices (..., 4, 4) with orthonormal coordinates (..., 10)."""
    return (coordinates @ _FLAT).reshape(*coordinates.shape[:-1], 4, 4)


def svec(matrices: Array) -> Array:
    """Return the orthonormal coordinates (..., 10) of symmetric matrices (..., 4, 4)."""
    return matrices.reshape(*matrices.shape[:-2], 16) @ _FLAT.T


@dataclass(frozen=True, eq=False)
class Scalars:
    """Ratios of positive scalars to their priors, y = begin + slope z."""

    columns: NDArray[np.intp]  # (k,) indices in z
    begin: Array  # (k,) y at z = 0
    slope: Array  # (k,) dy/dz
    weights: Array  # (k,) weights of their divergence

    def ratios(self, z: Array) -> Array:
        """Return y (k,) at z (p,)."""
        return self.begin + self.slope * z[self.columns]


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Coordinates z with x = x₀ + T z, chosen so that each z is of order one.

    An inertia block has P(φ) = P(φ₀) + L smat(z) Lᵀ with the Cholesky factor L of its reference
    P = L Lᵀ, where the pullback metric ([Lee2019] Eq. (B.1.7)) is half the identity in any frame
    and units. A positive scalar is divided by its prior value, and any other one by the norm of
    its column of data and prior.
    """

    problem: FitProblem
    transform: Array  # (p, p) block-diagonal T
    starts: Array  # (n_blocks, 4, 4) matrices L⁻¹ P(φ₀) L⁻ᵀ
    references: Array  # (n_blocks, 4, 4) matrices L⁻¹ P(reference) L⁻ᵀ, the identity unless centred

    @classmethod
    def of(cls, problem: FitProblem, *, centre: Array | None = None) -> Coordinates:
        """Return the coordinates of a problem.

        Blocks are scaled by the references, or by a `centre` (p,) close to the solution, with which
        a solver gets closer to a boundary.
        """
        R = problem.factor[:, :-1]
        norms = np.sqrt((R * R).sum(0) + np.diagonal(problem.prior_information))
        scale = 1.0 / np.where(norms > 0, norms, 1.0)
        for column, (prior, _) in {**problem.scalar_priors, **problem.entropic_scalars}.items():
            scale[column] = prior
            if centre is not None:
                scale[column] = max(centre[column], 0.0) + _CENTRE_FLOOR * prior
        transform = np.diag(scale)
        references = scales = _pseudo_inertias(problem)
        if centre is not None:
            scales = _pseudo_inertias(problem, centre) + _CENTRE_FLOOR * references
        roots = np.linalg.cholesky(scales)
        for start, L in zip(problem.inertia_blocks, roots, strict=True):
            block = slice(start, start + 10)
            transform[block, block] = from_pseudo_inertia(L @ SYMMETRIC_BASIS @ L.T).T
        starts = _congruent(roots, _pseudo_inertias(problem, problem.prior_mean))
        return cls(problem, transform, starts, _congruent(roots, references))

    def parameters(self, z: Array) -> Array:
        """Return parameters x (p,) of coordinates z (p,)."""
        return self.problem.prior_mean + self.transform @ z

    def at(self, x: Array) -> Array:
        """Return coordinates z (p,) of parameters x (p,)."""
        return np.asarray(np.linalg.solve(self.transform, x - self.problem.prior_mean), float)

    def data(self) -> Array:
        """Return [R T | r − R x₀] (k, p + 1), whose residual is ‖(R T) z − (r − R x₀)‖²."""
        R, r = self.problem.factor[:, :-1], self.problem.factor[:, -1]
        return np.column_stack([R @ self.transform, r - R @ self.problem.prior_mean])

    def prior_root(self) -> Array:
        """Return a matrix C (k, p) with Cᵀ C = Tᵀ Λ T."""
        metric = self.transform.T @ self.problem.prior_information @ self.transform
        columns = np.flatnonzero(np.diagonal(metric))
        root = np.zeros((len(columns), len(metric)))
        try:
            root[:, columns] = np.linalg.cholesky(metric[np.ix_(columns, columns)]).T
        except np.linalg.LinAlgError:
            values, vectors = np.linalg.eigh(metric)
            if values[0] < -1e-9 * values[-1]:
                raise ArgumentError(
                    "prior_information is not positive semidefinite: its smallest eigenvalue is "
                    f"{values[0] / values[-1]:.1e} times the largest, in scaled parameters."
                ) from None
            root = (vectors * np.sqrt(np.maximum(values, 0.0))).T
        return root

    def scalars(self, priors: Mapping[int, tuple[float, float]]) -> Scalars:
        """Return the ratios of positive scalars to priors, column -> (x⁰, weight)."""
        columns = np.array(list(priors), int)
        values = np.reshape([priors[k] for k in priors], (-1, 2)).astype(float)
        begin = self.problem.prior_mean[columns] / values[:, 0]
        slope = np.diagonal(self.transform)[columns] / values[:, 0]
        return Scalars(columns, begin, slope, values[:, 1])

    def bounds(self) -> tuple[Array, Array]:
        """Return the bounds (p,) and (p,) of z for those of x."""
        scale = np.ones(self.problem.size)
        scalar = np.isfinite(self.problem.lower) | np.isfinite(self.problem.upper)
        scale[scalar] = np.diagonal(self.transform)[scalar]
        mean, least = self.problem.prior_mean, self.problem.lower.copy()
        for column in self.problem.entropic_scalars:  # the divergence keeps them positive
            least[column] = least[column] if least[column] > 0 else -np.inf
        return (least - mean) / scale, (self.problem.upper - mean) / scale

    def rows(self) -> tuple[Rows, Rows]:
        """Return bounds and constraints as inequalities G z ≥ h and equalities E z = e.

        All rows of G (m, p) and E (l, p) are of unit length.
        """
        lower, upper = self.bounds()
        matrix = np.eye(self.problem.size)
        constraints = self.problem.constraints
        if constraints is not None:
            begin = constraints.matrix @ self.problem.prior_mean
            matrix = np.vstack([matrix, constraints.matrix @ self.transform])
            lower = np.append(lower, constraints.lower - begin)
            upper = np.append(upper, constraints.upper - begin)
        norms = np.linalg.norm(matrix, axis=1)
        scale = 1.0 / np.where(norms > 0, norms, 1.0)
        matrix, lower, upper = scale[:, None] * matrix, scale * lower, scale * upper
        fixed = np.isfinite(lower) & (lower == upper)
        above, below = np.isfinite(lower) & ~fixed, np.isfinite(upper) & ~fixed
        G = np.vstack([matrix[above], -matrix[below]])
        return (G, np.append(lower[above], -upper[below])), (matrix[fixed], lower[fixed])

    def smallest_eigenvalues(self, x: ArrayLike) -> Array:
        """Return the smallest eigenvalue of P(reference)⁻¹ P(φ) of each block (n_blocks,) of x."""
        roots = np.linalg.cholesky(_pseudo_inertias(self.problem))
        relative = _congruent(roots, _pseudo_inertias(self.problem, np.asarray(x, float)))
        return np.asarray(np.linalg.eigvalsh(relative), float)[..., 0]


def _pseudo_inertias(problem: FitProblem, x: Array | None = None) -> Array:
    """Return P(φ_i) (n_blocks, 4, 4) of every block of x (p,), or of the references."""
    references, starts = problem.reference, problem.inertia_blocks
    blocks = [references[k] if x is None else x[k : k + 10] for k in starts]
    return pseudo_inertia(np.reshape(blocks, (-1, 10)))


def _congruent(roots: NDArray[np.floating[Any]], matrices: Array) -> Array:
    """Return L⁻¹ M L⁻ᵀ for roots L and symmetric matrices M (n, 4, 4), exactly symmetric."""
    half = np.swapaxes(np.linalg.solve(roots, matrices), -1, -2)
    full = np.asarray(np.linalg.solve(roots, half), float)
    return 0.5 * (full + np.swapaxes(full, -1, -2))
