"""Local minima of a fit with the Riemannian distance, within bounds and linear constraints.

Every step is to the minimum of the second order of the cost within the constraints, which is a
convex fit again: Newton's method where the cost is convex, and else with its negative curvatures
turned positive.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space

from geodrake.descent import PRECISION, is_within_rounding, step_length
from geodrake.errors import IdentificationError
from geodrake.identification.coordinates import (
    SYMMETRIC_BASIS,
    Coordinates,
    Rows,
    Scalars,
    smat,
    svec,
)
from geodrake.identification.newton_path import minimize
from geodrake.identification.newton_program import NewtonProgram
from geodrake.identification.problem import FitProblem, LinearConstraints
from geodrake.identification.residual_path import meet_residual
from geodrake.inertia import Array
from geodrake.robot.reduction import triangular_factor

_SAME = 1e-4
"""Geodesic distance within which two minima count as one."""
_ACCURACY = 1e-14
"""Decrease that a step must promise to be worth taking, as a share of the size of the cost."""
_MOST_STEPS, _GUESSES = 300, 10
_RIDGES = (0.0, 1e-14, 1e-12, 1e-10, 1e-8, 1e-6)
"""Shares of its diagonal to be added in turn to a Hessian that rounding left indefinite."""
_ROUNDING = 1e-13
"""How far beyond a constraint counts as on it, relative to the coordinates."""
_LEAST_CURVATURE = 0.1
"""Of the distance, relative to that at the prior, where its own is not convex."""
_MEETS, _NEARLY_MEETS = 1e-9, 1e-6
"""Relative difference of the residual from its bound; that where rounding leaves no closer one."""
_WEIGHTS = 1e-40, 1e40
_FARTHEST = 1.5
"""Standard deviation of the logarithms of mass and moments in random starts, at most."""


@dataclass(frozen=True, eq=False)
class LocalMinima:
    """Where the starts led to.

    Attributes:
        starts: Names of the starts.
        costs: (n,) cost reached from each start, at the γ of the solution; inf where the search
            failed.
        distances: (n,) geodesic distance of what each start led to from the best.
        strict: Whether the best is a strict local minimum: its Hessian is positive definite.
    """

    starts: tuple[str, ...]
    costs: Array
    distances: Array
    strict: bool

    @property
    def agree(self) -> bool:
        """Whether all starts led to the same minimum."""
        return bool((self.distances < _SAME).all())

    @property
    def distinct(self) -> int:
        """Number of different minima that were found, distinguished by their costs."""
        found = np.sort(self.costs[np.isfinite(self.costs)])
        if (self.distances[np.isfinite(self.costs)] < _SAME).all():
            return 1
        scale = max(abs(found[0]), np.finfo(float).tiny)
        return 1 + int(np.count_nonzero(np.diff(found) > 1e-9 * scale))


@dataclass(frozen=True, eq=False)
class LocalMinimum:
    """A local minimum.

    Attributes:
        z: (p,) where it is.
        value: The cost there.
        hessian: (p, p) Hessian there.
        strict: Whether that is positive definite, as far as equalities leave freedom.
    """

    z: Array
    value: float
    hessian: Array
    strict: bool


@dataclass(frozen=True, eq=False)
class RiemannianSearch:
    """A search for minima of data ‖F z − f‖² + w (zᵀ Λ z + γ (Σ ½ ‖log S_i‖² + Σ w_k ½ log² y_k)).

    Attributes:
        coordinates: Coordinates z of the problem; its references are the prior Φ⁰.
        inequalities: Bounds and constraints G z ≥ h, but for those of scalars that the distance
            keeps positive.
        equalities: Constraints E z = e.
        freedom: (p, q) orthonormal directions along the equalities.
        triangle: (p, p + 1) factor [F f] of the data.
        prior: (p, p) Λ.
        blocks: (nb, 10) coordinates of the blocks.
        scalars: Positive scalars y with their weights w.
        gamma: γ.
        data: Weight of the data, 1 or 0.
        weight: Weight w of the prior against the data.
    """

    coordinates: Coordinates
    inequalities: Rows
    equalities: Rows
    freedom: Array
    triangle: Array
    prior: Array
    blocks: Array
    scalars: Scalars
    gamma: float
    data: float = 1.0
    weight: float = 1.0

    @classmethod
    def of(cls, problem: FitProblem, prior: Array, gamma: float) -> RiemannianSearch:
        """Return the search for a problem with a physical prior (nb, 10) and the weight γ of d²."""
        references = dict(zip(problem.inertia_blocks, prior, strict=True))
        coordinates = Coordinates.of(replace(problem, reference=references))
        root, positive, lower = coordinates.prior_root(), list(problem.scalar_priors), problem.lower
        lower = lower.copy()
        lower[positive] = np.where(lower[positive] > 0, lower[positive], -np.inf)
        inequalities, equalities = replace(
            coordinates, problem=replace(coordinates.problem, lower=lower)
        ).rows()
        freedom = np.eye(problem.size)
        if len(equalities[0]):
            freedom = null_space(equalities[0])
        return cls(
            coordinates,
            inequalities,
            equalities,
            freedom,
            triangle=triangular_factor([np.column_stack(coordinates.data())])[: problem.size],
            prior=root.T @ root,
            blocks=np.array(problem.inertia_blocks)[:, None] + np.arange(10),
            scalars=coordinates.scalars(problem.scalar_priors),
            gamma=gamma,
        )

    def weighted(self, weight: float) -> RiemannianSearch:
        """Return the search with a weight w of the regularizer; inf leaves the data out."""
        if np.isinf(weight):
            return replace(self, data=0.0, weight=1.0)
        return replace(self, data=1.0, weight=weight)

    def start(self, x: Array) -> Array:
        """Return coordinates (p,) of parameters x (p,), put onto the equality constraints."""
        z, (E, e) = self.coordinates.at(x), self.equalities
        return z + np.linalg.lstsq(E, e - E @ z, rcond=None)[0] if len(E) else z

    def is_inside(self, z: Array) -> bool:
        """Return whether coordinates z (p,) keep all constraints."""
        (G, h), (E, e) = self.inequalities, self.equalities
        kept = np.allclose(E @ z, e, rtol=0.0, atol=1e-9) and (G @ z >= h).all()
        return bool(kept and np.isfinite(self.cost(z)))

    def random_start(self, z: Array, random: np.random.Generator) -> Array:
        """Return a point inside all constraints on a random geodesic from z (p,), which is so."""
        S = self.matrices(z)
        rates, axes = np.linalg.eigh(smat(random.normal(size=(len(S), 10))))
        far = np.exp(0.5 * random.uniform(0.0, _FARTHEST) * rates)[:, None, :]
        root = np.linalg.cholesky(S) @ axes * far
        start = z.copy()
        start[self.blocks] = svec(root @ np.swapaxes(root, 1, 2) - self.coordinates.starts)
        start = self.start(self.coordinates.parameters(start))
        while not self.is_inside(start):
            start = 0.8 * start + 0.2 * z
        return start

    def matrices(self, z: Array) -> Array:
        """Return S_i at z, (nb, 4, 4)."""
        return self.coordinates.starts + smat(z[self.blocks])

    def misfit(self, z: Array) -> float:
        """Return ‖F z − f‖², the residual above the least that any parameters reach."""
        return float(np.square(self.triangle @ np.append(z, -1.0)).sum())

    def cost(self, z: Array) -> float:
        """Return the cost at z; infinite where a body is not physical."""
        logs = float(half_squared_logs(self.matrices(z)).sum())
        ratios = half_squared_logs(self.scalars.ratios(z)[:, None, None])
        logs += float((self.scalars.weights * ratios).sum())
        prior = float(z @ self.prior @ z) + self.gamma * logs
        return self.data * self.misfit(z) + self.weight * prior

    def derivatives(self, z: Array, *, convex: bool = False) -> tuple[Array, Array]:
        """Return the gradient (p,) and Hessian (p, p) at z.

        Args:
            z: (p,) coordinates.
            convex: Whether negative curvatures of the distance are turned positive.
        """
        F, f = self.triangle[:, :-1], self.triangle[:, -1]
        gradient = 2.0 * (self.data * F.T @ (F @ z - f) + self.weight * self.prior @ z)
        hessian = 2.0 * (self.data * F.T @ F + self.weight * self.prior)
        slopes, curvatures = log_derivatives(self.matrices(z), convex=convex)
        scale, blocks = self.weight * self.gamma, self.blocks
        gradient[blocks] += scale * slopes
        hessian[blocks[:, :, None], blocks[:, None, :]] += scale * curvatures
        columns, y = self.scalars.columns, self.scalars.ratios(z)
        weights, rates, bend = scale * self.scalars.weights, self.scalars.slope / y, 1.0 - np.log(y)
        gradient[columns] += weights * rates * np.log(y)
        bend = np.maximum(np.abs(bend), _LEAST_CURVATURE) if convex else bend
        hessian[columns, columns] += weights * rates**2 * bend
        return gradient, hessian

    def minimum(self, z: Array) -> LocalMinimum:
        """Return the minimum that z (p,), inside all constraints, leads to.

        Raises:
            IdentificationError: No step lowers the cost, or none is defined.
        """
        size = max(min(self.cost(z), self.cost(0.0 * z)), self.weight * self.gamma)
        before = np.inf
        for _ in range(_MOST_STEPS):
            value, strict = self.cost(z), True
            gradient, hessian = self.derivatives(z)
            try:
                step = self._step(z, gradient, hessian)
            except np.linalg.LinAlgError:
                step, strict = self._convex_step(z), False
            promise, rounding = -float(gradient @ step), PRECISION * max(abs(value), size)
            ends = promise <= _ACCURACY * size or is_within_rounding(promise, before, rounding)

            length = self._length(z, step, promise, rounding)
            before, z = promise, z + length * step
            if ends:
                return LocalMinimum(z, self.cost(z), self.derivatives(z)[1], strict)
            if length == 0.0:
                break
        raise IdentificationError(
            "No step lowers the cost of the Riemannian fit.",
            advice="Check units and noise levels, raise gamma, or start from another point.",
        )

    def _length(self, z: Array, step: Array, promise: float, rounding: float) -> float:
        value = self.cost(z)
        return float(
            step_length(lambda share: value - self.cost(z + share * step), promise, rounding)
        )

    def _convex_step(self, z: Array) -> Array:
        """Return a step downhill where the cost is not convex, or is so but for rounding."""
        gradient, hessian = self.derivatives(z, convex=True)
        size = np.diagonal(hessian)
        size = np.diag(np.where(size > 0.0, size, 1.0))
        for ridge in _RIDGES:
            try:
                return self._step(z, gradient, hessian + ridge * size)
            except np.linalg.LinAlgError:
                continue
        raise IdentificationError(
            "The parameters cannot be distinguished by data and prior: no Newton step is defined.",
            advice="Add data or a prior for them, or leave their columns out.",
        )

    def _step(self, z: Array, gradient: Array, hessian: Array) -> Array:
        """Return the step to the minimum of the second order within the constraints.

        A few guesses of the active ones mostly end where these are known.

        Raises:
            LinAlgError: It is not convex.
        """
        N, (G, h) = self.freedom, self.inequalities
        root, room, q = np.linalg.cholesky(N.T @ hessian @ N), h - G @ z, N.shape[1]
        target = -np.linalg.solve(root, N.T @ gradient)
        rows, active = np.linalg.solve(root, (G @ N).T), np.zeros(len(h), bool)
        for _ in range(_GUESSES):
            forces, held = np.zeros(len(h)), rows[:, active]
            forces[active] = np.linalg.lstsq(held.T @ held, room[active] - held.T @ target)[0]
            y = target + rows @ forces
            wanted = (forces > 0) | (rows.T @ y < room - _ROUNDING * (1.0 + np.abs(z).max()))
            if np.array_equal(wanted, active):
                return np.asarray(N @ np.linalg.solve(root.T, y))
            active = wanted
        quadratic = FitProblem(
            factor=np.column_stack([root.T, target]),
            inertia_blocks=(),
            prior_mean=np.zeros(q),
            prior_information=np.zeros((q, q)),
            constraints=LinearConstraints(matrix=G @ N, lower=room, upper=np.full(len(h), np.inf)),
        )
        program = NewtonProgram.of(quadratic)
        found = minimize(program).point.z
        return np.asarray(N @ program.coordinates.parameters(found))

    def second_order(self, x: Array) -> tuple[FitProblem, float]:
        """Return the problem whose cost is the second order of this one's at x (p,), and its size.

        Raises:
            ArgumentError: It is not convex.
        """
        z, problem = self.coordinates.at(x), self.coordinates.problem
        gradient, hessian = self.derivatives(z)
        target = z - np.linalg.lstsq(hessian, gradient, rcond=None)[0]
        local = replace(
            problem,
            factor=np.zeros((1, len(z) + 1)),
            prior_mean=self.coordinates.parameters(target),
            prior_information=self.information(hessian),
            residual_bound=None,
        )
        # (Like that of a FitProgram: where the prior fits, γ is what there is to compare with.)
        return local, max(self.cost(z) + self.data * self._floor, self.weight * self.gamma)

    def information(self, hessian: Array) -> Array:
        """Return the information (p, p) about the parameters of a Hessian (p, p) in z."""
        inverse = np.linalg.inv(self.coordinates.transform)
        information = 0.5 * inverse.T @ hessian @ inverse
        return 0.5 * (information + information.T)

    def meet_bound(self, z: Array, weight: float) -> tuple[LocalMinimum, float]:
        """Return a minimum, and in the point-to-set form the weight w for which it meets the bound.

        Args:
            z: (p,) where to start from.
            weight: First guess of w; inf where the data are idle.

        Raises:
            IdentificationError: No minimum meets the bound: the residual jumps across it.
        """
        bound = self.coordinates.problem.residual_bound
        if bound is None:
            return self.weighted(1.0).minimum(z), 1.0
        excess = bound - self._floor
        if np.isinf(weight):
            nearest = self.weighted(np.inf).minimum(z)
            if self.misfit(nearest.z) <= excess:
                return nearest, np.inf
            weight = 1.0

        def solve(trial: float, last: LocalMinimum | None) -> tuple[LocalMinimum, float]:
            found = self.weighted(trial).minimum(z if last is None else last.z)
            return found, self.misfit(found.z)

        enough = _MEETS * min(bound, 1e3 * excess)
        found, weight, misfit = meet_residual(
            solve, excess, guess=weight, limits=_WEIGHTS, enough=enough
        )
        if abs(misfit - excess) <= max(enough, _NEARLY_MEETS * bound):
            return found, weight
        raise IdentificationError(
            f"No local minimum has the residual {bound:.6g}: as gamma changes, it jumps from one "
            f"minimum to another; the nearest found has {self._floor + misfit:.6g}.",
            advice="Take another residual bound, or the entropic regularizer, which is convex.",
            residual=self._floor + misfit,
            gamma=weight * self.gamma,
        )

    @property
    def _floor(self) -> float:
        """Least residual that any parameters reach."""
        x = self.coordinates.problem.prior_mean
        return self.coordinates.problem.residual(x) - self.misfit(np.zeros(len(x)))

    def compared(self, found: Mapping[str, LocalMinimum | None], best: LocalMinimum) -> LocalMinima:
        """Return what several starts led to (name -> minimum or None) against the best of them."""
        root = np.linalg.inv(np.linalg.cholesky(self.matrices(best.z)))
        own = self.scalars.ratios(best.z)
        costs, distances = np.full(len(found), np.inf), np.full(len(found), np.inf)
        for k, minimum in enumerate(found.values()):
            if minimum is not None:
                ratio = root @ self.matrices(minimum.z) @ np.swapaxes(root, -1, -2)
                ratios = [np.linalg.eigvalsh(ratio).ravel(), self.scalars.ratios(minimum.z) / own]
                costs[k] = minimum.value
                distances[k] = np.linalg.norm(np.log(np.concatenate(ratios)))
        return LocalMinima(tuple(found), costs, distances, best.strict)


def half_squared_logs(S: Array) -> Array:
    """Return ½ Σ_k log² λ_k(S) of matrices S (..., n, n); infinite if one is not positive definite.

    It is convex along geodesics, but not along straight lines: beyond an eigenvalue of e it
    flattens.
    """
    eigenvalues = np.asarray(np.linalg.eigvalsh(S), float)
    positive = eigenvalues > 0
    logs = np.log(np.where(positive, eigenvalues, 1.0))
    return np.where(positive.all(-1), 0.5 * (logs * logs).sum(-1), np.inf)


def log_derivatives(S: Array, *, convex: bool = False) -> tuple[Array, Array]:
    """Return gradients (..., 10) and Hessians (..., 10, 10) at positive definite S (..., 4, 4).

    The function is a spectral one, so that its gradient is V diag(h) Vᵀ with h(λ) = log λ / λ, and
    its Hessian has the divided differences of h as coefficients in the eigenvectors V.

    Args:
        S: (..., 4, 4) matrices.
        convex: Whether negative coefficients are turned positive, and small ones enlarged.
    """
    eigenvalues, V = np.linalg.eigh(S)
    logs = np.log(eigenvalues)
    gradient = svec((V * (logs / eigenvalues)[..., None, :]) @ np.swapaxes(V, -1, -2))
    ratio = logs[..., :, None] - logs[..., None, :]
    # δ/(e^δ − 1), with its limit 1 at δ = 0.
    small = np.abs(ratio) < 1e-12
    share = np.where(small, 1.0, ratio / np.where(small, 1.0, np.expm1(ratio)))
    coefficients = share - logs[..., None, :]
    if convex:
        coefficients = np.maximum(np.abs(coefficients), _LEAST_CURVATURE)
    coefficients = coefficients / (eigenvalues[..., :, None] * eigenvalues[..., None, :])
    V = V[..., None, :, :]
    turned = np.swapaxes(V, -1, -2) @ SYMMETRIC_BASIS @ V
    hessian = np.einsum("...kij,...ij,...lij->...kl", turned, coefficients, turned, optimize=True)
    return np.asarray(gradient, float), np.asarray(hessian, float)
