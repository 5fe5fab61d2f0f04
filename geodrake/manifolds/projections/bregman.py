"""The Bregman projection onto a polyhedron."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, integer, positive, real_array
from geodrake.errors import ArgumentError, ConvergenceError
from geodrake.manifolds.base import Array, Lift, Manifold
from geodrake.manifolds.projections.dual import State
from geodrake.manifolds.projections.path import attempts
from geodrake.manifolds.projections.polyhedron import Polyhedron

_ROUNDING = 1e-14  # relative, of coordinates and multipliers on the way to a certificate
_DEPENDENT = 1e-10  # singular value, relative to the largest, of rows that say nothing new


def bregman_projection(
    manifold: Manifold,
    x: ArrayLike,
    constraints: Polyhedron,
    *,
    tolerance: float = 1e-10,
    max_iterations: int = 25,
) -> Array:
    """The point of a polyhedron that is nearest to x, inside of the manifold's set.

    It is returned only with a certificate: multipliers with which it meets the conditions of
    optimality, checked with the manifold's own gradient.

    Args:
        manifold: Where x lives.
        x: (n,) point inside of the manifold's set, however far from the polyhedron.
        constraints: The polyhedron.
        tolerance: Greatest error of the conditions of optimality, in lengths of the metric.
        max_iterations: Most steps between two points of the path from x to the projection.

    Returns:
        (n,) the projection; x itself if it is in the polyhedron.

    Raises:
        ArgumentError: x is not inside, a shape is wrong, or equations contradict each other.
        ConvergenceError: No projection was found, most likely because the polyhedron does not meet
            the manifold's set.
    """
    x = _checked_point(manifold, x, constraints)
    positive(tolerance, "tolerance")
    integer(max_iterations, "max_iterations", lower=1)
    if not constraints.violation(x).any():
        return x
    constraints = _without_zeros(constraints)
    _check_equations(manifold, x, constraints)
    with np.errstate(all="ignore"):  # what overflows does not pass the certificate
        y, missing = _certified(manifold, x, constraints, (tolerance, max_iterations))
    if missing <= tolerance:
        return y
    violation = constraints.violation(y)
    raise ConvergenceError(
        f"No projection was found to {tolerance:g}: the last point breaks row "
        f"{int(np.argmax(violation))} by {violation.max():.3g} (error {missing:.2g}).",
        advice="Check that some point of the manifold satisfies all rows: limits, signs and units.",
        last=y,
        violation=violation,
    )


def _certified(
    manifold: Manifold, x: Array, constraints: Polyhedron, effort: tuple[float, int]
) -> tuple[Array, float]:
    """The best point that was found, and how far it is from being optimal."""
    lift = manifold.lift() or Lift.nothing(manifold)
    k = len(constraints.matrix)
    matrix = np.zeros((k, len(lift.offset)))
    matrix[:, lift.places] = constraints.matrix
    matrix = np.concatenate([matrix, lift.rows])
    scale = 1.0 / np.linalg.norm(matrix, axis=1)
    limits = (np.append(b, lift.values) for b in (constraints.lower, constraints.upper))
    rows = Polyhedron(scale[:, None] * matrix, *(scale * limit for limit in limits))
    best, least = x, np.inf
    for state in attempts(State.at(lift.manifold, rows, lift.matrix @ x + lift.offset), effort[1]):
        y, held = state.y[lift.places], (state.multipliers * scale)[:k]
        missing = _certificate(manifold, (x, y), (constraints.matrix, held))
        missing = max(state.error, missing) if np.isfinite(missing) else np.inf
        if missing < least or best is x:
            best, least = y, missing
        if least <= effort[0]:
            break
    return best, least


def _certificate(
    manifold: Manifold, points: tuple[Array, Array], push: tuple[Array, Array]
) -> float:
    """How far y is from meeting the conditions of optimality, beyond what rounding explains.

    What is left of ∇h(y) − ∇h(x) − Aᵀ λ is shared out to x and y: with both moved by no more than
    the length returned, it would be zero.
    """
    (x, y), (A, held) = points, push
    if not (np.isfinite(y).all() and bool(manifold.calc_contains(y))):
        return np.inf
    try:
        rest = manifold.calc_gradient(y) - manifold.calc_gradient(x) - A.T @ held
        frames = np.stack([manifold.calc_frame(x), manifold.calc_frame(y)])
        inverses = np.linalg.inv(frames)
        # The metric at y seen from x has the squares of `stretch`.
        _, stretch, axes = np.linalg.svd(inverses[1] @ frames[0])
    except np.linalg.LinAlgError:
        return np.inf
    damping, seen = 1.0 / np.hypot(1.0, stretch), axes @ frames[0].T
    left = float(np.linalg.norm(damping * (seen @ rest)))
    unsure = float(np.linalg.norm(damping * (np.abs(seen) @ (np.abs(held) @ np.abs(A)))))
    for point, inverse in zip(points, inverses, strict=True):
        unsure += float(np.linalg.norm(np.linalg.norm(inverse, axis=0) * point))
    return max(0.0, left - _ROUNDING * unsure)


def _without_zeros(constraints: Polyhedron) -> Polyhedron:
    """The polyhedron without rows that say nothing."""
    A, lower, upper = constraints.matrix, constraints.lower, constraints.upper
    used = A.any(1)
    if ((lower > 0) | (upper < 0))[~used].any():
        raise ArgumentError(
            "A row of the polyhedron has only zeros, and limits that zero is not between.",
            advice="Leave it out, or give it coefficients.",
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
    kept = strengths > _DEPENDENT * strengths[0]
    rest = values - U[:, kept] @ (U[:, kept].T @ values)
    if np.abs(rest).max() > np.sqrt(_DEPENDENT) * max(1.0, np.abs(values).max()):
        raise ArgumentError(
            "The equations of the polyhedron contradict each other.",
            advice="Leave out equations that say the same with other values.",
        )


def _checked_point(manifold: Manifold, x: ArrayLike, constraints: Polyhedron) -> Array:
    n = instance(manifold, "manifold", Manifold).dimension
    x, rows = real_array(x, "x", (n,)), instance(constraints, "constraints", Polyhedron).matrix
    if rows.shape[1] != n:
        raise ArgumentError(
            f"The manifold has {n} coordinates; got rows of {rows.shape[1]} coefficients."
        )
    if not manifold.calc_contains(x):
        raise ArgumentError(
            f"The point to be projected is not inside of the manifold's set: {x.tolist()}."
        )
    return x
