"""Base class of the barrier-Hessian manifolds."""

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
_SMALL = 1e-3  # step below which five terms of the series are exact to rounding
_MOST_STEPS = 80
_SHORT = 0.25  # length in the metric of a full Newton step
_EXACT = 1e-7  # length of the last Newton step, whose error is of its square


class MirrorSpan(NamedTuple):
    """Points y(λ) with ∇h(y) = ∇h(x) + Aᵀ λ, from a point x (n,) along covectors A (k, n).

    Bregman projections lie in this span: the optimum's gradient differs from that of x by a
    combination of rows ([Lee2019] Eq. (2.2.11)).
    """

    products: Array  # (k, k) inner products A g(x)⁻¹ Aᵀ of the covectors
    # Maps multipliers λ (k,) to y(λ) (n,), which is outside of the manifold or NaN if there is no
    # such point.
    point: Callable[[Array], Array]


class Manifold(abc.ABC):
    """An open convex set in ℝⁿ with a barrier h, [Lee2019] Definition 5.3.3.

    Methods check their arguments, and raise an ArgumentError for points outside of the set and for
    covectors that are not finite. Kernels of the same names with the prefix `calc_` do not: they
    serve controllers, and solvers whose iterates may be outside. Subclasses define the kernels.
    """

    @property
    @abc.abstractmethod
    def dimension(self) -> int:
        """Number n of coordinates."""

    @property
    def least_weight(self) -> float:
        """Smallest weight of a logarithm in the barrier, at most 1."""
        return 1.0

    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Return whether each point x (..., n) is finite and inside the set."""
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
        """Return g(x)⁻¹ b (..., n), the natural gradient of covectors b (..., n)."""
        return self.calc_inverse_metric_times(*self._point_and(x, b, "b"))

    def divergence(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the Bregman divergence D(x‖y) ≥ 0 (...), zero only for x = y."""
        sizes: Sizes = {}
        return self.calc_divergence(self._points(x, "x", sizes), self._points(y, "y", sizes))

    def longest_step(self, x: ArrayLike, v: ArrayLike) -> Array:
        """Return the time (...) at which the line x + t v leaves the set, or inf."""
        return self.calc_longest_step(*self._point_and(x, v, "v"))

    def retract(self, x: ArrayLike, v: ArrayLike) -> Array:
        """Return the point (..., n) after a step v (..., n) from x, inside for every v.

        It equals x + v to first order, and is independent of units and frames, except for
        parameters without bounds. `PhysicalInertia`, `Positive` and `Free` follow their geodesics.
        Other manifolds have no closed-form geodesics: they slow the straight line down so that it
        reaches the boundary only in the limit. The step is shortened if rounding puts its end
        outside, or beyond 1e60, so that repeated long steps do not overflow.
        """
        return self.calc_retract(*self._point_and(x, v, "v"))

    def natural_step(self, x: ArrayLike, b: ArrayLike, time: float) -> Array:
        """Return `retract` along −time g(x)⁻¹ b (..., n), faster if g⁻¹ can be avoided."""
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
        """Return orthonormal tangent vectors in the metric at x (n,), as columns (n, n)."""
        metric = self.calc_metric(x)
        # With a unit diagonal, units do not cost precision.
        scale = 1.0 / np.sqrt(np.diagonal(metric))
        L = np.linalg.cholesky(metric * scale[:, None] * scale)
        return np.asarray(scale[:, None] * np.linalg.inv(L).T)

    def calc_mirror_span(self, x: Array, rows: Array) -> MirrorSpan:
        """Return points y(λ) with ∇h(y(λ)) = ∇h(x) + Aᵀ λ, for points and rows A (k, ..., n)."""
        flat = rows.reshape(len(rows), x.size)
        vectors = self.calc_inverse_metric_times(x, rows).reshape(flat.shape)
        start = self.calc_gradient(x)

        def point(multipliers: Array) -> Array:
            added = (multipliers @ flat).reshape(start.shape)
            return self.calc_point_of_gradient(start + added, x)

        return MirrorSpan(flat @ vectors.T, point)

    def calc_point_of_gradient(self, gradient: Array, near: Array) -> Array:
        """Return the points y (..., n) with gradients ∇h(y), searched from points `near` them.

        The result is outside of the manifold or NaN where there is no such point.
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
        """Return the retraction in exact arithmetic, by default along the straight line.

        With the boundary at time T, time s of the step is slowed down to T (1 − exp(−s/T)).
        """
        slowed = slowed_time(self.calc_longest_step(x, v))
        return np.asarray(x + slowed[..., None] * v)


def slowed_time(edge: Array) -> Array:
    """Return T (1 − exp(−1/T)) for a boundary at time T > 0; 1 without a boundary."""
    safe = np.where(np.isfinite(edge) & (edge > 0), edge, 1.0)
    return np.where(np.isfinite(edge), -safe * np.expm1(-1.0 / safe), 1.0)


def excess(step: Array) -> Array:
    """Return r − 1 − log r with r = 1 + step, the divergence of one logarithm."""
    # The series avoids cancellation for small steps.
    series = step**2 * (0.5 - step * (1 / 3 - step * (1 / 4 - step * (1 / 5 - step / 6))))
    return np.where(np.abs(step) < _SMALL, series, step - np.log1p(step))


def _with_gradient(manifold: Manifold, wanted: Array, y: Array) -> Array:
    """Return the point (n,) with a wanted gradient, from a first guess y; NaN if not found."""
    try:
        for _ in range(_MOST_STEPS):
            error = wanted - manifold.calc_gradient(y)
            step = manifold.calc_inverse_metric_times(y, error)
            length = float(np.sqrt(max(float(error @ step), 0.0)))
            relative = length / np.sqrt(manifold.least_weight)  # steps of at most 1 stay inside
            y = y + (step if relative < _SHORT else step / (1.0 + relative))
            if length < _EXACT:
                return y
    except (ArgumentError, np.linalg.LinAlgError):  # diverged to the boundary
        pass
    return np.full(len(y), np.nan)
