"""Fits with the Riemannian distance, the geometric distance itself, which is not convex.

Local minima are found within bounds and linear constraints. Every step minimizes the second order
of the cost within the constraints; where the cost is not convex, negative curvatures are made
positive.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import nnls
from scipy.special import exprel

from geodrake.boundary.arguments import instances
from geodrake.descent import PRECISION, is_within_rounding, step_length
from geodrake.errors import ArgumentError, GeodrakeError, IdentificationError
from geodrake.identification.conic_fit import certified, uncertified
from geodrake.identification.coordinates import SYMMETRIC_BASIS, Rows, svec
from geodrake.identification.fit import SAME_COST, FitResult, LocalMinima, fit_result
from geodrake.identification.newton import NewtonProgram, solve_with_bound
from geodrake.identification.problem import FitProblem
from geodrake.identification.regularizer import Entropic, Pullback, Regularizer, Solver
from geodrake.inertia import Array, riemannian_distance

STARTS = ("entropic", "pullback", "prior", "data")

_ACCURACY = 1e-14
"""Predicted relative decrease of the cost at convergence."""
_MOST_STEPS, _MOST_DRAWS = 300, 60
_RIDGES = (0.0, 1e-14, 1e-12, 1e-10, 1e-8, 1e-6)
"""Relative ridges to be tried in turn on a Hessian that rounding left indefinite."""
_LEAST_CURVATURE = 0.1
"""Least curvature of the convexified distance, relative to that at the prior."""


@dataclass(frozen=True)
class Riemannian(Regularizer):
    """d² = Σ_i ½ ‖log(P_i⁰⁻½ P_i P_i⁰⁻½)‖² ([Lee2019] Eqs. (3.3.26), (3.5.53)).

    Half the square of the geodesic distance (2.2.10), which agrees to second order with the
    pullback metric and the entropic divergence, so that γ has the same meaning for all three. It is
    independent of units and frames, and infinite at the boundary of physical bodies.

    The problem is not convex: the cost flattens for bodies more than e times as heavy as their
    prior, so that there can be several minima. The search starts at the entropic solution, the
    global minimum of a convex approximation, and then at others; `minima` of the result reports
    whether they agree. In the point-to-set form, γ is one for which the residual of a local minimum
    equals the bound.
    """

    # Starts of the search, "entropic" first: some of "entropic", "pullback", "prior" and "data",
    # the entropic solution with γ/1000.
    starts: tuple[str, ...] = STARTS

    name: ClassVar[str] = "riemannian"

    def __post_init__(self) -> None:
        object.__setattr__(self, "starts", instances(self.starts, "starts", str))
        if not set(self.starts) <= set(STARTS) or self.starts[:1] != ("entropic",):
            raise ArgumentError(
                f"starts must begin with 'entropic' and come from {', '.join(STARTS)}; "
                f"got {self.starts}."
            )

    def divergence(self, phi: Array, prior: Array) -> float:
        """Return d(Φ, Φ⁰)² of all bodies together."""
        return 0.5 * float(np.square(riemannian_distance(prior, phi)).sum())

    def scalar_divergence(self, values: Array, priors: Array) -> Array:
        """Return ½ log²(x/x⁰) of positive scalars ([Lee2019] Eq. (3.6.60))."""
        return np.asarray(0.5 * np.log(values / priors) ** 2)

    def regularize(self, problem: FitProblem, prior: Array, gamma: float) -> FitProblem:
        """Return the entropic problem, a convex approximation that agrees to second order."""
        return Entropic().regularize(problem, prior, gamma)

    def solve(
        self, problem: FitProblem, prior: Array, gamma: float, solver: Solver, certify: bool = False
    ) -> FitResult:
        """Return the best local minimum of all starts; `solver` finds the first start.

        The certificate is that of a local minimum. Its program is the second order of the cost at
        the solution with all constraints, and with the weight that meets a residual bound.
        """
        begin = time.perf_counter()
        program = RiemannianProgram.of(self.regularize(problem, prior, gamma))
        convex = Entropic().solve(problem, prior, gamma, solver)
        first = program.start(convex.x)

        def solve(trial: RiemannianProgram, previous: LocalMinimum | None) -> LocalMinimum:
            return trial.minimum(first if previous is None else previous.z)

        best, weight = solve_with_bound(program, solve, guess=convex.prior_weight)
        found: dict[str, LocalMinimum | None] = {"entropic": best}
        weighted, free = program.weighted(weight), replace(problem, residual_bound=None)

        def start(name: str) -> Array:
            if name == "pullback":
                # Its bodies may be at the boundary; mixing in the first start moves them inside.
                x = Pullback().solve(free, prior, gamma * weight, "newton").x
                return 0.9 * program.start(x) + 0.1 * first
            if name == "data":
                weak = 1e-3 * gamma * weight
                return program.start(Entropic().solve(free, prior, weak, "newton").x)
            return program.drawn_in(program.start(free.prior_mean), first)

        idle = {"pullback", "data"} if np.isinf(weight) else {}
        for name in (name for name in self.starts[1:] if name not in idle):
            try:
                found[name] = weighted.minimum(start(name))
            except GeodrakeError:  # keep the other minima
                found[name] = None
        lowest = min(filter(None, found.values()), key=lambda minimum: minimum.value)
        rounding = _ACCURACY * gamma * weighted.weight
        better = lowest.value < best.value - max(SAME_COST * abs(best.value), rounding)
        minima = program.compared(found, lowest if better else best)
        if better:
            first = lowest.z
            best, weight = solve_with_bound(program, solve, guess=weight)
        x = np.clip(program.coordinates.parameters(best.z), problem.lower, problem.upper)
        fit = fit_result(program.coordinates.problem, x, weight, "newton", begin)
        fit = replace(fit, information=program.information(best.hessian), minima=minima)
        if not certify:
            return fit
        try:
            local, size = program.weighted(weight).second_order(x)
            return certified(local, fit, size=size, scope="local")
        except ArgumentError:  # the second order is not convex
            return uncertified(fit, "the cost is not convex around the minimum", scope="local")


@dataclass(frozen=True, eq=False)
class LocalMinimum:
    """A local minimum z (p,), its cost, Hessian (p, p), and whether it is strict."""

    z: Array
    value: float
    hessian: Array
    strict: bool


@dataclass(frozen=True, eq=False)
class RiemannianProgram(NewtonProgram):
    """Fit with the cost ½ ‖F z − f‖² + Σ_i γ_i ½ ‖log S_i‖² + Σ_k γ_k ½ log² y_k.

    It is the entropic program with another distance. At the prior, every S_i is the identity and
    the positive scalars y are 1.
    """

    @cached_property
    def freedom(self) -> Array:
        """(p, q) orthonormal basis of the equalities' null space."""
        return np.asarray(null_space(self.equalities[0]))

    @property
    def limits(self) -> Rows:
        """Bounds and constraints G z ≥ h, except those that the distance implies."""
        (G, h), k = self.inequalities, len(self.scalars.columns)
        return G[k:], h[k:]

    def start(self, x: Array) -> Array:
        """Return the coordinates (p,) of parameters x (p,), projected onto the equalities."""
        z, (E, e) = self.coordinates.at(x), self.equalities
        return np.asarray(z + np.linalg.lstsq(E, e - E @ z, rcond=None)[0])

    def drawn_in(self, z: Array, inner: Array) -> Array:
        """Return z (p,), moved towards a feasible `inner` point until it is feasible."""
        (G, h), (E, e) = self.limits, self.equalities
        for share in 0.8 ** np.arange(_MOST_DRAWS):
            point = inner + share * (z - inner)
            feasible = np.allclose(E @ point, e, rtol=0.0, atol=1e-9) and (G @ point >= h).all()
            if feasible and np.isfinite(self.cost(point)):
                return point
        return inner

    def cost(self, z: Array) -> float:
        """Return the cost at z (p,) without `floor`; infinite if a body is not physical."""
        (F, f), y = self.rows, self.scalars.ratios(z)
        bodies = self.gamma @ half_squared_logs(self.matrices(z))
        scalars = self.targets[: len(y)] @ half_squared_logs(y[:, None, None])
        return float(0.5 * np.square(F @ z - f).sum() + bodies + scalars)

    def derivatives(self, z: Array, *, convex: bool = False) -> tuple[Array, Array]:
        """Return the gradient (p,) and the Hessian (p, p), optionally convexified, at z."""
        (F, f), blocks = self.rows, self.blocks
        gradient, hessian = F.T @ (F @ z - f), F.T @ F
        slopes, curvatures = log_derivatives(self.matrices(z), convex=convex)
        gradient[blocks] += self.gamma[:, None] * slopes
        hessian[blocks[:, :, None], blocks[:, None, :]] += self.gamma[:, None, None] * curvatures
        columns, y = self.scalars.columns, self.scalars.ratios(z)
        weights, rates = self.targets[: len(y)], self.scalars.slope / y
        bend = 1.0 - np.log(y)
        bend = np.maximum(np.abs(bend), _LEAST_CURVATURE) if convex else bend
        gradient[columns] += weights * rates * np.log(y)
        hessian[columns, columns] += weights * rates**2 * bend
        return gradient, hessian

    def minimum(self, z: Array) -> LocalMinimum:
        """Return the local minimum reached from a feasible z (p,)."""
        size = max(min(self.cost(z), self.cost(0.0 * z)), float(self.gamma.max()))
        previous = np.inf
        for _ in range(_MOST_STEPS):
            gradient, step, strict = self._direction(z)
            value = self.cost(z)
            promise, rounding = -float(gradient @ step), PRECISION * max(abs(value), size)
            ends = promise <= _ACCURACY * size or is_within_rounding(promise, previous, rounding)

            def decrease(share: Array, z: Array = z, step: Array = step) -> float:
                return self.cost(z) - self.cost(z + share * step)

            length = float(step_length(decrease, promise, rounding))
            previous, z = promise, z + length * step
            if ends:
                return LocalMinimum(z, self.cost(z), self.derivatives(z)[1], strict)
            if length == 0.0:
                break
        raise IdentificationError(
            "No step lowers the cost of the Riemannian fit.",
            advice="Check units and noise levels, raise gamma, or start from another point.",
        )

    def _direction(self, z: Array) -> tuple[Array, Array, bool]:
        """Return the gradient (p,), a descent step (p,), and whether the cost is convex."""
        gradient, hessian = self.derivatives(z)
        if (step := self._step(z, gradient, hessian)) is not None:
            return gradient, step, True
        hessian = self.derivatives(z, convex=True)[1]
        for ridge in _RIDGES:  # against rounding
            ridged = hessian + ridge * np.diag(np.diagonal(hessian))
            if (step := self._step(z, gradient, ridged)) is not None:
                return gradient, step, False
        raise IdentificationError(
            "Data and prior do not identify all parameters, so Newton's step is undefined.",
            advice="Add data or a prior for them, or remove their columns.",
        )

    def _step(self, z: Array, gradient: Array, hessian: Array) -> Array | None:
        """Return the step to the constrained minimum of a quadratic model, or None if not convex.

        The active constraints are those of Lawson and Hanson's least-distance problem (*Solving
        Least Squares Problems*, 1974, ch. 23).
        """
        N, (G, h) = self.freedom, self.limits
        try:
            root = np.linalg.cholesky(N.T @ hessian @ N)
        except np.linalg.LinAlgError:
            return None
        y, rows = -np.linalg.solve(root, N.T @ gradient), np.linalg.solve(root, (G @ N).T)
        missing = h - G @ z - rows.T @ y
        if missing.max(initial=0.0) > 0.0:
            norms = np.linalg.norm(rows, axis=0)
            norms = np.where(norms > 0, norms, 1.0)
            distance = missing / norms
            scaled = np.vstack([rows / norms, distance / distance.max()])
            try:
                active = nnls(scaled, np.eye(len(scaled))[-1])[0] > 0
            except RuntimeError:  # not converged
                return None
            normals = rows[:, active]
            y += normals @ np.linalg.lstsq(normals.T @ normals, missing[active])[0]
        return np.asarray(N @ np.linalg.solve(root.T, y))

    def second_order(self, x: Array) -> tuple[FitProblem, float]:
        """Return the problem with the second order of the cost at x (p,), and the cost's size.

        Raise an ArgumentError if it is not convex.
        """
        z = self.coordinates.at(x)
        gradient, hessian = self.derivatives(z)
        target = z - np.linalg.lstsq(hessian, gradient, rcond=None)[0]
        local = replace(
            self.coordinates.problem,
            factor=np.zeros((1, len(z) + 1)),
            prior_mean=self.coordinates.parameters(target),
            prior_information=self.information(hessian),
            entropic={},
            entropic_scalars={},
            residual_bound=None,
        )
        # As in a FitProgram, γ sets the scale if the prior fits perfectly.
        return local, max(self.cost(z) + self.floor, float(self.gamma.max()))

    def information(self, hessian: Array) -> Array:
        """Return the information (p, p) about the parameters from a Hessian (p, p) in z."""
        inverse = np.linalg.inv(self.coordinates.transform)
        information = 0.5 * inverse.T @ hessian @ inverse
        return 0.5 * (information + information.T)

    def compared(self, found: Mapping[str, LocalMinimum | None], best: LocalMinimum) -> LocalMinima:
        """Compare the minima of several starts, None if failed, with the best."""
        root = np.linalg.inv(np.linalg.cholesky(self.matrices(best.z)))
        best_ratios = self.scalars.ratios(best.z)
        costs, distances = np.full(len(found), np.inf), np.full(len(found), np.inf)
        for k, minimum in enumerate(found.values()):
            if minimum is not None:
                ratio = root @ self.matrices(minimum.z) @ np.swapaxes(root, -1, -2)
                scalars = self.scalars.ratios(minimum.z) / best_ratios
                ratios = np.append(np.linalg.eigvalsh(ratio).ravel(), scalars)
                costs[k] = minimum.value
                distances[k] = np.linalg.norm(np.log(ratios))
        return LocalMinima(tuple(found), costs, distances, best.strict)


def half_squared_logs(S: Array) -> Array:
    """Return ½ Σ_k log² λ_k(S) of matrices S (..., n, n); infinite if one is not positive definite.

    It is convex along geodesics, but not along straight lines, as it flattens beyond eigenvalues of
    e.
    """
    eigenvalues = np.asarray(np.linalg.eigvalsh(S), float)
    positive = eigenvalues > 0
    logs = np.log(np.where(positive, eigenvalues, 1.0))
    return np.where(positive.all(-1), 0.5 * (logs * logs).sum(-1), np.inf)


def log_derivatives(S: Array, *, convex: bool = False) -> tuple[Array, Array]:
    """Return gradients (..., 10) and Hessians (..., 10, 10) of `half_squared_logs` at S ≻ 0.

    The gradient of this spectral function is V diag(h) Vᵀ with h(λ) = log λ / λ, and its Hessian
    has the divided differences of h as coefficients in the eigenvectors V. If `convex`, these are
    replaced by their absolute values, bounded below.
    """
    eigenvalues, V = np.linalg.eigh(S)
    logs = np.log(eigenvalues)
    gradient = svec((V * (logs / eigenvalues)[..., None, :]) @ np.swapaxes(V, -1, -2))
    ratio = logs[..., :, None] - logs[..., None, :]
    coefficients = 1.0 / exprel(ratio) - logs[..., None, :]
    if convex:
        coefficients = np.maximum(np.abs(coefficients), _LEAST_CURVATURE)
    coefficients = coefficients / (eigenvalues[..., :, None] * eigenvalues[..., None, :])
    V = V[..., None, :, :]
    turned = np.swapaxes(V, -1, -2) @ SYMMETRIC_BASIS @ V
    hessian = np.einsum("...kij,...ij,...lij->...kl", turned, coefficients, turned, optimize=True)
    return np.asarray(gradient, float), np.asarray(hessian, float)
