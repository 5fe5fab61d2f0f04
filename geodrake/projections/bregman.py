"""The Bregman projection onto a polyhedron."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from geodrake.errors import ArgumentError, ConvergenceError
from geodrake.manifolds import Manifold
from geodrake.manifolds.base import Array
from geodrake.projections.interior_point import Program
from geodrake.projections.polyhedron import Polyhedron

_NEAR = 1e-6  # error of the iterate at which to look for the exact solution


def bregman_projection(
    manifold: Manifold,
    x: ArrayLike,
    constraints: Polyhedron,
    *,
    tolerance: float = 1e-10,
    max_iterations: int = 100,
) -> Array:
    """The point of a polyhedron that is nearest to x, inside of the manifold's set.

    Args:
        manifold: Where x lives.
        x: (n,) point inside of the manifold's set.
        constraints: The polyhedron.
        tolerance: Greatest error of the conditions of optimality, in lengths of the metric at x.
        max_iterations: Newton steps after which to give up.

    Returns:
        (n,) the projection; x itself if it is in the polyhedron.

    Raises:
        ArgumentError: x is not inside, a shape is wrong, or equations contradict each other.
        ConvergenceError: No projection was found, most likely because the polyhedron does not meet
            the manifold's set.
    """
    x = np.asarray(x, float)
    _check(manifold, x, constraints)
    if not constraints.violation(x).any():
        return x
    program = Program.of(manifold, x, constraints)
    point = program.start()
    for _ in range(max_iterations):
        if program.error(point) <= _NEAR:
            exact = program.polished(point, tolerance)
            if exact is not None:
                return program.position(exact)
        following = program.next(point)
        if following is None:
            break
        point = following
    y = program.position(point)
    violation = constraints.violation(y)
    raise ConvergenceError(
        f"No projection was found to {tolerance:g}: the last point breaks row "
        f"{int(np.argmax(violation))} by {violation.max():.3g} (error {program.error(point):.2g}).",
        advice="Check that some point of the manifold satisfies all rows: limits, signs and units.",
        last=y,
        violation=violation,
    )


def _check(manifold: Manifold, x: Array, constraints: Polyhedron) -> None:
    n = manifold.dimension
    if x.shape != (n,) or constraints.matrix.shape[1] != n:
        raise ArgumentError(
            f"The manifold has {n} coordinates; got a point of shape {x.shape} and rows of "
            f"{constraints.matrix.shape[1]}."
        )
    if not manifold.contains(x):
        raise ArgumentError(
            f"The point to be projected is not inside of the manifold's set: {x.tolist()}."
        )
