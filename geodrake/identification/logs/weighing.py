"""The weight of a regularizer that held-out errors ask for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import IdentificationError
from geodrake.identification.logs.criteria import SPREAD
from geodrake.identification.logs.log_fits import LogFits, regularizer_scale

Array = NDArray[np.float64]

DECADES = (4, 3, 2, 1, 0, -1)
"""A sweep tries these powers of ten of γ, relative to that of inertias known to within `SPREAD`."""

LEAST_DECADE = 0
"""A sweep chooses at least this power of ten.

Below, what the model lacks goes into its inertias, and held-out errors on the same kind of motion
even reward that.
"""

SWEPT_AS = {"riemannian": "entropic"}
"""The γ of these regularizers is chosen by another: both agree to second order, one is convex."""


@dataclass(frozen=True)
class Weighing:
    """One γ of a sweep.

    Attributes:
        nrms: Held-out nrms with it; inf where a fit failed.
    """

    gamma: float
    nrms: float


def weigh(fits: LogFits, regularizer: str) -> tuple[float, tuple[Weighing, ...]]:
    """Return the largest γ that is not clearly worse than the best, and what each one tried gives.

    Decades of γ are tried, then half decades around the best; none below
    `LEAST_DECADE` is chosen. "Clearly" is one standard error of the difference over the folds,
    so that where the data say little the prior stays. Tried ones come with the largest γ first.

    Raises:
        IdentificationError: No fit succeeded.
    """
    regularizer = SWEPT_AS.get(regularizer, regularizer)
    start = 1.0 / (SPREAD**2 * regularizer_scale(fits.prior, regularizer))
    losses: dict[float, Array] = {
        decade: _loss(fits, regularizer, start * 10.0**decade) for decade in DECADES
    }
    best = max(min(losses, key=lambda decade: losses[decade].sum()), LEAST_DECADE)
    for decade in (best + 0.5, best - 0.5):
        losses[decade] = _loss(fits, regularizer, start * 10.0**decade)
    allowed = [decade for decade in losses if decade >= LEAST_DECADE]
    best = min(allowed, key=lambda decade: losses[decade].sum())
    if not np.isfinite(losses[best]).all():
        raise IdentificationError(
            f"No weight of the {regularizer} regularizer leads to a solution.",
            advice="Give another regularizer or γ.",
        )
    chosen = max(decade for decade in allowed if _as_good(losses[decade], losses[best]))
    samples = fits.dataset.samples.sum(0)
    joints = len(samples)
    sweep = [
        Weighing(start * 10.0**decade, float(np.sqrt(losses[decade].sum() / joints)))
        for decade in sorted(losses, reverse=True)
    ]
    return start * 10.0**chosen, tuple(sweep)


def _loss(fits: LogFits, regularizer: str, gamma: float) -> Array:
    """(F,) parts of the folds in the joints' summed squared nrms; inf where a fit fails."""
    try:
        held_out = fits.held_out_at(regularizer, gamma)
    except IdentificationError:
        return np.full(len(fits.dataset.folds), np.inf)
    mean = held_out.sse / held_out.samples.sum(0)
    return np.asarray((mean / fits.dataset.effort_std**2).sum(1))


def _as_good(loss: Array, best: Array) -> bool:
    worse = loss - best
    if not np.isfinite(worse).all():
        return False
    error = np.std(worse, ddof=1) * np.sqrt(len(worse)) if len(worse) > 1 else 0.0
    return bool(worse.sum() <= error)
