"""Base of the barrier-Hessian manifolds."""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import Sizes, number, real_array
from geodrake.errors import ArgumentError

Array = NDArray[np.float64]

_MOST_HALVINGS = 60
_SMALL = 1e-3  # step below which five terms of a series are exact to rounding
_MOST_STEPS = 80
_SHORT = 0.25  # length in the metric of a Newton step that is taken in full
_EXACT = 1e-7  # length of one after which the next would be its square


class MirrorSpan(NamedTuple):
    """Points y(λ) with ∇h(y) = ∇h(x) + Aᵀ λ, from a point x (n,) along covectors A (k, n).

    Projections move along them ([Lee2019] Eq. (2.2.11): the optimum differs from x in its gradient
    by a combination of rows), and they never leave the manifold.
    """

    products: Array  # (k, k) inner products A g(x)⁻¹ Aᵀ of the covectors
    # Maps multipliers λ (k,) to y(λ) (n,), which is outside of the manifold, or not a number, where
    # there is no such point.
    point: Callable[[Array], Array]


class Manifold(abc.ABC):
    """An open convex set in ℝⁿ with a barrier h, [Lee2019] Definition 5.3.3.

    Every function is a door that refuses points outside of the set, covectors that are not finite,
    and what is no array of real numbers (ArgumentError). Behind it is a kernel of the same name
    with `calc_`, which trusts its arrays: for every sample of a controller, and for solvers that
    meet points outside on their way. What only those need is a kernel alone. A manifold of your own
    defines the kernels.
    """

    @property
    @abc.abstractmethod
    def dimension(self) -> int:
        """Number n of coordinates."""

    @property
    def least_weight(self) -> float:
        """Least weight of a logarithm in the barrier, at most 1."""
        return 1.0

    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each point x (..., n) is inside the set; one that is not finite is not."""
        return self.calc_contains(real_array(x, "x", ("...", self.dimension), finite=False))

    def barrier(self, x: ArrayLike) -> Array:
        """Return h(x) (...) at points x (..., n) inside the set."""
        return self.calc_barrier(self._points(x))

    def gradient(self, x: ArrayLike) -> Array:
        """Return ∇h(x), (..., n)."""
        return self.calc_gradient(self._points(x))

    def metric(self, x: ArrayLike) -> Array:
        """Return the metric g(x) = ∇²h(x), (..., n, n) ([Lee2019] Eq. (5.3.17))."""
        return self.calc_metric(self._points(x))

    def inverse_metric_times(self, x: ArrayLike, b: ArrayLike) -> Array:
        """g(x)⁻¹ b, (..., n), without building g: the natural gradient of covectors b (..., n)."""
        return self.calc_inverse_metric_times(*self._point_and(x, b, "b"))

    def divergence(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return Bregman divergence D(x‖y) ≥ 0 (...), zero just when x = y; both inside the set."""
        sizes: Sizes = {}
        return self.calc_divergence(self._points(x, "x", sizes), self._points(y, "y", sizes))

    def longest_step(self, x: ArrayLike, v: ArrayLike) -> Array:
        """Return the time (...) at which the line x + t v leaves the set, inf for never."""
        return self.calc_longest_step(*self._point_and(x, v, "v"))

    def retract(self, x: ArrayLike, v: ArrayLike) -> Array:
        """Return the point (..., n) after a step v (..., n) from x, inside for every v.

        It agrees with x + v to first order, and does not depend on units and frames, except for
        parameters without any bound. `PhysicalInertia`, `Positive` and `Free` follow their
        geodesics. Other manifolds have no geodesics in closed form: they slow the straight line
        down so that it reaches the edge only in the limit. Where the result is so close to the edge
        that rounding puts it outside, or beyond 1e60, the step is shortened: repeated long steps do
        not overflow.
        """
        return self.calc_retract(*self._point_and(x, v, "v"))

    def natural_step(self, x: ArrayLike, b: ArrayLike, time: float) -> Array:
        """`retract` along −time g(x)⁻¹ b (..., n): the natural gradient of b, followed for a time.

        The same point up to rounding, and sooner where there is a way without g⁻¹.
        """
        return self.calc_natural_step(*self._point_and(x, b, "b"), number(time, "time"))

    def _points(self, x: ArrayLike, name: str = "x", sizes: Sizes | None = None) -> Array:
        """Return points (..., n) inside the set."""
        points = real_array(x, name, ("...", self.dimension), sizes)
        if not (inside := self.calc_contains(points)).all():
            outside = points[~inside][0] if inside.ndim else points
            raise ArgumentError(
                f"{name} must be inside {type(self).__name__}; it has {outside.tolist()}.",
                name=name,
            )
        return points

    def _point_and(self, x: ArrayLike, b: ArrayLike, name: str) -> tuple[Array, Array]:
        """Return points with covectors or steps."""
        sizes: Sizes = {}
        points = self._points(x, "x", sizes)
        return points, real_array(b, name, ("...", self.dimension), sizes)

    @abc.abstractmethod
    def calc_contains(self, x: Array) -> NDArray[np.bool_]:
        """Kernel of `contains`."""

    @abc.abstractmethod
    def calc_barrier(self, x: Array) -> Array:
        """Kernel of `barrier`."""

    @abc.abstractmethod
    def calc_gradient(self, x: Array) -> Array:
        """Kernel of `gradient`."""

    @abc.abstractmethod
    def calc_metric(self, x: Array) -> Array:
        """Kernel of `metric`."""

    @abc.abstractmethod
    def calc_inverse_metric_times(self, x: Array, b: Array) -> Array:
        """Kernel of `inverse_metric_times`."""

    @abc.abstractmethod
    def calc_divergence(self, x: Array, y: Array) -> Array:
        """Kernel of `divergence`."""

    @abc.abstractmethod
    def calc_longest_step(self, x: Array, v: Array) -> Array:
        """Kernel of `longest_step`."""

    def calc_frame(self, x: Array) -> Array:
        """Tangent vectors (n, n), as columns, that are orthonormal in the metric at x (n,)."""
        metric = self.calc_metric(x)
        # On a unit diagonal, so that units cost no precision.
        scale = 1.0 / np.sqrt(np.diagonal(metric))
        L = np.linalg.cholesky(metric * scale[:, None] * scale)
        return np.asarray(scale[:, None] * np.linalg.inv(L).T)

    def calc_mirror_span(self, x: Array, rows: Array) -> MirrorSpan:
        """Return points y(λ) with ∇h(y(λ)) = ∇h(x) + Aᵀ λ, for points and rows A (k, ..., n)."""
        flat = rows.reshape(len(rows), x.size)
        pulls = self.calc_inverse_metric_times(x, rows).reshape(flat.shape)
        start = self.calc_gradient(x)

        def point(multipliers: Array) -> Array:
            added = (multipliers @ flat).reshape(start.shape)
            return self.calc_point_of_gradient(start + added, x)

        return MirrorSpan(flat @ pulls.T, point)

    def calc_point_of_gradient(self, gradient: Array, near: Array) -> Array:
        """Return the points y (..., n) with gradients ∇h(y), searched from points near them.

        Where there is no such point, what comes is outside of the manifold, or not a number.
        """
        y = np.empty_like(near)
        for index in np.ndindex(near.shape[:-1]):
            y[index] = _with_gradient(self, gradient[index], near[index])
        return y

    def calc_retract(self, x: Array, v: Array) -> Array:
        """Kernel of `retract`."""
        x, v = np.broadcast_arrays(x, v)
        point, share = self._retract(x, v), np.ones(x.shape[:-1])
        for _ in range(_MOST_HALVINGS):
            outside = ~self._well_inside(point)
            if not outside.any():
                return point
            share = np.where(outside, 0.5 * share, share)
            point = np.where(outside[..., None], self._retract(x, share[..., None] * v), point)
        return np.where(self._well_inside(point)[..., None], point, x)

    def calc_natural_step(self, x: Array, b: Array, time: float) -> Array:
        """Kernel of `natural_step`."""
        return self.calc_retract(x, -time * self.calc_inverse_metric_times(x, b))

    def _well_inside(self, x: Array) -> NDArray[np.bool_]:
        """Return whether points are inside by more than rounding."""
        return self.calc_contains(x)

    def _retract(self, x: Array, v: Array) -> Array:
        """Return the retraction in exact arithmetic; along the straight line unless overridden.

        On the way to an edge at time T, time s of the step is slowed down to T (1 − exp(−s/T)).
        """
        slowed = slowed_time(self.calc_longest_step(x, v))
        return np.asarray(x + slowed[..., None] * v)


def slowed_time(edge: Array) -> Array:
    """Return T (1 − exp(−1/T)) for the time T > 0 of an edge; 1 without an edge."""
    safe = np.where(np.isfinite(edge) & (edge > 0), edge, 1.0)
    return np.where(np.isfinite(edge), -safe * np.expm1(-1.0 / safe), 1.0)


def excess(step: Array) -> Array:
    """Return the contribution of one logarithm to a divergence: r − 1 − log r of r = 1 + step."""
    # Of a small step the difference would be rounding.
    series = step**2 * (0.5 - step * (1 / 3 - step * (1 / 4 - step * (1 / 5 - step / 6))))
    return np.where(np.abs(step) < _SMALL, series, step - np.log1p(step))


def _with_gradient(manifold: Manifold, wanted: Array, y: Array) -> Array:
    """Return the point (n,) with a wanted gradient, from a first guess y; NaN if not found."""
    try:
        for _ in range(_MOST_STEPS):
            off = wanted - manifold.calc_gradient(y)
            step = manifold.calc_inverse_metric_times(y, off)
            length = float(np.sqrt(max(float(off @ step), 0.0)))
            far = length / np.sqrt(manifold.least_weight)  # of one or less, a step is inside
            y = y + (step if far < _SHORT else step / (1.0 + far))
            if length < _EXACT:
                return y
    except (ArgumentError, np.linalg.LinAlgError):  # at the edge, on the way to infinity
        pass
    return np.full(len(y), np.nan)
