"""A solver of our own for convex fits: some ten Newton steps on the triangular factor."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, positive
from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.fit import FitResult, check_residual_bound, fit_result
from geodrake.identification.newton_path import Minimum
from geodrake.identification.newton_program import NewtonProgram
from geodrake.identification.newton_root import bounded_minimum, first_minimum, next_minimum
from geodrake.identification.problem import FitProblem, checked
from geodrake.inertia import is_physical

_LEAST_EIGENVALUES = (1e-13, 1e-11, 1e-9)
"""Eigenvalues of P(φ⁰)⁻¹ P(φ) that rounding leaves positive, to be tried in turn."""


def solve_newton(
    problem: FitProblem, *, start: ArrayLike | None = None, weight: float | None = None
) -> FitResult:
    """Fit parameters whose every inertia block has an entropic or a quadratic prior.

    An entropic divergence keeps P(φ) ≻ 0 by itself, so `margin` plays no part there. A block with a
    quadratic prior gets a logarithmic barrier of 1e-10 of its prior's curvature, or more where
    rounding needs it. In the point-to-set form the weight of the prior is the root of
    residual(γ) = residual_bound; all trials after the first start from the one before.

    Args:
        problem: What to fit.
        start: (p,) parameters close to the solution, to save some steps; the prior if None.
        weight: A weight of the prior close to the solution's, in the point-to-set form.

    Returns:
        The unique minimum, with the information of data and prior together. Its cost is exact to
        1e-7 of itself or to 1e-12 γ, if that is more: bodies to about 1e-6 in geometric distance.

    Raises:
        ArgumentError: A block has no prior, or the residual bound is below what physical
            bodies inside all constraints reach; its evidence has that `minimum`.
        IdentificationError: The constraints contradict each other.
    """
    begin = time.perf_counter()
    check_residual_bound(instance(problem, "problem", FitProblem))
    if weight is not None:
        positive(weight, "weight")
    program = NewtonProgram.of(problem)
    if start is not None:
        start = checked("start", start, (problem.size,))
    if problem.residual_bound is not None:
        minimum, found = bounded_minimum(program, problem.residual_bound, start, weight)
    else:
        minimum, found = first_minimum(program, 1.0, start), 1.0
    return _result(minimum, found, time.perf_counter() - begin)


def newton_sweep(problem: FitProblem, weights: ArrayLike) -> tuple[FitResult, ...]:
    """Fits with several weights of the whole prior, each started from the one before.

    Args:
        problem: What to fit, without a residual bound.
        weights: (k,) positive factors of the prior information and of every γ, best in order.

    Returns:
        One result for each weight, which is its `prior_weight`.

    Raises:
        ArgumentError: A weight is not positive, there is a residual bound, or a block has no
            prior.
        IdentificationError: The constraints contradict each other.
    """
    instance(problem, "problem", FitProblem)
    weights = checked("weights", weights, (None,))
    if np.any(weights <= 0):
        raise ArgumentError(f"weights must be positive; the smallest is {weights.min():g}.")
    if problem.residual_bound is not None:
        raise ArgumentError(
            "A sweep over weights cannot keep a residual bound too.",
            advice="Solve each bound with `solve_newton`.",
        )
    begin = time.perf_counter()
    program = NewtonProgram.of(problem)
    results: list[FitResult] = []
    minimum: Minimum | None = None
    for weight in weights.tolist():
        minimum = (
            first_minimum(program, weight, None)
            if minimum is None
            else next_minimum(minimum, weight)
        )
        now = time.perf_counter()
        results.append(_result(minimum, weight, now - begin))
        begin = now
    return tuple(results)


def _result(minimum: Minimum, weight: float, elapsed: float) -> FitResult:
    """The result of a minimum; rounding alone can leave a tiny γ's bodies at the boundary."""
    coordinates = minimum.weighted.program.coordinates
    problem = coordinates.problem
    for least in (0.0, *_LEAST_EIGENVALUES):
        z = minimum.weighted.program.lifted(minimum.point.z, least)
        x = np.clip(coordinates.parameters(z), problem.lower, problem.upper)
        blocks = [x[start : start + 10] for start in problem.inertia_blocks]
        if np.all(coordinates.smallest_eigenvalues(x) > 0) and np.all(is_physical(blocks)):
            return fit_result(coordinates, x, weight, "newton", elapsed)
    raise IdentificationError(
        "Newton's parameters are not physical after rounding: a body of the prior is too flat for "
        "double precision.",
        advice="Check the units of the prior, or raise gamma.",
        solver="newton",
    )
