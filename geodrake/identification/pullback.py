"""The constant pullback metric: the geometric distance near the prior, as a quadratic form."""

from __future__ import annotations

from geodrake.identification.regularizer import QuadraticRegularizer
from geodrake.inertia import Array, pullback_metric


class Pullback(QuadraticRegularizer):
    """d² = Σ_i ½ tr((P(φ_i⁰)⁻¹ P(φ_i − φ_i⁰))²) ([Lee2019] Eqs. (3.3.33), (3.5.50)).

    Independent of units and frames. Finite at the boundary of physical bodies, which a fit with
    strong data and a weak prior therefore can reach.
    """

    name = "pullback"

    def metric(self, prior: Array) -> Array:
        """g(φ⁰) of every body ([Lee2019] Eq. (B.1.7))."""
        return pullback_metric(prior)
