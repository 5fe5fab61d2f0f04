"""A product of manifolds that takes factors of one kind together: for updates at every sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.arguments.arrays import LARGEST
from geodrake.inertia import (
    PARAMETERS_PER_BODY,
    dual,
    from_pseudo_inertia,
    pseudo_inertia_basis,
)
from geodrake.manifolds import Interval, Manifold, PhysicalInertia, Product
from geodrake.manifolds.base import Array

_TO_MATRIX = pseudo_inertia_basis().reshape(PARAMETERS_PER_BODY, 16)
_TO_DUAL = dual(np.eye(PARAMETERS_PER_BODY)).reshape(PARAMETERS_PER_BODY, 16)
_FROM_MATRIX = from_pseudo_inertia(np.eye(16).reshape(16, 4, 4))
_SHORT = 0.02  # length of a step of all bodies together, for a series
_SERIES = np.array(
    [[1.0, 1 / 2, 1 / 6], [0.0, 1 / 24, 1 / 120]]
)  # of z, z² and z³ in e^z − 1, and in what z² multiplies there
_USUAL_GROWTH = 4.0  # logarithm of what one step may multiply a direction of P by, on the fast way
_WELL_INSIDE = 1e-12  # det P over the product of its diagonal


@dataclass(frozen=True, eq=False)
class _Group:
    """Factors of one kind and weight.

    Attributes:
        manifold: What they all are.
        places: (k, n) their coordinates.
        weight: Weight of their barriers.
        lower: (n,) lower bounds of an interval in which all have a lower and no upper one.
    """

    manifold: Manifold
    places: NDArray[np.intp]
    weight: float
    lower: Array | None = None

    @cached_property
    def _span(self) -> slice | None:
        """Where the coordinates are, if they follow each other: slices take a third of the time."""
        start = int(self.places[0, 0]) if self.places.size else 0
        following = np.arange(start, start + self.places.size).reshape(self.places.shape)
        return slice(start, following.size + start) if (following == self.places).all() else None

    def part(self, x: Array) -> Array:
        """The coordinates (..., k, n) among those of the product (..., N)."""
        if self._span is None:
            return x[..., self.places]
        return x[..., self._span].reshape((*x.shape[:-1], *self.places.shape))

    def put(self, values: Array, x: Array) -> None:
        """Writes coordinates (..., k, n) to their places in those of the product (..., N)."""
        if self._span is None:
            x[..., self.places] = values
        else:
            x[..., self._span] = values.reshape((*x.shape[:-1], self.places.size))


@dataclass(frozen=True, eq=False)
class BatchedProduct(Product):
    """`Product`, evaluated for all bodies at once and for all bounded parameters at once.

    The values are those of `Product` up to rounding.
    """

    @cached_property
    def _groups(self) -> tuple[_Group, ...]:
        """Bodies together, intervals as one manifold, and every other factor by itself."""
        bodies: dict[float, list[NDArray[np.intp]]] = {}
        intervals: dict[float, list[tuple[Interval, NDArray[np.intp]]]] = {}
        groups = []
        for factor, weight, part in self._factors:
            places = np.arange(part.start, part.stop)
            if isinstance(factor, PhysicalInertia):
                bodies.setdefault(weight, []).append(places)
            elif isinstance(factor, Interval):
                intervals.setdefault(weight, []).append((factor, places))
            else:
                groups.append(_Group(factor, places[None], weight))
        for weight, rows in bodies.items():
            groups.append(_Group(PhysicalInertia(), np.array(rows), weight))
        for weight, members in intervals.items():
            lower = tuple(bound for factor, _ in members for bound in factor.lower)
            upper = tuple(bound for factor, _ in members for bound in factor.upper)
            places = np.concatenate([places for _, places in members])
            simple = np.isfinite(lower).all() and np.isinf(upper).all()
            bounds = np.array(lower) if simple else None
            groups.append(_Group(Interval(lower, upper), places[None], weight, bounds))
        return tuple(groups)

    def calc_contains(self, x: Array) -> NDArray[np.bool_]:
        """Whether x is inside every factor (...)."""
        inside = [g.manifold.calc_contains(g.part(x)).all(-1) for g in self._groups]
        return np.logical_and.reduce(inside)

    def calc_barrier(self, x: Array) -> Array:
        """Σ wᵢ hᵢ(xᵢ), [Lee2019] Eq. (5.3.42)."""
        terms = [g.weight * g.manifold.calc_barrier(g.part(x)).sum(-1) for g in self._groups]
        return np.asarray(sum(terms), float)

    def calc_gradient(self, x: Array) -> Array:
        """The factors' gradients times their weights, (..., n)."""
        return self._filled(lambda g, x: g.weight * g.manifold.calc_gradient(x), x)

    def calc_inverse_metric_times(self, x: Array, b: Array) -> Array:
        """gᵢ(xᵢ)⁻¹ bᵢ / wᵢ factor by factor, [Lee2019] Eq. (B.4.19)."""

        def solved(group: _Group, x: Array, b: Array) -> Array:
            if isinstance(group.manifold, PhysicalInertia):
                P, X = _matrices(x, _TO_MATRIX), _matrices(b, _TO_DUAL)
                return _parameters(P @ X @ P) / group.weight
            return group.manifold.calc_inverse_metric_times(x, b) / group.weight

        return self._filled(solved, x, b)

    def squared_length(self, x: ArrayLike, rows: ArrayLike) -> float:
        """tr(A g(x)⁻¹ Aᵀ) of covectors A (k, n), at x (n,)."""
        x, rows = np.asarray(x, float), np.asarray(rows, float)
        total = 0.0
        for group in self._groups:
            p, b = group.part(x), group.part(rows)
            if isinstance(group.manifold, PhysicalInertia):
                Z = _matrices(p, _TO_MATRIX) @ _matrices(b, _TO_DUAL)
                square = np.vdot(Z, Z.swapaxes(-1, -2))
            elif group.lower is not None:
                pulled = (p - group.lower) * b
                square = np.vdot(pulled, pulled)
            else:
                square = np.vdot(b, group.manifold.calc_inverse_metric_times(p, b))
            total += float(square) / group.weight
        return total

    def calc_divergence(self, x: Array, y: Array) -> Array:
        """Σ wᵢ Dᵢ(xᵢ‖yᵢ), [Lee2019] Eq. (5.3.44)."""
        terms = [
            g.weight * g.manifold.calc_divergence(g.part(x), g.part(y)).sum(-1)
            for g in self._groups
        ]
        return np.asarray(sum(terms), float)

    def calc_longest_step(self, x: Array, v: Array) -> Array:
        """The least of the factors' times (...)."""
        times = [g.manifold.calc_longest_step(g.part(x), g.part(v)).min(-1) for g in self._groups]
        return np.minimum.reduce(times)

    def calc_retract(self, x: Array, v: Array) -> Array:
        """Each factor by itself."""
        return self._filled(lambda g, x, v: g.manifold.calc_retract(x, v), x, v)

    def natural_step(self, x: ArrayLike, b: ArrayLike, time: float) -> Array:
        """`retract` along −time g(x)⁻¹ b, which for bodies needs no inverse.

        P⁺ = L exp(−time/w Lᵀ X(b) L) Lᵀ with P = L Lᵀ, the geodesic of [Lee2019] Eq. (2.2.9).
        """
        x, b = np.asarray(x, float), np.asarray(b, float)
        if x.shape != b.shape:
            x, b = np.broadcast_arrays(x, b)
        following = np.empty(x.shape)
        for group in self._groups:
            group.put(_natural_step(group, group.part(x), group.part(b), time), following)
        return following

    def _filled(self, function: Callable[..., Array], *vectors: ArrayLike) -> Array:
        """Values (..., n) of a function of a group and of its coordinates (..., k, n_g)."""
        whole = [np.asarray(vector, float) for vector in vectors]
        # (What has fewer leading axes than the rest is not repeated: the functions broadcast.)
        same = whole[0].shape == whole[-1].shape
        filled = np.empty(
            whole[0].shape if same else np.broadcast_shapes(*[x.shape for x in whole])
        )
        for group in self._groups:
            group.put(function(group, *[group.part(x) for x in whole]), filled)
        return filled


def _matrices(vectors: Array, basis: Array) -> Array:
    flat = vectors.reshape(-1, PARAMETERS_PER_BODY) @ basis
    return flat.reshape((*vectors.shape[:-1], 4, 4))


def _parameters(matrices: Array) -> Array:
    flat = matrices.reshape(-1, 16) @ _FROM_MATRIX
    return flat.reshape((*matrices.shape[:-2], PARAMETERS_PER_BODY))


def _natural_step(group: _Group, x: Array, b: Array, time: float) -> Array:
    time = time / group.weight
    if isinstance(group.manifold, PhysicalInertia):
        return _body_step(x, b, time)
    if group.lower is not None:
        return _positive_step(x, b, time, lower=group.lower)
    return group.manifold.calc_retract(x, -time * group.manifold.calc_inverse_metric_times(x, b))


def _body_step(phi: Array, b: Array, time: float) -> Array:
    """The natural step of inertial parameters φ (..., 10) for covectors b (..., 10)."""
    P, X = _matrices(phi, _TO_MATRIX), _matrices(b, _TO_DUAL)
    stepped = _short_step(P, X, time)
    if stepped is not None:
        return _parameters(stepped)
    try:
        L = np.linalg.cholesky(P)
        turned = L.swapaxes(-1, -2) @ X @ L
        rates, axes = np.linalg.eigh(turned)
        if np.abs(rates).max(initial=0.0) * abs(time) <= _USUAL_GROWTH:
            root = (L @ axes) * np.exp((-0.5 * time) * rates)[..., None, :]
            P = root @ root.swapaxes(-1, -2)
            if _well_inside(P):
                return _parameters(P)
    except np.linalg.LinAlgError:
        pass
    return _careful_step(phi, b, time)


def _short_step(P: Array, X: Array, time: float) -> Array | None:
    """The natural step of pseudo inertias by a series, if it is short.

    It is exp(Z) P with Z = −time P X, whatever root of P there is.
    """
    powers = np.empty((3, *P.shape))
    Z = np.matmul(P, X * -time, out=powers[0])
    # tr Z² is the squared length of time Lᵀ X L.
    if not np.vdot(Z, Z.swapaxes(-1, -2)) < _SHORT**2:
        return None
    square = np.matmul(Z, Z, out=powers[1])
    np.matmul(square, Z, out=powers[2])
    low, high = (_SERIES @ powers.reshape(3, -1)).reshape(2, *P.shape)
    stepped = P + (low + square @ high) @ P
    return stepped if _well_inside(stepped) else None


def _well_inside(P: Array) -> bool:
    """Whether P (..., 4, 4) are so far from the edge that rounding does not matter.

    P is what a positive-definite matrix was turned into, up to rounding. Where det P is not small
    beside the product of its diagonal, no eigenvalue is, in units that make the diagonal one: then
    rounding has not changed a sign of any. (Where both overflow, the answer is no.)
    """
    least = _WELL_INSIDE * np.multiply.reduce(P.reshape(-1, 16)[:, ::5], 1)
    return bool((np.linalg.det(P).ravel() > least).all())


def _careful_step(phi: Array, b: Array, time: float) -> Array:
    """The natural step for long steps, and for bodies at the edge of what can exist."""
    body = PhysicalInertia()
    return body.calc_retract(phi, -time * body.calc_inverse_metric_times(phi, b))


def _positive_step(x: Array, b: Array, time: float, *, lower: Array) -> Array:
    """The natural step of parameters x (..., n) that have a lower bound only."""
    slack = x - lower
    growth = slack * b
    growth *= -time
    if np.vdot(growth, growth) <= _USUAL_GROWTH**2:
        stepped = np.expm1(growth)
        stepped *= slack
        stepped += x
        if (stepped > lower).all() and np.vdot(stepped, stepped) < LARGEST:
            return np.asarray(stepped)
    above = Interval(tuple(lower.tolist()), (np.inf,) * len(lower))
    return above.calc_retract(x, slack * growth)
