"""Fits of the leg with several regularizers at the same training residual, [Lee2019] §3.5.1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from diagrams.studies.cheetah.leg import Array, Leg
from geodrake.errors import ArgumentError
from geodrake.identification import (
    IdentificationResult,
    PointMasses,
    PointMassEuclidean,
    Regularizer,
    Riemannian,
    identify,
)
from geodrake.robot.reduction import triangular_factor

REGULARIZERS = ("euclidean", "point_mass_euclidean", "pullback", "entropic", "riemannian")
COLORS = {
    "prior": "#a9b4c0",
    "euclidean": "#e08a3c",
    "point_mass_euclidean": "#c8a415",
    "264 point masses": "#d9c25c",
    "687 point masses": "#a8860b",
    "pullback": "#3f9c6b",
    "entropic": "#1b6ca8",
    "riemannian": "#8064a2",
}
GAMMA = 0.2
"""Weight of the entropic and the Riemannian regularizer, [Lee2019] §3.6.2.1."""
NEAR = 1.001
"""How far above the least residual of point masses their fit stays, if that is what they reach."""


@dataclass(frozen=True, eq=False)
class Condensed:
    """Data of A x ≈ b in as many rows as they have information.

    Attributes:
        A: (r, p) rows.
        b: (r,) measurements.
        rest: Squared residual that no parameters remove.
        count: Number of measurements before.
    """

    A: Array
    b: Array
    rest: float
    count: int

    @classmethod
    def of(cls, A: Array, b: Array) -> Condensed:
        """From (m, p) rows and (m,) measurements."""
        factor = triangular_factor([np.column_stack([A, b])])
        U, size, Vt = np.linalg.svd(factor[:, :-1], full_matrices=False)
        rank = np.count_nonzero(size > 1e-11 * size[0])
        reduced = U[:, :rank].T @ factor[:, -1]
        rest = float(np.square(factor[:, -1] - U[:, :rank] @ reduced).sum())
        return cls(size[:rank, None] * Vt[:rank], reduced, rest, len(b))

    def rms(self, found: IdentificationResult) -> float:
        """RMS training error of what was found."""
        return float(np.sqrt((found.residual + self.rest) / self.count))


def fit(data: Condensed, leg: Leg, kind: str | Regularizer, **more: Any) -> IdentificationResult:
    """The fit with a regularizer and `gamma` or `residual_bound`, bodies in their ellipsoids."""
    ellipsoids = None if isinstance(kind, PointMassEuclidean) else leg.ellipsoids
    return identify(data.A, data.b, leg.prior, regularizer=kind, ellipsoids=ellipsoids, **more)


def fit_points(
    data: Condensed, leg: Leg, points: PointMasses, residual: float, **more: Any
) -> IdentificationResult:
    """Point masses with a residual, or one that is a little higher, if no masses there have it."""
    kind = PointMassEuclidean(points)
    try:
        return fit(data, leg, kind, residual_bound=residual, **more)
    except ArgumentError as error:
        if "minimum" not in error.evidence:
            raise
        bound = NEAR * error.evidence["minimum"]
        return fit(data, leg, kind, residual_bound=bound, **more)


def compare(
    data: Condensed, leg: Leg, points: PointMasses, **more: Any
) -> dict[str, IdentificationResult]:
    """Every regularizer: γ for the entropic and the Riemannian one, its residual for the others.

    Args:
        data: What is fitted.
        leg: The leg.
        points: Point masses of its bodies.
        **more: Further arguments of `identify`, the same for all.
    """
    entropic = fit(data, leg, "entropic", gamma=GAMMA, **more)
    bound = entropic.residual
    return {
        "euclidean": fit(data, leg, "euclidean", residual_bound=bound, **more),
        "point_mass_euclidean": fit_points(data, leg, points, bound, **more),
        "pullback": fit(data, leg, "pullback", residual_bound=bound, **more),
        "entropic": entropic,
        "riemannian": fit(data, leg, Riemannian(starts=("entropic",)), gamma=GAMMA, **more),
    }
