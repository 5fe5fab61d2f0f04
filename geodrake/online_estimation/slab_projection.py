"""Bregman projection onto the slabs of one sample."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from geodrake.inertia import Array
from geodrake.manifolds import Manifold
from geodrake.online_estimation.mirror_map import Covectors, MirrorMap, Point

_MOST_STEPS = 50  # of Newton's method, on one set of rows
_SHRUNK = 0.7  # share of the error that a full step may leave
_ROUNDING = 1e-5  # error that is left where rounding ends Newton's method
_SHARING = 1e-2  # of a row's squared length, added to it
_NOTHING = 1e-300  # squared length of a row that says nothing
_EDGE = 1e-6  # of the tolerance, outside of which a row is not yet outside


@dataclass(frozen=True, eq=False)
class _Face:
    """Rows that bind.

    Attributes:
        bound: (m,) which rows.
        rows: The rows.
        target: (m,) values that they are to have.
        scale: (m,) what their errors are measured in.
    """

    bound: NDArray[np.intp]
    rows: Covectors
    target: Array
    scale: Array

    @classmethod
    def of(cls, rows: Covectors, bound: NDArray[np.intp], target: Array, scale: Array) -> _Face:
        """The rows that are bound, of all rows."""
        own = Covectors(*(part[bound] for part in (rows.X, rows.X_light, rows.a, rows.a_light)))
        return cls(bound, own, target[bound], scale[bound])


@dataclass(frozen=True, eq=False)
class SlabProjection:
    """The nearest estimate with |Y p − effort| ≤ ε in every row, [Lee2019] Eq. (2.2.11).

    For the multipliers λ of the rows that bind, the projection is the y with
    ∇h(y) = ∇h(x) − Yᵀ λ, and Y y falls monotonically with λ: a handful of unknowns, found by
    Newton's method however many parameters there are.

    If the truth p is in the slabs, then D(p‖y) ≤ D(p‖x), and with a relaxation as well.

    Attributes:
        manifold: A product of `PhysicalInertia` and `Interval` factors.
        accuracy: Error of a row's value that is small enough, relative to its tolerance and to how
            far it was outside.
    """

    manifold: Manifold
    accuracy: float = 1e-9

    @cached_property
    def _map(self) -> MirrorMap:
        return MirrorMap.of(self.manifold)

    def project(
        self, p: Array, Y: Array, effort: Array, tolerance: Array, *, relaxation: float = 1.0
    ) -> Array | None:
        """The projection (n,) of an estimate.

        Args:
            p: (n,) estimate inside of the manifold.
            Y: (k, n) rows.
            effort: (k,) their values.
            tolerance: (k,) ε > 0 of each.
            relaxation: Share of the multipliers that is applied, in (0, 1]: less follows noise
                less.

        Returns:
            The estimate itself if it is in all slabs; None if no point of the manifold is found.
        """
        error = Y @ p - effort
        active = np.abs(error) > (1.0 + _EDGE) * tolerance
        if not active.any():
            return p
        rows, point = self._map.covectors(Y), self._map.point(p)
        side = np.where(active, np.sign(error), 0.0)
        scale = np.maximum(np.abs(error), tolerance)
        multipliers = np.zeros(len(Y))
        for _ in range(3 * len(Y)):
            face = _Face.of(rows, np.flatnonzero(side), effort + side * tolerance, scale)
            found = self._multipliers(point, face, multipliers[face.bound])
            if found is None:
                return None
            multipliers[:] = 0.0
            multipliers[face.bound] = found
            pushed = multipliers * side
            if (pushed < 0).any():
                worst = int(np.argmin(pushed))
                multipliers[worst] = side[worst] = 0.0
                continue
            y = self._map.moved(point, rows, multipliers)
            if y is None:
                return None
            values = self._map.values(y, rows) - effort
            outside = np.where(side == 0, np.abs(values) - tolerance, -np.inf)
            if (outside > max(_EDGE, self.accuracy) * scale).any():
                worst = int(np.argmax(outside / scale))
                side[worst] = np.sign(values[worst])
                continue
            y = self._map.moved(point, rows, relaxation * multipliers)
            return None if y is None else self._map.parameters(y)
        return None

    def nudged(
        self, p: Array, Y: Array, effort: Array, tolerance: Array, *, relaxation: float = 1.0
    ) -> Array | None:
        """One step of Newton's method toward the slabs that an estimate is outside of.

        For one of many samples: the step has its own way to be short, at most one in the manifold's
        metric, and rows that nearly depend on each other share what they ask for, so that samples
        that contradict each other do little. With the truth in the slabs, it comes nearer.

        Args:
            p: (n,) estimate inside of the manifold.
            Y: (k, n) rows.
            effort: (k,) their values.
            tolerance: (k,) ε > 0 of each.
            relaxation: Share of the step that is made, in (0, 1].

        Returns:
            The estimate (n,); itself if it is in all slabs, None if rounding leaves none.
        """
        error = Y @ p - effort
        error -= np.minimum(np.maximum(error, -tolerance), tolerance)  # zero in the slab
        bound = np.flatnonzero(error)
        if not len(bound):
            return p
        error = error[bound]
        rows, point = self._map.covectors(Y[bound]), self._map.point(p)
        products = self._map.products(point, rows)
        multipliers, kept = np.zeros(len(bound)), np.arange(len(bound))
        own, outside = products, error
        while len(kept):
            found = _solve_scaled(own, outside, _SHARING)
            right = found * outside >= 0
            if right.all():
                multipliers[kept] = found
                break
            kept = kept[right]
            own, outside = products[kept[:, None], kept], error[kept]
        length = np.sqrt(max(float(error @ multipliers) / self._map.lightest, 0.0))
        multipliers *= relaxation / (1.0 + length)
        return self._map.moved_a_little(point, rows, multipliers)

    def _multipliers(self, x: Point, face: _Face, start: Array) -> Array | None:
        """Multipliers (m,) with which the rows of a face have their targets.

        Newton's method for the least of a convex, self-concordant function of the multipliers.
        """
        own, scale, multipliers = face.rows, face.scale, start
        y = self._map.moved(x, own, start) if start.any() else x
        if y is None:
            y, multipliers = x, np.zeros(len(start))
        error = self._map.values(y, own) - face.target
        for _ in range(_MOST_STEPS):
            size = np.abs(error / scale).max(initial=0.0)
            if size <= self.accuracy:
                return multipliers
            direction = _solve_scaled(self._map.products(y, own), error)
            following = multipliers + direction
            length = np.sqrt(max(float(error @ direction) / self._map.lightest, 0.0))
            if length <= self.accuracy:
                return following  # what a short step leaves is this share of the error
            moved = self._map.moved(x, own, following)
            if moved is not None:
                left = self._map.values(moved, own) - face.target
            if moved is None or not np.abs(left / scale).max() < _SHRUNK * size:
                # This step stays inside and makes progress.
                following = multipliers + direction / (1.0 + length)
                moved = self._map.moved(x, own, following)
                if moved is None:
                    return None
                left = self._map.values(moved, own) - face.target
            multipliers, y, error = following, moved, left
        good = np.abs(error / scale).max() < max(_ROUNDING, self.accuracy)
        return multipliers if good else None


def _solve_scaled(products: Array, error: Array, softness: float = 1e-12) -> NDArray[np.float64]:
    """Newton's direction, a share of each row's squared length added to it.

    Rows of any length do no harm: Cholesky's decomposition does not depend on their units.
    """
    softened = products.copy()
    squares = softened.ravel()[:: len(softened) + 1]
    squares *= 1.0 + softness
    squares += _NOTHING
    # (LAPACK itself: at so few unknowns the checks of numpy.linalg.solve cost more than solving.)
    _, solution, failed = dposv(softened, error)
    if failed:
        solution = np.linalg.solve(softened, error)
    return np.asarray(solution)
