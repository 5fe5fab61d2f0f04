"""Residual bounds: the weight of the prior at which a fit has the residual asked for."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TypeVar

import numpy as np
from scipy.optimize import brentq

from geodrake.errors import ArgumentError
from geodrake.identification.problem import FitProblem
from geodrake.inertia import Array

T = TypeVar("T")

_LEAP, _MOST_TRIALS, _NARROW = 6.0, 60, 1e-12


def meet_residual(
    solve: Callable[[float, T | None], tuple[T, float]],
    wanted: float,
    *,
    guess: float,
    limits: tuple[float, float],
    enough: float,
) -> tuple[T, float, float]:
    """Return the solution whose residual is nearest to the wanted one, its weight and its residual.

    The weight is 0 if no weight has so low a residual, and inf if none has so high a one. `solve`
    maps a weight and the last solution, None at first, to a solution and its residual.

    Brent's method on the logarithms: the residual grows with the weight of the prior ([Lee2019]
    Propositions A.4 and A.5).
    """
    trials: list[tuple[float, T, float, float]] = []

    @cache
    def error(log_weight: float) -> float:
        weight = float(np.exp(log_weight))
        found, residual = solve(weight, trials[-1][1] if trials else None)
        trials.append((abs(residual - wanted), found, weight, residual))
        if trials[-1][0] <= enough:
            return 0.0
        return float(np.log(max(residual, np.finfo(float).tiny) / wanted))

    low, high = np.log(limits)
    u = float(np.clip(np.log(guess), low, high))
    here, step = error(u), 0.0
    enclosed = here == 0.0
    for _ in range(_MOST_TRIALS):
        step = min(max(2.0 * abs(here), 2.0 * step), _LEAP)
        before, last, u = u, here, float(np.clip(u - step * np.sign(here), low, high))
        if enclosed or u == before:
            break
        here = error(u)
        enclosed = last * here <= 0.0
        if enclosed:
            ends = min(before, u), max(before, u)
            brentq(error, *ends, xtol=_NARROW, maxiter=_MOST_TRIALS, disp=False)
    _, found, weight, residual = min(trials, key=lambda trial: trial[0])
    if not enclosed:
        weight = 0.0 if residual > wanted else np.inf
    return found, weight, residual


def check_residual_bound(problem: FitProblem) -> None:
    """Raise if the residual bound is below the least squares minimum, which nothing lowers."""
    bound = problem.residual_bound
    if bound is None:
        return
    minimum = least_residual(problem.factor[:, :-1], problem.factor[:, -1])
    if not bound > minimum:
        raise out_of_reach(bound, minimum, "any parameters")


def least_residual(A: Array, b: Array) -> float:
    """Return the least ‖A x − b‖² that any parameters x reach, physical or not."""
    norms = np.linalg.norm(A, axis=0)
    scaled = A / np.where(norms > 0, norms, 1.0)
    return float(np.square(scaled @ np.linalg.lstsq(scaled, b)[0] - b).sum())


def out_of_reach(
    bound: float, minimum: float, who: str = "physical bodies inside all constraints"
) -> ArgumentError:
    """Return what is wrong with a residual bound below the minimum that some can reach."""
    return ArgumentError(
        f"residual_bound is {bound:.10g}, but the least squared residual that {who} reach is "
        f"{minimum:.10g}.",
        advice="Take a bound above that.",
        minimum=minimum,
    )
