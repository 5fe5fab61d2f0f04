"""Convex sets for estimates: functions of your own, and the linear limits that robots have."""

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
    """The points p (n,) with c(p) ≤ 0 for k convex functions c of your own, [Lee2019] Eq. (5.4.54).

    Attributes:
        function: Maps p (n,) to c(p), a number or (k,).
        gradient: Maps p (n,) to ∇c(p), (n,) or (k, n); any subgradient where there is no gradient.
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
        rows: (k, 10) or (10,) coefficients; limits are (k,) or one.
    """
    rows = real_array(rows, "rows")
    rows = real_array(rows[None] if rows.ndim == 1 else rows, "rows", ("k", PARAMETERS_PER_BODY))
    integer(size, "size", lower=0, upper=_MOST)
    first = PARAMETERS_PER_BODY * integer(body, "body", lower=0)
    if first > size - PARAMETERS_PER_BODY:
        raise ArgumentError(f"Body {body} does not exist: {size} parameters are ten for each body.")
    matrix = np.zeros((len(rows), size))
    matrix[:, first : first + PARAMETERS_PER_BODY] = rows
    return Polyhedron(matrix, _of_rows(lower, len(rows)), _of_rows(upper, len(rows)))


def mass_limits(size: int, body: int, lower: float, upper: float) -> Polyhedron:
    """Return limits on the mass of a body, kg; −inf and inf for none."""
    lower, upper = number(lower, "lower", finite=False), number(upper, "upper", finite=False)
    return body_limits(size, body, np.eye(PARAMETERS_PER_BODY)[0], lower=lower, upper=upper)


def center_of_mass_box(size: int, body: int, lower: ArrayLike, upper: ArrayLike) -> Polyhedron:
    """Return limits on the centre of mass p_BoBcm_B of a body, in a box: m l ≤ h ≤ m u.

    Args:
        lower: (3,) lower corner l in B, m.
        upper: (3,) upper corner u in B, m; above l in every coordinate.
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
    """Return what keeps a body in an ellipsoid, as far as second moments show: tr(P Q) ≥ 0.

    Args:
        quadric: (4, 4) Q with [x;1]ᵀ Q [x;1] ≥ 0 inside ([Lee2019] Eq. (3.5.46)).
    """
    return body_limits(
        size, body, realizability_row(real_array(quadric, "quadric", (4, 4))), lower=0.0
    )


def parameter_limits(
    size: int, indices: Sequence[int], lower: ArrayLike, upper: ArrayLike
) -> Polyhedron:
    """Return limits on single parameters, such as friction coefficients, (k,) or one of each."""
    integer(size, "size", lower=1, upper=_MOST)
    matrix = np.eye(size)[list(integers(indices, "indices", lower=0, upper=size - 1))]
    return Polyhedron(matrix, _of_rows(lower, len(matrix)), _of_rows(upper, len(matrix)))


def intersection(*polyhedra: Polyhedron) -> Polyhedron:
    """Return the points that are in all polyhedra."""
    sizes = {instance(each, "a polyhedron", Polyhedron).matrix.shape[1] for each in polyhedra}
    if len(sizes) != 1:
        raise ArgumentError(
            f"An intersection needs polyhedra with equally many parameters; got {sorted(sizes)}."
        )
    return Polyhedron(
        np.concatenate([each.matrix for each in polyhedra]),
        np.concatenate([each.lower for each in polyhedra]),
        np.concatenate([each.upper for each in polyhedra]),
    )


def _of_rows(limits: ArrayLike, count: int) -> Array:
    """Return limits (k,) from one for all rows, or one each; Polyhedron tells of a wrong shape."""
    limits = real_array(limits, "limits", finite=False)
    return np.full(count, limits) if limits.ndim == 0 else limits
