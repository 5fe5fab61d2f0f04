"""The entropic divergence: convex, independent of coordinates, and a barrier."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geodrake.identification.problem import FitProblem
from geodrake.identification.regularizer import Regularizer
from geodrake.inertia import Array, pseudo_inertia
from geodrake.inertia.positive_definite import relative_logarithms


class Entropic(Regularizer):
    """d² = Σ_i −log|P_i| + log|P_i⁰| + tr((P_i⁰)⁻¹ P_i) − 4 ([Lee2019] Eqs. (2.2.14), (3.5.44)).

    Grows without limit at the boundary of physical bodies, so that every result is well inside.
    """

    name = "entropic"

    def divergence(self, phi: Array, prior: Array) -> float:
        """d(Φ ‖ Φ⁰)² of all bodies together."""
        logs = relative_logarithms(pseudo_inertia(prior), pseudo_inertia(phi))
        return float((np.expm1(logs) - logs).sum())

    def scalar_divergence(self, values: Array, priors: Array) -> Array:
        """x/x⁰ − log(x/x⁰) − 1 of positive scalars ([Lee2019] Eqs. (3.6.60), (5.3.33))."""
        change = values / priors - 1.0
        return np.asarray(change - np.log1p(change))

    def regularize(self, problem: FitProblem, prior: Array, gamma: float) -> FitProblem:
        """The problem with an entropic prior for every body, and every scalar that has a prior."""
        priors = zip(problem.inertia_blocks, prior, strict=True)
        return replace(
            problem,
            entropic={start: (phi, gamma) for start, phi in priors},
            entropic_scalars={k: (x, gamma * w) for k, (x, w) in problem.scalar_priors.items()},
        )
