"""Parameters with separate bounds: positive, bounded and free ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import LARGEST, Sizes, integer, real_array
from geodrake.compiling import contiguous
from geodrake.errors import ArgumentError
from geodrake.manifolds.base import Array, Manifold, MirrorSpan, excess, slowed_time
from geodrake.manifolds.robot_kernels import Factors, calc_natural_steps, robot_span

_LONGEST_GROWTH = 300.0  # logarithm of the largest growth without overflow
_MOST = 10**6  # largest number of parameters
_LEAST_SLACK = 1e-150  # smallest slack whose inverse square is finite


@dataclass(frozen=True)
class Interval(Manifold):
    """Parameters with separate bounds, lᵢ < xᵢ < uᵢ.

    h = −Σ log(xᵢ − lᵢ) − Σ log(uᵢ − xᵢ), [Lee2019] Eq. (5.3.35). An infinite bound has no term; a
    parameter without bounds is flat, with the term ½ xᵢ².

    Attributes:
        lower: The n lower bounds l.
        upper: The n upper bounds u.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def __post_init__(self) -> None:
        sizes: Sizes = {}
        lower = real_array(self.lower, "lower", ("n",), sizes, finite=False)
        upper = real_array(self.upper, "upper", ("n",), sizes, finite=False)
        object.__setattr__(self, "lower", tuple(lower.tolist()))
        object.__setattr__(self, "upper", tuple(upper.tolist()))
        if not ((lower < upper) & (lower < np.inf) & (upper > -np.inf)).all():
            raise ArgumentError(
                f"Every lower bound needs an upper bound above it; got {self.lower} and "
                f"{self.upper}."
            )

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.lower)

    @cached_property
    def _bounds(self) -> tuple[Array, Array]:
        """The lower and the upper bounds (n,)."""
        return np.array(self.lower), np.array(self.upper)

    @cached_property
    def _flat(self) -> NDArray[np.bool_]:
        """(n,) whether a parameter has no bound."""
        return np.isinf(self.lower) & np.isinf(self.upper)

    @cached_property
    def _one_sided(self) -> NDArray[np.bool_]:
        """(n,) whether a parameter has exactly one bound."""
        return np.isfinite(self.lower) ^ np.isfinite(self.upper)

    @cached_property
    def _only_bound(self) -> Array:
        """Bounds of the one-sided parameters."""
        lower, upper = self._bounds
        return np.where(np.isfinite(lower), lower, upper)[self._one_sided]

    @cached_property
    def only_lower(self) -> bool:
        """Whether all parameters have a lower bound and no upper one."""
        return bool(np.isfinite(self.lower).all() and np.isinf(self.upper).all())

    def _slacks(self, x: Array) -> tuple[Array, Array]:
        """Return the distances to the lower and upper bounds."""
        lower, upper = self._bounds
        return x - lower, upper - x

    def calc_contains(self, x: Array) -> NDArray[np.bool_]:
        """Return whether l < x < u in every parameter (...)."""
        lower, upper = self._bounds
        return np.asarray(((x > lower) & (x < upper)).all(-1))

    def calc_barrier(self, x: Array) -> Array:
        """Return h(x), [Lee2019] Eq. (5.3.35)."""
        logs = sum(np.log(np.where(np.isinf(slack), 1.0, slack)) for slack in self._slacks(x))
        return (np.where(self._flat, 0.5 * x * x, 0.0) - logs).sum(-1)

    def calc_gradient(self, x: Array) -> Array:
        """Return ∇h(x), (..., n)."""
        if self.only_lower:
            return np.asarray(-1.0 / (x - self._bounds[0]))
        below, above = self._slacks(x)
        return np.where(self._flat, x, 1.0 / above - 1.0 / below)

    def _curvature(self, x: Array) -> Array:
        below, above = self._slacks(x)
        return np.where(self._flat, 1.0, below**-2.0 + above**-2.0)

    def calc_metric(self, x: Array) -> Array:
        """Return the diagonal metric of [Lee2019] Eq. (5.3.36)."""
        return self._curvature(x)[..., None] * np.eye(self.dimension)

    def calc_inverse_metric_times(self, x: Array, b: Array) -> Array:
        """Return g(x)⁻¹ b componentwise, [Lee2019] Eq. (B.4.22) and (B.4.23)."""
        if self.only_lower:
            slack = x - self._bounds[0]
            return np.asarray(slack * slack * b)
        return b / self._curvature(x)

    def calc_divergence(self, x: Array, y: Array) -> Array:
        """Return D(x‖y), [Lee2019] Eq. (5.3.37)."""
        step = x - y
        below, above = self._slacks(y)
        terms = excess(step / below) + excess(-step / above)
        return np.where(self._flat, 0.5 * step * step, terms).sum(-1)

    def calc_longest_step(self, x: Array, v: Array) -> Array:
        """Return the time (...) at which x + t v reaches a bound."""
        below, above = self._slacks(x)
        toward = np.where(v > 0, above, below)
        moving = v != 0
        times = toward / np.where(moving, np.abs(v), 1.0)
        return np.where(moving, times, np.inf).min(-1, initial=np.inf)

    def calc_frame(self, x: Array) -> Array:
        """Return the diagonal (n, n)."""
        return np.diag(1.0 / np.sqrt(self._curvature(x)))

    def calc_mirror_span(self, x: Array, rows: Array) -> MirrorSpan:
        """Return the span, by the compiled kernel if there are only lower bounds."""
        if self.only_lower:
            return robot_span(contiguous(x), contiguous(rows), self._factors(x))
        return super().calc_mirror_span(x, rows)

    def calc_point_of_gradient(self, gradient: Array, near: Array) -> Array:
        """Return the points componentwise; NaN where there is none."""
        lower, upper = self._bounds
        if self.only_lower:
            return np.asarray(lower + 1.0 / _positive(-gradient))
        single, double = self._one_sided, np.isfinite(lower) & np.isfinite(upper)
        sign = np.where(np.isfinite(lower[single]), 1.0, -1.0)  # away from the bound
        y = gradient.copy()
        y[..., single] = self._only_bound + sign / _positive(-sign * gradient[..., single])
        y[..., double] = _balanced(lower[double], upper[double], gradient[..., double])
        return y

    def calc_natural_step(self, x: Array, b: Array, time: float) -> Array:
        """Return the geodesic step, by the compiled kernel if short and with only lower bounds."""
        if self.only_lower and x.shape == b.shape:
            stepped, each = np.empty(x.shape), (contiguous(x).ravel(), contiguous(b).ravel())
            if calc_natural_steps(*each, self._factors(x), float(time), stepped.reshape(-1)):
                return stepped
        return super().calc_natural_step(x, b, time)

    def _factors(self, x: Array) -> Factors:
        """Return the factors of points (..., n) with only lower bounds."""
        places, lower = np.arange(x.size), np.broadcast_to(self._bounds[0], x.shape).flatten()
        return places[:0], np.empty(0), places, lower, np.ones(x.size)

    def _well_inside(self, x: Array) -> NDArray[np.bool_]:
        return self.calc_contains(x) & (np.abs(x) < LARGEST).all(-1)

    def _retract(self, x: Array, v: Array) -> Array:
        """Return geodesics of one-sided parameters, and slowed straight lines of the others."""
        lower, upper = self._bounds
        below, above = self._slacks(x)
        bounded = self._one_sided
        sign = np.where(np.isinf(lower), -1.0, 1.0)  # away from the bound
        slack = np.where(bounded, np.where(np.isinf(lower), above, below), 1.0)
        growth = np.clip(sign * v / slack, -_LONGEST_GROWTH, _LONGEST_GROWTH)
        change = np.where(bounded, np.maximum(slack * np.expm1(growth), _LEAST_SLACK - slack), 0.0)
        geodesic = x + sign * change
        edge = np.where(v > 0, above, below) / np.where(v == 0, 1.0, np.abs(v))
        line = x + np.where(v == 0, 1.0, slowed_time(edge)) * v
        point = np.where(bounded, geodesic, line)
        # Rounding may put a point onto a bound.
        least = np.maximum(np.nextafter(lower, np.inf), lower + _LEAST_SLACK)
        most = np.minimum(np.nextafter(upper, -np.inf), upper - _LEAST_SLACK)
        return np.clip(point, least, most)


def _positive(x: Array) -> Array:
    """Replace values that are not positive by NaN."""
    x[x <= 0] = np.nan
    return x


def _balanced(lower: Array, upper: Array, force: Array) -> Array:
    """Return the y with 1/(u − y) − 1/(y − l) = force, precise in the smaller slack."""
    half = 0.5 * (upper - lower)
    q = np.abs(half * force)
    root = np.hypot(1.0, q)
    small = half * (1.0 + 1.0 / (root + q)) / (1.0 + root)
    return np.asarray(np.where(force < 0, lower + small, upper - small))


class Positive(Interval):
    """n positive parameters with h = −Σ log xᵢ ([Lee2019] Eq. (5.3.31))."""

    def __init__(self, dimension: int = 1) -> None:
        integer(dimension, "dimension", lower=0, upper=_MOST)
        super().__init__((0.0,) * dimension, (np.inf,) * dimension)


class Free(Interval):
    """n parameters without bounds: ℝⁿ with h = ½ ‖x‖², which depends on their units."""

    def __init__(self, dimension: int = 1) -> None:
        integer(dimension, "dimension", lower=0, upper=_MOST)
        super().__init__((-np.inf,) * dimension, (np.inf,) * dimension)
