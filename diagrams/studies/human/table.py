"""What is told of the human's fits: their bodies, and their errors in N and cm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagrams.studies.human.plate import NAMES, Array, Human
from geodrake.identification import RegularizerComparison
from geodrake.inertia import pseudo_inertia
from geodrake.inertia.positive_definite import distance, relative_logarithms

BOUNDARY = 1e-3
"""Smallest eigenvalue of P(φ⁰)⁻¹P(φ) below which a body is flat or a point, for all purposes."""


@dataclass(frozen=True)
class Row:
    """One regularizer at one α, from all measurements.

    Attributes:
        alpha: α of the Euclidean regularizer.
        regularizer: Name.
        gamma: Its own γ.
        residual: ‖A Φ − b‖²_{Σ⁻¹}.
        mismatch: Relative difference of the residual from the Euclidean one.
        distance: Geodesic distance of all bodies from the prior.
        least: Smallest eigenvalue of P(φ⁰)⁻¹P(φ) of all bodies.
        degenerate: Bodies where that is below 1e-3.
        starts_agree: Whether all starts led to the same minimum; None for convex regularizers.
        masses: Mass of every body, kg.
    """

    alpha: float
    regularizer: str
    gamma: float
    residual: float
    mismatch: float
    distance: float
    least: float
    degenerate: Sequence[str]
    starts_agree: bool | None
    masses: Sequence[float]


@dataclass(frozen=True)
class Errors:
    """RMS errors of the prior or a regularizer, a row of [Lee2019] table 3.1.

    Attributes:
        regularizer: Name, or "prior".
        train: Of the vertical force, N, and the zero-moment point's x and y, cm, from a fit to all
            measurements.
        test: The same, of blocks that the fit to all others predicts.
    """

    regularizer: str
    train: Sequence[float]
    test: Sequence[float]


def rows_of(human: Human, alpha: float, found: RegularizerComparison) -> list[Row]:
    """The rows of one α."""
    rows, prior = [], pseudo_inertia(human.prior)
    for name, result in found.results.items():
        bodies = pseudo_inertia(result.phi)
        least = np.exp(relative_logarithms(prior, bodies))
        rows.append(
            Row(
                alpha=alpha,
                regularizer=name,
                gamma=result.gamma,
                residual=result.residual,
                mismatch=result.residual / found.residual - 1.0,
                distance=float(np.linalg.norm(distance(prior, bodies))),
                least=float(least.min()),
                degenerate=[NAMES[i] for i in np.flatnonzero(least.min(1) < BOUNDARY)],
                starts_agree=result.minima.agree if result.minima else None,
                masses=result.phi[:, 0].tolist(),
            )
        )
    return rows


def errors_of(
    human: Human, found: RegularizerComparison, tested: Mapping[str, Sequence[Array]]
) -> list[Errors]:
    """The rows of table 3.1.

    Args:
        human: The measurements.
        found: Fits to all of them.
        tested: Regularizer -> errors (t, 3) of every block, from fits to the others.
    """
    bodies = {"prior": human.prior, **{name: fit.phi for name, fit in found.results.items()}}
    parts = {"prior": [human.errors(human.prior)], **tested}
    return [
        Errors(name, _rms(human.errors(phi)), _rms(np.concatenate(parts[name])))
        for name, phi in bodies.items()
    ]


def _rms(errors: Array) -> list[float]:
    return [float(value) for value in np.sqrt(np.square(errors).mean(0))]
