"""Compare regularizers at the same residual ([Lee2019] §3.5.1)."""

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
    """Results by regularizer, in the requested order, with equal residuals to 1e-5.

    `gamma` is that of the `reference`. `failures` are the reasons why other regularizers have no
    solution with that residual.
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
    """Solve with a reference regularizer and its γ, and with others at the same residual.

    Equal γ would be unfair, as distances differ in scale. Solutions with equal residuals fit the
    training data equally well, and differ only in the use of the prior (Proposition A.5). The
    Riemannian distance is not convex: its γ is one for which a local minimum has that residual.

    A, b, prior and further options are those of `identify`. `regularizers` are names, or
    regularizers such as `PointMassKL(points)`. γ > 0 is that of the `reference`, which may be the
    name of one of them. `extra_priors` maps names to a separate `extra_prior`, as weights of a
    Euclidean distance have units.

    Raises:
        IdentificationError: The reference has no solution, or fits the data to rounding.
    """
    positive(gamma, "gamma")
    compared = [regularizer_of(each) for each in instances(regularizers, "regularizers", object)]
    kinds = {kind.name: kind for kind in compared}
    if len(kinds) < len(compared):
        names = ", ".join(kind.name for kind in compared)
        raise ArgumentError(f"Each regularizer can be compared once; got {names}.")
    reference_kind = kinds.get(str(reference)) or regularizer_of(reference)
    names, extra_priors = ", ".join({**kinds, reference_kind.name: None}), extra_priors or {}
    if unknown := sorted(set(extra_priors) - {*kinds, reference_kind.name}):
        raise ArgumentError(f"extra_priors has {', '.join(unknown)}; compared are {names}.")

    def solve(kind: Regularizer, **form: Any) -> IdentificationResult:
        settings = {**options}
        if kind.name in extra_priors:
            settings["extra_prior"] = extra_priors[kind.name]
        return identify(A, b, prior, regularizer=kind, **form, **settings)

    reference_result = solve(reference_kind, gamma=gamma)
    residual = reference_result.residual
    if residual <= _EXACT * float(np.square(np.asarray(b, float)).sum()):
        raise IdentificationError(
            f"The data are fitted exactly: the residual of {reference_kind.name} is "
            f"{residual:.3g}, at which no other can be compared.",
            advice="Raise gamma, or use measured data.",
        )
    results, failures = dict[str, IdentificationResult](), dict[str, str]()
    for name, kind in kinds.items():
        if name == reference_kind.name:
            results[name] = reference_result
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
                raise  # the arguments are invalid for any data
            failures[name] = str(error)
    return RegularizerComparison(
        results=results,
        reference=reference_kind.name,
        gamma=gamma,
        residual=residual,
        failures=failures,
    )
