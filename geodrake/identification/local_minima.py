"""What a search from several starts found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geodrake.identification.fit import FitResult
from geodrake.inertia import Array

_SAME = 1e-4
"""Geodesic distance within which two minima count as one."""


@dataclass(frozen=True, eq=False)
class LocalMinima:
    """Where the starts led to.

    Attributes:
        starts: Names of the starts.
        costs: (n,) cost reached from each start, at the γ of the solution; inf where the search
            failed.
        distances: (n,) geodesic distance of what each start led to from the best.
        strict: Whether the best is a strict local minimum: its Hessian is positive definite.
    """

    starts: tuple[str, ...]
    costs: Array
    distances: Array
    strict: bool

    @property
    def agree(self) -> bool:
        """Whether all starts led to the same minimum."""
        return bool((self.distances < _SAME).all())

    @property
    def distinct(self) -> int:
        """Number of different minima that were found, distinguished by their costs."""
        found = np.sort(self.costs[np.isfinite(self.costs)])
        apart = self.distances[np.isfinite(self.costs)]
        if (apart < _SAME).all():
            return 1
        scale = max(abs(found[0]), np.finfo(float).tiny)
        return 1 + int(np.count_nonzero(np.diff(found) > 1e-9 * scale))


@dataclass(frozen=True, kw_only=True, eq=False)
class RiemannianFit(FitResult):
    """A `FitResult` of a problem that may have several minima.

    Attributes:
        minima: What the starts led to.
    """

    minima: LocalMinima
