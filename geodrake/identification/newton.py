"""Solve convex fits by some ten Newton steps on the triangular factor."""

from __future__ import annotations

import time

import numpy as np

from geodrake.boundary.arguments import instance
from geodrake.errors import IdentificationError
from geodrake.identification.fit import FitResult, fit_result
from geodrake.identification.newton_path import Minimum, continued, minimize
from geodrake.identification.newton_program import NewtonProgram
from geodrake.identification.problem import FitProblem
from geodrake.identification.residual_path import check_residual_bound, meet_residual, out_of_reach
from geodrake.inertia import Array, is_physical

_INSIDE = (0.0, 1e-13, 1e-11, 1e-9)
"""Shares of the way to the prior, where every P(φ⁰)⁻¹ P(φ) is the identity, to be tried in turn."""
_SAME_RESIDUAL, _NEARLY = 1e-10, 1e-7
"""Relative differences from the residual bound: that aimed at, and that rounding may leave."""
_RIGID, _IDLE = 1e-12, 1e10
"""Weights, relative to the cost of the prior, at which prior and data no longer matter."""


def solve_newton(problem: FitProblem) -> FitResult:
    """Fit parameters whose every inertia block has an entropic or a quadratic prior.

    An entropic divergence keeps P(φ) ≻ 0 by itself, so `margin` plays no part there. A block with a
    quadratic prior gets a logarithmic barrier of 1e-10 of its prior's curvature, or more where
    rounding needs it. In the point-to-set form the weight of the prior is the root of
    residual(γ) = residual_bound; all trials after the first start from the one before.

    The cost is exact to 1e-7 of itself or to 1e-12 γ, if that is more: bodies to about 1e-6 in
    geometric distance.

    The ArgumentError of a residual bound below what physical bodies inside all constraints reach
    has that `minimum` in its evidence.
    """
    begin = time.perf_counter()
    check_residual_bound(instance(problem, "problem", FitProblem))
    program = NewtonProgram.of(problem)
    if problem.residual_bound is None:
        minimum, weight = minimize(program), 1.0
    else:
        minimum, weight = _bounded(program, problem.residual_bound)
    return fit_result(problem, parameters_at(minimum), weight, "newton", begin)


def parameters_at(minimum: Minimum) -> Array:
    """Return the parameters (p,) of a minimum, physical and within bounds despite rounding."""
    program = minimum.program
    coordinates, problem = program.coordinates, program.coordinates.problem
    for share in _INSIDE:  # rounding alone can leave a tiny γ's bodies at the boundary
        z = (1.0 - share) * minimum.point.z + share * program.middle
        x = np.clip(coordinates.parameters(z), problem.lower, problem.upper)
        blocks = [x[start : start + 10] for start in problem.inertia_blocks]
        if np.all(coordinates.smallest_eigenvalues(x) > 0) and np.all(is_physical(blocks)):
            return x
    raise IdentificationError(
        "Newton's parameters are not physical after rounding: a body of the prior is too flat for "
        "double precision.",
        advice="Check the units of the prior, or raise gamma.",
        solver="newton",
    )


def _bounded(program: NewtonProgram, bound: float) -> tuple[Minimum, float]:
    """Return the minimum whose residual is the bound, and its weight; inf when data are idle."""
    wanted = max(bound - program.floor, np.finfo(float).tiny)
    scale = (program.excess(program.middle) + wanted) / program.strength

    def solve(weight: float, before: Minimum | None) -> tuple[Minimum, float]:
        weighted = program.weighted(weight)
        found = minimize(weighted, None if before is None else continued(before, weighted))
        return found, program.excess(found.point.z)

    minimum, weight, excess = meet_residual(
        solve,
        wanted,
        guess=wanted / program.strength,
        limits=(_RIGID * scale, _IDLE * scale),
        enough=_SAME_RESIDUAL * bound,
    )
    if np.isinf(weight) or abs(excess - wanted) <= _NEARLY * bound:
        return minimum, weight
    if weight == 0.0:
        raise out_of_reach(bound, program.floor + excess)
    raise IdentificationError(
        f"newton found no weight of the prior with the residual {bound:.10g}; the nearest residual "
        f"was {program.floor + excess:.10g}.",
        advice="Check units and noise levels, or use the solver clarabel.",
        solver="newton",
    )
