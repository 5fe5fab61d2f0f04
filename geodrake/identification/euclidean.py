"""The Euclidean distance: simple, and dependent on units and frames."""

from __future__ import annotations

import numpy as np

from geodrake.identification.regularizer import QuadraticRegularizer
from geodrake.inertia import Array


class Euclidean(QuadraticRegularizer):
    """d² = ‖Φ − Φ⁰‖² ([Lee2019] Eq. (3.2.16)): adds kg² and (kg·m²)², so prefer another.

    Its minimum often lies at the boundary of physical bodies.
    """

    name = "euclidean"

    def scalar_metric(self, priors: Array) -> Array:
        """One for every scalar."""
        return np.ones_like(priors)

    def metric(self, prior: Array) -> Array:
        """The identity for every body."""
        return np.broadcast_to(np.eye(10), (len(prior), 10, 10))
