"""Base of the barrier-Hessian manifolds."""

from __future__ import annotations

import abc

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_MOST_HALVINGS = 60


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

    @abc.abstractmethod
    def longest_step(self, x: ArrayLike, v: ArrayLike) -> Array:
        """The time (...) at which the straight line x + t v leaves the set, inf for never."""

    def retract(self, x: ArrayLike, v: ArrayLike) -> Array:
        """The point (..., n) that a step v (..., n) from x leads to, inside however long v is.

        It agrees with x + v to first order, and does not depend on units and frames, except for
        parameters without any bound. `PhysicalInertia`, `Positive` and `Free` follow their
        geodesics. Other manifolds have no geodesics in closed form: they slow the straight line
        down so that it reaches the edge only in the limit. Where the result is so close to the edge
        that rounding puts it outside, the step is shortened.
        """
        x, v = np.broadcast_arrays(np.asarray(x, float), np.asarray(v, float))
        point, share = self._retract(x, v), np.ones(x.shape[:-1])
        for _ in range(_MOST_HALVINGS):
            outside = ~self._well_inside(point)
            if not outside.any():
                return point
            share = np.where(outside, 0.5 * share, share)
            point = np.where(outside[..., None], self._retract(x, share[..., None] * v), point)
        return np.where(self._well_inside(point)[..., None], point, x)

    def _well_inside(self, x: Array) -> NDArray[np.bool_]:
        """Whether points are inside by more than rounding."""
        return self.contains(x)

    def _retract(self, x: Array, v: Array) -> Array:
        """The retraction in exact arithmetic; along the straight line unless overridden.

        On the way to an edge at time T, time s of the step is slowed down to T (1 − exp(−s/T)).
        """
        slowed = slowed_time(self.longest_step(x, v))
        return np.asarray(x + slowed[..., None] * v)


def slowed_time(edge: Array) -> Array:
    """T (1 − exp(−1/T)) for the time T > 0 of an edge, which is one if there is none."""
    safe = np.where(np.isfinite(edge) & (edge > 0), edge, 1.0)
    return np.where(np.isfinite(edge), -safe * np.expm1(-1.0 / safe), 1.0)


def excess(step: Array) -> Array:
    """What one logarithm adds to a divergence: r − 1 − log r of the ratio r = 1 + step."""
    return step - np.log1p(step)
