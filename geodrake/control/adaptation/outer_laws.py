"""Update laws that wrap another law: for some parameters only, or inside a convex set.

[Lee2019] §5.4.2 and §5.5.2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag
from scipy.optimize import nnls

from geodrake.boundary.arguments import instance, mask, number, real_array
from geodrake.boundary.showing import Short
from geodrake.compiling import contiguous
from geodrake.control.adaptation.constraints import ConvexSet
from geodrake.control.adaptation.law import AdaptationLaw, Steps, UpdateLaw
from geodrake.errors import ArgumentError, ConvergenceError, GeodrakeError
from geodrake.inertia import Array
from geodrake.manifolds import ConstrainedInertia, Interval, Manifold, PhysicalInertia, Product
from geodrake.manifolds.projections import Polyhedron, bregman_projection
from geodrake.manifolds.slabs import slab_projection

_MOST_CUTS = 60
_SHORTENED = (8.0, 2.0)  # lengths, in the metric, to which long steps are shortened
_CUT_TOLERANCE = 1e-9  # distance from the set, in the metric, that counts as inside
_ROUNDING = 1e-13  # of a limit, relative to its terms


class _OuterLaw(UpdateLaw):
    """A law that delegates everything except its rate and step to the inner `law`."""

    law: UpdateLaw

    def _inner(self, values: Array) -> Array:
        """Return the entries of values (..., n) that belong to the inner law."""
        return values

    @property
    def dimension(self) -> int | None:
        """Number n of all parameters."""
        return self.law.dimension

    @property
    def slowness(self) -> float:
        """γ of the inner law."""
        return self.law.slowness

    def with_slowness(self, gamma: float) -> Self:
        """Return the same law with another γ."""
        return replace(self, law=self.law.with_slowness(gamma))  # type: ignore[type-var]

    def calc_contains(self, parameters: Array) -> bool:
        """Return whether an estimate (n,) is in the inner law's domain."""
        return self.law.calc_contains(self._inner(parameters))

    def calc_reach(self, parameters: Array, rows: Array) -> float:
        """Return the bound of the inner law; limits do not increase rates."""
        return self.law.calc_reach(self._inner(parameters), self._inner(rows))

    def calc_parameter_error(self, truth: Array, parameters: Array) -> Array:
        """Return V_p of the inner law."""
        return self.law.calc_parameter_error(self._inner(truth), self._inner(parameters))


@dataclass(frozen=True, eq=False)
class PartialLaw(_OuterLaw, Short):
    """A law for some parameters, such as those of a load, with the others known and constant.

    It is the law of the submanifold on which only the adapted parameters vary. V̇_t ≤ (p̂ − p)ᵀ b
    does not depend on parameters that equal the truth. Constant parameters are bitwise unchanged.

    Attributes:
        law: The law for the k adapted parameters, on their own manifold.
        adapted: (n,) booleans, true for these k; see `adapted_parameters`.

    Raises:
        ArgumentError: The law has another number of parameters, or none is adapted.
    """

    law: UpdateLaw
    adapted: NDArray[np.bool_]

    def __post_init__(self) -> None:
        instance(self.law, "law", UpdateLaw)
        adapted = mask(self.adapted, "adapted")
        if not adapted.any():
            raise ArgumentError("adapted must be booleans (n,), at least one of them true.")
        if self.law.dimension not in (None, count := int(adapted.sum())):
            raise ArgumentError(
                f"The law has {self.law.dimension} parameters, but {count} are adapted.",
                advice="Define its manifold for these only, such as PhysicalInertia() for one "
                "body.",
            )
        object.__setattr__(self, "adapted", adapted.copy())

    @cached_property
    def _indices(self) -> NDArray[np.intp]:
        return np.flatnonzero(self.adapted)

    @property
    def dimension(self) -> int:
        """Number n of all parameters."""
        return len(self.adapted)

    def calc_rate(self, parameters: Array, b: Array) -> Array:
        """Return the rate (n,), zero for constant parameters."""
        rate = np.zeros(len(self.adapted))
        rate[self._indices] = self.law.calc_rate(self._inner(parameters), self._inner(b))
        return rate

    def calc_step(self, parameters: Array, b: Array, dt: float) -> Array:
        """Return the estimate (n,) after dt seconds."""
        result = parameters.copy()
        result[self._indices] = self.law.calc_step(self._inner(parameters), self._inner(b), dt)
        return result

    def _inner(self, values: Array) -> Array:
        return values[..., self._indices]


@dataclass(frozen=True, eq=False)
class ProjectedLaw(_OuterLaw):
    """An adaptation law whose estimate stays in a convex set C that contains the truth.

    The rate is projected onto the active limits, Eq. (5.4.57), and steps that end outside C are
    corrected by the Bregman projection, Eq. (5.4.59). Neither increases V. With several active
    limits, the projected rate is the closest rate that violates none of them. The rate does not
    move an estimate into C: start with `project`.

    Attributes:
        constraints: C; a `Polyhedron`, or a `ConvexSet`.
        margin: Distance in the manifold's metric below which a limit is active.
    """

    law: AdaptationLaw
    constraints: ConvexSet | Polyhedron
    margin: float = 1e-6

    def __post_init__(self) -> None:
        n = instance(self.law, "law", AdaptationLaw).manifold.dimension
        number(self.margin, "margin", lower=0.0)
        instance(self.constraints, "constraints", (ConvexSet, Polyhedron))
        if (k := self._rows[0].shape[1]) != n:
            raise ArgumentError(f"The law has {n} parameters, but the limits {k}.")

    @cached_property
    def _rows(self) -> tuple[Array, Array]:
        """G (k, n) and g (k,) of the linear limits G p ≤ g; empty for a `ConvexSet`."""
        if isinstance(limits := self.constraints, ConvexSet):
            return np.zeros((0, self.law.dimension)), np.zeros(0)
        above, below = np.isfinite(limits.upper), np.isfinite(limits.lower)
        G = np.concatenate([limits.matrix[above], -limits.matrix[below]])
        return contiguous(G), np.concatenate([limits.upper[above], -limits.lower[below]])

    def limits(self, p: Array) -> tuple[Array, Array]:
        """Return c(p) (k,), which is ≤ 0 in C, and ∇c(p) (k, n)."""
        if isinstance(self.constraints, ConvexSet):
            return self.constraints.limits(p)
        G, g = self._rows
        return G @ p - g, G

    @cached_property
    def compiled(self) -> Steps | None:
        """Factors of the inner law, with the limits of a polyhedron."""
        if self.law.compiled is None or isinstance(self.constraints, ConvexSet):
            return None
        return self.law.compiled[0], *self._rows

    def calc_rate(self, parameters: Array, b: Array) -> Array:
        """Return the law's rate, projected onto active limits ([Lee2019] Eq. (5.4.57))."""
        p = parameters
        v = self.law.calc_rate(p, b)
        values, normals = self.limits(p)
        leaving = normals @ v > 0
        if not leaving.any():
            return v
        gradients = self.law.manifold.calc_inverse_metric_times(p, normals)
        lengths = np.sqrt((normals * gradients).sum(-1))
        active = values >= -self.margin * lengths
        if not (active & leaving).any():
            return v
        a, w = normals[active] / lengths[active, None], gradients[active] / lengths[active, None]
        return v - _multipliers(a @ w.T, a @ v) @ w

    def calc_step(self, parameters: Array, b: Array, dt: float) -> Array:
        """Return the estimate after dt seconds, projected onto C ([Lee2019] Eq. (5.4.59)).

        Steps may have any length. If a step ends so close to the manifold's boundary that its
        projection fails due to rounding, it is shortened to length 8, then 2, in the manifold's
        metric.

        Raises:
            ConvergenceError: No step can be projected onto C, most likely because C does not
                intersect the manifold.
        """
        p = self.law.calc_step(parameters, b, dt)
        if not (self.limits(p)[0] > 0).any():
            return p
        try:
            return self.project(p)
        except GeodrakeError:
            # vᵀ g v = −γ⁻¹ vᵀ b for the rate v, without g.
            pull = self.law.calc_pull(parameters, b)
            speed = -np.dot(self.law.calc_rate(parameters, b), pull) / self.law.gamma
        length = float(dt * np.sqrt(max(speed, 0.0)))
        for limit in _SHORTENED:
            if length > limit:
                try:
                    return self.project(self.law.calc_step(parameters, b, dt * limit / length))
                except GeodrakeError:
                    continue
        return self.project(parameters)

    def project(self, parameters: ArrayLike) -> Array:
        """Return the Bregman projection of an estimate (n,) onto C; itself if it is in C.

        Raises:
            ConvergenceError: C does not intersect the manifold.
            ArgumentError: The estimate is outside the manifold, as after an Euler step.
        """
        p = real_array(parameters, "parameters", (self.law.manifold.dimension,))
        if not (self.limits(p)[0] > 0).any():
            return p
        if isinstance(self.constraints, ConvexSet):
            return _project_by_cuts(self.law.manifold, p, self.constraints)
        return _project_by_rows(self.law.manifold, p, *self._rows)


def _project_by_rows(manifold: Manifold, p: Array, G: Array, g: Array) -> Array:
    """Project onto the violated limits of G x ≤ g, adding limits that the result violates.

    A projection onto some limits that satisfies the others is the projection onto all.
    """
    active, point = np.zeros(len(g), bool), p
    while True:
        violated = G @ point - g > _rounding(G, point)
        if not (violated & ~active).any():
            return point
        active |= violated
        point = _project_factors(manifold, p, G[active], g[active])


def _project_by_cuts(manifold: Manifold, p: Array, convex: ConvexSet) -> Array:
    """Project onto half-spaces that contain a convex set, adding cuts until the result is in it.

    The cut c(y) + ∇c(y)ᵀ (x − y) ≤ 0 at a point y contains the set. Every projection is thus at
    least as close to p as that onto the set, and the last one is in the set.
    """
    point, rows, upper = p, np.zeros((0, len(p))), np.zeros(0)
    for _ in range(_MOST_CUTS):
        values, normals = convex.limits(point)
        lengths = np.sqrt((normals * manifold.calc_inverse_metric_times(p, normals)).sum(-1))
        outside = values > _CUT_TOLERANCE * lengths
        if not outside.any():
            return point
        cuts = normals[outside] / lengths[outside, None]
        rows = np.concatenate([rows, cuts])
        upper = np.concatenate([upper, cuts @ point - values[outside] / lengths[outside]])
        limits = Polyhedron(rows, np.full(len(upper), -np.inf), upper)
        point = bregman_projection(manifold, p, limits)
    raise ConvergenceError(
        f"No point of the set was found after {_MOST_CUTS} cuts; the last one violates it by "
        f"{convex.limits(point)[0].max():.3g}.",
        advice="Check that the functions are convex, and their gradients against differences.",
        last=point,
    )


def _project_factors(manifold: Manifold, p: Array, G: Array, g: Array) -> Array:
    """Return the Bregman projection of p (n,) onto G x ≤ g, restricted to factors in G."""
    product = manifold if isinstance(manifold, Product) else Product((manifold,))
    ends = np.cumsum([factor.dimension for factor in product.manifolds])
    parts = np.split(np.arange(product.dimension), ends[:-1])
    involved = [k for k, part in enumerate(parts) if G[:, part].any()] or range(len(parts))
    factors = tuple(product.manifolds[k] for k in involved)
    submanifold = Product(factors, tuple(product.weights[k] for k in involved))
    indices = np.concatenate([parts[k] for k in involved])
    rows, lower, point = G[:, indices], np.full(len(g), -np.inf), p.copy()
    if submanifold.robot is not None and submanifold.calc_contains(p[indices]):
        projection = slab_projection(submanifold, p[indices], rows, lower, g)
        x = projection.point
        if projection.certified and (rows @ x - g <= _rounding(rows, x)).all():
            point[indices] = x
            return point
    point[indices] = bregman_projection(submanifold, p[indices], Polyhedron(rows, lower, g))
    return point


def _rounding(G: Array, x: Array) -> Array:
    """Return a bound of the rounding errors of G x (k,)."""
    return _ROUNDING * (np.abs(G) @ np.abs(x))


def _multipliers(G: Array, a_v: Array) -> Array:
    """Return λ ≥ 0 (k,) that minimizes ½ λᵀ G λ − λᵀ a_v, with G the products of unit normals."""
    if len(a_v) == 1:
        return np.maximum(a_v, 0.0) / G[0]
    # Factor G = Sᵀ S, which is singular for dependent normals.
    values, axes = np.linalg.eigh(G)
    positive = values > 1e-12 * values[-1]
    root, axes = np.sqrt(values[positive]), axes[:, positive].T
    multipliers, _ = nnls(root[:, None] * axes, (axes @ a_v) / root)
    return np.asarray(multipliers)


def limited(law: UpdateLaw, points: ArrayLike, factor: float) -> UpdateLaw:
    """Return a law with limits relative to the model's parameters and the initial estimate.

    Limited are tr(P₀⁻¹ P) of each body, which is four for P = P₀ and independent of units and
    frames, and the distance of an effect's parameter from its bound, if it has exactly one. They
    are limited to `factor` times the values at the points. As P ≤ tr(P₀⁻¹ P) P₀, mass matrices stay
    below 4 factor times the model's. Without limits, sampled gains K = λ M̂ with h λ M̂ > 2 M cause
    chatter, which increases the estimates further, and the loop does not recover.

    Laws on flat manifolds, with Euler steps or with limits are returned unchanged.

    Args:
        points: (k, n) the model's parameters, and the initial estimate.
    """
    number(factor, "factor", lower=1.0, strict=True)
    points = real_array(points, "points", ("k", instance(law, "law", UpdateLaw).dimension or "n"))
    if isinstance(law, PartialLaw):
        return replace(law, law=limited(law.law, points[:, law.adapted], factor))
    if not isinstance(law, AdaptationLaw) or law.integrator != "geodesic":
        return law
    product = law.manifold if isinstance(law.manifold, Product) else Product((law.manifold,))
    parts = np.split(points, np.cumsum([m.dimension for m in product.manifolds])[:-1], axis=1)
    cones = [_cone(factor, part) for factor, part in zip(product.manifolds, parts, strict=True)]
    A, tip = block_diag(*(cone[0] for cone in cones)), np.concatenate([cone[1] for cone in cones])
    heights = (points - tip) @ A.T
    least = heights.min(0, where=heights > 0, initial=np.inf) / factor + A @ tip
    limits = Polyhedron(A, least, heights.max(0, initial=0.0) * factor + A @ tip)
    return ProjectedLaw(law, limits) if len(A) else law


def _cone(manifold: Manifold, points: Array) -> tuple[Array, Array]:
    """Return linear functions (rows, n) that are positive in a conic manifold, and its tip (n,)."""
    inside = points[manifold.contains(points)]
    if isinstance(manifold, PhysicalInertia | ConstrainedInertia) and len(inside):
        return -PhysicalInertia().gradient(inside[:1]), np.zeros(points.shape[1])
    if isinstance(manifold, Interval):
        lower, upper = np.array(manifold.lower), np.array(manifold.upper)
        sign = np.isfinite(lower).astype(float) - np.isfinite(upper)
        tip = np.where(sign > 0, lower, np.where(sign < 0, upper, 0.0))
        return np.diag(sign)[sign != 0], tip
    return np.zeros((0, points.shape[1])), np.zeros(points.shape[1])
