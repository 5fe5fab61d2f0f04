"""The dual of a Bregman projection: multipliers of the rows, and the point that belongs to them.

    ∇h(y) = ∇h(x) + Aᵀ λ,   λᵢ > 0 only where aᵢᵀ y = lowerᵢ,   λᵢ < 0 only where aᵢᵀ y = upperᵢ

The dual is concave, and all its points are inside of the manifold. Every step sets out from the
last point and its metric, so that distances of many orders of magnitude cost no precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geodrake.manifolds.base import Array, Manifold
from geodrake.manifolds.projections.polyhedron import Polyhedron
from geodrake.manifolds.projections.quadratic import least_change

_NEAR = 0.1  # length of a Newton step in the metric that needs no search
_ENOUGH = (-0.3, 0.1)  # slope that a full step may leave, relative to the first
_ROUNDING = 4e-16  # of a row's value, relative to its terms


@dataclass(frozen=True, eq=False)
class State:
    """A point y (n,) with the multipliers λ (k,) that lead to it from x."""

    manifold: Manifold
    limits: Polyhedron
    y: Array
    multipliers: Array

    @classmethod
    def at(cls, manifold: Manifold, limits: Polyhedron, x: Array) -> State:
        """The state of x itself.

        Args:
            x: (n,) point inside the manifold.
        """
        return cls(manifold, limits, x, np.zeros(len(limits.matrix)))

    def pushed(self, d: Array) -> State | None:
        """The state of λ + d, at once; None where there is no such point."""
        b = self.limits.matrix.T @ d
        line = self.manifold.calc_mirror_line(self.y, b) if b.any() else None
        if line is None or line.longest <= 1.0:
            return None
        return State(self.manifold, self.limits, line.point(1.0), self.multipliers + d)

    def weighted(self, w: float) -> State:
        """The state with the gradient and the multipliers times w."""
        force = self.manifold.calc_gradient(self.y)
        if w < 1.0:
            y = self.manifold.calc_mirror_line(self.y, -force).point(1.0 - w)
        else:
            y = self.manifold.calc_mirror_line(self.y, force).point(w - 1.0)
        return State(self.manifold, self.limits, y, w * self.multipliers)

    @cached_property
    def frame(self) -> Array:
        """Orthonormal tangent vectors (n, n) at y."""
        return self.manifold.calc_frame(self.y)

    @cached_property
    def rows(self) -> Array:
        """Rows (k, n) in that frame."""
        return np.asarray(self.limits.matrix @ self.frame)

    @cached_property
    def lengths(self) -> Array:
        """Lengths (k,) of the rows in the metric at y."""
        return np.asarray(np.linalg.norm(self.rows, axis=1))

    @cached_property
    def gaps(self) -> tuple[Array, Array]:
        """How far lower and upper limits are above the value of the rows, in the metric at y."""
        value = self.limits.matrix @ self.y
        return (self.limits.lower - value) / self.lengths, (
            self.limits.upper - value
        ) / self.lengths

    @cached_property
    def rounding(self) -> Array:
        """What the gaps (k,) cannot be known better than."""
        terms = np.abs(self.limits.matrix) @ np.abs(self.y)
        return np.asarray(_ROUNDING * len(self.y) * terms / self.lengths)

    @cached_property
    def errors(self) -> Array:
        """Distance (k,) in the metric at y from feasibility and complementarity of each row."""
        below, above = self.gaps
        broken = np.maximum(0.0, np.maximum(below, -above))
        pushed = np.where(self.multipliers > 0, np.abs(below), np.abs(above))
        off = np.where(self.multipliers == 0, broken, pushed)
        return np.maximum(0.0, off - self.rounding)

    @property
    def error(self) -> float:
        """The greatest of the errors."""
        return float(self.errors.max())

    @cached_property
    def direction(self) -> Array | None:
        """Newton's step (k,) of the multipliers; None if there is none."""
        held = self.multipliers * self.lengths
        d = least_change(self.rows / self.lengths[:, None], *self.gaps, held)
        if d is None or not np.isfinite(d).all():
            return None
        return np.asarray(d / self.lengths)

    @property
    def newton_length(self) -> float:
        """Length of Newton's step in the metric at y, which bounds the distance to the optimum."""
        d = self.direction
        return np.inf if d is None else float(np.linalg.norm(d @ self.rows))

    def newton_step(self) -> State | None:
        """The state after a damped Newton step of all multipliers; None if there is none."""
        d = self.direction
        if d is None or not d.any():
            return None
        return self._moved(d, full=True, near=self.newton_length < _NEAR)

    def single_step(self, row: int) -> State | None:
        """The state in which one row is exact, by its own multiplier alone; None if it is."""
        below, above = (float(gap[row]) for gap in self.gaps)
        held, slack = float(self.multipliers[row]), float(self.rounding[row])
        d = np.zeros(len(self.multipliers))
        if below > slack or (held < 0 and above > slack):
            d[row] = 1.0
        elif above < -slack or (held > 0 and below < -slack):
            d[row] = -1.0
        else:
            return None
        return self._moved(d, full=False)

    def _moved(self, d: Array, *, full: bool, near: bool = False) -> State | None:
        """The state along λ + t d where the dual is greatest.

        Args:
            d: (k,) direction in which the dual rises.
            full: Whether d is a step by itself, t = 1, that may be good enough.
            near: Whether it is known to be, so that rounding cannot spoil the search.
        """
        b = self.limits.matrix.T @ d
        if not b.any():  # rows that contradict each other: the dual rises, and y stays
            return None
        held = self.multipliers
        moving, back = d != 0, held * d < 0
        equal = self.limits.lower == self.limits.upper
        sign = np.where(held == 0, d, held)
        targets = np.where(sign > 0, self.limits.lower, self.limits.upper)[moving]
        value = self.limits.matrix @ self.y
        goal = float(d[moving] @ (targets - value[moving]))
        if not (near or 0 < goal < np.inf):
            return None
        turn = back & ~equal
        kinks = np.where(turn, -held / np.where(turn, d, 1.0), np.inf)
        line = self.manifold.calc_mirror_line(self.y, b)
        if near and kinks.min() >= 1.0 and line.longest > 1.0:
            t = 1.0
        else:
            target = float(d[moving] @ targets)
            enough = (_ENOUGH[0] * goal, _ENOUGH[1] * goal) if full else None
            t = line.time_of(target, most=float(kinks.min()), enough=enough)
        multipliers = held + t * d
        multipliers[kinks <= t] = 0.0
        return State(self.manifold, self.limits, line.point(t), multipliers)
