"""What one filtered sample does to an estimate."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import expm1, isfinite

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, number, positive, real_array
from geodrake.boundary.showing import Short
from geodrake.control.adaptation import ConvexSet, ProjectedLaw, natural_adaptation
from geodrake.control.online_estimation.slab_step import slab_step
from geodrake.errors import ArgumentError, GeodrakeError
from geodrake.inertia import Array
from geodrake.manifolds import Product
from geodrake.manifolds.projections import Polyhedron

Rows = tuple[Array, Array]
"""A regressor (k, n) and its efforts (k,)."""


@dataclass(frozen=True, eq=False)
class SampleUpdate(Short):
    """A step of an estimate toward the slab of a sample, and its projection onto a constraint set.

    Attributes:
        manifold: The manifold of the parameters, as `parameter_manifold` gives it.
        tolerance: (nv,) or one ε, N·m or N: the error of filtered efforts that is not believed.
        constraints: A convex set that holds the truth, if one is known.
        relaxation: Share in (0, 1] of a step toward the slabs that is carried out: less follows
            noise less.
        forgetting: Rate, 1/s, at which the gradient of the barrier at an estimate goes back to that
            at the prior, where no sample says otherwise; zero for never.
        prior: (n,) where it goes back to, inside of the manifold.

    Raises:
        ArgumentError: A number is out of range, or prior or constraints do not fit the manifold.
    """

    manifold: Product
    tolerance: ArrayLike
    constraints: ConvexSet | Polyhedron | None = None
    relaxation: float = 0.5
    forgetting: float = 0.0
    prior: Array | None = None

    def __post_init__(self) -> None:
        instance(self.manifold, "manifold", Product)
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
        _ = self._limited  # what does not fit is reported now, not while a robot moves

    @cached_property
    def _tolerances(self) -> Array:
        return np.asarray(self.tolerance, float)

    @cached_property
    def _limited(self) -> ProjectedLaw | None:
        if self.constraints is None:
            return None
        return ProjectedLaw(natural_adaptation(self.manifold), self.constraints)

    @cached_property
    def _prior_gradient(self) -> Array:
        return self.manifold.calc_gradient(np.asarray(self.prior, float))

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
            moved = slab_step(
                self.manifold, following, Y, effort, epsilon, relaxation=self.relaxation
            )
        except np.linalg.LinAlgError:
            return p
        if self._limited is not None:
            try:
                moved = self._limited.project(moved)
            except (GeodrakeError, np.linalg.LinAlgError):
                return p
        return moved if self.manifold.calc_contains(moved) else p

    def _forgotten(self, p: Array, dt: float) -> Array:
        """The point of which ∇h is nearer to that of the prior, by the share of a time step."""
        gradient = self.manifold.calc_gradient(p)
        gradient -= expm1(-self.forgetting * dt) * (self._prior_gradient - gradient)
        return self.manifold.calc_point_of_gradient(gradient, p)
