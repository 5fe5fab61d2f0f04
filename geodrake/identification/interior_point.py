"""Interior-point minimization of a small smooth function, convex or not, over linear constraints.

A primal-dual barrier method after J. Nocedal and S. Wright, *Numerical Optimization* (2006), §19.3:
it starts inside the inequalities and stays there. Where the Hessian is not positive definite, a
multiple of a metric is added to it, which is a trust region in that metric.

SciPy's SLSQP and trust-constr reach the same minima in 3 and 11 times the time, and IPOPT by way of
Drake, which passes it no Hessians, in more than 100 times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, null_space

from geodrake.descent import PRECISION, is_within_rounding, step_length
from geodrake.errors import IdentificationError
from geodrake.inertia import Array

_GAP = 1e-11
"""Duality gap at which to stop, as a share of the size of the function."""

_ACCURACY = 1e-14
"""Decrease that a step must promise to be worth taking, as a share of the size."""

_TO_BOUNDARY = 0.995
_FIRST_SHIFT, _MOST_SHIFTS = 1e-3, 40
_MOST_STEPS = 300
_CLIP = 1e8


class SmoothCost(Protocol):
    """A twice differentiable function with a domain of its own."""

    @property
    def size(self) -> float:
        """Value that counts as one, to which tolerances are relative."""

    def value(self, z: Array) -> float:
        """f(z), infinite outside the domain."""

    def derivatives(self, z: Array) -> tuple[Array, Array]:
        """Gradient (p,) and Hessian (p, p) at z."""

    def metric(self, z: Array) -> Array:
        """(p, p) positive definite matrix of about the size of the Hessian."""


@dataclass(frozen=True, eq=False)
class Region:
    """Points z with E z = e, of which only the directions are needed, and C z ≥ c.

    Attributes:
        directions: (p, p − k) orthonormal basis of the null space of E.
        matrix: (m, p) C.
        lower: (m,) c.
    """

    directions: Array
    matrix: Array
    lower: Array

    @classmethod
    def of(cls, equality: Array, matrix: Array, lower: Array) -> Region:
        """Return the region of equality rows E (k, p), inequality rows C (m, p) and lower bounds c.

        Args:
            equality: (k, p) rows E; k may be 0.
            matrix: (m, p) rows C.
            lower: (m,) bounds c.
        """
        directions = null_space(equality) if len(equality) else np.eye(equality.shape[1])
        return cls(directions, matrix, lower)

    def slacks(self, z: Array) -> Array:
        """C z − c, (m,)."""
        return self.matrix @ z - self.lower


@dataclass(frozen=True, eq=False)
class LocalMinimum:
    """A local minimum.

    Attributes:
        z: (p,) where it is.
        value: f(z).
        hessian: (p, p) Hessian of f at z.
        strict: Whether the Hessian is positive definite there, as far as constraints leave freedom.
        steps: Newton steps taken.
    """

    z: Array
    value: float
    hessian: Array
    strict: bool
    steps: int


def minimize(
    objective: SmoothCost, region: Region, start: Array, *, barrier: float = 1e-2
) -> LocalMinimum:
    """Return the local minimum that a start leads to.

    Args:
        objective: The function f.
        region: The constraints.
        start: (p,) in the domain, on the equalities and strictly inside the inequalities.
        barrier: First duality gap, as a share of the size of the function; less for a good start.

    Raises:
        IdentificationError: No minimum was reached in 300 Newton steps, none of them lowered f, or
            rounding put the point onto a constraint.
    """
    m, size = len(region.lower), objective.size
    least = _GAP * size / max(m, 1)
    t = max(barrier * size / m, least) if m else least
    z, s = start, region.slacks(start)
    y, before = t / s, np.inf
    for count in range(1, _MOST_STEPS + 1):
        if not s.min(initial=np.inf) > np.finfo(float).tiny * max(t, 1.0):
            break  # rounding has put the point onto a constraint
        g, H = objective.derivatives(z)
        g = g - region.matrix.T @ (t / s)
        step, shift = _newton_step(
            objective, region, z, g, H + (region.matrix.T * (y / s)) @ region.matrix
        )
        promise = -float(g @ step)
        value = objective.value(z)
        rounding = PRECISION * max(abs(value), size)
        ends = promise <= _ACCURACY * size or is_within_rounding(promise, before, rounding)
        if t > least and (ends or promise <= 0.1 * t * m):
            t, before = max(least, 0.1 * t * min(1.0, (t * m / size) ** 0.25)), np.inf
            continue
        change = region.matrix @ step
        decrease = _decrease(objective, value, (z, s, t), (step, change))
        length = float(step_length(decrease, promise, rounding, longest=_longest(s, change)))
        if length == 0.0 and t == least:
            break  # far from where rounding would explain it
        before, z = promise, z + length * step
        y = _moved_multipliers(y, s, t, change)
        s = region.slacks(z)
        y = np.clip(y, t / s / _CLIP, t / s * _CLIP)
        if length == 0.0:
            t, before = max(least, 0.1 * t), np.inf
        elif ends:
            return LocalMinimum(
                z, objective.value(z), objective.derivatives(z)[1], shift == 0.0, count
            )
    raise IdentificationError(
        f"No minimum was reached in {count} Newton steps.",
        advice="Check units and noise levels, raise gamma, or start from another point.",
        steps=count,
    )


def _newton_step(
    objective: SmoothCost, region: Region, z: Array, gradient: Array, hessian: Array
) -> tuple[Array, float]:
    """The step (p,), and the multiple of the metric that made its matrix positive definite."""
    N = region.directions
    reduced: Any = N.T @ hessian @ N
    if not np.isfinite(reduced).all():
        raise IdentificationError(
            "The steps of Newton's method overflow: data, prior and constraints differ by too many "
            "orders of magnitude.",
            advice="Check units and noise levels, or raise gamma.",
        )
    metric: Any = None
    shift = 0.0
    for _ in range(_MOST_SHIFTS):
        try:
            factor = cho_factor(reduced if metric is None else reduced + shift * metric)
        except LinAlgError:
            if metric is None:
                metric = N.T @ objective.metric(z) @ N
            shift = 4.0 * shift or _FIRST_SHIFT
        else:
            return -N @ cho_solve(factor, N.T @ gradient), shift
    raise IdentificationError(
        "The parameters cannot be distinguished by data and prior: no Newton step is defined.",
        advice="Add data or a prior for them, or leave their columns out.",
    )


def _decrease(
    objective: SmoothCost, begin: float, point: tuple[Array, Array, float], way: tuple[Array, Array]
) -> Callable[[Array], Array]:
    """How much lower f − t Σ log s is after a share of a step, where f begins with a value."""
    (z, s, t), (step, change) = point, way

    def decrease(share: Array) -> Array:
        barrier = t * np.log1p(share * change / s).sum()
        return np.asarray(begin - objective.value(z + share * step) + barrier)

    return decrease


def _moved_multipliers(y: Array, s: Array, t: float, change: Array) -> Array:
    """Multipliers y after Newton's step on s y = t, kept positive."""
    step = t / s - y - y / s * change
    return y + step * _longest(y, step)


def _longest(values: Array, change: Array) -> float:
    """Share of a change, one at most, that keeps values positive."""
    falls = change < 0
    edge = float(np.min(values[falls] / -change[falls], initial=np.inf))
    return min(1.0, _TO_BOUNDARY * edge)
