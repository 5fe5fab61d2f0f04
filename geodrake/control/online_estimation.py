"""Online parameter estimation from filtered regressors, by Bregman projection.

A `FilteredRegressor` turns positions, velocities and efforts into rows Y p = effort without
accelerations. A `SampleUpdate` projects an estimate p̂ onto such rows, in the divergence of its
manifold. Both are pure functions of arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import expm1, isfinite, sqrt

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import (
    instance,
    integer,
    number,
    one_of,
    one_or_each,
    positive,
    real_array,
)
from geodrake.boundary.showing import Short
from geodrake.compiling import compiled, contiguous
from geodrake.control.adaptation import ConvexSet, ProjectedLaw, natural_adaptation
from geodrake.control.regressor import ControlModel, ControlSample, checked_control
from geodrake.errors import ArgumentError, GeodrakeError
from geodrake.inertia import Array
from geodrake.manifolds import Product
from geodrake.manifolds.projections import Polyhedron
from geodrake.manifolds.robot_kernels import Factors
from geodrake.manifolds.slabs import (
    TOLERANCE,
    SlabProjection,
    calc_slab_projection,
    put_direction,
    slab_projection,
)

_MOST_FILTERS = 100


@dataclass(frozen=True, eq=False)
class FilteredRegressor:
    """Low-pass filtered inverse dynamics, from positions, velocities and efforts.

    The effort is d/dt (Y_p p) − Y_c p, so that its mean over a sampling interval is

        Ȳ p = mean effort,   Ȳ = (Y_p(t) − Y_p(t − h)) / h − mean Y_c,

    which needs no acceleration. Both sides pass through the same low-pass filters λ / (s + λ), so
    that the rows remain exact while velocity noise is attenuated. Intervals with missing data are
    omitted from both sides, which also keeps the rows exact. If a sensor repeats its last state,
    the interval extends to the next new one.

    The filter's state, called memory, is one vector, so that a Drake Context can store it.
    """

    control: ControlModel
    period: float  # sampling interval h, s
    bandwidth: float = 20.0  # λ, 1/s
    order: int = 2  # number of filters in series
    # Whether a sample's effort acted since the previous sample, as for a sampled controller;
    # otherwise it is a sample of a continuous signal.
    held_effort: bool = False

    def __post_init__(self) -> None:
        checked_control(self.control)
        positive(self.period, "period")
        positive(self.bandwidth, "bandwidth")
        integer(self.order, "order", lower=1, upper=_MOST_FILTERS)

    def check_robot(self, control: ControlModel) -> None:
        """Check that the filter was constructed with this ControlModel."""
        if self.control is not control:
            raise ArgumentError(
                "The filter was constructed with another ControlModel.",
                advice="Construct FilteredRegressor and system with the same one.",
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (nv, p) of the regressor."""
        return len(self.control.joints), len(self.control.prior)

    @property
    def size(self) -> int:
        """Length of the memory; see `calc_filtered`."""
        rows, columns = self.shape
        return 1 + (self.order + 1) * rows * (columns + 1)

    def start(self) -> Array:
        """Return the memory before the first sample."""
        return np.zeros(self.size)

    def advanced(
        self,
        memory: Array,
        q: Array,
        qd: Array,
        effort: Array,
        *,
        sample: ControlSample | None = None,
        repeated: bool = False,
    ) -> Array:
        """Return the memory after another sample; non-finite data end the interval.

        Args:
            memory: (size,) memory before the sample; not changed.
            sample: The robot at q, q̇ and v = q̇, if already available.
            repeated: Whether only the effort is new, and the state is the last one again.
        """
        advanced = memory.copy()
        if sample is None:
            sample = self.control.at(q, qd, qd, np.zeros_like(qd))
        try:
            regressors = sample.momentum_regressors
        except GeodrakeError:  # an effect has non-finite columns
            advanced[0] = 0.0
            return advanced
        calc_filtered(regressors, contiguous(effort), (*self.options, repeated), advanced)
        return advanced

    @cached_property
    def options(self) -> tuple[float, float, bool]:
        """Period, s, filter gain 1 − exp(−λ h), and `held_effort`."""
        return self.period, float(-np.expm1(-self.bandwidth * self.period)), self.held_effort

    def skipped(self, memory: Array) -> Array:
        """Return the memory after a missing sample."""
        skipped = memory.copy()
        skipped[0] = 0.0
        return skipped

    def rows(self, memory: Array) -> tuple[Array, Array]:
        """Return the filtered regressor Y (nv, p) and efforts (nv,), N·m or N: Y p = effort."""
        return filtered_rows(memory, *self.shape)


@compiled
def filtered_rows(memory: Array, rows: int, columns: int) -> tuple[Array, Array]:
    """Return the filtered regressor (rows, columns) and efforts from a memory."""
    entries = rows * columns
    first = len(memory) - 2 * (entries + rows)
    last = first + entries
    return memory[first:last].reshape((rows, columns)), memory[last : last + rows]


@compiled
def calc_filtered(
    regressors: Array, effort: Array, options: tuple[float, float, bool, bool], memory: Array
) -> bool:
    """Pass the rows of an interval through all filters, and begin the next interval.

    The interval's rows are [end] − [start], where the sample at its end provides [end], and [start]
    of the next interval.

    Args:
        regressors: (2, nv, p) Y_p and Y_c.
        options: `FilteredRegressor.options`, and whether only the effort is new.
        memory: Length of the interval in periods, 0 if it is omitted; then (order + 1) vectors
            (nv p + nv,): the states of the filters, and [start] of the interval.

    Returns:
        Whether all values were finite; otherwise the interval is omitted.
    """
    period, gain, held, repeated = options
    momentum, drift = regressors[0].ravel(), regressors[1].ravel()
    entries, periods = len(momentum), memory[0]
    width = entries + len(effort)
    order = (len(memory) - 1) // width - 1
    if periods > 1.0:
        gain = 1.0 - (1.0 - gain) ** periods
    square = 0.0
    end, next_start = np.empty(width), np.empty(width)
    for i in range(entries):
        rate, mean = momentum[i] / period, 0.5 * drift[i]
        end[i], next_start[i] = rate - mean, rate + mean
    for i, value in enumerate(effort):
        mean = value if held else 0.5 * value
        end[entries + i], next_start[entries + i] = mean, mean - value
    for i in range(width):
        square += end[i] * end[i]
    if not square < np.inf:
        memory[0] = 0.0
        return False
    start = memory[1 + order * width :]
    if repeated and periods > 0.0:
        for i in range(width):
            start[i] += next_start[i] - end[i]
        memory[0] = periods + 1.0
        return True
    for i in range(width) if periods > 0.0 else range(0):
        value = (end[i] - start[i]) / periods
        for k in range(order):
            index = 1 + k * width + i
            memory[index] += gain * (value - memory[index])
            value = memory[index]
    start[:] = next_start
    memory[0] = 1.0
    return True


Rows = tuple[Array, Array]
"""A regressor (k, n) and its efforts (k,)."""

Projector = tuple[Array, Factors, tuple[float, float]]
"""Tolerances, (nv,) or (1,), and factors and `options` of `calc_slab_projection`."""

METHODS = ("projection", "nudge")
_DAMPING = 1e-2  # relative regularization of the rows' squared lengths
_TINY = 1e-300  # absolute one, for zero rows


@dataclass(frozen=True, eq=False)
class SampleUpdate(Short):
    """A projection of an estimate onto the slabs of a sample, and onto a constraint set.

    A "projection" is exact ([Lee2019] Eq. (2.2.11), (5.4.59)). It projects onto the slabs of this
    sample and of an earlier one, or onto those of this sample if the former do not intersect. A
    sample whose own slabs do not intersect is ignored.

    A "nudge" is one damped Newton step toward the slabs of both samples. It costs less, and it
    averages samples that contradict each other or the model, as on a real robot whose unknown
    friction exceeds ε.

    Neither moves the estimate away from a truth that is in the slabs.

    Attributes:
        tolerance: Scalar or (nv,) ε, N·m or N: error of filtered efforts that is ignored.
        constraints: A convex set that contains the truth, if known.
        relaxation: Fraction in (0, 1] of the step to the slabs; smaller values reduce the influence
            of noise. None for 1, or 0.5 for a nudge.
        forgetting: Rate, 1/s, at which the barrier's gradient at the estimate decays to that at the
            prior without samples; zero for no forgetting.
        prior: (n,) point to which it decays, inside the manifold.
    """

    manifold: Product
    tolerance: ArrayLike
    constraints: ConvexSet | Polyhedron | None = None
    method: str = "projection"
    relaxation: float | None = None
    forgetting: float = 0.0
    prior: Array | None = None

    def __post_init__(self) -> None:
        instance(self.manifold, "manifold", Product)
        epsilon = real_array(self.tolerance, "tolerance")
        one_or_each(epsilon, "tolerance", epsilon.size, strict=True)
        one_of(self.method, "method", METHODS)
        if self.relaxation is not None:
            number(self.relaxation, "relaxation", upper=1.0)
            positive(self.relaxation, "relaxation")
        number(self.forgetting, "forgetting", lower=0.0)
        if self.forgetting > 0 and self.prior is None:
            raise ArgumentError("Forgetting needs a prior.")
        if self.prior is not None:
            prior = real_array(self.prior, "prior", (self.manifold.dimension,))
            if not self.manifold.contains(prior):
                raise ArgumentError(f"A prior must be inside the manifold; got {prior.tolist()}.")
        _ = self._limited  # report invalid constraints now, not while a robot moves

    @cached_property
    def _limited(self) -> ProjectedLaw | None:
        if self.constraints is None:
            return None
        return ProjectedLaw(natural_adaptation(self.manifold), self.constraints)

    @cached_property
    def _prior_gradient(self) -> Array:
        return self.manifold.calc_gradient(np.asarray(self.prior, float))

    @cached_property
    def _share(self) -> float:
        if self.relaxation is not None:
            return self.relaxation
        return 1.0 if self.method == "projection" else 0.5

    def updated(
        self, p: Array, Y: Array, effort: Array, dt: float, *, earlier: Rows | None = None
    ) -> SlabProjection:
        """Return the estimate after a sample; unchanged if data are not finite.

        Its error, which certifies the projection onto the slabs, is at most 1e-8, or infinite
        without a projection.

        Args:
            p: (n,) estimate inside the manifold.
            Y: (nv, n) filtered regressor.
            earlier: Regressor and efforts of an earlier sample, to be satisfied as well. One sample
                determines few of the parameters, and would soon be forgotten otherwise.
        """
        unchanged = SlabProjection(p, np.inf, 0)
        if not (isfinite(np.vdot(Y, Y)) and isfinite(np.vdot(effort, effort))):
            return unchanged
        start = self._forgotten(p, dt) if self.forgetting > 0 else p
        try:
            projection = self._project(start, (Y, effort), earlier)
            if self._limited is not None:
                projection = projection._replace(point=self._limited.project(projection.point))
        except (GeodrakeError, np.linalg.LinAlgError):
            return unchanged
        return projection if self.manifold.calc_contains(projection.point) else unchanged

    def _project(self, p: Array, rows: Rows, earlier: Rows | None) -> SlabProjection:
        """Project an estimate onto the slabs of a sample, and of an earlier one if compatible."""
        Y, effort = rows
        if earlier is not None:
            Y, effort = np.concatenate((Y, earlier[0])), np.concatenate((effort, earlier[1]))
        epsilon = np.resize(np.asarray(self.tolerance, float), len(effort))
        if self.method == "nudge":
            point = slab_step(self.manifold, p, Y, effort, epsilon, relaxation=self._share)
            return SlabProjection(point, np.inf, 1)
        projection = slab_projection(
            self.manifold, p, Y, effort - epsilon, effort + epsilon, share=self._share
        )
        if projection.certified:
            return projection
        return self._project(p, rows, None) if earlier else projection._replace(point=p)

    @cached_property
    def compiled(self) -> Projector | None:
        """Arguments of `calc_projected`; None if it cannot perform this update."""
        robot = self.manifold.robot
        has_more = self._limited is not None or self.forgetting > 0
        if self.method == "nudge" or robot is None or has_more:
            return None
        options = self.manifold.least_weight, float(self._share)
        return np.atleast_1d(np.asarray(self.tolerance, float)), robot, options

    def _forgotten(self, p: Array, dt: float) -> Array:
        """Return the estimate after ∇h decays toward that of the prior for a time step."""
        gradient = self.manifold.calc_gradient(p)
        gradient -= expm1(-self.forgetting * dt) * (self._prior_gradient - gradient)
        return self.manifold.calc_point_of_gradient(gradient, p)


@compiled
def calc_projected(
    p: Array, rows: Rows, earlier: Rows, projector: Projector, y: Array
) -> tuple[float, int]:
    """Write the projection of an estimate onto the slabs of a sample and of an earlier one.

    If these do not intersect, project onto the slabs of the sample only. If that fails too, write
    the estimate, and return an infinite error.

    Args:
        earlier: Rows of an earlier sample, possibly empty.

    Returns:
        Error and number of steps of `calc_slab_projection`.
    """
    (Y, effort), (tolerances, factors, options) = rows, projector
    count, error, steps = len(effort), np.inf, 0
    for earlier_count in (len(earlier[1]), 0):
        A = np.empty((count + earlier_count, len(p)))
        lower, upper = np.empty(len(A)), np.empty(len(A))
        for i in range(len(A)):
            is_present = i < count
            A[i] = Y[i] if is_present else earlier[0][i - count]
            value = effort[i] if is_present else earlier[1][i - count]
            epsilon = tolerances[i % count if len(tolerances) > 1 else 0]
            lower[i], upper[i] = value - epsilon, value + epsilon
        error, steps = calc_slab_projection(p, (A, lower, upper), factors, options, y)
        if error <= TOLERANCE:
            return error, steps
    y[:] = p
    return np.inf, steps


def slab_step(
    manifold: Product,
    p: Array,
    Y: Array,
    effort: Array,
    tolerance: Array,
    *,
    relaxation: float = 1.0,
) -> Array:
    """Take one Newton step toward the slabs |Y p − effort| ≤ ε that p violates.

    The Bregman projection onto them, [Lee2019] Eq. (2.2.11), is the y with ∇h(y) = ∇h(p) − Yᵀ λ for
    multipliers λ of the active rows, few unknowns compared with the parameters. For one of many
    samples one step suffices. Its length is limited to one in the manifold's metric, and nearly
    dependent rows are damped, so that contradictory samples have little influence. If the truth is
    in the slabs, the step moves toward it.

    Args:
        Y: (k, n) rows, with (k,) efforts and tolerances ε > 0.
        relaxation: Fraction of the step, in (0, 1]; smaller values reduce the influence of noise.

    Returns:
        The new estimate (n,), or p itself if it is in all slabs. Due to rounding it may be outside
        the manifold, or NaN.
    """
    error = Y @ p - effort
    error -= np.minimum(np.maximum(error, -tolerance), tolerance)  # zero in the slab
    (active,) = error.nonzero()
    if not len(active):
        return p
    if len(active) < len(error):
        Y, error = Y.take(active, 0), error.take(active)
    span = manifold.calc_mirror_span(p, Y)
    multipliers = calc_multipliers(span.products, error)
    length = sqrt(max(float(error @ multipliers) / manifold.least_weight, 0.0))
    return span.point(multipliers * (-relaxation / (1.0 + length)))


@compiled
def calc_multipliers(products: Array, error: Array) -> Array:
    """Return Newton multipliers (k,) for the rows outside their slabs; none moves a row farther.

    They are those of the first step of a projection (`manifolds.slabs`), damped in proportion to
    each row's squared length.

    Args:
        products: (k, k) inner products of the rows; overwritten.
        error: (k,) distance of each row outside its slab.
    """
    for i in range(len(error)):
        products[i, i] = products[i, i] * (1.0 + _DAMPING) + _TINY
    multipliers = np.empty(len(error))
    put_direction(products, error, np.zeros(len(error)), multipliers)
    return multipliers
