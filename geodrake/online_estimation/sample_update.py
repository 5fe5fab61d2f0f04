"""What one filtered sample does to an estimate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geodrake.adaptation import (
    BatchedProduct,
    ConvexSet,
    ProjectedLaw,
    natural_adaptation,
    prediction_covector,
)
from geodrake.errors import ArgumentError, GeodrakeError
from geodrake.inertia import Array
from geodrake.online_estimation.mirror_map import MirrorMap
from geodrake.online_estimation.slab_projection import SlabProjection
from geodrake.projections import Polyhedron

_ACCURACY = 1e-3  # of one of many projections


@dataclass(frozen=True, eq=False)
class SampleUpdate:
    """Projections of an estimate onto the slab of a sample, and then onto a constraint set.

    Attributes:
        manifold: The manifold of the parameters, as `parameter_manifold` gives it.
        tolerance: (nv,) ε, N·m or N: the error of filtered efforts that is not believed.
        constraints: A convex set that holds the truth, if one is known.
        relaxation: Share in (0, 1] of a projection that is carried out.
        forgetting: Rate, 1/s, at which an estimate goes back to the prior along the way of least
            divergence, where no sample holds it; zero for never.
        prior: (n,) where it goes back to.
    """

    manifold: BatchedProduct
    tolerance: Array
    constraints: ConvexSet | Polyhedron | None = None
    relaxation: float = 0.5
    forgetting: float = 0.0
    prior: Array | None = None

    def __post_init__(self) -> None:
        usable = np.isfinite(self.tolerance).all() and (np.asarray(self.tolerance) > 0).all()
        if not (usable and 0 < self.relaxation <= 1 and 0 <= self.forgetting < np.inf):
            raise ArgumentError(
                "An estimator needs positive tolerances, a relaxation in (0, 1] and a forgetting "
                f"of zero or more; got {np.asarray(self.tolerance).tolist()}, {self.relaxation} "
                f"and {self.forgetting}."
            )
        if self.forgetting > 0 and self.prior is None:
            raise ArgumentError("Forgetting needs a prior to go back to.")

    @cached_property
    def _slabs(self) -> SlabProjection:
        return SlabProjection(self.manifold, accuracy=_ACCURACY)

    @cached_property
    def _map(self) -> MirrorMap:
        return MirrorMap.of(self.manifold)

    @cached_property
    def _limited(self) -> ProjectedLaw | None:
        if self.constraints is None:
            return None
        return ProjectedLaw(natural_adaptation(self.manifold), self.constraints)

    @cached_property
    def _prior_gradient(self) -> Array:
        return np.asarray(self.manifold.gradient(np.asarray(self.prior, float)), float)

    def updated(self, p: Array, Y: Array, effort: Array, dt: float) -> Array:
        """The estimate (n,) after a sample; the one before if something is not finite.

        Args:
            p: (n,) estimate inside of the manifold.
            Y: (nv, n) filtered regressor.
            effort: (nv,) filtered efforts, N·m or N.
            dt: Time since the last sample, s.
        """
        if not (np.isfinite(Y).all() and np.isfinite(effort).all()):
            return p
        following = self._forgotten(p, dt) if self.forgetting > 0 else p
        try:
            moved = self._slabs.project(
                following, Y, effort, self.tolerance, relaxation=self.relaxation
            )
        except np.linalg.LinAlgError:
            moved = None
        if moved is None:
            # No body has these efforts: a short step toward them instead.
            moved = self._stepped(following, Y, effort)
        if self._limited is not None:
            try:
                moved = self._limited.project(moved)
            except (GeodrakeError, np.linalg.LinAlgError):
                return p
        good = np.isfinite(moved).all() and bool(self.manifold.contains(moved))
        return moved if good else p

    def _stepped(self, p: Array, Y: Array, effort: Array) -> Array:
        """A natural step of the squared error, in units of the tolerances, without overshoot."""
        weight = self.tolerance**-2.0
        pulls = self.manifold.inverse_metric_times(p, Y)
        curvature = float((weight * np.einsum("ij,ij->i", Y, pulls)).sum())
        b = prediction_covector(Y, p, effort, weight=weight)
        # The length of b is at most one, too, so that no body changes by more than a factor e.
        length = float(np.sqrt(max(float(b @ self.manifold.inverse_metric_times(p, b)), 0.0)))
        return self.manifold.natural_step(p, b, self.relaxation / max(curvature, length, 1e-300))

    def _forgotten(self, p: Array, dt: float) -> Array:
        share = -np.expm1(-self.forgetting * dt)
        b = share * (np.asarray(self.manifold.gradient(p), float) - self._prior_gradient)
        rows = self._map.covectors(b[None])
        moved = self._map.moved(self._map.point(p), rows, np.ones(1))
        return p if moved is None else self._map.parameters(moved)
