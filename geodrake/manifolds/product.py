"""Several manifolds side by side."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from geodrake.arguments import instances, real_array
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
        manifolds = instances(self.manifolds, "manifolds", Manifold)
        given = (1.0,) * len(manifolds) if np.size(self.weights) == 0 else self.weights
        weights = real_array(given, "weights", (len(manifolds),))
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
        """Every factor with its weight and where its coordinates are."""
        ends = np.cumsum([manifold.dimension for manifold in self.manifolds]).tolist()
        slices = [slice(a, b) for a, b in zip([0, *ends[:-1]], ends, strict=True)]
        return tuple(zip(self.manifolds, self.weights, slices, strict=True))

    def calc_contains(self, x: Array) -> NDArray[np.bool_]:
        """Whether x is inside every factor (...)."""
        inside = [factor.calc_contains(x[..., part]) for factor, _, part in self._factors]
        return np.logical_and.reduce(inside)

    def calc_barrier(self, x: Array) -> Array:
        """Σ wᵢ hᵢ(xᵢ), [Lee2019] Eq. (5.3.42)."""
        return _sum(w * factor.calc_barrier(x[..., part]) for factor, w, part in self._factors)

    def calc_gradient(self, x: Array) -> Array:
        """The factors' gradients times their weights, (..., n)."""
        parts = [w * factor.calc_gradient(x[..., part]) for factor, w, part in self._factors]
        return np.concatenate(parts, -1)

    def calc_metric(self, x: Array) -> Array:
        """diag(wᵢ gᵢ(xᵢ)), [Lee2019] Eq. (5.3.43)."""
        metric = np.zeros((*x.shape, self.dimension))
        for factor, w, part in self._factors:
            metric[..., part, part] = w * factor.calc_metric(x[..., part])
        return metric

    def calc_inverse_metric_times(self, x: Array, b: Array) -> Array:
        """gᵢ(xᵢ)⁻¹ bᵢ / wᵢ factor by factor, [Lee2019] Eq. (B.4.19)."""
        parts = [
            factor.calc_inverse_metric_times(x[..., part], b[..., part]) / w
            for factor, w, part in self._factors
        ]
        return np.concatenate(parts, -1)

    def calc_divergence(self, x: Array, y: Array) -> Array:
        """Σ wᵢ Dᵢ(xᵢ‖yᵢ), [Lee2019] Eq. (5.3.44)."""
        return _sum(
            w * f.calc_divergence(x[..., part], y[..., part]) for f, w, part in self._factors
        )

    def calc_longest_step(self, x: Array, v: Array) -> Array:
        """The least of the factors' times (...)."""
        times = [
            factor.calc_longest_step(x[..., part], v[..., part])
            for factor, _, part in self._factors
        ]
        return np.minimum.reduce(times)

    def calc_frame(self, x: Array) -> Array:
        """Those of the factors as blocks (n, n)."""
        frame = np.zeros((self.dimension, self.dimension))
        for factor, w, part in self._factors:
            frame[part, part] = factor.calc_frame(x[part]) / np.sqrt(w)
        return frame

    def calc_mirror_line(self, x: Array, b: Array) -> MirrorLine:
        """Factor by factor; those that b has nothing of stay."""
        used = [(f, w, part) for f, w, part in self._factors if b[part].any()]
        return joined(
            [(part, w, f.calc_mirror_line(x[part], b[part] / w)) for f, w, part in used], x
        )

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

    def calc_retract(self, x: Array, v: Array) -> Array:
        """Each factor by itself."""
        x, v = np.broadcast_arrays(x, v)
        parts = [
            factor.calc_retract(x[..., part], v[..., part]) for factor, _, part in self._factors
        ]
        return np.concatenate(parts, -1)


def _sum(terms: Iterable[Array]) -> Array:
    return np.asarray(sum(terms), float)
