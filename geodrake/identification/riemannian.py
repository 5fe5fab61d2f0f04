"""The Riemannian distance: the geometric distance itself, and not convex."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from geodrake.boundary.arguments import instances, integer
from geodrake.errors import ArgumentError, GeodrakeError
from geodrake.identification.conic_fit import certified, uncertified
from geodrake.identification.fit import FitResult, fit_result
from geodrake.identification.problem import FitProblem
from geodrake.identification.regularizer import Entropic, Pullback, Regularizer
from geodrake.identification.riemannian_search import (
    ACCURACY,
    LocalMinima,
    LocalMinimum,
    RiemannianProgram,
)
from geodrake.inertia import Array, pseudo_inertia
from geodrake.inertia.positive_definite import relative_logarithms

STARTS = ("entropic", "pullback", "prior", "data")

_SAME_COST = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class RiemannianFit(FitResult):
    """A `FitResult` of a problem that may have several minima, and what the starts led to."""

    minima: LocalMinima


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

    Attributes:
        starts: Where to start from, the entropic solution first: some of "entropic", "pullback",
            "prior" and "data", the entropic solution of a thousandth of the weight γ.
        random_starts: Number of further starts, on random geodesics from the entropic solution.
        seed: Seed of the random starts.
    """

    starts: tuple[str, ...] = STARTS
    random_starts: int = 0
    seed: int = 0

    name: ClassVar[str] = "riemannian"

    def __post_init__(self) -> None:
        object.__setattr__(self, "starts", instances(self.starts, "starts", str))
        integer(self.random_starts, "random_starts", lower=0)
        integer(self.seed, "seed", lower=0)
        unknown = [start for start in self.starts if start not in STARTS]
        if unknown or self.starts[:1] != ("entropic",):
            raise ArgumentError(
                f"starts must begin with 'entropic' and come from {', '.join(STARTS)}; "
                f"got {self.starts}."
            )

    def divergence(self, phi: Array, prior: Array) -> float:
        """Return d(Φ, Φ⁰)² of all bodies together."""
        logs = relative_logarithms(pseudo_inertia(prior), pseudo_inertia(phi))
        return 0.5 * float(np.square(logs).sum())

    def scalar_divergence(self, values: Array, priors: Array) -> Array:
        """Return ½ log²(x/x⁰) of positive scalars ([Lee2019] Eq. (3.6.60))."""
        return np.asarray(0.5 * np.log(values / priors) ** 2)

    def regularize(self, problem: FitProblem, prior: Array, gamma: float) -> FitProblem:
        """Return the entropic problem, a convex neighbour that agrees with this to second order."""
        return Entropic().regularize(problem, prior, gamma)

    def solve(
        self, problem: FitProblem, prior: Array, gamma: float, solver: str | None
    ) -> FitResult:
        """Return the best local minimum of all starts; the solver finds the first start."""
        begin, random = time.perf_counter(), np.random.default_rng(self.seed)
        program = RiemannianProgram.of(self.regularize(problem, prior, gamma))
        convex = Entropic().solve(problem, prior, gamma, solver)
        first = program.start(convex.x)
        best, weight = program.meet_bound(first, convex.prior_weight)
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
            if name == "prior":  # it may break a constraint that the first start keeps
                begin = program.start(free.prior_mean)
                ways = ((1.0 - share) * begin + share * first for share in (0.0, 1e-3, 0.1, 0.5))
                return next((z for z in ways if program.is_inside(z)), first)
            return program.random_start(first, random)

        idle = {"pullback", "data"} if np.isinf(weight) else {}
        others = [name for name in self.starts[1:] if name not in idle]
        for name in (*others, *(f"random {k}" for k in range(self.random_starts))):
            try:
                found[name] = weighted.minimum(start(name))
            except GeodrakeError:  # the minima that were found stand
                found[name] = None
        lowest = min(filter(None, found.values()), key=lambda minimum: minimum.value)
        rounding = ACCURACY * gamma * weighted.weight
        better = lowest.value < best.value - max(_SAME_COST * abs(best.value), rounding)
        minima = program.compared(found, lowest if better else best)
        if better:
            best, weight = program.meet_bound(lowest.z, weight)
        x = np.clip(program.coordinates.parameters(best.z), problem.lower, problem.upper)
        fit = fit_result(program.coordinates.problem, x, weight, "newton", begin)
        own = {**vars(fit), "information": program.information(best.hessian)}
        return RiemannianFit(**own, minima=minima)

    def certified(
        self, problem: FitProblem, prior: Array, gamma: float, fit: FitResult
    ) -> FitResult:
        """Return the solution with a certificate that it is a local minimum.

        The program is that of the cost's second order at the solution, with all constraints, and
        with the weight that meets a residual bound.
        """
        program = RiemannianProgram.of(self.regularize(problem, prior, gamma))
        try:
            local, size = program.weighted(fit.prior_weight).second_order(fit.x)
            return certified(local, fit, size=size, scope="local")
        except ArgumentError:  # the second order is no convex program
            return uncertified(fit, "the cost is not convex around the minimum", scope="local")
