"""What one filtered sample does to an estimate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from geodrake.adaptation import (
    BatchedProduct,
    ConvexSet,
    ProjectedLaw,
    natural_adaptation,
)
from geodrake.arguments import instance, number, positive, real_array
from geodrake.errors import ArgumentError, GeodrakeError
from geodrake.inertia import Array
from geodrake.online_estimation.mirror_map import MirrorMap, Point
from geodrake.online_estimation.slab_projection import SlabProjection
from geodrake.projections import Polyhedron

Rows = tuple[Array, Array]
"""A regressor (k, n) and its efforts (k,)."""


@dataclass(frozen=True, eq=False)
class SampleUpdate:
    """A step of an estimate toward the slab of a sample, and its projection onto a constraint set.

    Attributes:
        manifold: The manifold of the parameters, as `parameter_manifold` gives it.
        tolerance: (nv,) or one ε, N·m or N: the error of filtered efforts that is not believed.
        constraints: A convex set that holds the truth, if one is known.
        relaxation: Share in (0, 1] of a step toward the slabs that is carried out: less follows
            noise less.
        forgetting: Rate, 1/s, at which an estimate goes back to the prior along the way of least
            divergence, where no sample holds it; zero for never.
        prior: (n,) where it goes back to, inside of the manifold.

    Raises:
        ArgumentError: A number is out of range, a factor of the manifold has no closed way of least
            divergence (see `MirrorMap`), or prior or constraints do not fit the manifold.
    """

    manifold: BatchedProduct
    tolerance: ArrayLike
    constraints: ConvexSet | Polyhedron | None = None
    relaxation: float = 0.5
    forgetting: float = 0.0
    prior: Array | None = None

    def __post_init__(self) -> None:
        instance(self.manifold, "manifold", BatchedProduct)
        epsilon = real_array(self.tolerance, "tolerance")
        if epsilon.ndim > 1 or not (epsilon > 0).all():
            raise ArgumentError(
                f"tolerance must be positive numbers, one or (nv,); it is {epsilon.tolist()}."
            )
        number(self.relaxation, "relaxation", upper=1.0)
        positive(self.relaxation, "relaxation")
        number(self.forgetting, "forgetting", lower=0.0)
        if self.forgetting > 0 and self.prior is None:
            raise ArgumentError("Forgetting needs a prior to go back to.")
        if self.prior is not None:
            prior = real_array(self.prior, "prior", (self.manifold.dimension,))
            if not self.manifold.contains(prior):
                raise ArgumentError(f"A prior is inside of the manifold; got {prior.tolist()}.")
        # What does not fit is told now, not while a robot moves.
        _ = self._map, self._limited

    @cached_property
    def _tolerances(self) -> Array:
        return np.asarray(self.tolerance, float)

    @cached_property
    def _slabs(self) -> SlabProjection:
        return SlabProjection(self.manifold)

    @cached_property
    def _map(self) -> MirrorMap:
        return MirrorMap.of(self.manifold)

    @cached_property
    def _limited(self) -> ProjectedLaw | None:
        if self.constraints is None:
            return None
        return ProjectedLaw(natural_adaptation(self.manifold), self.constraints)

    @cached_property
    def _prior_point(self) -> Point:
        return self._map.point(np.asarray(self.prior, float))

    def updated(
        self, p: Array, Y: Array, effort: Array, dt: float, *, earlier: Rows | None = None
    ) -> Array:
        """The estimate (n,) after a sample; the one before if something is not finite.

        Args:
            p: (n,) estimate inside of the manifold.
            Y: (nv, n) filtered regressor.
            effort: (nv,) filtered efforts, N·m or N.
            dt: Time since the last sample, s.
            earlier: Regressor and efforts of an earlier sample, which are to hold as well: what one
                sample says of the parameters is little, and soon forgotten without.
        """
        if not (isfinite(np.vdot(Y, Y)) and isfinite(np.vdot(effort, effort))):
            return p
        following = self._forgotten(p, dt) if self.forgetting > 0 else p
        epsilon = self._tolerances
        if earlier is not None:
            Y, effort = np.concatenate((Y, earlier[0])), np.concatenate((effort, earlier[1]))
            epsilon = np.concatenate((epsilon, epsilon)) if epsilon.ndim else epsilon
        epsilon = epsilon if epsilon.ndim else np.full(len(effort), epsilon)
        try:
            moved = self._slabs.nudged(following, Y, effort, epsilon, relaxation=self.relaxation)
        except np.linalg.LinAlgError:
            return p
        if moved is None:
            return p
        if self._limited is not None:
            try:
                moved = self._limited.project(moved)
            except (GeodrakeError, np.linalg.LinAlgError):
                return p
        good = self._map.clearly_inside(moved) or bool(self.manifold.calc_contains(moved))
        return moved if good else p

    def _forgotten(self, p: Array, dt: float) -> Array:
        share = float(-np.expm1(-self.forgetting * dt))
        moved = self._map.mixed(self._map.point(p), self._prior_point, share)
        return p if moved is None else self._map.parameters(moved)
