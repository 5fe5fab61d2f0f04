"""Ellipsoids equivalent to bodies, and ellipsoids that contain bodies.

An ellipsoid is the set [x;1]ᵀ Q [x;1] ≥ 0. A body can consist of mass inside it if and only if
P(φ) ⪰ 0 and tr(P(φ) Q) ≥ 0 ([Lee2019] Eq. (3.5.46); Eq. (3.2.12) has the opposite sign).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import Sizes, instance, integers, number, positive, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.inertia.kernels import Array
from geodrake.inertia.parameters import (
    checked_phi,
    from_dual,
    from_mass_com_inertia,
    is_physical,
    principal_axes,
    pseudo_inertia,
)


@dataclass(frozen=True, eq=False)
class Ellipsoid(Short):
    """Solid ellipsoids in body frames B.

    Attributes:
        center: (..., 3) position of the centre from Bo, expressed in B, m.
        semi_axes: (..., 3) semi-axes, m.
        rotation: (..., 3, 3) rotation R_BE, whose columns are the axes.
    """

    center: Array
    semi_axes: Array
    rotation: Array

    def __post_init__(self) -> None:
        sizes: Sizes = {}
        for name, end in (("center", (3,)), ("semi_axes", (3,)), ("rotation", (3, 3))):
            value = real_array(getattr(self, name), name, ("...", *end), sizes)
            object.__setattr__(self, name, value)
        if not (self.semi_axes > 0).all():
            raise ArgumentError(
                f"Semi-axes of an ellipsoid must be positive; got {self.semi_axes.tolist()}."
            )
        error = self.rotation @ np.swapaxes(self.rotation, -1, -2) - np.eye(3)
        if np.abs(error).max(initial=0.0) > 1e-6 or (np.linalg.det(self.rotation) < 0).any():
            raise ArgumentError(f"Not a rotation: {self.rotation.tolist()}.")
        shape = np.broadcast_shapes(
            self.center.shape[:-1], self.semi_axes.shape[:-1], self.rotation.shape[:-2]
        )
        for name, end in (("center", (3,)), ("semi_axes", (3,)), ("rotation", (3, 3))):
            object.__setattr__(self, name, np.broadcast_to(getattr(self, name), (*shape, *end)))

    @property
    def volume(self) -> Array:
        """Volumes (...), m³."""
        return np.asarray(4.0 / 3.0 * np.pi * self.semi_axes.prod(-1))

    @property
    def quadric(self) -> Array:
        """(..., 4, 4) matrices Q with [x;1]ᵀ Q [x;1] = 1 − (scaled distance from the centre)²."""
        side = self.rotation / self.semi_axes[..., None, :]
        shape = side @ np.swapaxes(side, -1, -2)
        pulled = np.einsum("...ij,...j->...i", shape, self.center)
        Q = np.empty((*pulled.shape[:-1], 4, 4))
        Q[..., :3, :3] = -shape
        Q[..., :3, 3] = Q[..., 3, :3] = pulled
        Q[..., 3, 3] = 1.0 - (pulled * self.center).sum(-1)
        return Q

    def scaled(self, factor: float) -> Ellipsoid:
        """Return the same ellipsoid with semi-axes `factor` times as long."""
        factor = positive(factor, "factor")
        return Ellipsoid(self.center, factor * self.semi_axes, self.rotation)

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Return whether points (..., 3), m, are inside."""
        points = real_array(points, "points", ("...", 3), {"...": self.center.shape[:-1]})
        local = np.einsum("...ji,...j->...i", self.rotation, points - self.center)
        return np.asarray(((local / self.semi_axes) ** 2).sum(-1) <= 1.0)

    def uniform_body(self, mass: ArrayLike) -> Array:
        """Return the inertial parameters (..., 10) of the uniform ellipsoid of a mass (...), kg."""
        mass = real_array(mass, "mass", ("...",), {"...": self.center.shape[:-1]})
        mass = np.broadcast_to(mass, np.broadcast_shapes(mass.shape, self.center.shape[:-1]))
        squares = self.semi_axes**2
        moments = 0.2 * mass[..., None] * (squares.sum(-1, keepdims=True) - squares)
        turned = (self.rotation * moments[..., None, :]) @ np.swapaxes(self.rotation, -1, -2)
        return from_mass_com_inertia(mass, np.broadcast_to(self.center, (*mass.shape, 3)), turned)

    def random_points(self, rng: np.random.Generator, size: tuple[int, ...]) -> Array:
        """Return uniformly distributed points (*size, 3), m, of the ellipsoids.

        The last axes of `size` are those of the ellipsoids.
        """
        instance(rng, "rng", np.random.Generator)
        direction = rng.normal(size=(*_checked_size(size, self.center.shape[:-1]), 3))
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        radius = rng.uniform(size=(*size, 1)) ** (1 / 3)
        local = radius * direction * self.semi_axes
        return np.asarray(self.center + np.einsum("...ij,...j->...i", self.rotation, local))


def _checked_size(size: tuple[int, ...], leading: tuple[int, ...]) -> tuple[int, ...]:
    """Return the size if its last axes are those of the ellipsoids; raise otherwise."""
    size = integers(size, "size")
    if min(size, default=0) < 0 or len(size) < len(leading) or not _broadcast(size, leading):
        raise ArgumentError(
            f"size must be the shape of the points, ending with the ellipsoids' {leading}; "
            f"it is {size}."
        )
    return size


def _broadcast(size: tuple[int, ...], leading: tuple[int, ...]) -> bool:
    return all(b in (1, a) for a, b in zip(size[::-1], leading[::-1], strict=False))


def equivalent_ellipsoid(phi: ArrayLike, *, least_semi_axis: float = 0.0) -> Ellipsoid:
    """Return the uniform ellipsoids with the inertial parameters φ (..., 10).

    Their semi-axes are √(5 σᵢ/m), with ascending principal second moments σ.

    Args:
        least_semi_axis: Lower bound of the semi-axes, m, with which bodies at the physical boundary
            can be drawn; only their mass must then be positive.
    """
    phi = checked_phi(phi)
    least_semi_axis = number(least_semi_axis, "least_semi_axis", lower=0.0)
    thin = phi[..., 0] > 0
    possible = thin if least_semi_axis > 0 else is_physical(phi)
    if not possible.all():
        bad = phi.reshape(-1, 10)[int(np.argmin(possible.ravel()))]
        raise ArgumentError(f"The inertial parameters {bad.tolist()} are not physical.")
    principal = principal_axes(phi)
    squares: Array = 5.0 * principal.second_moments / principal.mass[..., None]
    # Rounding can make the smallest moment of a thin body negative.
    least = max(least_semi_axis**2, float(np.finfo(float).tiny))
    return Ellipsoid(principal.center, np.sqrt(np.maximum(squares, least)), principal.rotation)


def ellipsoid_of_quadric(Q: ArrayLike) -> Ellipsoid:
    """Return the ellipsoids [x;1]ᵀ Q [x;1] ≥ 0 of symmetric Q (..., 4, 4)."""
    Q = real_array(Q, "Q", ("...", 4, 4))
    if (np.abs(Q - np.swapaxes(Q, -1, -2)) > 1e-8 * np.abs(Q).max((-2, -1), keepdims=True)).any():
        raise ArgumentError(
            f"Expected symmetric matrices; got {Q.tolist()}.",
            advice="0.5 * (Q + Q.T) describes the same region.",
        )
    values, axes = np.linalg.eigh(-Q[..., :3, :3])
    if not (values > 0).all():
        raise ArgumentError(
            f"[x;1]ᵀ Q [x;1] ≥ 0 is not an ellipsoid for Q = {Q.tolist()}.",
            advice="Its upper left 3×3 block must be negative definite; use −Q if yours is "
            "negative inside.",
        )
    center = np.asarray(np.linalg.solve(-Q[..., :3, :3], Q[..., :3, 3, None])[..., 0], float)
    level = Q[..., 3, 3] + (Q[..., :3, 3] * center).sum(-1)
    if not (level > 0).all():
        raise ArgumentError(f"[x;1]ᵀ Q [x;1] ≥ 0 is empty for Q = {Q.tolist()}.")
    axes[..., 2] *= np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[..., None]
    return Ellipsoid(center, np.sqrt(level[..., None] / values), axes)


def is_realizable(phi: ArrayLike, Q: ArrayLike) -> NDArray[np.bool_]:
    """Return whether mass inside ellipsoids Q (..., 4, 4) can have inertial parameters φ (..., 10).

    The conditions are P(φ) ≻ 0 and tr(P(φ) Q) ≥ 0 ([Lee2019] Eqs. (3.2.7), (3.5.46)).
    """
    sizes: Sizes = {}
    phi, Q = checked_phi(phi, "phi", sizes), real_array(Q, "Q", ("...", 4, 4), sizes)
    trace = np.einsum("...ij,...ij->...", pseudo_inertia(phi), Q)
    return np.asarray(is_physical(phi) & (trace >= 0))


def realizability_row(Q: ArrayLike) -> Array:
    """Return the coefficients a (..., 10) of aᵀφ = tr(P(φ) Q) ≥ 0 for Q (..., 4, 4)."""
    return from_dual(real_array(Q, "Q", ("...", 4, 4)))
