"""Local minima of a fit with the Riemannian distance, within bounds and linear constraints."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.optimize import brentq

from geodrake.errors import IdentificationError
from geodrake.identification.coordinates import SYMMETRIC_BASIS, Coordinates
from geodrake.identification.fit import FitResult, fit_result
from geodrake.identification.interior_point import LocalMinimum, Region, minimize
from geodrake.identification.local_minima import LocalMinima, RiemannianFit
from geodrake.identification.log_distance import LogCost
from geodrake.identification.problem import FitProblem, LinearConstraints
from geodrake.inertia import Array
from geodrake.robot.reduction import triangular_factor

_MARGINS = (1e-4, 1e-6, 1e-8)
"""Shares of a constraint's scale by which a start is kept inside it; the first feasible one."""

_WARM = 1e-6
_MEETS = 1e-9
"""Relative difference of the residual from its bound."""

_NEARLY_MEETS = 1e-6
"""The same, that will do where rounding leaves no closer one."""

_NARROW = 1e-12
_MOST_TRIALS = 60
_FARTHEST = 1.5
"""Standard deviation of the logarithms of mass and moments in random starts, at most."""


@dataclass(frozen=True, eq=False)
class RiemannianSearch:
    """A search for minima of ‖R x − r‖² + w (γ d(Φ, Φ⁰)² + prior information), scalars included.

    Attributes:
        problem: What is to be fitted; its references are the prior Φ⁰.
        coordinates: Its coordinates z.
        region: Bounds and constraints on z.
        equality: (k, p) rows of the constraints that are equalities, with their values (k,).
        cost: The cost at w = 1.
    """

    problem: FitProblem
    coordinates: Coordinates
    region: Region
    equality: tuple[Array, Array]
    cost: LogCost

    @classmethod
    def of(cls, problem: FitProblem, prior: Array, gamma: float) -> RiemannianSearch:
        """The search for a problem with a physical prior (nb, 10).

        Args:
            problem: The data, bounds and constraints.
            prior: (nb, 10) physical prior Φ⁰.
            gamma: Weight γ of d².
        """
        references = dict(zip(problem.inertia_blocks, prior, strict=True))
        problem = replace(problem, reference=references)
        coordinates = Coordinates.of(problem)
        M, d = coordinates.data()
        triangle = triangular_factor([np.column_stack([M, d])])[: problem.size]
        root = coordinates.prior_root()
        cost = LogCost(
            triangle=triangle,
            prior=root.T @ root,
            starts=coordinates.starts,
            blocks=np.array(problem.inertia_blocks, int),
            scalars=coordinates.scalars(problem.scalar_priors),
            gamma=gamma,
            data=1.0,
            weight=1.0,
            size=gamma,
        )
        # The distance keeps scalars with a prior positive; a barrier there would push them away.
        positive = list(problem.scalar_priors)
        lower = problem.lower.copy()
        lower[positive] = np.where(lower[positive] > 0, lower[positive], -np.inf)
        inequalities, equalities = replace(
            coordinates, problem=replace(problem, lower=lower)
        ).rows()
        region = Region.of(equalities[0], *inequalities)
        return cls(problem, coordinates, region, equalities, cost)

    def inside(self, solve: Callable[[FitProblem], FitResult]) -> FitResult:
        """A convex fit strictly inside bounds and constraints, to start from.

        Raises:
            IdentificationError: There are no parameters inside them.
        """
        for margin in _MARGINS[:-1]:
            try:
                return solve(self._tightened(margin))
            except IdentificationError:
                continue
        return solve(self._tightened(_MARGINS[-1]))

    def start(self, x: Array) -> Array:
        """Coordinates (p,) of parameters x (p,), put onto the equality constraints."""
        z = self.coordinates.at(x)
        E, e = self.equality
        return z + np.linalg.lstsq(E, e - E @ z, rcond=None)[0] if len(E) else z

    def is_inside(self, z: Array) -> bool:
        """Whether coordinates z (p,) keep all constraints, the inequalities strictly."""
        E, e = self.equality
        on = np.allclose(E @ z, e, rtol=0.0, atol=1e-9)
        return (
            on
            and bool((self.region.slacks(z) > 0.0).all())
            and bool(np.isfinite(self.cost.value(z)))
        )

    def random_start(self, z: Array, random: np.random.Generator) -> Array:
        """A point inside all constraints, as far as they allow on a random geodesic from z (p,).

        Args:
            z: (p,) coordinates of a point inside all constraints.
            random: Source of randomness.
        """
        L = np.linalg.cholesky(self.cost.matrices(z))
        directions = random.normal(size=(len(L), len(SYMMETRIC_BASIS)))
        rates, axes = np.linalg.eigh(np.einsum("bk,kij->bij", directions, SYMMETRIC_BASIS))
        root = L @ axes * np.exp(0.5 * random.uniform(0.0, _FARTHEST) * rates)[:, None, :]
        change = root @ np.swapaxes(root, 1, 2) - self.cost.matrices(np.zeros_like(z))
        start = z.copy()
        start[self.cost.inside] = np.einsum("bij,kij->bk", change, SYMMETRIC_BASIS)
        start = self.start(self.coordinates.parameters(start))
        while not self.is_inside(start):
            start = 0.8 * start + 0.2 * z
        return start

    def minimum(self, z: Array, weight: float, *, warm: bool = False) -> LocalMinimum:
        """The minimum that z leads to with a weight w; inf leaves the data out.

        Args:
            z: (p,) coordinates inside all constraints.
            weight: w of the regularizer; inf leaves the data out.
            warm: Whether z is close to the minimum, so that the barrier may start low.
        """
        data, weight = (0.0, 1.0) if np.isinf(weight) else (1.0, weight)
        cost = replace(self.cost, data=data, weight=weight)
        cost = replace(cost, size=max(min(cost.value(z), cost.value(0.0 * z)), weight * cost.gamma))
        return minimize(cost, self.region, z, barrier=_WARM if warm else 1e-2)

    def second_order(self, x: Array, weight: float) -> tuple[FitProblem, float]:
        """The problem whose cost is the second order of this one's at x, and the size of the cost.

        Args:
            x: (p,) parameters.
            weight: w of the regularizer; inf leaves the data out.
        """
        data, weight = (0.0, 1.0) if np.isinf(weight) else (1.0, weight)
        cost, z = replace(self.cost, data=data, weight=weight), self.coordinates.at(x)
        gradient, hessian = cost.derivatives(z)
        inverse = np.linalg.inv(self.coordinates.transform)
        target = z - np.linalg.lstsq(hessian, gradient, rcond=None)[0]
        problem = replace(
            self.problem,
            factor=np.zeros((1, len(z) + 1)),
            prior_mean=self.coordinates.parameters(target),
            prior_information=0.5 * inverse.T @ hessian @ inverse,
            residual_bound=None,
        )
        # (Like that of a FitProgram: where the prior fits, γ is what there is to compare with.)
        return problem, max(cost.value(z) + data * self._floor, weight * cost.gamma)

    def meet_bound(self, z: Array, weight: float) -> tuple[LocalMinimum, float]:
        """A minimum, and in the point-to-set form the weight w for which it meets the bound.

        Args:
            z: (p,) where to start from.
            weight: First guess of w; inf where the data are idle.

        Raises:
            IdentificationError: No minimum meets the bound: the residual jumps across it.
        """
        bound = self.problem.residual_bound
        if bound is None:
            return self.minimum(z, 1.0), 1.0
        if np.isinf(weight):
            nearest = self.minimum(z, np.inf)
            if self.problem.residual(self.coordinates.parameters(nearest.z)) <= bound:
                return nearest, np.inf
            weight = 1.0
        return self._root(z, weight, bound)

    def _root(self, z: Array, weight: float, bound: float) -> tuple[LocalMinimum, float]:
        """Brent's method on the logarithms of w and of the residual above its least."""
        excess = bound - self._floor
        enough = _MEETS * min(bound, 1e3 * excess)
        trials: list[tuple[float, LocalMinimum, float]] = []  # how far off, where, and its w

        @cache
        def error(log_weight: float) -> float:
            weight = float(np.exp(log_weight))
            start = trials[-1][1].z if trials else z
            found = self.minimum(start, weight, warm=bool(trials))
            misfit = self.cost.misfit(found.z)
            trials.append((abs(misfit - excess), found, weight))
            if trials[-1][0] <= enough:
                return 0.0
            return float(np.log(max(misfit, np.finfo(float).tiny) / excess))

        ends = _enclosed(error, float(np.log(weight)))
        if ends is not None:
            brentq(error, *ends, xtol=_NARROW, maxiter=_MOST_TRIALS, disp=False)
        miss, found, weight = min(trials, key=lambda trial: trial[0])
        if miss <= max(enough, _NEARLY_MEETS * bound):  # rounding may leave no closer one
            return found, weight
        residual = self._floor + self.cost.misfit(found.z)
        raise IdentificationError(
            f"No local minimum has the residual {bound:.6g}: as gamma changes, it jumps from one "
            f"minimum to another; the nearest found has {residual:.6g}.",
            advice="Take another residual bound, or the entropic regularizer, which is convex.",
            residual=residual,
            gamma=weight * self.cost.gamma,
        )

    @property
    def _floor(self) -> float:
        """Least residual that any parameters reach."""
        x = self.problem.prior_mean
        return self.problem.residual(x) - self.cost.misfit(np.zeros(len(x)))

    def _tightened(self, margin: float) -> FitProblem:
        """The problem with less room between bounds and constraints."""
        problem = self.problem
        scale = np.diagonal(self.coordinates.transform)
        lower, upper = _closer(problem.lower, problem.upper, margin * scale)
        constraints = problem.constraints
        if constraints is not None:
            rows = np.linalg.norm(constraints.matrix @ self.coordinates.transform, axis=1)
            limits = _closer(constraints.lower, constraints.upper, margin * rows)
            constraints = LinearConstraints(
                matrix=constraints.matrix, lower=limits[0], upper=limits[1]
            )
        return replace(problem, lower=lower, upper=upper, constraints=constraints)

    def result(
        self, best: LocalMinimum, weight: float, minima: LocalMinima, elapsed: float
    ) -> RiemannianFit:
        """The result of a minimum.

        Args:
            best: The minimum.
            weight: The w that it belongs to.
            minima: What the other starts led to.
            elapsed: Time of the search, s.
        """
        problem, T = self.problem, self.coordinates.transform
        x = np.clip(self.coordinates.parameters(best.z), problem.lower, problem.upper)
        inverse = np.linalg.inv(T)
        information = 0.5 * inverse.T @ best.hessian @ inverse
        fit = fit_result(self.coordinates, x, weight, "interior point", elapsed)
        own = {**vars(fit), "information": 0.5 * (information + information.T)}
        return RiemannianFit(**own, minima=minima)

    def compared(self, found: Mapping[str, LocalMinimum | None], best: LocalMinimum) -> LocalMinima:
        """What several starts led to, against the best of them.

        Args:
            found: Name of the start -> its minimum, or None where it led to none.
            best: The best of the minima.
        """
        S = self.cost.matrices(best.z)
        root = np.linalg.inv(np.linalg.cholesky(S))
        own = self.cost.scalars.ratios(best.z)
        costs, distances = [], []
        for minimum in found.values():
            if minimum is None:
                costs.append(np.inf)
                distances.append(np.inf)
                continue
            ratio = root @ self.cost.matrices(minimum.z) @ np.swapaxes(root, -1, -2)
            logs = np.log(np.linalg.eigvalsh(ratio))
            costs.append(minimum.value)
            scalars = np.log(self.cost.scalars.ratios(minimum.z) / own)
            distances.append(float(np.sqrt(np.square(logs).sum() + np.square(scalars).sum())))
        return LocalMinima(tuple(found), np.array(costs), np.array(distances), best.strict)


def _closer(lower: Array, upper: Array, margin: Array) -> tuple[Array, Array]:
    """Bounds moved towards each other, by a quarter of their distance at most."""
    width = upper - lower
    margin = np.minimum(margin, 0.25 * width)
    return lower + margin, upper - margin


def _enclosed(error: Callable[[float], float], at: float) -> tuple[float, float] | None:
    """Ends, outwards from a first guess, between which an increasing function has its root."""
    here = error(at)
    for _ in range(_MOST_TRIALS):
        if here == 0.0:
            return at, at
        before, at = at, at - float(np.clip(1.2 * here, -3.0, 3.0) + 1e-3 * np.sign(here))
        sign, here = np.sign(here), error(at)
        if sign * here <= 0.0:
            return min(before, at), max(before, at)
    return None
