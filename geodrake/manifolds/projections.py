"""Bregman projections onto half-spaces, affine sets, slabs and polyhedra, [Lee2019] Eq. (2.2.11).

    Proj_C(x) = argmin D(y‖x)  over y in C

Projecting an estimate onto a convex set that contains the true p moves it closer to p in the
manifold's divergence (Pythagorean inequality, Eq. (2.2.12)):

    D(p‖x) ≥ D(p‖Proj_C(x)) + D(Proj_C(x)‖x)

Newton's method on the dual, in coordinates in which the metric is the identity, so that units and
frames do not cost precision.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from geodrake.boundary.arguments import Sizes, instance, integer, number, positive, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError, ConvergenceError
from geodrake.manifolds.base import Array, Manifold


@dataclass(frozen=True, eq=False)
class Polyhedron(Short):
    """The points y with lower ≤ matrix y ≤ upper.

    Attributes:
        matrix: (k, n) coefficients.
        lower: (k,) lower limits; −inf for none.
        upper: (k,) upper limits; inf for none, equal to `lower` for an equation.
    """

    matrix: Array
    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        sizes: Sizes = {}
        matrix = real_array(self.matrix, "matrix", ("k", "n"), sizes)
        lower = real_array(self.lower, "lower", ("k",), sizes, finite=False)
        upper = real_array(self.upper, "upper", ("k",), sizes, finite=False)
        if not ((lower <= upper) & (lower < np.inf) & (upper > -np.inf)).all():
            raise ArgumentError(
                "Lower values must not exceed upper ones, and the range must not be empty; "
                f"got lower {lower.tolist()}, upper {upper.tolist()}."
            )
        for name, value in (("matrix", matrix), ("lower", lower), ("upper", upper)):
            object.__setattr__(self, name, value)

    def violation(self, y: ArrayLike) -> Array:
        """Return the violation (k,) of each row at y (n,)."""
        value = self.matrix @ real_array(y, "y", (self.matrix.shape[1],))
        return np.maximum(0.0, np.maximum(self.lower - value, value - self.upper))


def halfspace(a: ArrayLike, b: float) -> Polyhedron:
    """Return the points y with aᵀ y ≥ b, for a normal a (n,) that points inside."""
    return slab(a, number(b, "b"), np.inf)


def affine_set(A: ArrayLike, b: ArrayLike) -> Polyhedron:
    """Return the points y with A y = b, for A (k, n) and b (k,), or one row (n,) and a scalar."""
    A, b = np.atleast_2d(real_array(A, "A")), np.atleast_1d(real_array(b, "b"))
    return Polyhedron(A, b, b)


def slab(a: ArrayLike, lower: float, upper: float) -> Polyhedron:
    """Return the points y with lower ≤ aᵀ y ≤ upper, for a (n,); limits may be infinite."""
    limits = (number(lower, "lower", finite=False), number(upper, "upper", finite=False))
    return Polyhedron(real_array(a, "a", ("n",))[None], *(np.array([limit]) for limit in limits))


_MOST_SCALINGS = 4
_EMPTY = 1e-13  # least residual of the unit row for a non-empty polyhedron
_NEAR = 0.25  # length of a full Newton step in the metric
_MOST_DOUBLINGS = 60
_ROUNDING = 4e-16  # rounding error of a row's value, relative to its terms
_SLOW = 0.5  # ratio of errors above which polishing steps end
_EXACT = 1e-13  # error of an exact solution
_PRECISE = 1e-8  # error below which steps only polish
_LOOSE = 0.3  # length of the next Newton step close to the central path
_LEAST_WEIGHT = 1e-24
_LONG, _SHORT = 1e-3, 4.0  # factors of the weight on the way away from x, and back


def _shortest(G: Array, lower: Array, upper: Array) -> Array | None:
    """Return multipliers μ (k,) of the shortest z = Gᵀ μ with lower ≤ G z ≤ upper, or None.

    Lawson and Hanson's least-distance program, which allows dependent rows.
    """
    below, above = np.flatnonzero(np.isfinite(lower)), np.flatnonzero(np.isfinite(upper))
    rows = np.concatenate([G[below], -G[above]])
    limit = np.concatenate([lower[below], -upper[above]])
    scale = float(limit.max(initial=0.0))
    if scale <= 0:
        return np.zeros(len(lower))
    unit = np.zeros(G.shape[1] + 1)
    unit[-1] = 1.0
    for _ in range(_MOST_SCALINGS):
        matrix = np.vstack([rows.T, limit / scale])
        try:
            u, _ = nnls(matrix, unit)
        except RuntimeError:
            return None
        residual = 1.0 - float(matrix[-1] @ u)
        if not residual > _EMPTY:
            return None
        length = float(np.linalg.norm(rows.T @ u)) / residual
        if length < 10.0:
            break
        scale *= length
    multipliers = np.zeros(len(lower))
    np.add.at(multipliers, below, u[: len(below)] * (scale / residual))
    np.add.at(multipliers, above, -u[len(below) :] * (scale / residual))
    return multipliers


@dataclass(frozen=True, eq=False)
class _State:
    """A point y (n,) with the multipliers λ (k,) from x."""

    manifold: Manifold
    limits: Polyhedron
    y: Array
    multipliers: Array

    def weighted(self, w: float) -> _State:
        """Return the state with the gradient and the multipliers scaled by w."""
        gradient = w * self.manifold.calc_gradient(self.y)
        y = self.manifold.calc_point_of_gradient(gradient, self.y)
        return replace(self, y=y, multipliers=w * self.multipliers)

    @cached_property
    def rows(self) -> Array:
        """Rows (k, n) in orthonormal tangent vectors at y."""
        return np.asarray(self.limits.matrix @ self.manifold.calc_frame(self.y))

    @cached_property
    def lengths(self) -> Array:
        """Lengths (k,) of the rows in the metric at y."""
        return np.asarray(np.linalg.norm(self.rows, axis=1))

    @cached_property
    def gaps(self) -> tuple[Array, Array]:
        """Lower and upper limits minus the values of the rows, in the metric at y."""
        value = self.limits.matrix @ self.y
        limits = self.limits.lower, self.limits.upper
        below, above = ((limit - value) / self.lengths for limit in limits)
        return below, above

    @cached_property
    def error(self) -> float:
        """Largest violation in the metric at y of a row's feasibility and complementarity."""
        below, above = self.gaps
        violation = np.maximum(0.0, np.maximum(below, -above))
        complementarity = np.where(self.multipliers > 0, np.abs(below), np.abs(above))
        terms = np.abs(self.limits.matrix) @ np.abs(self.y)
        rounding = _ROUNDING * len(self.y) * terms / self.lengths
        errors = np.where(self.multipliers == 0, violation, complementarity)
        return float(np.maximum(0.0, errors - rounding).max())

    @cached_property
    def newton_multipliers(self) -> Array | None:
        """Multipliers λ + d (k,) after Newton's step d; None if there is none.

        z = Aᵀ d minimizes ½ |z + Aᵀ λ|² within the limits.
        """
        rows, current = self.rows / self.lengths[:, None], self.multipliers * self.lengths
        shift = rows @ (rows.T @ current)
        wanted = _shortest(rows, *(gap + shift for gap in self.gaps))
        if wanted is None or not np.isfinite(wanted).all():
            return None
        binding = wanted != 0.0
        if binding.any() and not current[~binding].any():
            # Solving for the step is more precise.
            gap = np.where(wanted > 0.0, *self.gaps)[binding]
            step = np.linalg.lstsq(rows[binding], gap)[0]
            refined = current[binding] + np.linalg.lstsq(rows[binding].T, step)[0]
            if (refined * wanted[binding] > 0.0).all():
                wanted[binding] = refined
        return np.asarray(wanted / self.lengths)

    @property
    def newton_length(self) -> float:
        """Length of Newton's step in the metric at y, which bounds the distance to the optimum."""
        if self.newton_multipliers is None:
            return np.inf
        return float(np.linalg.norm((self.newton_multipliers - self.multipliers) @ self.rows))

    def newton_step(self) -> _State | None:
        """Return the state after a step of the multipliers, or None.

        A long step d is damped to d / (1 + |d|), which stays inside, and then doubled while the
        dual increases and no multiplier changes its sign.
        """
        if self.newton_multipliers is None:
            return None
        current, d = self.multipliers, self.newton_multipliers - self.multipliers
        if not (self.limits.matrix.T @ d).any():  # contradicting rows
            return None
        span = self.manifold.calc_mirror_span(self.y, self.limits.matrix)
        length = self.newton_length / np.sqrt(self.manifold.least_weight)
        share = 1.0 if length < _NEAR else 1.0 / (1.0 + length)
        y = span.point(share * d)
        if length >= _NEAR:
            turning = (current * d < 0) & (self.limits.lower < self.limits.upper)
            most = float((-current[turning] / d[turning]).min(initial=np.inf))
            sign, moving = np.where(current == 0, d, current), d != 0
            targets = np.where(sign > 0, self.limits.lower, self.limits.upper)[moving]
            rows = self.limits.matrix[moving]
            for _ in range(_MOST_DOUBLINGS):
                farther = span.point(2.0 * share * d)
                if not (2.0 * share <= most and self.manifold.calc_contains(farther)):
                    break
                if not d[moving] @ (targets - rows @ farther) >= 0:
                    break
                share, y = 2.0 * share, farther
        if not self.manifold.calc_contains(y):
            return None
        multipliers = self.newton_multipliers if share == 1.0 else current + share * d
        return replace(self, y=y, multipliers=multipliers)


def _solved(state: _State, most_steps: int) -> _State:
    """Return the best of a sequence of states towards the optimum."""
    best = state
    try:
        for _ in range(most_steps):
            if state.error <= _EXACT:
                return state
            if best.error <= _PRECISE and state.error > _SLOW * best.error and state is not best:
                break  # only rounding errors remain
            best = min(state, best, key=lambda s: s.error)
            following = state.newton_step()
            if following is None:
                break
            state = following
        return min(state, best, key=lambda s: s.error)
    except (ArgumentError, np.linalg.LinAlgError):  # at the boundary within rounding
        return best


def _along_path(start: _State, max_iterations: int) -> _State:
    """Return the optimum by following the optima for gradients w ∇h(x), from small w to 1.

    If the optimum is much larger than x, ∇h(x) dominates the barrier, and Newton's quadratic model
    is good only for small steps. A small w enlarges x, and the path is that of interior-point
    methods.
    """
    weight, state, is_close = 1.0, start, False
    try:
        while weight > _LEAST_WEIGHT and not is_close:
            start, weight = start.weighted(_LONG), _LONG * weight
            state, is_close = _centered(start, max_iterations)
        while weight < 1.0 and is_close:
            factor = min(_SHORT, 1.0 / weight)
            weight = weight * factor if factor == _SHORT else 1.0
            state, is_close = _centered(state.weighted(factor), max_iterations)
    except (ArgumentError, np.linalg.LinAlgError):
        return state
    return _solved(state, max_iterations) if weight == 1.0 else state


def _centered(state: _State, max_iterations: int) -> tuple[_State, bool]:
    """Return a state moved towards the path, and whether it is close enough."""
    for _ in range(max_iterations):
        if state.newton_length < _LOOSE:
            return state, True
        following = state.newton_step()
        if following is None:
            break
        state = following
    return state, False


_UNSURE = 1e-14  # relative rounding error of coordinates and multipliers in a certificate
_SAME_EQUATION = 1e-10  # relative singular value of redundant rows


def bregman_projection(
    manifold: Manifold,
    x: ArrayLike,
    constraints: Polyhedron,
    *,
    tolerance: float = 1e-10,
    max_iterations: int = 25,
) -> Array:
    """Return the point of a polyhedron, inside of the manifold, that is closest to x.

    The result is certified: it satisfies the optimality conditions, evaluated with the manifold's
    gradient.

    Args:
        manifold: Manifold of x.
        x: (n,) point inside of the manifold, at any distance from the polyhedron.
        constraints: The polyhedron.
        tolerance: Largest error of the optimality conditions, in lengths of the metric.
        max_iterations: Largest number of steps between two points of the path.

    Returns:
        (n,) the projection; x itself if it is in the polyhedron.
    """
    x = _checked_point(manifold, x, constraints)
    positive(tolerance, "tolerance")
    integer(max_iterations, "max_iterations", lower=1)
    if not constraints.violation(x).any():
        return x
    constraints = _without_zeros(constraints)
    _check_equations(manifold, x, constraints)
    with np.errstate(all="ignore"):  # the certificate rejects overflows
        y, error = _certified(manifold, x, constraints, (tolerance, max_iterations))
    if error <= tolerance:
        return y
    violation = constraints.violation(y)
    raise ConvergenceError(
        f"The projection did not converge to {tolerance:g}: the last point violates row "
        f"{int(np.argmax(violation))} by {violation.max():.3g} (error {error:.2g}).",
        advice="Check that some point of the manifold satisfies all rows: limits, signs and units.",
        last=y,
        violation=violation,
    )


def _certified(
    manifold: Manifold, x: Array, constraints: Polyhedron, effort: tuple[float, int]
) -> tuple[Array, float]:
    """Return the best point, and its error of the optimality conditions."""
    scale = 1.0 / np.linalg.norm(constraints.matrix, axis=1)
    limits = (scale * limit for limit in (constraints.lower, constraints.upper))
    rows = Polyhedron(scale[:, None] * constraints.matrix, *limits)
    best, least = x, np.inf
    for solve in (_solved, _along_path):  # the second is more expensive
        state = solve(_State(manifold, rows, x, np.zeros(len(scale))), effort[1])
        duals = constraints.matrix, scale * state.multipliers
        error = _certificate(manifold, (x, state.y), duals)
        error = max(state.error, error) if np.isfinite(error) else np.inf
        if error < least or best is x:
            best, least = state.y, error
        if least <= effort[0]:
            break
    return best, least


def _certificate(
    manifold: Manifold, points: tuple[Array, Array], duals: tuple[Array, Array]
) -> float:
    """Return the violation of the optimality conditions at y, beyond rounding.

    The residual ∇h(y) − ∇h(x) − Aᵀ λ is a backward error: it would vanish after moving both x and y
    by no more than the returned length.
    """
    (x, y), (A, multipliers) = points, duals
    if not (np.isfinite(y).all() and bool(manifold.calc_contains(y))):
        return np.inf
    try:
        residual = manifold.calc_gradient(y) - manifold.calc_gradient(x) - A.T @ multipliers
        frames = np.stack([manifold.calc_frame(x), manifold.calc_frame(y)])
        inverses = np.linalg.inv(frames)
        # The metric at y relative to that at x has the eigenvalues `stretch`².
        _, stretch, axes = np.linalg.svd(inverses[1] @ frames[0])
    except np.linalg.LinAlgError:
        return np.inf
    damping, seen = 1.0 / np.hypot(1.0, stretch), axes @ frames[0].T
    length = float(np.linalg.norm(damping * (seen @ residual)))
    rounding = float(np.linalg.norm(damping * (np.abs(seen) @ (np.abs(multipliers) @ np.abs(A)))))
    for point, inverse in zip(points, inverses, strict=True):
        rounding += float(np.linalg.norm(np.linalg.norm(inverse, axis=0) * point))
    return max(0.0, length - _UNSURE * rounding)


def _without_zeros(constraints: Polyhedron) -> Polyhedron:
    """Return the polyhedron without zero rows."""
    A, lower, upper = constraints.matrix, constraints.lower, constraints.upper
    used = A.any(1)
    if ((lower > 0) | (upper < 0))[~used].any():
        raise ArgumentError(
            "A row of the polyhedron is zero, but its limits exclude zero.",
            advice="Remove it, or give it coefficients.",
        )
    return constraints if used.all() else Polyhedron(A[used], lower[used], upper[used])


def _check_equations(manifold: Manifold, x: Array, constraints: Polyhedron) -> None:
    equal = constraints.lower == constraints.upper
    if equal.sum() < 2:
        return
    rows = constraints.matrix[equal] @ manifold.calc_frame(x)
    lengths = np.linalg.norm(rows, axis=1)
    values = (constraints.lower[equal] - constraints.matrix[equal] @ x) / lengths
    U, strengths, _ = np.linalg.svd(rows / lengths[:, None], full_matrices=False)
    kept = strengths > _SAME_EQUATION * strengths[0]
    rest = values - U[:, kept] @ (U[:, kept].T @ values)
    if np.abs(rest).max() > np.sqrt(_SAME_EQUATION) * max(1.0, np.abs(values).max()):
        raise ArgumentError(
            "The equations of the polyhedron are inconsistent.",
            advice="Remove duplicate equations with different values.",
        )


def _checked_point(manifold: Manifold, x: ArrayLike, constraints: Polyhedron) -> Array:
    n = instance(manifold, "manifold", Manifold).dimension
    x, rows = real_array(x, "x", (n,)), instance(constraints, "constraints", Polyhedron).matrix
    if rows.shape[1] != n:
        raise ArgumentError(
            f"The manifold has {n} coordinates, but the rows {rows.shape[1]} coefficients."
        )
    if not manifold.calc_contains(x):
        raise ArgumentError(f"The point to project is not inside the manifold: {x.tolist()}.")
    return x
