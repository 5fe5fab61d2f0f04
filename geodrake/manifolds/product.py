"""Product manifolds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instances, real_array
from geodrake.compiling import contiguous
from geodrake.errors import ArgumentError
from geodrake.manifolds.base import Array, Manifold, MirrorSpan
from geodrake.manifolds.inertia import PhysicalInertia
from geodrake.manifolds.interval import Interval
from geodrake.manifolds.robot_kernels import (
    Factors,
    calc_clearly_inside,
    calc_natural_steps,
    factors_of,
    robot_span,
)


@dataclass(frozen=True, eq=False)
class _FactorGroup:
    """Factors of one kind and weight."""

    manifold: Manifold
    places: NDArray[np.intp]  # (k, n) indices of their coordinates
    weight: float

    @cached_property
    def _span(self) -> slice | None:
        """Slice of the coordinates if they are contiguous, three times as fast as indices."""
        start = int(self.places[0, 0]) if self.places.size else 0
        following = np.arange(start, start + self.places.size).reshape(self.places.shape)
        return slice(start, following.size + start) if (following == self.places).all() else None

    @cached_property
    def _shapes(self) -> tuple[tuple[int, int], tuple[int]]:
        """Shapes of the coordinates by factor, and flat."""
        k, n = self.places.shape
        return (k, n), (k * n,)

    def part(self, x: Array) -> Array:
        """Return the coordinates (..., k, n) among those of the product (..., N)."""
        if self._span is None:
            return x[..., self.places]
        return x[..., self._span].reshape(x.shape[:-1] + self._shapes[0])

    def light(self, covectors: Array) -> Array:
        """Divide covectors by the weight of the barrier."""
        return covectors if self.weight == 1.0 else covectors / self.weight

    def heavy(self, covectors: Array) -> Array:
        """Multiply covectors by the weight of the barrier."""
        return covectors if self.weight == 1.0 else covectors * self.weight

    def put(self, values: Array, x: Array) -> None:
        """Write coordinates (..., k, n) into those of the product (..., N)."""
        if self._span is None:
            x[..., self.places] = values
        else:
            x[..., self._span] = values.reshape(x.shape[:-1] + self._shapes[1])


@dataclass(frozen=True)
class Product(Manifold):
    """Product of manifolds with h = Σ wᵢ hᵢ(xᵢ), [Lee2019] Eq. (5.3.41)–(5.3.44).

    Kernels process all bodies of one weight at once, and all bounded parameters, fast enough for an
    update at every sample.

    Attributes:
        manifolds: The factors, in the order of their coordinates.
        weights: Positive weights w; all 1 if empty.
    """

    manifolds: tuple[Manifold, ...]
    weights: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        manifolds = instances(self.manifolds, "manifolds", Manifold)
        if not manifolds:
            raise ArgumentError("A product needs at least one manifold; `manifolds` is empty.")
        weights = real_array(self.weights, "weights")
        weights = real_array(
            weights if weights.size else np.ones(len(manifolds)), "weights", (len(manifolds),)
        )
        if not (weights > 0).all():
            raise ArgumentError(
                f"Each of the {len(manifolds)} manifolds needs a positive weight; got "
                f"{weights.tolist()}."
            )
        object.__setattr__(self, "manifolds", manifolds)
        object.__setattr__(self, "weights", tuple(weights.tolist()))

    @property
    def dimension(self) -> int:
        """Sum of the factors' dimensions."""
        return sum(manifold.dimension for manifold in self.manifolds)

    @cached_property
    def _factors(self) -> tuple[tuple[Manifold, float, slice], ...]:
        """The factors of nested products, with their weights and slices of coordinates."""
        factors, start = [], 0
        for factor, weight in _leaves(self):
            factors.append((factor, weight, slice(start, start + factor.dimension)))
            start += factor.dimension
        return tuple(factors)

    @cached_property
    def least_weight(self) -> float:
        """Smallest weight of a factor, at most 1."""
        return min((1.0, *(weight * factor.least_weight for factor, weight, _ in self._factors)))

    @cached_property
    def _groups(self) -> tuple[_FactorGroup, ...]:
        """Groups of bodies, of intervals as one manifold, and of every other factor alone."""
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
                groups.append(_FactorGroup(factor, places[None], weight))
        for weight, rows in bodies.items():
            groups.append(_FactorGroup(PhysicalInertia(), np.array(rows), weight))
        for weight, members in intervals.items():
            lower = tuple(bound for factor, _ in members for bound in factor.lower)
            upper = tuple(bound for factor, _ in members for bound in factor.upper)
            places = np.concatenate([places for _, places in members])
            groups.append(_FactorGroup(Interval(lower, upper), places[None], weight))
        return tuple(groups)

    def _filled(self, function: Callable[..., Array], *vectors: Array) -> Array:
        """Return values (..., n) of a function of a group and its coordinates (..., k, n_g)."""
        # The functions broadcast, so that vectors need not have the same leading axes.
        same = vectors[0].shape == vectors[-1].shape
        filled = np.empty(
            vectors[0].shape if same else np.broadcast_shapes(*[x.shape for x in vectors])
        )
        for group in self._groups:
            group.put(function(group, *[group.part(x) for x in vectors]), filled)
        return filled

    def calc_contains(self, x: Array) -> NDArray[np.bool_]:
        """Return whether x is inside every factor (...)."""
        robot = self.robot if x.ndim == 1 else None
        if robot is not None and calc_clearly_inside(contiguous(x), robot):
            return np.asarray(True)
        inside = [g.manifold.calc_contains(g.part(x)) for g in self._groups]
        return np.logical_and.reduce(np.concatenate(inside, -1), -1)

    def calc_barrier(self, x: Array) -> Array:
        """Return Σ wᵢ hᵢ(xᵢ), [Lee2019] Eq. (5.3.42)."""
        return _sum(g.weight * g.manifold.calc_barrier(g.part(x)).sum(-1) for g in self._groups)

    def calc_gradient(self, x: Array) -> Array:
        """Return the weighted gradients (..., n) of the factors."""
        gradient = np.empty(x.shape)
        for group in self._groups:
            group.put(group.heavy(group.manifold.calc_gradient(group.part(x))), gradient)
        return gradient

    def calc_metric(self, x: Array) -> Array:
        """Return diag(wᵢ gᵢ(xᵢ)), [Lee2019] Eq. (5.3.43)."""
        metric = np.zeros((*x.shape, self.dimension))
        for factor, w, part in self._factors:
            metric[..., part, part] = w * factor.calc_metric(x[..., part])
        return metric

    def calc_inverse_metric_times(self, x: Array, b: Array) -> Array:
        """Return gᵢ(xᵢ)⁻¹ bᵢ / wᵢ of all factors, [Lee2019] Eq. (B.4.19)."""
        return self._filled(
            lambda g, x, b: g.manifold.calc_inverse_metric_times(x, g.light(b)), x, b
        )

    def calc_divergence(self, x: Array, y: Array) -> Array:
        """Return Σ wᵢ Dᵢ(xᵢ‖yᵢ), [Lee2019] Eq. (5.3.44)."""
        return _sum(
            g.weight * g.manifold.calc_divergence(g.part(x), g.part(y)).sum(-1)
            for g in self._groups
        )

    def calc_longest_step(self, x: Array, v: Array) -> Array:
        """Return the smallest of the factors' times (...)."""
        times = [g.manifold.calc_longest_step(g.part(x), g.part(v)).min(-1) for g in self._groups]
        return np.minimum.reduce(times)

    def calc_frame(self, x: Array) -> Array:
        """Return the block-diagonal frame (n, n) of the factors."""
        frame = np.zeros((self.dimension, self.dimension))
        for factor, w, part in self._factors:
            frame[part, part] = factor.calc_frame(x[part]) / np.sqrt(w)
        return frame

    def calc_mirror_span(self, x: Array, rows: Array) -> MirrorSpan:
        """Return the span of all factors, by the compiled kernel for robots."""
        if self.robot is not None and x.ndim == 1:
            return robot_span(contiguous(x), contiguous(rows), self.robot)
        points, products = [], np.zeros((len(rows), len(rows)))
        for group in self._groups:
            span = group.manifold.calc_mirror_span(group.part(x), group.part(rows))
            points.append((group, span.point))
            products += group.light(span.products)

        def point(multipliers: Array) -> Array:
            y = np.empty(x.shape)
            for group, group_point in points:
                group.put(group_point(group.light(multipliers)), y)
            return y

        return MirrorSpan(products, point)

    def calc_point_of_gradient(self, gradient: Array, near: Array) -> Array:
        """Return the points of all factors."""
        y = np.empty(near.shape)
        for group in self._groups:
            part = group.light(group.part(gradient))
            group.put(group.manifold.calc_point_of_gradient(part, group.part(near)), y)
        return y

    def calc_retract(self, x: Array, v: Array) -> Array:
        """Return the retractions of all factors."""
        return self._filled(lambda g, x, v: g.manifold.calc_retract(x, v), x, v)

    def calc_natural_step(self, x: Array, b: Array, time: float) -> Array:
        """Return the steps of all factors, by the compiled kernel for one point of a robot."""
        if self.robot is not None and x.ndim == b.ndim == 1:
            stepped, (x, b) = np.empty(x.shape), (contiguous(x), contiguous(b))
            if calc_natural_steps(x, b, self.robot, float(time), stepped):
                return stepped
        return self._filled(
            lambda g, x, b: g.manifold.calc_natural_step(x, b, time / g.weight), x, b
        )

    @cached_property
    def robot(self) -> Factors | None:
        """Factors for compiled kernels; None unless all are bodies and lower bounds."""
        bodies, bounded = [], []
        for factor, weight, part in self._factors:
            if isinstance(factor, PhysicalInertia):
                bodies.append((part.start, 1.0 / weight))
            elif isinstance(factor, Interval) and factor.only_lower:
                lower = zip(range(part.start, part.stop), factor.lower, strict=True)
                bounded += [(at, bound, 1.0 / weight) for at, bound in lower]
            else:
                return None
        return factors_of(bodies, bounded)


def _leaves(product: Product) -> Iterator[tuple[Manifold, float]]:
    """Yield the factors of nested products with their weights."""
    for factor, weight in zip(product.manifolds, product.weights, strict=True):
        if isinstance(factor, Product):
            yield from ((leaf, weight * inner) for leaf, inner in _leaves(factor))
        else:
            yield factor, weight


def _sum(terms: Iterable[Array]) -> Array:
    return np.asarray(sum(terms), float)
