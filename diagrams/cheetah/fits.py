"""Fits of the leg with several regularizers at the same training residual, [Lee2019] §3.5.1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from cheetah.leg import Array, Leg
from geodrake.identification import IdentificationResult, identify
from geodrake.robot.reduction import triangular_factor

REGULARIZERS = ("euclidean", "pullback", "entropic", "riemannian")
COLORS = {
    "prior": "#a9b4c0",
    "euclidean": "#e08a3c",
    "pullback": "#3f9c6b",
    "entropic": "#1b6ca8",
    "riemannian": "#8064a2",
}
GAMMA = 0.2
"""Weight of the entropic and the Riemannian regularizer, [Lee2019] §3.6.2.1."""


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


def fit(data: Condensed, leg: Leg, kind: str, gamma: float, **more: Any) -> IdentificationResult:
    """The regularized fit, bodies inside their ellipsoids."""
    solver = "newton" if kind == "entropic" else "clarabel"
    return identify(
        data.A,
        data.b,
        leg.prior,
        regularizer=kind,
        gamma=gamma,
        ellipsoids=leg.ellipsoids,
        solver=solver,
        **more,
    )


def fit_to_residual(
    data: Condensed, leg: Leg, kind: str, residual: float, *, start: float, **more: Any
) -> IdentificationResult:
    """The fit whose training residual, with `rest`, is a given one, by the root in log γ."""
    tried: dict[float, IdentificationResult] = {}

    def excess(log_gamma: float) -> float:
        tried[log_gamma] = fit(data, leg, kind, float(np.exp(log_gamma)), **more)
        return float(np.log((tried[log_gamma].residual + data.rest) / (residual + data.rest)))

    low = high = float(np.log(start))
    while excess(low) > 0 and low > -60:
        high, low = low, low - 2.0
    while excess(high) < 0 and high < 60:
        low, high = high, high + 2.0
    best = brentq(excess, low, high, xtol=1e-7) if high > low else low
    return tried.get(best) or fit(data, leg, kind, float(np.exp(best)), **more)


def compare(data: Condensed, leg: Leg, **more: Any) -> dict[str, IdentificationResult]:
    """Every regularizer: γ for the entropic and the Riemannian one, its residual for the others."""
    entropic = fit(data, leg, "entropic", GAMMA, **more)
    found = {
        kind: fit_to_residual(data, leg, kind, entropic.residual, start=start, **more)
        for kind, start in (("euclidean", 4.0), ("pullback", 0.1))
    }
    return {
        **found,
        "entropic": entropic,
        "riemannian": fit(data, leg, "riemannian", GAMMA, **more),
    }
