"""Update laws made of another one: of some parameters alone, or inside of a convex set.

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
_SHORTENED = (8.0, 2.0)  # lengths in the metric of steps in place of ones that are too long
_CUT_TOLERANCE = 1e-9  # distance outside of the set, in the metric, that counts as inside
_ROUNDING = 1e-13  # of a limit, relative to its terms


class _OuterLaw(UpdateLaw):
    """A law around another one, `law`, from which it takes all but its rate and its step."""

    law: UpdateLaw

    def _own(self, values: Array) -> Array:
        """Return those of values (..., n) that the law inside sees."""
        return values

    @property
    def dimension(self) -> int | None:
        """Number n of all parameters."""
        return self.law.dimension

    @property
    def slowness(self) -> float:
        """That of the law inside."""
        return self.law.slowness

    def with_slowness(self, gamma: float) -> Self:
        """Return the same law with another γ."""
        return replace(self, law=self.law.with_slowness(gamma))  # type: ignore[type-var]

    def calc_contains(self, parameters: Array) -> bool:
        """Return whether the law inside can move an estimate (n,), be it outside of a set."""
        return self.law.calc_contains(self._own(parameters))

    def calc_reach(self, parameters: Array, rows: Array) -> float:
        """Return the value of the law inside: limits make no rate greater."""
        return self.law.calc_reach(self._own(parameters), self._own(rows))

    def calc_parameter_error(self, truth: Array, parameters: Array) -> Array:
        """Return V_p of the law inside."""
        return self.law.calc_parameter_error(self._own(truth), self._own(parameters))


@dataclass(frozen=True, eq=False)
class PartialLaw(_OuterLaw, Short):
    """A law of some parameters, such as those of a load; the others are known and stay as they are.

    It is the law of the submanifold on which only those parameters vary: V̇_t ≤ (p̂ − p)ᵀ b has no
    part of parameters that are equal to the truth. What is held does not change by a single bit.

    Attributes:
        law: The law of the k parameters that are adapted, on their own manifold.
        adapted: (n,) booleans, true for these k; `adapted_parameters` makes them from names.

    Raises:
        ArgumentError: The law moves another number of parameters, or none is adapted.
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
    def _places(self) -> NDArray[np.intp]:
        return np.flatnonzero(self.adapted)

    @property
    def dimension(self) -> int:
        """Number n of all parameters."""
        return len(self.adapted)

    def calc_rate(self, parameters: Array, b: Array) -> Array:
        """Return the rate (n,), zero for what is held."""
        rate = np.zeros(len(self.adapted))
        rate[self._places] = self.law.calc_rate(self._own(parameters), self._own(b))
        return rate

    def calc_step(self, parameters: Array, b: Array, dt: float) -> Array:
        """Return the estimate (n,) after dt seconds, what is held as it was."""
        following = parameters.copy()
        following[self._places] = self.law.calc_step(self._own(parameters), self._own(b), dt)
        return following

    def _own(self, values: Array) -> Array:
        return values[..., self._places]


@dataclass(frozen=True, eq=False)
class ProjectedLaw(_OuterLaw):
    """An adaptation law whose estimate stays in a convex set C that holds the truth.

    The rate is projected onto the limits that bind, Eq. (5.4.57), and a step that ends outside of C
    is taken back by the Bregman projection, Eq. (5.4.59). Neither makes V greater. With several
    limits at once, the projection of the rate is the nearest rate that breaks none of them. An
    estimate that begins outside of C stays outside by its rate alone: begin with `project` of it.

    Attributes:
        constraints: C; a `Polyhedron`, or a `ConvexSet`.
        margin: Distance in the manifold's metric below which a limit binds.
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
        """G (k, n) and g (k,) of limits G p ≤ g; none of them of functions."""
        if isinstance(limits := self.constraints, ConvexSet):
            return np.zeros((0, self.law.dimension)), np.zeros(0)
        above, below = np.isfinite(limits.upper), np.isfinite(limits.lower)
        G = np.concatenate([limits.matrix[above], -limits.matrix[below]])
        return contiguous(G), np.concatenate([limits.upper[above], -limits.lower[below]])

    def limits(self, p: Array) -> tuple[Array, Array]:
        """Return c(p) (k,) of p (n,), at most zero in C, and ∇c(p) (k, n)."""
        if isinstance(self.constraints, ConvexSet):
            return self.constraints.limits(p)
        G, g = self._rows
        return G @ p - g, G

    @cached_property
    def compiled(self) -> Steps | None:
        """Return the steps of the law, within limits of a polyhedron."""
        if self.law.compiled is None or isinstance(self.constraints, ConvexSet):
            return None
        return self.law.compiled[0], *self._rows

    def calc_rate(self, parameters: Array, b: Array) -> Array:
        """Return the rate of the law, tangent to limits that bind ([Lee2019] Eq. (5.4.57))."""
        p = parameters
        v = self.law.calc_rate(p, b)
        values, normals = self.limits(p)
        leaving = normals @ v > 0
        if not leaving.any():
            return v
        # Limits that do not bind are far from it, so the metric is only asked about those near it.
        pulls = self.law.manifold.calc_inverse_metric_times(p, normals)
        lengths = np.sqrt((normals * pulls).sum(-1))
        active = values >= -self.margin * lengths
        if not (active & leaving).any():
            return v
        a, w = normals[active] / lengths[active, None], pulls[active] / lengths[active, None]
        return v - _least_push(a @ w.T, a @ v) @ w

    def calc_step(self, parameters: Array, b: Array, dt: float) -> Array:
        """Return the estimate after dt seconds, projected onto C ([Lee2019] Eq. (5.4.59)).

        Steps may be of any length. Only where the end of one is so near to the edge of the manifold
        that rounding hides its projection, it is shortened to eight, and then to two in the
        manifold's metric.

        Raises:
            ConvergenceError: No step can be projected onto C, most likely because C does not meet
                the manifold.
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
        for most in _SHORTENED:
            if length > most:
                try:
                    return self.project(self.law.calc_step(parameters, b, dt * most / length))
                except GeodrakeError:
                    continue
        return self.project(parameters)

    def project(self, parameters: ArrayLike) -> Array:
        """Return the Bregman projection of an estimate (n,) onto C; itself if it is in C.

        Raises:
            ConvergenceError: C does not meet the manifold.
            ArgumentError: The estimate is not inside of the manifold, as after an Euler step.
        """
        p = real_array(parameters, "parameters", (self.law.manifold.dimension,))
        if not (self.limits(p)[0] > 0).any():
            return p
        if isinstance(self.constraints, ConvexSet):
            return _project_by_cuts(self.law.manifold, p, self.constraints)
        return _project_by_rows(self.law.manifold, p, *self._rows)


def _project_by_rows(manifold: Manifold, p: Array, G: Array, g: Array) -> Array:
    """Project onto the limits G x ≤ g that p is beyond, and onto more while the result is.

    The projection onto some limits that keeps the others is the one onto all.
    """
    bound, point = np.zeros(len(g), bool), p
    while True:
        beyond = G @ point - g > _rounding(G, point)
        if not (beyond & ~bound).any():
            return point
        bound |= beyond
        point = _nearest(manifold, p, G[bound], g[bound])


def _project_by_cuts(manifold: Manifold, p: Array, convex: ConvexSet) -> Array:
    """Project onto half-spaces around a convex set, with new ones where the last point is outside.

    A half-space that touches c at y, c(y) + ∇c(y)ᵀ (x − y) ≤ 0, holds the whole set, so every
    projection is at least as near to p as the one onto the set, and the last one is inside of it.
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


def _nearest(manifold: Manifold, p: Array, G: Array, g: Array) -> Array:
    """Return the Bregman projection of p (n,) onto G x ≤ g, of the factors that these are about."""
    product = manifold if isinstance(manifold, Product) else Product((manifold,))
    ends = np.cumsum([factor.dimension for factor in product.manifolds])
    places = np.split(np.arange(product.dimension), ends[:-1])
    kept = [k for k, at in enumerate(places) if G[:, at].any()] or range(len(places))
    factors = tuple(product.manifolds[k] for k in kept)
    part = Product(factors, tuple(product.weights[k] for k in kept))
    at = np.concatenate([places[k] for k in kept])
    own, lower, point = G[:, at], np.full(len(g), -np.inf), p.copy()
    if part.robot is not None and part.calc_contains(p[at]):
        found = slab_projection(part, p[at], own, lower, g)
        if found.certified and (own @ found.point - g <= _rounding(own, found.point)).all():
            point[at] = found.point
            return point
    point[at] = bregman_projection(part, p[at], Polyhedron(own, lower, g))
    return point


def _rounding(G: Array, x: Array) -> Array:
    """Return what rounding makes of G x (k,), at most."""
    return _ROUNDING * (np.abs(G) @ np.abs(x))


def _least_push(G: Array, a_v: Array) -> Array:
    """Return λ ≥ 0 (k,) of least ½ λᵀ G λ − λᵀ a_v, with G the products of unit normals."""
    if len(a_v) == 1:
        return np.maximum(a_v, 0.0) / G[0]
    # G = Sᵀ S, and S may be singular where normals depend on each other.
    values, axes = np.linalg.eigh(G)
    kept = values > 1e-12 * values[-1]
    root = np.sqrt(values[kept])
    multipliers, _ = nnls(root[:, None] * axes[:, kept].T, (axes[:, kept].T @ a_v) / root)
    return np.asarray(multipliers)


def limited(law: UpdateLaw, points: ArrayLike, factor: float) -> UpdateLaw:
    """Return a law with limits about the model's parameters and a first estimate.

    Limited are tr(P₀⁻¹ P) of each body, which is four for P = P₀ and does not depend on units and
    frames, and how far each parameter of an effect is from its bound, if it has only one. They stay
    within `factor` times what the points have. As P ≤ tr(P₀⁻¹ P) P₀, mass matrices stay below
    4 factor times the model's: sampled gains K = λ M̂ with h λ M̂ > 2 M make a loop chatter, chatter
    makes estimates grow, and such a loop would not come back.

    A law of a flat manifold, one of Euler steps and one with limits of its own stay as they are.

    Args:
        points: (k, n) the model's parameters, and the first estimate.
    """
    number(factor, "factor", lower=1.0, strict=True)
    points = real_array(points, "points", ("k", instance(law, "law", UpdateLaw).dimension or "n"))
    if isinstance(law, PartialLaw):
        return replace(law, law=limited(law.law, points[:, law.adapted], factor))
    if not isinstance(law, AdaptationLaw) or law.integrator != "geodesic":
        return law
    product = law.manifold if isinstance(law.manifold, Product) else Product((law.manifold,))
    places = np.split(points, np.cumsum([m.dimension for m in product.manifolds])[:-1], axis=1)
    cones = [_cone(*each) for each in zip(product.manifolds, places, strict=True)]
    A, tip = block_diag(*(cone[0] for cone in cones)), np.concatenate([cone[1] for cone in cones])
    heights = (points - tip) @ A.T
    least = heights.min(0, where=heights > 0, initial=np.inf) / factor + A @ tip
    limits = Polyhedron(A, least, heights.max(0, initial=0.0) * factor + A @ tip)
    return ProjectedLaw(law, limits) if len(A) else law


def _cone(manifold: Manifold, points: Array) -> tuple[Array, Array]:
    """Return what grows inside of a manifold that is a cone, (rows, n), and its tip (n,)."""
    inside = points[manifold.contains(points)]
    if isinstance(manifold, PhysicalInertia | ConstrainedInertia) and len(inside):
        return -PhysicalInertia().gradient(inside[:1]), np.zeros(points.shape[1])
    if isinstance(manifold, Interval):
        lower, upper = np.array(manifold.lower), np.array(manifold.upper)
        sign = np.isfinite(lower).astype(float) - np.isfinite(upper)
        tip = np.where(sign > 0, lower, np.where(sign < 0, upper, 0.0))
        return np.diag(sign)[sign != 0], tip
    return np.zeros((0, points.shape[1])), np.zeros(points.shape[1])
