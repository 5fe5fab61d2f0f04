"""Perturb bodies by random point masses, as true bodies of studies, [Lee2019] §B.2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, integer, number, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError, ConvergenceError
from geodrake.inertia.body_distances import riemannian_distance
from geodrake.inertia.ellipsoids import Ellipsoid, equivalent_ellipsoid
from geodrake.inertia.kernels import Array
from geodrake.inertia.parameters import from_point_masses, is_physical

_MOST_DRAWS = 1000
_TOLERANCE = 1e-6  # relative eigenvalue of P: a body of 1 m that is 1 mm thin


@dataclass(frozen=True, eq=False)
class Perturbation(Short):
    """Random physical bodies around nominal ones.

    Attributes:
        phi: (count, nb, 10) inertial parameters.
        distances: (count, nb) geodesic distances from the nominal bodies ([Lee2019] Eq. (3.3.25)).
        rejected: Number of draws that were not physical, and were repeated.
    """

    phi: Array
    distances: Array
    rejected: int


def perturb(
    phi: ArrayLike,
    count: int,
    *,
    rng: np.random.Generator,
    mass_uncertainty: float = 0.5,
    point_masses: int = 10,
    support: Ellipsoid | None = None,
) -> Perturbation:
    """Return random bodies with point masses added or removed at random positions.

        P̃ = P + Σ (Δm ηᵢ) [xᵢ;1][xᵢ;1]ᵀ,  Δm ∈ [−δ m, δ m],  Σ ηᵢ = 1       [Lee2019] (B.2.11)

    Δm is uniform, the shares η are uniform on the simplex, and the positions x are uniform in the
    support. Bodies that are not physical, or thinner than a thousandth of their length, are drawn
    again.

    Args:
        phi: (nb, 10) physical inertial parameters.
        mass_uncertainty: δ in (0, 1).
        point_masses: Number of point masses of each body.
        support: Ellipsoids of the bodies, of shape (nb,), or one for all; by default the equivalent
            uniform ellipsoids.
    """
    phi = real_array(phi, "phi", ("nb", 10))
    if not is_physical(phi).all():
        wrong = np.flatnonzero(~is_physical(phi)).tolist()
        raise ArgumentError(f"Bodies {wrong} are not physical, so they cannot be perturbed.")
    count = integer(count, "count", lower=1)
    point_masses = integer(point_masses, "point_masses", lower=1)
    number(mass_uncertainty, "mass_uncertainty", lower=0.0, upper=1.0, strict=True)
    instance(rng, "rng", np.random.Generator)
    given = equivalent_ellipsoid(phi) if support is None else support
    support = instance(given, "support", Ellipsoid)
    if support.center.shape[:-1] not in ((), (len(phi),)):
        raise ArgumentError(
            f"Expected one support, or one for each of {len(phi)} bodies; got "
            f"{support.center.shape[:-1]}."
        )
    shape = (count, len(phi))
    bodies, missing, rejected = np.empty((*shape, 10)), np.ones(shape, bool), 0
    for _ in range(_MOST_DRAWS):
        change = rng.uniform(-mass_uncertainty, mass_uncertainty, shape) * phi[:, 0]
        shares = rng.dirichlet(np.ones(point_masses), shape)
        positions = np.moveaxis(support.random_points(rng, (point_masses, *shape)), 0, -2)
        drawn = phi + from_point_masses(change[..., None] * shares, positions)
        accepted = missing & is_physical(drawn, tolerance=_TOLERANCE)
        bodies[accepted] = drawn[accepted]
        missing &= ~accepted
        rejected += int(missing.sum())
        if not missing.any():
            return Perturbation(bodies, riemannian_distance(bodies, phi), rejected)
    raise ConvergenceError(
        f"Body {int(np.argwhere(missing)[0, 1])} was not physical in any of {_MOST_DRAWS} draws.",
        advice="Choose a smaller mass_uncertainty, more point masses, or a support that is not "
        "larger than the body.",
    )
