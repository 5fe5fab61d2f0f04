"""Convex sets for estimates: user-defined functions, and linear limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import function, instance, integer, integers, number, real_array
from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.inertia.ellipsoids import realizability_row
from geodrake.manifolds.projections import Polyhedron

_MOST = 10_000  # parameters of one robot


@dataclass(frozen=True, eq=False)
class ConvexSet:
    """The points p (n,) with c(p) ≤ 0 for k convex functions c, [Lee2019] Eq. (5.4.54).

    Attributes:
        function: Maps p (n,) to c(p), scalar or (k,).
        gradient: Maps p (n,) to ∇c(p), (n,) or (k, n), or any subgradient.
    """

    function: Callable[[Array], ArrayLike]
    gradient: Callable[[Array], ArrayLike]

    def __post_init__(self) -> None:
        for name in ("function", "gradient"):
            function(getattr(self, name), name)

    def limits(self, p: Array) -> tuple[Array, Array]:
        """Return c(p) (k,) and ∇c(p) (k, n)."""
        values = np.atleast_1d(np.asarray(self.function(p), float))
        return values, np.atleast_2d(np.asarray(self.gradient(p), float))


def body_limits(
    size: int, body: int, rows: ArrayLike, *, lower: ArrayLike = -np.inf, upper: ArrayLike = np.inf
) -> Polyhedron:
    """Return limits on linear functions of one body's parameters: lower ≤ rows φ ≤ upper.

    Args:
        rows: (k, 10) or (10,) coefficients; limits are (k,) or scalar.
    """
    rows = real_array(rows, "rows")
    rows = real_array(rows[None] if rows.ndim == 1 else rows, "rows", ("k", PARAMETERS_PER_BODY))
    integer(size, "size", lower=0, upper=_MOST)
    first = PARAMETERS_PER_BODY * integer(body, "body", lower=0)
    if first > size - PARAMETERS_PER_BODY:
        raise ArgumentError(f"Body {body} does not exist: {size} parameters are ten for each body.")
    matrix = np.zeros((len(rows), size))
    matrix[:, first : first + PARAMETERS_PER_BODY] = rows
    return Polyhedron(matrix, _row_limits(lower, len(rows)), _row_limits(upper, len(rows)))


def mass_limits(size: int, body: int, lower: float, upper: float) -> Polyhedron:
    """Return limits on the mass of a body, kg; −inf and inf for no limit."""
    lower, upper = number(lower, "lower", finite=False), number(upper, "upper", finite=False)
    return body_limits(size, body, np.eye(PARAMETERS_PER_BODY)[0], lower=lower, upper=upper)


def center_of_mass_box(size: int, body: int, lower: ArrayLike, upper: ArrayLike) -> Polyhedron:
    """Return limits that keep a body's centre of mass p_BoBcm_B in a box: m l ≤ h ≤ m u.

    Args:
        lower: (3,) lower corner l in B, m.
        upper: (3,) upper corner u in B, m, with u > l.
    """
    lower, upper = real_array(lower, "lower", (3,)), real_array(upper, "upper", (3,))
    if not (lower < upper).all():
        raise ArgumentError(
            f"A box needs a lower corner (3,) below an upper one; got {lower.tolist()} and "
            f"{upper.tolist()}."
        )
    identity = np.eye(PARAMETERS_PER_BODY)
    moment, mass = identity[1:4], identity[0]
    rows = np.concatenate([moment - lower[:, None] * mass, upper[:, None] * mass - moment])
    return body_limits(size, body, rows, lower=0.0)


def inside_ellipsoid(size: int, body: int, quadric: ArrayLike) -> Polyhedron:
    """Return the limit tr(P Q) ≥ 0, necessary for a body to lie inside an ellipsoid.

    Args:
        quadric: (4, 4) Q with [x;1]ᵀ Q [x;1] ≥ 0 inside ([Lee2019] Eq. (3.5.46)).
    """
    return body_limits(
        size, body, realizability_row(real_array(quadric, "quadric", (4, 4))), lower=0.0
    )


def parameter_limits(
    size: int, indices: Sequence[int], lower: ArrayLike, upper: ArrayLike
) -> Polyhedron:
    """Return limits on single parameters, such as friction coefficients; scalar or (k,)."""
    integer(size, "size", lower=1, upper=_MOST)
    matrix = np.eye(size)[list(integers(indices, "indices", lower=0, upper=size - 1))]
    return Polyhedron(matrix, _row_limits(lower, len(matrix)), _row_limits(upper, len(matrix)))


def intersection(*polyhedra: Polyhedron) -> Polyhedron:
    """Return the points that are in all polyhedra."""
    sizes = {instance(p, "a polyhedron", Polyhedron).matrix.shape[1] for p in polyhedra}
    if len(sizes) != 1:
        raise ArgumentError(
            f"An intersection needs polyhedra with equally many parameters; got {sorted(sizes)}."
        )
    return Polyhedron(
        np.concatenate([p.matrix for p in polyhedra]),
        np.concatenate([p.lower for p in polyhedra]),
        np.concatenate([p.upper for p in polyhedra]),
    )


def _row_limits(limits: ArrayLike, count: int) -> Array:
    """Return limits (k,), repeating a scalar; Polyhedron checks the shape."""
    limits = real_array(limits, "limits", finite=False)
    return np.full(count, limits) if limits.ndim == 0 else limits
