"""Several manifolds side by side."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from geodrake.errors import ArgumentError
from geodrake.manifolds.base import Array, Lift, Manifold
from geodrake.manifolds.mirror import MirrorLine, joined


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

    def longest_step(self, x: ArrayLike, v: ArrayLike) -> Array:
        """The least of the factors' times (...)."""
        x, v = np.asarray(x, float), np.asarray(v, float)
        times = [
            factor.longest_step(x[..., part], v[..., part]) for factor, _, part in self._factors
        ]
        return np.minimum.reduce(times)

    def frame(self, x: ArrayLike) -> Array:
        """Those of the factors as blocks (n, n)."""
        x = np.asarray(x, float)
        frame = np.zeros((self.dimension, self.dimension))
        for factor, w, part in self._factors:
            frame[part, part] = factor.frame(x[part]) / np.sqrt(w)
        return frame

    def mirror_line(self, x: ArrayLike, b: ArrayLike) -> MirrorLine:
        """Factor by factor; those that b has nothing of stay."""
        x, b = np.asarray(x, float), np.asarray(b, float)
        used = [(f, w, part) for f, w, part in self._factors if b[part].any()]
        return joined([(part, w, f.mirror_line(x[part], b[part] / w)) for f, w, part in used], x)

    def lift(self) -> Lift | None:
        """The lifts of the factors side by side, if there are any."""
        own = [factor.lift() for factor in self.manifolds]
        if not any(own):
            return None
        lifts = [a or Lift.nothing(f) for a, f in zip(own, self.manifolds, strict=True)]
        starts = np.cumsum([0, *(len(a.offset) for a in lifts[:-1])])
        return Lift(
            Product(tuple(a.manifold for a in lifts), self.weights),
            block_diag(*(a.matrix for a in lifts)),
            np.concatenate([a.offset for a in lifts]),
            np.concatenate([a.places + at for a, at in zip(lifts, starts, strict=True)]),
            block_diag(*(a.rows for a in lifts)),
            np.concatenate([a.values for a in lifts]),
        )

    def retract(self, x: ArrayLike, v: ArrayLike) -> Array:
        """Each factor by itself."""
        x, v = np.broadcast_arrays(np.asarray(x, float), np.asarray(v, float))
        parts = [factor.retract(x[..., part], v[..., part]) for factor, _, part in self._factors]
        return np.concatenate(parts, -1)


def _sum(terms: Iterable[Array]) -> Array:
    return np.asarray(sum(terms), float)
