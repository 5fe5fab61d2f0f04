"""Primal-dual interior-point method for the least divergence inside of a polyhedron."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from geodrake.errors import ArgumentError
from geodrake.manifolds import Manifold
from geodrake.manifolds.base import Array
from geodrake.projections.polyhedron import Polyhedron

_SHARE_OF_EDGE = 0.95  # of the way to the edge that one step may go
_CENTERING = 0.1
_LEAST_GAP = 1e-12  # so that no row outweighs the others by more than rounding bears
_SHORT = 0.3  # length in the metric of a step that is taken in full
_REFINEMENTS = 3  # full Newton steps on the faces that bind
_DEPENDENT = 1e-10  # singular value, relative to the largest, of rows that say nothing new


@dataclass(frozen=True, eq=False)
class Iterate:
    """Iterate: coordinates z (n,), slacks s and multipliers of inequalities, of equations."""

    z: Array
    slacks: Array
    inequality: Array
    equation: Array

    def moved(self, direction: Iterate, t: float) -> Iterate:
        """The point t along a direction."""
        return Iterate(
            self.z + t * direction.z,
            self.slacks + t * direction.slacks,
            self.inequality + t * direction.inequality,
            self.equation + t * direction.equation,
        )


@dataclass(frozen=True, eq=False)
class Program:
    """Minimize D(x + T z‖x) subject to E z = e and C z ≥ c, with rows of unit length."""

    manifold: Manifold
    x: Array
    T: Array
    E: Array
    e: Array
    C: Array
    c: Array

    @classmethod
    def of(cls, manifold: Manifold, x: Array, constraints: Polyhedron) -> Program:
        """The program of a projection of x."""
        L = np.linalg.cholesky(manifold.metric(x))
        T = np.linalg.inv(L).T
        rows = constraints.matrix @ T
        lengths = np.linalg.norm(rows, axis=1)
        lengths = np.where(lengths > 0, lengths, 1.0)
        rows /= lengths[:, None]
        value = constraints.matrix @ x
        lower, upper = (constraints.lower - value) / lengths, (constraints.upper - value) / lengths
        equal = constraints.lower == constraints.upper
        below, above = ~equal & np.isfinite(lower), ~equal & np.isfinite(upper)
        C = np.concatenate([rows[below], -rows[above]])
        c = np.concatenate([lower[below], -upper[above]])
        return cls(manifold, x, T, *_independent(rows[equal], lower[equal]), C, c)

    def position(self, point: Iterate) -> Array:
        """Parameters y (n,) of an iterate."""
        return np.asarray(self.x + self.T @ point.z)

    def start(self) -> Iterate:
        """The first iterate, at x."""
        slacks = np.maximum(-self.c, 1.0)
        ones = np.ones(len(self.c))
        return Iterate(np.zeros(len(self.x)), slacks, ones, np.zeros(len(self.e)))

    def pull(self, point: Iterate) -> Array:
        """Gradient of the divergence (n,)."""
        y = self.position(point)
        return self.T.T @ (self.manifold.gradient(y) - self.manifold.gradient(self.x))

    def residuals(self, point: Iterate) -> tuple[Array, Array, Array]:
        """Errors of stationarity (n,), of the equations and of the inequalities."""
        push = self.E.T @ point.equation + self.C.T @ point.inequality
        return (
            self.pull(point) - push,
            self.E @ point.z - self.e,
            self.C @ point.z - self.c - point.slacks,
        )

    def error(self, point: Iterate) -> float:
        """Greatest error of the conditions of optimality."""
        gaps = point.slacks * point.inequality
        return float(np.abs(np.concatenate([*self.residuals(point), gaps])).max())

    def next(self, point: Iterate) -> Iterate | None:
        """The iterate after a Newton step toward a smaller gap; None if there is none."""
        try:
            direction = self.newton(point)
            following = point.moved(direction, self._longest(point, direction))
            self.manifold.longest_step(self.position(following), self.T @ direction.z)
        except (ArgumentError, np.linalg.LinAlgError):  # on the edge, as far as rounding tells
            return None
        return following

    def newton(self, point: Iterate) -> Iterate:
        """Newton's direction toward a smaller gap."""
        s, nu = point.slacks, point.inequality
        target = max(_CENTERING * float(s @ nu) / len(s), _LEAST_GAP) if len(s) else 0.0
        off_gradient, off_equation, off_inequality = self.residuals(point)
        H = self.T.T @ self.manifold.metric(self.position(point)) @ self.T
        # Without slacks and multipliers of the inequalities, which follow from dz.
        H += (self.C.T * (nu / s)) @ self.C
        right = -off_gradient + self.C.T @ ((target - s * nu - nu * off_inequality) / s)
        dz, d_equation = _solve_saddle(H, self.E, right, -off_equation)
        ds = self.C @ dz + off_inequality
        return Iterate(dz, ds, (target - s * nu - nu * ds) / s, d_equation)

    def polished(self, point: Iterate, tolerance: float) -> Iterate | None:
        """The exact solution on the faces that bind; None if they are not found.

        A row that barely binds has s ≈ ν ≈ √(s ν), which is far more than the tolerance. So the
        rows that bind are guessed, solved with as equations, and corrected by their signs.
        """
        binding = point.inequality > point.slacks
        for _ in range(len(binding) + 1):
            exact = self._on_face(point, binding)
            if exact is None:
                return None
            missed = self.C @ exact.z - self.c < -tolerance
            if missed.any():
                binding = binding | missed
                continue
            rows = np.concatenate([self.C[binding], self.E, -self.E])
            multipliers, rest = nnls(rows.T, self.pull(exact))
            if rest <= tolerance * (1 + np.linalg.norm(multipliers)):
                return exact
            pushed = multipliers[: binding.sum()] > 0
            if pushed.all():
                return None
            binding[binding] = pushed
        return None

    def _on_face(self, point: Iterate, binding: NDArray[np.bool_]) -> Iterate | None:
        """The minimum with binding rows as equations; None if they contradict each other."""
        E = np.concatenate([self.E, self.C[binding]])
        e = np.concatenate([self.e, self.c[binding]])
        try:
            E, e = _independent(E, e)
            face = replace(self, E=E, e=e, C=self.C[:0], c=self.c[:0])
            point = Iterate(point.z, np.zeros(0), np.zeros(0), np.zeros(len(e)))
            for _ in range(_REFINEMENTS):
                direction = face.newton(point)
                point = point.moved(direction, face._longest(point, direction))
        except (ArgumentError, np.linalg.LinAlgError):
            return None
        return point

    def _longest(self, point: Iterate, direction: Iterate) -> float:
        """Longest step up to one that stays inside of everything."""
        y, dy = self.position(point), self.T @ direction.z
        inside = float(self.manifold.longest_step(y, dy))
        length = float(np.sqrt(dy @ self.manifold.metric(y) @ dy))
        damped = 1.0 if length < _SHORT else 1.0 / (1.0 + length)
        for value, change in (
            (point.slacks, direction.slacks),
            (point.inequality, direction.inequality),
        ):
            falling = change < 0
            inside = min(inside, (value[falling] / -change[falling]).min(initial=np.inf))
        return min(damped, _SHARE_OF_EDGE * inside)


def _independent(E: Array, e: Array) -> tuple[Array, Array]:
    """The same equations without those that follow from others."""
    if not len(e):
        return E, e
    U, values, Vt = np.linalg.svd(E, full_matrices=False)
    kept = values > _DEPENDENT * values[0]
    turned = U.T @ e
    rest = e - U[:, kept] @ turned[kept]
    if np.abs(rest).max() > np.sqrt(_DEPENDENT) * max(1.0, np.abs(e).max()):
        raise ArgumentError(
            "The equations of the polyhedron contradict each other, or one of them has only zeros.",
            advice="Leave out equations that say the same with other values.",
        )
    return Vt[kept], turned[kept] / values[kept]


def _solve_saddle(H: Array, E: Array, right: Array, low: Array) -> tuple[Array, Array]:
    """Solution dz and dλ of H dz − Eᵀ dλ = right, E dz = low."""
    k = len(low)
    matrix = np.block([[H, -E.T], [E, np.zeros((k, k))]])
    solved = np.linalg.solve(matrix, np.concatenate([right, low]))
    return solved[: len(right)], solved[len(right) :]
