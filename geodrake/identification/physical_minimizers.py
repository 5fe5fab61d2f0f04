"""Quadratic fits whose bodies stay physical: many small ones at once, by an interior point method.

The minimum of ½ xᵀ G x − rᵀ x where every inertia block has P(φ) ⪰ 0 and parameters stay within
bounds. Steps are those of Nesterov and Todd with Mehrotra's predictor and corrector, as in
`newton_step`, here of all problems together. The last Hessian is that of the fit in all directions
that the constraints leave, and so predicts what further columns would change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import IdentificationError
from geodrake.identification.normal_equations import choleskies, cholesky, solved
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.inertia.kernels import BASIS, calc_from_pseudo_inertia, calc_pseudo_inertia

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

_GAP = 1e-3
"""Distance of the cost from its minimum, where squared residuals are counted in variances."""
_MOST_STEPS = 60
_REACH = 0.9  # of the way to the boundary
_RIDGE = 1e-13
_INSIDE = 1e-3  # smallest over largest moment of a body from which to start
_NO_MASS = 1e-6  # kg or kg·m², largest moment of a body that is nothing
_FLAT = BASIS.reshape(PARAMETERS_PER_BODY, 16)
_UNIT = np.eye(4)


@dataclass(frozen=True, eq=False)
class PhysicalMinima:
    """Minima of F problems.

    Attributes:
        x: (F, p) minimizers; parameters that are held by a bound are at it.
        slope: (F, p) derivatives of the cost there less what the constraints push.
        hessian: (F, p, p) second derivatives, with those of the constraints.
    """

    x: Array
    slope: Array
    hessian: Array


def are_physical(x: Array, blocks: Sequence[int]) -> Mask:
    """(F,) whether all bodies of parameters are physical.

    Args:
        x: (F, p) parameters.
        blocks: First parameter of every inertia block.
    """
    P = calc_pseudo_inertia(x[:, _places(blocks)])
    return np.asarray((np.linalg.eigvalsh(P)[..., 0] > 0.0).all(axis=1))


def inner_bodies(x: Array, blocks: Sequence[int], small: Array) -> Array:
    """(F, p) parameters with bodies at or beyond the boundary moved inside; none moves far.

    Args:
        x: (F, p) parameters.
        blocks: First parameter of every inertia block.
        small: (10,) what becomes of a body that has no mass.
    """
    places = _places(blocks)
    bodies = x[:, places]
    values, vectors = np.linalg.eigh(calc_pseudo_inertia(bodies))
    most = values[..., -1:]
    raised = np.maximum(values, _INSIDE * most)[..., None, :]
    inside = calc_from_pseudo_inertia((vectors * raised) @ np.swapaxes(vectors, 2, 3))
    inside = np.where(values[..., :1] > _INSIDE * most, bodies, inside)
    moved = x.copy()
    moved[:, places] = np.where(most > _NO_MASS, inside, small)
    return moved


def physical_minimizers(
    gram: Array,
    rhs: Array,
    blocks: Sequence[int],
    start: Array,
    bounds: tuple[Array, Array],
    *,
    beyond: Sequence[int] | None = None,
) -> PhysicalMinima:
    """Minimizers of ½ xᵀ G x − rᵀ x with physical bodies within bounds, for F problems at once.

    Parameters without constraints are eliminated. If a body then becomes unphysical, it is
    constrained as well, and the problem is solved again.

    Args:
        gram: (F, p, p) positive definite matrices G.
        rhs: (F, p) right sides r.
        blocks: First parameter of every inertia block.
        start: (F, p) parameters whose bodies are physical.
        bounds: Lower and upper bounds (p,), infinite for inertial parameters.
        beyond: Blocks to constrain from the start; all by default.

    Raises:
        IdentificationError: The method does not end.
    """
    kept = list(beyond or blocks)
    while True:
        found = _with_bodies_kept(gram, rhs, kept, start, bounds)
        others = [block for block in blocks if block not in kept]
        left = [block for block in others if not are_physical(found.x, [block]).all()]
        if not left:
            return found
        kept += left


def _with_bodies_kept(
    gram: Array, rhs: Array, blocks: Sequence[int], start: Array, bounds: tuple[Array, Array]
) -> PhysicalMinima:
    """As `physical_minimizers`, with constraints for the given blocks only."""
    constrained = np.isfinite(bounds[0]) | np.isfinite(bounds[1])
    constrained[_places(blocks)] = True
    at, rest = np.flatnonzero(constrained), np.flatnonzero(~constrained)
    small = np.searchsorted(at, blocks).tolist()
    within = bounds[0][at], bounds[1][at]
    if not len(rest):
        return _inner_minima(_Problem.of(gram, rhs, small, within), start)
    scale = 1.0 / np.sqrt(np.diagonal(gram, axis1=1, axis2=2)[:, rest])
    own = gram[:, rest[:, None], rest] * scale[:, :, None] * scale[:, None, :]
    right = np.concatenate([gram[:, rest[:, None], at], rhs[:, rest, None]], axis=2)
    factors = choleskies(own, _RIDGE)
    pairs = zip(factors, scale[..., None] * right, strict=True)
    moved = scale[..., None] * np.array([solved(factor, each) for factor, each in pairs])
    turned = np.swapaxes(right[..., :-1], 1, 2) @ moved
    schur = gram[:, at[:, None], at] - turned[..., :-1]
    schur = 0.5 * (schur + np.swapaxes(schur, 1, 2))
    problem = _Problem.of(schur, rhs[:, at] - turned[..., -1], small, within)
    inner = _inner_minima(problem, start[:, at])
    x, slope, hessian = np.empty_like(rhs), np.zeros_like(rhs), gram.copy()
    x[:, at], slope[:, at] = inner.x, inner.slope
    x[:, rest] = moved[..., -1] - (moved[..., :-1] @ inner.x[..., None])[..., 0]
    hessian[:, at[:, None], at] += inner.hessian - schur
    return PhysicalMinima(x, slope, hessian)


def _inner_minima(problem: _Problem, start: Array) -> PhysicalMinima:
    """The minima of problems whose bodies all have constraints, from points (F, p) inside."""
    at = problem.first(start)
    for _ in range(_MOST_STEPS):
        here = _Linearization(problem, at)
        if here.is_done():
            return here.minima()
        at = here.next()
    raise IdentificationError(
        f"A fit with physical bodies did not end within {_MOST_STEPS} steps.",
        advice="Check that the logs' efforts and the model have the same units.",
    )


@dataclass(frozen=True, eq=False)
class _Point:
    """Parameters x (F, p), dual matrices Z (F, n, 4, 4), slacks and multipliers (F, m) of bounds.

    Slacks are kept beside x, in whose last digits they may be lost.
    """

    x: Array
    Z: Array
    slack: Array
    multipliers: Array


@dataclass(frozen=True, eq=False)
class _Problem:
    """The costs and constraints of F problems; the m bounds are sign x_i − offset ≥ 0."""

    gram: Array
    rhs: Array
    places: Indices
    bounds: tuple[Array, Array]
    bounded: Indices
    sign: Array
    offset: Array
    lower: int  # how many of the bounds are lower ones

    @classmethod
    def of(
        cls, gram: Array, rhs: Array, blocks: Sequence[int], bounds: tuple[Array, Array]
    ) -> _Problem:
        low, high = (np.flatnonzero(np.isfinite(side)) for side in bounds)
        sign = np.concatenate([np.ones(len(low)), -np.ones(len(high))])
        offset = np.concatenate([bounds[0][low], -bounds[1][high]])
        bounded = np.concatenate([low, high])
        return cls(gram, rhs, _places(blocks), bounds, bounded, sign, offset, len(low))

    def first(self, start: Array) -> _Point:
        """A point inside all constraints, with multipliers that suit its cost."""
        lower, upper = self.bounds
        spread = 1.0 / np.sqrt(np.diagonal(self.gram, axis1=1, axis2=2))
        margin = np.minimum(spread, 0.25 * (upper - lower))
        x = np.clip(start, lower + margin, upper - margin)
        inside = np.maximum(self.slack(x), 0.5 * margin[:, self.bounded])
        S, slope = self.bodies(x), self.slope(x)
        factors = [cholesky(G, _RIDGE * np.trace(G)) for G in self.gram]
        far = [g @ solved(L, g) for L, g in zip(factors, slope, strict=True)]
        count = 4 * S.shape[1] + len(self.bounded)
        centre = np.maximum(1.0, 0.1 * np.array(far) / count)[:, None]
        return _Point(x, centre[..., None, None] * np.linalg.inv(S), inside, centre / inside)

    def bodies(self, x: Array) -> Array:
        """(F, n, 4, 4) pseudo inertias."""
        return np.asarray(x[:, self.places] @ _FLAT).reshape(len(x), -1, 4, 4)

    def slack(self, x: Array) -> Array:
        """(F, m) distances from the bounds."""
        return self.sign * x[:, self.bounded] - self.offset

    def slope(self, x: Array) -> Array:
        """(F, p) derivatives of the cost."""
        return (self.gram @ x[..., None])[..., 0] - self.rhs

    def pushed(self, matrices: Array, forces: Array) -> Array:
        """(F, p) what dual matrices (F, n, 4, 4) and multipliers (F, m) push the parameters."""
        push = np.zeros_like(self.rhs)
        push[:, self.places] = matrices.reshape(*matrices.shape[:2], 16) @ _FLAT.T
        self.add(push, self.sign * forces)
        return push

    def add(self, parameters: Array, values: Array) -> None:
        """Add values (F, m) of the bounds to those of parameters (F, p), which may have two."""
        for side in (slice(self.lower), slice(self.lower, None)):
            parameters[:, self.bounded[side]] += values[:, side]


class _Linearization:
    """The conditions of the minimum, linearized at a point by Nesterov and Todd's scaling."""

    def __init__(self, problem: _Problem, at: _Point) -> None:
        self._problem, self._at = problem, at
        root_S, root_Z = _root(problem.bodies(at.x)), _root(at.Z)
        _, self._d, V = np.linalg.svd(np.swapaxes(root_Z, 2, 3) @ root_S)
        T = root_S @ np.swapaxes(V, 2, 3) / np.sqrt(self._d)[..., None, :]
        self._scaling = np.linalg.inv(T)
        self._slack = at.slack
        self._error = problem.slope(at.x) - problem.pushed(at.Z, at.multipliers)
        self._gaps = np.square(self._d).sum((1, 2)) + (self._slack * at.multipliers).sum(1)
        self._count = self._d[0].size + len(problem.bounded)
        self._hessian = self._with_constraints()
        self._scale = 1.0 / np.sqrt(np.diagonal(self._hessian, axis1=1, axis2=2))
        scaled = self._hessian * self._scale[:, :, None] * self._scale[:, None, :]
        self._factors = choleskies(scaled, _RIDGE)

    def _with_constraints(self) -> Array:
        problem, hessian = self._problem, self._problem.gram.copy()
        basis = self._scaling[:, :, None] @ BASIS @ np.swapaxes(self._scaling, 2, 3)[:, :, None]
        flat = basis.reshape(*basis.shape[:3], 16)
        places = problem.places
        hessian[:, places[:, :, None], places[:, None, :]] += flat @ np.swapaxes(flat, 2, 3)
        problem.add(np.einsum("fii->fi", hessian), self._at.multipliers / self._slack)
        return hessian

    def _solved(self, right: Array) -> Array:
        steps = [solved(L, r) for L, r in zip(self._factors, self._scale * right, strict=True)]
        return self._scale * np.array(steps)

    def is_done(self) -> bool:
        """Whether all problems are as near to their minimum as asked for."""
        if self._gaps.max() > _GAP:
            return False
        return bool((self._error * self._solved(self._error)).sum(1).max() <= _GAP)

    def next(self) -> _Point:
        """The point after a step: predicted first, then centred and corrected."""
        problem, at, mean = self._problem, self._at, self._gaps / self._count
        straight = self._direction(np.zeros_like(mean))
        length = self._length(straight)
        share = (self._gaps_after(straight, length) / self._gaps) ** 3
        step = self._direction(np.clip(share, 1e-6, 1.0) * mean, straight)
        length = np.minimum(1.0, _REACH * self._length(step))
        return _Point(
            at.x + length[:, None] * step.x,
            at.Z + length[:, None, None, None] * step.Z,
            at.slack + length[:, None] * problem.sign * step.x[:, problem.bounded],
            at.multipliers + length[:, None] * step.multipliers,
        )

    def _direction(self, centre: Array, predicted: _Step | None = None) -> _Step:
        problem, at, d = self._problem, self._at, self._d
        wanted = (centre[:, None, None] - np.square(d))[..., None] * _UNIT
        force = centre[:, None] / self._slack
        if predicted is not None:
            product = predicted.primal @ predicted.dual
            wanted = wanted - 0.5 * (product + np.swapaxes(product, 2, 3))
            nearing = problem.sign * predicted.x[:, problem.bounded]
            force = force - nearing * predicted.multipliers / self._slack
        M = 2.0 * wanted / (d[..., :, None] + d[..., None, :])
        pull = self._turned_back(M)
        x = self._solved(problem.pushed(pull, force - at.multipliers) - self._error)
        change = problem.bodies(x)
        primal = self._scaling @ change @ np.swapaxes(self._scaling, 2, 3)
        dual = M - primal
        stiff = at.multipliers / self._slack
        multipliers = force - at.multipliers - stiff * problem.sign * x[:, problem.bounded]
        return _Step(x, self._turned_back(dual), multipliers, primal, dual)

    def _turned_back(self, matrices: Array) -> Array:
        return np.swapaxes(self._scaling, 2, 3) @ matrices @ self._scaling

    def _length(self, step: _Step) -> Array:
        """(F,) lengths at which a step reaches the boundary, or 1 / 0.9 if that is farther."""
        root = 1.0 / np.sqrt(self._d)
        scale = root[..., :, None] * root[..., None, :]
        both = np.concatenate([step.primal * scale, step.dual * scale], axis=1)
        falls = -np.linalg.eigvalsh(both)[..., 0].min(axis=1)
        if len(self._problem.bounded):
            nearing = self._problem.sign * step.x[:, self._problem.bounded] / self._slack
            falls = np.maximum(falls, -nearing.min(1))
            falls = np.maximum(falls, -(step.multipliers / self._at.multipliers).min(1))
        return 1.0 / np.maximum(falls, _REACH)

    def _gaps_after(self, step: _Step, length: Array) -> Array:
        length = np.minimum(1.0, length)
        D, along = self._d[..., None] * _UNIT, length[:, None, None, None]
        S, Z = D + along * step.primal, D + along * step.dual
        slack = self._slack + length[:, None] * (
            self._problem.sign * step.x[:, self._problem.bounded]
        )
        forces = self._at.multipliers + length[:, None] * step.multipliers
        return np.maximum((S * Z).sum((1, 2, 3)) + (slack * forces).sum(1), 0.0)

    def minima(self) -> PhysicalMinima:
        """The point as a minimum."""
        problem = self._problem
        x = np.clip(self._at.x, *problem.bounds)
        curvature = np.diagonal(problem.gram, axis1=1, axis2=2)[:, problem.bounded]
        f, k = np.nonzero(self._at.multipliers > self._slack * curvature)  # held by a bound
        x[f, problem.bounded[k]] = (problem.sign * problem.offset)[k]
        return PhysicalMinima(x, self._error, self._hessian)


@dataclass(frozen=True, eq=False)
class _Step:
    """A step, and what it does to the scaled bodies and dual matrices."""

    x: Array
    Z: Array
    multipliers: Array
    primal: Array
    dual: Array


def _root(matrices: Array) -> Array:
    """Matrices R (..., 4, 4) with R Rᵀ = those given, but for eigenvalues lost to rounding."""
    try:
        return np.asarray(np.linalg.cholesky(matrices), float)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(matrices)
        least = np.finfo(float).eps * values[..., -1:]
        return np.asarray(vectors * np.sqrt(np.maximum(values, least))[..., None, :])


def _places(blocks: Sequence[int]) -> Indices:
    """(n, 10) places of the parameters of every inertia block."""
    return np.array(blocks, int)[:, None] + np.arange(PARAMETERS_PER_BODY)
