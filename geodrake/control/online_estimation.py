"""Estimation while data come in: filtered regressors and projections onto what samples say.

A `FilteredRegressor` turns positions, velocities and efforts into rows Y p = effort without an
acceleration; a `SampleUpdate` moves an estimate p̂ into agreement with such rows, along the way
that moves it least in the divergence of its manifold. Both are pure: array in, array out.
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
    """Low-passed inverse dynamics, from positions, velocities and efforts.

    The effort is d/dt (Y_p p) − Y_c p, so over a sampling interval its mean is

        Ȳ p = mean effort,   Ȳ = (Y_p(t) − Y_p(t − h)) / h − mean Y_c,

    which needs no acceleration. Both sides pass through the same low-pass filters λ / (s + λ), so
    that the rows stay true and the noise of velocities does not get through. An interval at whose
    ends something is missing is left out of both sides, which keeps the rows true as well. Where a
    sensor only repeats its last state, the interval goes on to its next one.

    The memory of the filter is one vector, so that a Drake Context can hold it.
    """

    control: ControlModel
    period: float  # sampling interval h, s
    bandwidth: float = 20.0  # λ, 1/s
    order: int = 2  # number of filters after each other
    # Whether the effort at an instant is the one that acted since the last instant, as that of a
    # sampled controller; else it is a sample of an effort that changes smoothly.
    held_effort: bool = False

    def __post_init__(self) -> None:
        checked_control(self.control)
        positive(self.period, "period")
        positive(self.bandwidth, "bandwidth")
        integer(self.order, "order", lower=1, upper=_MOST_FILTERS)

    def check_robot(self, control: ControlModel) -> None:
        """Check that the filter is one for a robot."""
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
        """Length of the memory: a number, and for every filter a regressor and its efforts."""
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
        """Return the memory after one more sample; whatever is not finite ends an interval.

        Args:
            memory: (size,) of the last sample, not changed.
            sample: The robot at q, q̇ and v = q̇, if that is known already.
            repeated: Whether positions and velocities are no new measurement but the last one: then
                the effort alone is new.
        """
        after = memory.copy()
        if sample is None:
            sample = self.control.at(q, qd, qd, np.zeros_like(qd))
        try:
            both = sample.momentum_regressors
        except GeodrakeError:  # of an effect that has no finite columns
            after[0] = 0.0
            return after
        calc_filtered(both, contiguous(effort), (*self.how, repeated), after)
        return after

    @cached_property
    def how(self) -> tuple[float, float, bool]:
        """Return the period, s, the share that a filter lets through, and `held_effort`."""
        return self.period, float(-np.expm1(-self.bandwidth * self.period)), self.held_effort

    def skipped(self, memory: Array) -> Array:
        """Return the memory after a sample that is missing."""
        after = memory.copy()
        after[0] = 0.0
        return after

    def rows(self, memory: Array) -> tuple[Array, Array]:
        """Return the filtered regressor Y (nv, p) and efforts (nv,), N·m or N: Y p = effort."""
        return filtered_rows(memory, *self.shape)


@compiled
def filtered_rows(memory: Array, rows: int, columns: int) -> tuple[Array, Array]:
    """Return the regressor (rows, columns) and the efforts that a memory holds."""
    entries = rows * columns
    first = len(memory) - 2 * (entries + rows)
    last = first + entries
    return memory[first:last].reshape((rows, columns)), memory[last : last + rows]


@compiled
def calc_filtered(
    both: Array, effort: Array, how: tuple[float, float, bool, bool], memory: Array
) -> bool:
    """Pass the rows of an interval through all filters, and begin the next one.

    What a sample adds to the interval that it ends is [now], and what it takes off the next one
    [before]: the interval's rows are [now] − [before], with the filters linear in both.

    Args:
        both: (2, nv, p) Y_p and Y_c.
        how: h, s; the share that a filter lets through in that time; whether the effort is the one
            that acted since the last instant; and whether only the effort is new.
        memory: How many h the interval had, 0 if it is left out, and then (order + 1) times
            (nv p + nv,) states of the filters, and what the interval began with.

    Returns:
        Whether all was finite; the interval is left out otherwise.
    """
    period, one, held, repeated = how
    momentum, drift = both[0].ravel(), both[1].ravel()
    entries, periods = len(momentum), memory[0]
    width = entries + len(effort)
    last = (len(memory) - 1) // width - 1
    share = one if periods <= 1.0 else 1.0 - (1.0 - one) ** periods
    goes_on, size = repeated and periods > 0.0, 0.0
    now, before = np.empty(width), np.empty(width)
    for i in range(entries):
        moved, rest = momentum[i] / period, 0.5 * drift[i]
        now[i], before[i] = moved - rest, moved + rest
    for i, value in enumerate(effort):
        mean = value if held else 0.5 * value
        now[entries + i], before[entries + i] = mean, mean - value
    for i in range(width):
        size += now[i] * now[i]
    if not size < np.inf:
        memory[0] = 0.0
        return False
    begun = memory[1 + last * width :]
    if goes_on:
        for i in range(width):
            begun[i] += before[i] - now[i]
        memory[0] = periods + 1.0
        return True
    for i in range(width) if periods > 0.0 else range(0):
        value = (now[i] - begun[i]) / periods
        for k in range(last):
            at = 1 + k * width + i
            memory[at] += share * (value - memory[at])
            value = memory[at]
    begun[:] = before
    memory[0] = 1.0
    return True


Rows = tuple[Array, Array]
"""A regressor (k, n) and its efforts (k,)."""

Projecting = tuple[Array, Factors, tuple[float, float]]
"""Tolerances, (nv,) or (1,), and factors and `options` of `calc_slab_projection`."""

METHODS = ("projection", "nudge")
_SHARING = 1e-2  # of a row's squared length, added to it
_NOTHING = 1e-300  # squared length of a row that says nothing


@dataclass(frozen=True, eq=False)
class SampleUpdate(Short):
    """A projection of an estimate onto the slabs of a sample, and onto a constraint set.

    A "projection" is exact ([Lee2019] Eq. (2.2.11), (5.4.59)): onto the slabs of this sample and of
    an earlier one, if there is one and some bodies are in all of them; else onto those of this one.
    A sample of which no bodies are in the slabs is left out.

    A "nudge" is one damped step of Newton's method toward the slabs of both. It costs less, and
    averages samples that contradict each other or the model: where ε is less than what the model
    lacks, as on a real robot whose friction is not known.

    Neither takes the estimate farther from a truth that is in the slabs.

    Attributes:
        tolerance: (nv,) or one ε, N·m or N: the error of filtered efforts that is not believed.
        constraints: A convex set that holds the truth, if one is known.
        relaxation: Share in (0, 1] of the way to the slabs that is gone: less follows noise less.
            None for all of it, or for half of a nudge.
        forgetting: Rate, 1/s, at which the gradient of the barrier at an estimate goes back to that
            at the prior, where no sample says otherwise; zero for never.
        prior: (n,) where it goes back to, inside of the manifold.
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
        _ = self._limited  # what does not fit is reported now, not while a robot moves

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
        """Return the estimate after a sample; the one before if something is not finite.

        Its error, the certificate of the projection onto the slabs, is 1e-8 at most; infinite where
        none was found or sought.

        Args:
            p: (n,) estimate inside of the manifold.
            Y: (nv, n) filtered regressor.
            earlier: Regressor and efforts of an earlier sample, which are to hold as well: what one
                sample says of the parameters is little, and soon forgotten without.
        """
        stays = SlabProjection(p, np.inf, 0)
        if not (isfinite(np.vdot(Y, Y)) and isfinite(np.vdot(effort, effort))):
            return stays
        moved = self._forgotten(p, dt) if self.forgetting > 0 else p
        try:
            found = self._toward(moved, (Y, effort), earlier)
            if self._limited is not None:
                found = found._replace(point=self._limited.project(found.point))
        except (GeodrakeError, np.linalg.LinAlgError):
            return stays
        return found if self.manifold.calc_contains(found.point) else stays

    def _toward(self, p: Array, rows: Rows, earlier: Rows | None) -> SlabProjection:
        """Return where a sample takes an estimate, together with an earlier one if they agree."""
        Y, effort = rows
        if earlier is not None:
            Y, effort = np.concatenate((Y, earlier[0])), np.concatenate((effort, earlier[1]))
        epsilon = np.resize(np.asarray(self.tolerance, float), len(effort))
        if self.method == "nudge":
            nudged = slab_step(self.manifold, p, Y, effort, epsilon, relaxation=self._share)
            return SlabProjection(nudged, np.inf, 1)
        found = slab_projection(
            self.manifold, p, Y, effort - epsilon, effort + epsilon, share=self._share
        )
        if found.certified:
            return found
        return self._toward(p, rows, None) if earlier is not None else found._replace(point=p)

    @cached_property
    def compiled(self) -> Projecting | None:
        """Return what `calc_projected` needs; None where that is not the whole update."""
        robot, others = self.manifold.robot, (self._limited is not None or self.forgetting > 0)
        if self.method == "nudge" or robot is None or others:
            return None
        how = self.manifold.least_weight, float(self._share)
        return np.atleast_1d(np.asarray(self.tolerance, float)), robot, how

    def _forgotten(self, p: Array, dt: float) -> Array:
        """Return the point whose ∇h is nearer to that of the prior, by the share of a time step."""
        gradient = self.manifold.calc_gradient(p)
        gradient -= expm1(-self.forgetting * dt) * (self._prior_gradient - gradient)
        return self.manifold.calc_point_of_gradient(gradient, p)


@compiled
def calc_projected(
    p: Array, rows: Rows, earlier: Rows, projecting: Projecting, y: Array
) -> tuple[float, int]:
    """Write the projection of an estimate onto the slabs of a sample and of an earlier one.

    Where they do not agree, it is the one onto those of the sample; where there is none either, it
    is the estimate itself, and the error is infinite.

    Args:
        earlier: Those of an earlier one, or none at all.

    Returns:
        Error and steps of `calc_slab_projection`.
    """
    (Y, effort), (tolerances, factors, how) = rows, projecting
    count, error, steps = len(effort), np.inf, 0
    for others in (len(earlier[1]), 0):
        A = np.empty((count + others, len(p)))
        lower, upper = np.empty(len(A)), np.empty(len(A))
        for i in range(len(A)):
            own = i < count
            A[i] = Y[i] if own else earlier[0][i - count]
            value = effort[i] if own else earlier[1][i - count]
            epsilon = tolerances[i % count if len(tolerances) > 1 else 0]
            lower[i], upper[i] = value - epsilon, value + epsilon
        error, steps = calc_slab_projection(p, (A, lower, upper), factors, how, y)
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
    """Take one step of Newton's method toward the slabs |Y p − effort| ≤ ε that p is outside of.

    The Bregman projection onto them, [Lee2019] Eq. (2.2.11), is the y with ∇h(y) = ∇h(p) − Yᵀ λ for
    multipliers λ of the rows that bind: a handful of unknowns, however many parameters there are.
    For one of many samples one step is enough. It has its own way to be short, at most one in the
    manifold's metric, and rows that nearly depend on each other share what they ask for, so that
    samples that contradict each other do little. With the truth in the slabs, it comes nearer.

    Args:
        Y: (k, n) rows, with (k,) efforts and tolerances ε > 0.
        relaxation: Share of the step that is made, in (0, 1]: less follows noise less.

    Returns:
        The estimate (n,); itself if it is in all slabs. Rounding may leave it outside of the
        manifold, or not a number.
    """
    error = Y @ p - effort
    error -= np.minimum(np.maximum(error, -tolerance), tolerance)  # zero in the slab
    (bound,) = error.nonzero()
    if not len(bound):
        return p
    if len(bound) < len(error):
        Y, error = Y.take(bound, 0), error.take(bound)
    span = manifold.calc_mirror_span(p, Y)
    multipliers = calc_multipliers(span.products, error)
    length = sqrt(max(float(error @ multipliers) / manifold.least_weight, 0.0))
    return span.point(multipliers * (-relaxation / (1.0 + length)))


@compiled
def calc_multipliers(products: Array, error: Array) -> Array:
    """Return Newton's multipliers (k,) of rows outside of their slabs; none pulls a row farther.

    They are those of the first step of a projection (`manifolds.slabs`), with a share of each row's
    squared length added to it. Rows of any length do no harm. Inner products (k, k) of the rows
    are overwritten; errors (k,) are how far each is outside of its slab.
    """
    for i in range(len(error)):
        products[i, i] = products[i, i] * (1.0 + _SHARING) + _NOTHING
    multipliers = np.empty(len(error))
    put_direction(products, error, np.zeros(len(error)), multipliers)
    return multipliers
