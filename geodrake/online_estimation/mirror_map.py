"""The way of least divergence: points y with ∇h(y) = ∇h(x) − b."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.arguments.arrays import LARGEST
from geodrake.errors import ArgumentError
from geodrake.inertia import (
    PARAMETERS_PER_BODY,
    Array,
    dual,
    from_pseudo_inertia,
    pseudo_inertia_basis,
)
from geodrake.manifolds import Interval, Manifold, PhysicalInertia, Product

_TO_MATRIX = pseudo_inertia_basis().reshape(PARAMETERS_PER_BODY, 16)
_TO_DUAL = dual(np.eye(PARAMETERS_PER_BODY)).reshape(PARAMETERS_PER_BODY, 16)
_FROM_MATRIX = from_pseudo_inertia(np.eye(16).reshape(16, 4, 4))
_CLEAR = 1e-9  # det P over the product of its diagonal


@dataclass(frozen=True, eq=False)
class Point:
    """A point of a product of bodies and intervals.

    Attributes:
        P: (nb, 4, 4) pseudo inertias.
        x: (m,) the other parameters.
    """

    P: Array
    x: Array
    _known_inverse: Array | None = None

    @cached_property
    def P_inverse(self) -> Array:
        """(nb, 4, 4) inverses of the pseudo inertias.

        Raises:
            numpy.linalg.LinAlgError: A pseudo inertia is singular.
        """
        known = self._known_inverse
        return np.asarray(np.linalg.inv(self.P)) if known is None else known


@dataclass(frozen=True, eq=False)
class Covectors:
    """k covectors, split as the points are, their weights divided out.

    Attributes:
        X: (k, nb, 4, 4) symmetric matrices X with tr(P X) = φᵀ b.
        X_light: The same divided by the weights of the bodies.
        a: (k, m) coefficients of the other parameters.
        a_light: The same divided by their weights.
    """

    X: Array
    X_light: Array
    a: Array
    a_light: Array


@dataclass(frozen=True, eq=False)
class MirrorMap:
    """∇h and its inverse on a product of bodies and of parameters with or without bounds.

    A body has ∇h(y) = ∇h(x) − b at P(y)⁻¹ = P(x)⁻¹ + X(b) / w.

    Attributes:
        bodies: (nb, 10) places of the bodies' parameters.
        body_weights: (nb,) weights of their barriers.
        others: (m,) places of the other parameters.
        other_weights: (m,) weights of their barriers.
        lower: (m,) their lower bounds.
        upper: (m,) their upper bounds.
    """

    bodies: NDArray[np.intp]
    body_weights: Array
    others: NDArray[np.intp]
    other_weights: Array
    lower: Array
    upper: Array

    @classmethod
    def of(cls, manifold: Manifold) -> MirrorMap:
        """The map of a product.

        Raises:
            ArgumentError: A factor is neither a `PhysicalInertia` nor an `Interval`.
        """
        if not isinstance(manifold, Product):
            manifold = Product((manifold,))
        bodies, body_weights = [], []
        others: list[tuple[int, float, float, float]] = []
        start = 0
        for factor, weight in zip(manifold.manifolds, manifold.weights, strict=True):
            if isinstance(factor, PhysicalInertia):
                bodies.append(np.arange(start, start + PARAMETERS_PER_BODY))
                body_weights.append(weight)
            elif isinstance(factor, Interval):
                bounds = zip(factor.lower, factor.upper, strict=True)
                others += [(start + i, weight, *both) for i, both in enumerate(bounds)]
            else:
                raise ArgumentError(
                    f"There is no closed way of least divergence on a {type(factor).__name__}.",
                    advice="Use PhysicalInertia for bodies, and limits as constraints.",
                )
            start += factor.dimension
        table = np.array(others).reshape(-1, 4)
        return cls(
            np.array(bodies, np.intp).reshape(-1, PARAMETERS_PER_BODY),
            np.array(body_weights),
            table[:, 0].astype(np.intp),
            table[:, 1],
            table[:, 2],
            table[:, 3],
        )

    @cached_property
    def lightest(self) -> float:
        """The least weight of all, one at most."""
        weights = np.concatenate([self.body_weights, self.other_weights])
        return float(weights.min(initial=1.0))

    def point(self, p: Array) -> Point:
        """A parameter vector (n,) as a point."""
        P = (p.take(self.bodies) @ _TO_MATRIX).reshape(-1, 4, 4)
        return Point(P, p.take(self.others))

    def parameters(self, point: Point) -> Array:
        """The parameter vector (n,) of a point."""
        p = np.empty(self.bodies.size + self.others.size)
        p[self.bodies] = point.P.reshape(-1, 16) @ _FROM_MATRIX
        p[self.others] = point.x
        return p

    def covectors(self, rows: Array) -> Covectors:
        """Rows (k, n) as covectors."""
        bodies = rows.take(self.bodies, axis=1).reshape(-1, PARAMETERS_PER_BODY)
        X = (bodies @ _TO_DUAL).reshape(len(rows), -1, 4, 4)
        a = rows.take(self.others, axis=1)
        if self._unweighted:
            return Covectors(X, X, a, a)
        return Covectors(X, X / self.body_weights[:, None, None], a, a / self.other_weights)

    @cached_property
    def _unweighted(self) -> bool:
        return bool((self.body_weights == 1.0).all() and (self.other_weights == 1.0).all())

    @cached_property
    def _all_above(self) -> bool:
        """Whether all other parameters have a lower bound and no upper one."""
        return bool(np.isfinite(self.lower).all() and np.isinf(self.upper).all())

    def moved(self, point: Point, rows: Covectors, multipliers: Array) -> Point | None:
        """The point y with ∇h(y) = ∇h(x) − Σ λ a; None if there is none."""
        # (Sums over rows by one product each: this runs several times a sample.)
        push = multipliers @ rows.X_light.reshape(len(multipliers), -1)
        P_inverse = point.P_inverse + push.reshape(point.P.shape)
        try:
            root = np.linalg.inv(np.linalg.cholesky(P_inverse))
        except np.linalg.LinAlgError:
            return None
        x = self._moved_others(point.x, multipliers @ rows.a_light)
        if x is None:
            return None
        return Point(root.swapaxes(-1, -2) @ root, x, P_inverse)

    def moved_a_little(self, point: Point, rows: Covectors, multipliers: Array) -> Array | None:
        """Parameters (n,) of the point y of `moved`, where one is known to exist.

        As after steps that are shorter than one in the manifold's metric.
        """
        push = multipliers @ rows.X_light.reshape(len(multipliers), -1)
        x = self._moved_others(point.x, multipliers @ rows.a_light)
        if x is None:
            return None
        # (P⁻¹ + X)⁻¹ = (𝟙 + P X)⁻¹ P
        turned = point.P @ push.reshape(point.P.shape)
        turned.reshape(-1, 16)[:, ::5] += 1.0
        p = np.empty(self.bodies.size + self.others.size)
        p[self.bodies] = np.linalg.solve(turned, point.P).reshape(-1, 16) @ _FROM_MATRIX
        p[self.others] = x
        return p

    def mixed(self, point: Point, other: Point, share: float) -> Point | None:
        """The point y with ∇h(y) = (1 − s) ∇h(x) + s ∇h(x') for a share s in [0, 1]."""
        P_inverse = point.P_inverse + share * (other.P_inverse - point.P_inverse)
        x = self._moved_others(point.x, share * (self._slope(point.x) - self._slope(other.x)))
        return None if x is None else Point(np.asarray(np.linalg.inv(P_inverse)), x, P_inverse)

    def clearly_inside(self, p: Array) -> bool:
        """Whether a parameter vector (n,) is inside for sure: a cheap test that may say no."""
        if not np.vdot(p, p) < LARGEST:
            return False
        point = self.point(p)
        diagonal = point.P.reshape(-1, 16)[:, ::5]
        if not diagonal.min(initial=1.0) > 1 / LARGEST:
            return False
        try:
            L = np.linalg.cholesky(point.P)
        except np.linalg.LinAlgError:
            return False
        # det P over the product of its diagonal, which does not depend on units.
        shape = np.multiply.reduce(L.reshape(-1, 16)[:, ::5] ** 2 / diagonal, 1)
        inside = bool((point.x > self.lower).all() and (point.x < self.upper).all())
        return inside and bool((shape > _CLEAR).all())

    def values(self, point: Point, rows: Covectors) -> Array:
        """aᵀ y (k,)."""
        flat = rows.X.reshape(len(rows.X), -1) @ point.P.ravel()
        return np.asarray(flat + rows.a @ point.x)

    def products(self, point: Point, rows: Covectors) -> Array:
        """A g(y)⁻¹ Aᵀ (k, k): how fast the values fall with the multipliers."""
        k = len(rows.X)
        S = point.P @ rows.X
        light = S if rows.X_light is rows.X else point.P @ rows.X_light
        bodies = S.reshape(k, -1) @ light.swapaxes(-1, -2).reshape(k, -1).T
        others = (rows.a * self._softness(point.x)) @ rows.a_light.T
        return np.asarray(bodies + others)

    def _softness(self, x: Array) -> Array:
        """The inverse second derivative of each other parameter's barrier."""
        below = x - self.lower
        if self._all_above:
            return below * below
        flat = np.isinf(self.lower) & np.isinf(self.upper)
        return 1.0 / np.where(flat, 1.0, below**-2.0 + (self.upper - x) ** -2.0)

    def _slope(self, x: Array) -> Array:
        """∇h of each other parameter, less its weight."""
        flat = np.isinf(self.lower) & np.isinf(self.upper)
        return np.where(flat, x, 1.0 / (self.upper - x) - 1.0 / (x - self.lower))

    def _moved_others(self, x: Array, b: Array) -> Array | None:
        """Each other parameter by itself."""
        if not len(x):
            return x
        if self._all_above:
            inverse = 1.0 / (x - self.lower) + b
            return self.lower + 1.0 / inverse if (inverse > 0).all() else None
        has_lower, has_upper = np.isfinite(self.lower), np.isfinite(self.upper)
        lower, upper = np.where(has_lower, self.lower, 0.0), np.where(has_upper, self.upper, 0.0)
        y = x - b
        only = has_lower & ~has_upper
        inverse = np.where(only, 1.0 / np.where(only, x - lower, 1.0) + b, 1.0)
        y = np.where(only, lower + 1.0 / np.where(inverse > 0, inverse, 1.0), y)
        below = ~has_lower & has_upper
        to_upper = np.where(below, 1.0 / np.where(below, upper - x, 1.0) - b, 1.0)
        y = np.where(below, upper - 1.0 / np.where(to_upper > 0, to_upper, 1.0), y)
        if not ((inverse > 0).all() and (to_upper > 0).all()):
            return None
        both = has_lower & has_upper
        middle, half = 0.5 * (upper + lower), np.where(both, 0.5 * (upper - lower), 1.0)
        offset = np.where(both, x - middle, 0.0)
        c = 2.0 * offset / (half**2 - offset**2) - b
        return np.where(both, middle + c * half**2 / (1.0 + np.sqrt(1.0 + (c * half) ** 2)), y)
