"""The Riemannian distance: the geometric distance itself, and not convex.

Local minima of such a fit are found within bounds and linear constraints. Every step is to the
minimum of the second order of the cost within the constraints: Newton's method where the cost is
convex, and else with its negative curvatures turned positive.
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
from geodrake.identification.newton import NewtonProgram, bounded
from geodrake.identification.problem import FitProblem
from geodrake.identification.regularizer import Entropic, Pullback, Regularizer, Solver
from geodrake.inertia import Array, riemannian_distance

STARTS = ("entropic", "pullback", "prior", "data")

_ACCURACY = 1e-14
"""Decrease that a step must promise to be worth taking, as a share of the size of the cost."""
_MOST_STEPS, _MOST_DRAWS = 300, 60
_RIDGES = (0.0, 1e-14, 1e-12, 1e-10, 1e-8, 1e-6)
"""Shares of its diagonal to be added in turn to a Hessian that rounding left indefinite."""
_LEAST_CURVATURE = 0.1
"""Of the distance, relative to that at the prior, where its own is not convex."""


@dataclass(frozen=True)
class Riemannian(Regularizer):
    """d² = Σ_i ½ ‖log(P_i⁰⁻½ P_i P_i⁰⁻½)‖² ([Lee2019] Eqs. (3.3.26), (3.5.53)).

    Half the square of the geodesic distance (2.2.10), so that it agrees to second order with the
    pullback metric and the entropic divergence, and one γ means the same for all three. Independent
    of units and frames; grows without limit at the boundary of physical bodies.

    The problem is not convex: a body e times as heavy as its prior costs little more when it gets
    heavier still, so that there can be several minima. The search starts at the entropic solution,
    the global minimum of a convex neighbour, and then at others; `minima` of the result says
    whether they led to the same place. In the point-to-set form, γ is the one for which the
    residual of a local minimum meets its bound.
    """

    # Where to start from, the entropic solution first: some of "entropic", "pullback", "prior" and
    # "data", the entropic solution of a thousandth of the weight γ.
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
        """Return the entropic problem, a convex neighbour that agrees with this to second order."""
        return Entropic().regularize(problem, prior, gamma)

    def solve(
        self, problem: FitProblem, prior: Array, gamma: float, solver: Solver, certify: bool = False
    ) -> FitResult:
        """Return the best local minimum of all starts; the solver finds the first start.

        The certificate is that of a local minimum. Its program is the second order of the cost at
        the solution, with all constraints, and with the weight that meets a residual bound.
        """
        begin = time.perf_counter()
        program = RiemannianProgram.of(self.regularize(problem, prior, gamma))
        convex = Entropic().solve(problem, prior, gamma, solver)
        first = program.start(convex.x)

        def solve(trial: RiemannianProgram, before: LocalMinimum | None) -> LocalMinimum:
            return trial.minimum(first if before is None else before.z)

        best, weight = bounded(program, solve, guess=convex.prior_weight)
        found: dict[str, LocalMinimum | None] = {"entropic": best}
        weighted, free = program.weighted(weight), replace(problem, residual_bound=None)

        def start(name: str) -> Array:
            if name == "pullback":
                # It may be at the boundary of bodies; a share of the first start leads inside.
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
            except GeodrakeError:  # the minima that were found stand
                found[name] = None
        lowest = min(filter(None, found.values()), key=lambda minimum: minimum.value)
        rounding = _ACCURACY * gamma * weighted.weight
        better = lowest.value < best.value - max(SAME_COST * abs(best.value), rounding)
        minima = program.compared(found, lowest if better else best)
        if better:
            first = lowest.z
            best, weight = bounded(program, solve, guess=weight)
        x = np.clip(program.coordinates.parameters(best.z), problem.lower, problem.upper)
        fit = fit_result(program.coordinates.problem, x, weight, "newton", begin)
        fit = replace(fit, information=program.information(best.hessian), minima=minima)
        if not certify:
            return fit
        try:
            local, size = program.weighted(weight).second_order(x)
            return certified(local, fit, size=size, scope="local")
        except ArgumentError:  # the second order is no convex program
            return uncertified(fit, "the cost is not convex around the minimum", scope="local")


@dataclass(frozen=True, eq=False)
class LocalMinimum:
    """A local minimum z (p,), the cost and its Hessian (p, p) there, and whether it is strict."""

    z: Array
    value: float
    hessian: Array
    strict: bool


@dataclass(frozen=True, eq=False)
class RiemannianProgram(NewtonProgram):
    """A fit of ½ ‖F z − f‖² + Σ_i γ_i ½ ‖log S_i‖² + Σ_k γ_k ½ log² y_k.

    It is that of its entropic neighbour, with another distance from the same prior, where every
    S_i is the identity and the positive scalars y are 1.
    """

    @cached_property
    def freedom(self) -> Array:
        """Return (p, q) orthonormal directions along the equalities."""
        return np.asarray(null_space(self.equalities[0]))

    @property
    def limits(self) -> Rows:
        """Bounds and constraints G z ≥ h, but for those that the distance keeps by itself."""
        (G, h), k = self.inequalities, len(self.scalars.columns)
        return G[k:], h[k:]

    def start(self, x: Array) -> Array:
        """Return coordinates (p,) of parameters x (p,), put onto the equality constraints."""
        z, (E, e) = self.coordinates.at(x), self.equalities
        return np.asarray(z + np.linalg.lstsq(E, e - E @ z, rcond=None)[0])

    def drawn_in(self, z: Array, inner: Array) -> Array:
        """Return z (p,), or if it breaks a constraint a point on the way to one that keeps all."""
        (G, h), (E, e) = self.limits, self.equalities
        for share in 0.8 ** np.arange(_MOST_DRAWS):
            near = inner + share * (z - inner)
            kept = np.allclose(E @ near, e, rtol=0.0, atol=1e-9) and (G @ near >= h).all()
            if kept and np.isfinite(self.cost(near)):
                return near
        return inner

    def cost(self, z: Array) -> float:
        """Return the cost at z (p,), less `floor`; infinite where a body is not physical."""
        (F, f), y = self.rows, self.scalars.ratios(z)
        bodies = self.gamma @ half_squared_logs(self.matrices(z))
        scalars = self.targets[: len(y)] @ half_squared_logs(y[:, None, None])
        return float(0.5 * np.square(F @ z - f).sum() + bodies + scalars)

    def derivatives(self, z: Array, *, convex: bool = False) -> tuple[Array, Array]:
        """Return the gradient (p,) and Hessian (p, p) at z, or one of positive curvatures only."""
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
        """Return the minimum that z (p,), inside all constraints, leads to."""
        size = max(min(self.cost(z), self.cost(0.0 * z)), float(self.gamma.max()))
        before = np.inf
        for _ in range(_MOST_STEPS):
            gradient, step, strict = self._direction(z)
            value = self.cost(z)
            promise, rounding = -float(gradient @ step), PRECISION * max(abs(value), size)
            ends = promise <= _ACCURACY * size or is_within_rounding(promise, before, rounding)

            def decrease(share: Array, z: Array = z, step: Array = step) -> float:
                return self.cost(z) - self.cost(z + share * step)

            length = float(step_length(decrease, promise, rounding))
            before, z = promise, z + length * step
            if ends:
                return LocalMinimum(z, self.cost(z), self.derivatives(z)[1], strict)
            if length == 0.0:
                break
        raise IdentificationError(
            "No step lowers the cost of the Riemannian fit.",
            advice="Check units and noise levels, raise gamma, or start from another point.",
        )

    def _direction(self, z: Array) -> tuple[Array, Array, bool]:
        """Return the gradient (p,), a step downhill (p,), and whether the cost is convex there."""
        gradient, hessian = self.derivatives(z)
        if (step := self._step(z, gradient, hessian)) is not None:
            return gradient, step, True
        hessian = self.derivatives(z, convex=True)[1]
        for ridge in _RIDGES:  # it may be convex, but for rounding
            ridged = hessian + ridge * np.diag(np.diagonal(hessian))
            if (step := self._step(z, gradient, ridged)) is not None:
                return gradient, step, False
        raise IdentificationError(
            "Data and prior do not identify all parameters, so Newton's step is undefined.",
            advice="Add data or a prior for them, or remove their columns.",
        )

    def _step(self, z: Array, gradient: Array, hessian: Array) -> Array | None:
        """Return the step to the minimum of a second order within the constraints.

        None if it is not convex. Which constraints are active is a problem of least distance, that
        of Lawson and Hanson's *Solving Least Squares Problems* (1974), ch. 23.
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
            far = missing / norms
            scaled = np.vstack([rows / norms, far / far.max()])
            try:
                active = nnls(scaled, np.eye(len(scaled))[-1])[0] > 0
            except RuntimeError:  # it found none in as many steps as it has
                return None
            held = rows[:, active]
            y += held @ np.linalg.lstsq(held.T @ held, missing[active])[0]
        return np.asarray(N @ np.linalg.solve(root.T, y))

    def second_order(self, x: Array) -> tuple[FitProblem, float]:
        """Return the problem whose cost is the second order of this one's at x (p,), and its size.

        An ArgumentError says that it is not convex.
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
        # (Like that of a FitProgram: where the prior fits, γ is what there is to compare with.)
        return local, max(self.cost(z) + self.floor, float(self.gamma.max()))

    def information(self, hessian: Array) -> Array:
        """Return the information (p, p) about the parameters of a Hessian (p, p) in z."""
        inverse = np.linalg.inv(self.coordinates.transform)
        information = 0.5 * inverse.T @ hessian @ inverse
        return 0.5 * (information + information.T)

    def compared(self, found: Mapping[str, LocalMinimum | None], best: LocalMinimum) -> LocalMinima:
        """Return the results of several starts (name -> minimum or None) against the best."""
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
    its Hessian has the divided differences of h as coefficients in the eigenvectors V. If `convex`,
    negative coefficients are turned positive, and small ones enlarged.
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
