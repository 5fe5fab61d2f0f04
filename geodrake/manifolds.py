"""Barrier-Hessian manifolds: convex sets of parameters with the geometry of their log barrier.

Parameters that only make sense inside an open convex set (a friction coefficient above zero, a
pseudo inertia that is positive definite) get a strictly convex barrier h that grows without bound
towards the edge ([Lee2019] §5.3). Its Hessian is a metric, Eq. (5.3.17), and its Bregman divergence
a distance-like measure of error,

    D(x‖y) = h(x) − h(y) − ∇h(y)ᵀ (x − y)                                          [Lee2019] (2.2.2)

Both are free of the choice of units and frames, except for parameters without any bound.

All methods broadcast over leading axes.
"""

from __future__ import annotations

import abc
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.errors import ArgumentError
from geodrake.inertia import (
    PARAMETERS_PER_BODY,
    from_pseudo_inertia,
    is_physical,
    pseudo_inertia,
    pseudo_inertia_basis,
)

Array = NDArray[np.float64]

_BASIS = pseudo_inertia_basis()
_DUAL_BASIS = np.einsum(
    "ij,jab->iab", np.linalg.inv(np.einsum("iab,jab->ij", _BASIS, _BASIS)), _BASIS
)


class Manifold(abc.ABC):
    """An open convex set in ℝⁿ with a barrier h, [Lee2019] Definition 5.3.3."""

    @property
    @abc.abstractmethod
    def dimension(self) -> int:
        """Number n of coordinates."""

    @abc.abstractmethod
    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Whether each point x (..., n) is inside the set."""

    @abc.abstractmethod
    def barrier(self, x: ArrayLike) -> Array:
        """h(x) (...) at points x (..., n) inside the set."""

    @abc.abstractmethod
    def gradient(self, x: ArrayLike) -> Array:
        """∇h(x), (..., n)."""

    @abc.abstractmethod
    def metric(self, x: ArrayLike) -> Array:
        """The metric g(x) = ∇²h(x), (..., n, n) ([Lee2019] Eq. (5.3.17))."""

    @abc.abstractmethod
    def inverse_metric_times(self, x: ArrayLike, b: ArrayLike) -> Array:
        """g(x)⁻¹ b, (..., n), without building g: the natural gradient of a covector b (..., n)."""

    @abc.abstractmethod
    def divergence(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Bregman divergence D(x‖y) ≥ 0 (...), zero just when x = y; both inside the set."""


@dataclass(frozen=True)
class Interval(Manifold):
    """Parameters with bounds of their own, lᵢ < xᵢ < uᵢ.

    h = −Σ log(xᵢ − lᵢ) − Σ log(uᵢ − xᵢ), [Lee2019] Eq. (5.3.35). A bound may be infinite, and then
    has no term; a parameter without any bound is flat instead, with the term ½ xᵢ².

    Attributes:
        lower: The n lower bounds l.
        upper: The n upper bounds u.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.lower) != len(self.upper) or not np.all(np.less(self.lower, self.upper)):
            raise ArgumentError(
                f"Every lower bound needs an upper bound above it; got {self.lower} and "
                f"{self.upper}."
            )

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.lower)

    @cached_property
    def _flat(self) -> NDArray[np.bool_]:
        """Which parameters have no bound, (n,)."""
        return np.isinf(self.lower) & np.isinf(self.upper)

    def _slacks(self, x: Array) -> tuple[Array, Array]:
        """Distances to the lower and the upper bounds."""
        return x - np.array(self.lower), np.array(self.upper) - x

    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Whether l < x < u in every parameter (...)."""
        x = np.asarray(x, float)
        below, above = self._slacks(x)
        return (np.isfinite(x) & (below > 0) & (above > 0)).all(-1)

    def barrier(self, x: ArrayLike) -> Array:
        """h(x), [Lee2019] Eq. (5.3.35)."""
        x = np.asarray(x, float)
        logs = sum(np.log(np.where(np.isinf(slack), 1.0, slack)) for slack in self._slacks(x))
        return (np.where(self._flat, 0.5 * x * x, 0.0) - logs).sum(-1)

    def gradient(self, x: ArrayLike) -> Array:
        """∇h(x), (..., n)."""
        x = np.asarray(x, float)
        below, above = self._slacks(x)
        return np.where(self._flat, x, 1.0 / above - 1.0 / below)

    def _curvature(self, x: ArrayLike) -> Array:
        below, above = self._slacks(np.asarray(x, float))
        return np.where(self._flat, 1.0, below**-2.0 + above**-2.0)

    def metric(self, x: ArrayLike) -> Array:
        """The diagonal metric of [Lee2019] Eq. (5.3.36)."""
        return self._curvature(x)[..., None] * np.eye(self.dimension)

    def inverse_metric_times(self, x: ArrayLike, b: ArrayLike) -> Array:
        """g(x)⁻¹ b, [Lee2019] Eq. (B.4.22) and (B.4.23), component by component."""
        return np.asarray(b, float) / self._curvature(x)

    def divergence(self, x: ArrayLike, y: ArrayLike) -> Array:
        """D(x‖y), [Lee2019] Eq. (5.3.37)."""
        x, y = np.asarray(x, float), np.asarray(y, float)
        step = x - y
        below, above = self._slacks(y)
        terms = _excess(step / below) + _excess(-step / above)
        return np.where(self._flat, 0.5 * step * step, terms).sum(-1)


class Positive(Interval):
    """n positive parameters with h = −Σ log xᵢ ([Lee2019] Eq. (5.3.31))."""

    def __init__(self, dimension: int = 1) -> None:
        super().__init__((0.0,) * dimension, (np.inf,) * dimension)


class Free(Interval):
    """n parameters without bounds: ℝⁿ with h = ½ ‖x‖², in the units that they are given in."""

    def __init__(self, dimension: int = 1) -> None:
        super().__init__((-np.inf,) * dimension, (np.inf,) * dimension)


@dataclass(frozen=True)
class PhysicalInertia(Manifold):
    """Inertial parameters φ of one body with P(φ) ≻ 0 and h = −log det P(φ), [Lee2019] §5.3.1.

    The metric is the Hessian of h, [Lee2019] Eq. (5.3.24): twice the one of (B.1.7), so that one
    adaptation gain means one speed for inertias and friction alike.
    """

    @property
    def dimension(self) -> int:
        """Ten."""
        return PARAMETERS_PER_BODY

    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Whether P(x) ≻ 0 (...)."""
        return is_physical(x)

    def barrier(self, x: ArrayLike) -> Array:
        """−log det P(x), [Lee2019] Eq. (5.3.23)."""
        return -np.linalg.slogdet(pseudo_inertia(x))[1]

    def gradient(self, x: ArrayLike) -> Array:
        """−tr(P(x)⁻¹ P(eᵢ)), (..., 10)."""
        return -np.einsum("...ab,iab->...i", np.linalg.inv(pseudo_inertia(x)), _BASIS)

    def metric(self, x: ArrayLike) -> Array:
        """tr(P⁻¹ P(eᵢ) P⁻¹ P(eⱼ)), (..., 10, 10), [Lee2019] Eq. (5.3.24)."""
        solved = np.linalg.solve(pseudo_inertia(x)[..., None, :, :], _BASIS)
        return np.einsum("...iab,...jba->...ij", solved, solved)

    def inverse_metric_times(self, x: ArrayLike, b: ArrayLike) -> Array:
        """P⁻¹(P(x) X(b) P(x)), [Lee2019] Eq. (B.4.20) without its factor 2.

        X(b) is the symmetric matrix with tr(P(φ) X(b)) = φᵀ b, [Lee2019] Eq. (B.1.8).
        """
        matrix = pseudo_inertia(x)
        covector = np.einsum("...i,iab->...ab", np.asarray(b, float), _DUAL_BASIS)
        return from_pseudo_inertia(matrix @ covector @ matrix)

    def divergence(self, x: ArrayLike, y: ArrayLike) -> Array:
        """D(x‖y) = −log det(P(y)⁻¹P(x)) + tr(P(y)⁻¹P(x)) − 4, [Lee2019] Eq. (5.3.25)."""
        root = np.linalg.inv(np.linalg.cholesky(pseudo_inertia(y)))
        difference = pseudo_inertia(np.asarray(x, float) - np.asarray(y, float))
        ratio = root @ difference @ np.swapaxes(root, -1, -2)
        return _excess(np.asarray(np.linalg.eigvalsh(ratio), float)).sum(-1)


@dataclass(frozen=True)
class Product(Manifold):
    """Several manifolds side by side, h = Σ wᵢ hᵢ(xᵢ), [Lee2019] Eq. (5.3.41)–(5.3.44).

    Attributes:
        manifolds: The factors, in the order of their coordinates.
        weights: Positive weights w; all 1 if empty.
    """

    manifolds: tuple[Manifold, ...]
    weights: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not self.weights:
            object.__setattr__(self, "weights", (1.0,) * len(self.manifolds))
        if len(self.weights) != len(self.manifolds) or not all(w > 0 for w in self.weights):
            raise ArgumentError(
                f"Each of the {len(self.manifolds)} manifolds needs a positive weight; got "
                f"{self.weights}."
            )

    @property
    def dimension(self) -> int:
        """Sum of the factors' dimensions."""
        return sum(manifold.dimension for manifold in self.manifolds)

    @cached_property
    def _factors(self) -> tuple[tuple[Manifold, float, slice], ...]:
        """Every factor with its weight and where its coordinates are."""
        ends = np.cumsum([manifold.dimension for manifold in self.manifolds]).tolist()
        slices = [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]
        return tuple(zip(self.manifolds, self.weights, slices, strict=True))

    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Whether x is inside every factor (...)."""
        x = np.asarray(x, float)
        inside = [factor.contains(x[..., part]) for factor, _, part in self._factors]
        return np.logical_and.reduce(inside)

    def barrier(self, x: ArrayLike) -> Array:
        """Σ wᵢ hᵢ(xᵢ), [Lee2019] Eq. (5.3.42)."""
        x = np.asarray(x, float)
        return _sum(w * factor.barrier(x[..., part]) for factor, w, part in self._factors)

    def gradient(self, x: ArrayLike) -> Array:
        """The factors' gradients times their weights, (..., n)."""
        x = np.asarray(x, float)
        parts = [w * factor.gradient(x[..., part]) for factor, w, part in self._factors]
        return np.concatenate(parts, -1)

    def metric(self, x: ArrayLike) -> Array:
        """diag(wᵢ gᵢ(xᵢ)), [Lee2019] Eq. (5.3.43)."""
        x = np.asarray(x, float)
        metric = np.zeros((*x.shape, self.dimension))
        for factor, w, part in self._factors:
            metric[..., part, part] = w * factor.metric(x[..., part])
        return metric

    def inverse_metric_times(self, x: ArrayLike, b: ArrayLike) -> Array:
        """gᵢ(xᵢ)⁻¹ bᵢ / wᵢ factor by factor, [Lee2019] Eq. (B.4.19)."""
        x, b = np.asarray(x, float), np.asarray(b, float)
        parts = [
            factor.inverse_metric_times(x[..., part], b[..., part]) / w
            for factor, w, part in self._factors
        ]
        return np.concatenate(parts, -1)

    def divergence(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Σ wᵢ Dᵢ(xᵢ‖yᵢ), [Lee2019] Eq. (5.3.44)."""
        x, y = np.asarray(x, float), np.asarray(y, float)
        return _sum(w * f.divergence(x[..., part], y[..., part]) for f, w, part in self._factors)


def _excess(step: Array) -> Array:
    """What one logarithm adds to a divergence: r − 1 − log r of the ratio r = 1 + step."""
    return step - np.log1p(step)


def _sum(terms: Iterable[Array]) -> Array:
    return np.asarray(sum(terms), float)
