"""Regularizers compared fairly: all of them with the same residual ([Lee2019] §3.5.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instances, positive, typed
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError, GeodrakeError, IdentificationError
from geodrake.identification.identify import (
    REGULARIZERS,
    IdentificationResult,
    identify,
    regularizer_of,
)
from geodrake.identification.regularizer import Regularizer

EQUAL = 1e-5
"""Largest relative difference of two residuals that count as equal."""

_EXACT = 1e-20
"""Share of the squared data below which a residual is rounding."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RegularizerComparison(Short):
    """Results by regularizer, in the requested order, with residuals equal to 1e-5.

    The `gamma` given is that of the `reference`. Regularizers without a solution of that residual
    are among the `failures` instead, with the reason.
    """

    results: Mapping[str, IdentificationResult]
    reference: str
    gamma: float
    residual: float
    failures: Mapping[str, str] = field(default_factory=dict)


@typed
def compare_regularizers(
    A: ArrayLike,
    b: ArrayLike,
    prior: ArrayLike,
    *,
    gamma: float,
    reference: str | Regularizer = "entropic",
    regularizers: Sequence[str | Regularizer] = tuple(REGULARIZERS),
    extra_priors: Mapping[str, ArrayLike | None] | None = None,
    **options: Any,
) -> RegularizerComparison:
    """Solve with one regularizer and its γ, and with the others for the same residual.

    The same γ would not be fair, as distances differ in size. Solutions of the same residual fit
    the training data equally well, and differ in what they take from the prior (Proposition A.5).
    The Riemannian one is not convex: its γ is one for which a local minimum has that residual.

    A, b, prior and further options are those of `identify`, the same for all; `regularizers` are
    names, or regularizers such as `PointMassKL(points)`. γ > 0 is that of the `reference`, whose
    name means the one of `regularizers` that has it, if there is one. `extra_priors` maps names to
    an `extra_prior` of their own, as weights of a Euclidean distance have a unit.

    Raises:
        IdentificationError: The reference has no solution, or fits the data to rounding.
    """
    positive(gamma, "gamma")
    given = [regularizer_of(each) for each in instances(regularizers, "regularizers", object)]
    kinds = {kind.name: kind for kind in given}
    if len(kinds) < len(given):
        names = ", ".join(kind.name for kind in given)
        raise ArgumentError(f"Each regularizer can be compared once; got {names}.")
    first_kind = kinds.get(str(reference)) or regularizer_of(reference)
    compared, extra_priors = {**kinds, first_kind.name: first_kind}, extra_priors or {}
    if unknown := sorted(set(extra_priors) - set(compared)):
        raise ArgumentError(
            f"extra_priors has {', '.join(unknown)}; compared are {', '.join(compared)}."
        )

    def solve(kind: Regularizer, **form: Any) -> IdentificationResult:
        own = {**options}
        if kind.name in extra_priors:
            own["extra_prior"] = extra_priors[kind.name]
        return identify(A, b, prior, regularizer=kind, **form, **own)

    first = solve(first_kind, gamma=gamma)
    residual = first.residual
    if residual <= _EXACT * float(np.square(np.asarray(b, float)).sum()):
        raise IdentificationError(
            f"The data are fitted exactly: the residual of {first_kind.name} is "
            f"{residual:.3g}, at which no other can be compared.",
            advice="Raise gamma, or use measured data.",
        )
    results, failures = dict[str, IdentificationResult](), dict[str, str]()
    for name, kind in kinds.items():
        if name == first_kind.name:
            results[name] = first
            continue
        try:
            result = solve(kind, residual_bound=residual)
            if abs(result.residual - residual) > EQUAL * residual:
                raise IdentificationError(
                    f"Its residual is {result.residual:.6g} instead of {residual:.6g}: its "
                    "parameters closest to the prior already fit better.",
                    advice="Lower gamma: with such a strong prior there is nothing to compare.",
                )
            results[name] = result
        except GeodrakeError as error:
            if isinstance(error, ArgumentError) and "minimum" not in error.evidence:
                raise  # no other data would do with these arguments
            failures[name] = str(error)
    return RegularizerComparison(
        results=results,
        reference=first_kind.name,
        gamma=gamma,
        residual=residual,
        failures=failures,
    )
