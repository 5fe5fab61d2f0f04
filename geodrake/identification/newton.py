"""Newton's method for convex fits: about ten primal–dual steps on the triangular factor.

With dual matrices Z_i and multipliers λ, the minimum of a `NewtonProgram` satisfies

    F'(F z − f) + γ svec(I) − svec(Z) + Gᵀ(γ − λ) − Eᵀ ν = 0,
    S_i Z_i = γ_i I,   s_k λ_k = γ_k,   s = G z − h

with γ_k = 0 for an inequality, and the weight of the prior for a positive scalar s_k. The minimum
with an entropic divergence is thus the point γ on the central path of S ⪰ 0, where the
path-following method stops. It needs as few steps for a tiny γ, with a nearly singular S, as for a
large one. Steps are Nesterov–Todd with Mehrotra's predictor and corrector; S, Z, s and λ stay
strictly positive.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import NamedTuple, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtpmqrt, dtpqrt, dtrtrs
from scipy.optimize import brentq

from geodrake.boundary.arguments import instance
from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.coordinates import (
    IDENTITY,
    SYMMETRIC_BASIS,
    Coordinates,
    Rows,
    Scalars,
    smat,
    svec,
)
from geodrake.identification.fit import FitResult, fit_result
from geodrake.identification.problem import FitProblem, check_residual_bound, unreachable_bound
from geodrake.identification.solvers import CONTRADICTION, OTHER_CAUSE, solver_error
from geodrake.inertia import Array, is_physical
from geodrake.robot.reduction import triangular_factor

_STEPS, _PATIENCE, _HALVINGS = 100, 3, 8
_ROOM, _LEAST_ROOM = 0.02, 1e-5
"""Relative distance to the boundary after a step, far from and close to the solution."""
_PUSH, _SLACK = 10.0, 0.1
"""Initial multipliers, relative to the cost's slope, and least initial slack."""
_SHORT, _BACK = 0.4, 0.7
"""Length below which a step is poor, and the share of the excess kept by a recentring step."""
_FEASIBLE = 1e-9
_EXACT, _QUADRATIC = 1e-11, 1e-4
"""Gaps, relative to the smallest γ, of an exact next step and of quadratic convergence."""
_ROUNDING, _GOOD = 1e-16, 1e-9
"""Gaps, relative to the cost, of rounding errors and of an acceptable end."""
_FLOOR = 1e-15
"""Products S Z, relative to the misfit, below which rounding makes Z or S indefinite."""
_SAME_RESIDUAL, _NEARLY = 1e-10, 1e-7
"""Targeted and acceptable relative differences from the residual bound."""
_RIGID, _IDLE = 1e-12, 1e10
"""Weights, relative to the cost of the prior, at which the prior or the data no longer matter."""
_LEAP, _MOST_TRIALS, _NARROW = 6.0, 60, 1e-12
"""Longest step of log weight, iterations of Brent's method, and its tolerance."""
_PANEL = 16
_UNIT = np.eye(4)
_BARRIER, _LEAST = 1e-10, 1e-11
"""Weight of a barrier, relative to the curvature of the block's quadratic prior and the misfit."""
_UNDETERMINED, _FIXING = 1e-11, 1e-5
_INSIDE = (0.0, 1e-13, 1e-11, 1e-9)
"""Fractions of the way to the prior, to be tried in turn against rounding."""


def solve_newton(problem: FitProblem) -> FitResult:
    """Solve a fit in which every inertia block has an entropic or a quadratic prior.

    An entropic divergence keeps P(φ) ≻ 0 without the `margin`. A block with a quadratic prior gets
    a logarithmic barrier of 1e-10 of its prior's curvature, or more against rounding. In the
    point-to-set form the weight of the prior is the root of residual(γ) = residual_bound.

    The cost is exact to 1e-7 of itself or to 1e-12 γ, if that is larger: bodies to about 1e-6 in
    geometric distance.

    The ArgumentError of an unreachable residual bound has the `minimum` in its evidence.
    """
    begin = time.perf_counter()
    check_residual_bound(instance(problem, "problem", FitProblem))
    program = NewtonProgram.of(problem)
    solution, weight = solve_with_bound(program, lambda trial, _: minimize(trial))
    return fit_result(problem, program.parameters(solution.z), weight, "newton", begin)


@dataclass(frozen=True, eq=False)
class NewtonProgram:
    """A fit in the coordinates z of `Coordinates`, split into data and prior.

    Minimizes ‖M z − d‖² + w (‖C z‖² + Σ_i γ_i (tr S_i − log|S_i|) + Σ_k γ_k (s_k − log s_k)) with
    S_i = B_i + smat(z_i) ≻ 0, s = G z − h ≥ 0 and E z = e ([Lee2019] Eqs. (3.5.45), (3.5.46)). Only
    the ratios of positive scalars to their priors have γ_k > 0. A block with a quadratic prior has
    a tiny γ_i, as a barrier that keeps it physical.
    """

    coordinates: Coordinates
    data: Array  # (p, p + 1) triangle [M | d] of the data, without the residual `floor`
    prior: Array  # (k, p) root C of the quadratic prior
    fixing: Array  # (j, p) weak rows that fix directions without data or prior
    blocks: NDArray[np.intp]  # (n, 10) indices of the inertia blocks in z
    begin: Array  # (n, 4, 4) matrices B
    gammas: Array  # (n,) weights γ_i
    barrier: NDArray[np.bool_]  # (n,) whether a weight is that of a barrier
    strength: float  # size of the prior, the unit of weights w
    scalars: Scalars  # ratios of positive scalars to their priors, with their weights γ_k
    # G (m, p) and h (m,): rows of the positive scalars first, then others of unit length.
    inequalities: Rows
    equalities: Rows  # E (l, p) and e (l,), with independent rows of unit length
    floor: float  # least squared residual of any parameters, physical or not
    weight: float = 1.0  # weight w of the prior

    @classmethod
    def of(cls, problem: FitProblem) -> Self:
        """Return the program of a problem with a prior, entropic or quadratic, for every block."""
        coordinates, p = Coordinates.of(problem), problem.size
        triangle = triangular_factor([coordinates.data()])
        prior, starts = coordinates.prior_root(), np.array(problem.inertia_blocks, np.intp)
        blocks = starts[:, None] + np.arange(10)
        curvatures = np.square(prior).sum(0)[blocks].mean(1)
        entropic = np.array([problem.entropic.get(k, (None, 0.0))[1] for k in starts.tolist()])
        barrier = entropic == 0
        if free := starts[barrier & (curvatures == 0)].tolist():
            raise ArgumentError(
                "Newton's method needs an entropic or quadratic prior for every inertia "
                f"block; those at columns {free} have none.",
                advice="Give them one, or use the solver clarabel.",
                columns=free,
            )
        scalars = coordinates.scalars(problem.entropic_scalars)
        (G, h), equalities = coordinates.rows()
        positive = np.eye(p)[scalars.columns] * scalars.slope[:, None]
        others = np.setdiff1d(np.arange(p), np.append(blocks.ravel(), scalars.columns))
        margins = np.where(barrier, problem.margin, 0.0)[:, None, None]
        strengths = np.append(np.where(barrier, curvatures, entropic), scalars.weights)
        return cls(
            coordinates=coordinates,
            data=triangle[:p],
            prior=prior,
            fixing=_undetermined(np.vstack([triangle[:p, :p], prior]), others),
            blocks=blocks,
            begin=coordinates.starts - margins * coordinates.references,
            gammas=np.where(barrier, _BARRIER * curvatures, entropic),
            barrier=barrier,
            strength=float(strengths.max(initial=0.0)) or 1.0,
            scalars=scalars,
            inequalities=(np.vstack([positive, G]), np.append(-scalars.begin, h)),
            equalities=equalities,
            floor=float(triangle[p, p] ** 2),
        )

    def weighted(self, weight: float) -> Self:
        """Return the program with another weight w of the prior; inf leaves the data out."""
        if np.isinf(weight):
            return replace(self, data=0.0 * self.data, floor=0.0, weight=1.0)
        return replace(self, weight=weight)

    @cached_property
    def middle(self) -> Array:
        """Coordinates (p,) where every S is the identity."""
        z = np.zeros(self.data.shape[1] - 1)
        z[self.blocks] = IDENTITY - svec(self.begin)
        return z

    def excess(self, z: Array) -> float:
        """Return the squared residual of z (p,) beyond `floor`."""
        return float(np.square(self.data @ np.append(z, -1.0)).sum())

    def matrices(self, z: Array) -> Array:
        """Return S_i (n, 4, 4) of every block at z (p,)."""
        return self.begin + smat(z[self.blocks])

    def parameters(self, z: Array) -> Array:
        """Return parameters (p,) at z (p,), physical and within bounds despite rounding."""
        problem = self.coordinates.problem
        for share in _INSIDE:  # with a tiny γ, rounding can put bodies onto the boundary
            inner = (1.0 - share) * z + share * self.middle
            x = np.clip(self.coordinates.parameters(inner), problem.lower, problem.upper)
            physical = is_physical(x[self.blocks]) & (self.coordinates.smallest_eigenvalues(x) > 0)
            if np.all(physical):
                return x
        raise IdentificationError(
            "The parameters of Newton's method are not physical after rounding: a body of "
            "the prior is too flat for double precision.",
            advice="Check the units of the prior, or raise gamma.",
            solver="newton",
        )

    @cached_property
    def rows(self) -> Rows:
        """Upper triangular F (p, p) in Fortran order, and f (p,), of the cost ½ ‖F z − f‖²."""
        p, triangle = len(self.middle), self.data
        extra = np.vstack([np.sqrt(self.weight) * self.prior, self.fixing])
        if len(extra):
            rows = np.column_stack([extra, np.zeros(len(extra))])
            triangle = triangular_factor([triangle, rows])[:p]
        factor = np.asfortranarray(np.sqrt(2.0) * np.triu(triangle[:, :p]))
        return factor, np.sqrt(2.0) * triangle[:, p]

    @cached_property
    def gamma(self) -> Array:
        """(n,) weights w γ_i; those of barriers are bounded below against rounding."""
        least = np.where(self.barrier, _LEAST * self.excess(self.middle), 0.0)
        return np.maximum(self.weight * self.gammas, least)

    @cached_property
    def targets(self) -> Array:
        """(m,) weights w γ_k of the inequalities."""
        given = self.scalars.weights
        return np.append(self.weight * given, np.zeros(len(self.inequalities[1]) - len(given)))

    @property
    def weights(self) -> Array:
        """Weights of all entropic priors and barriers."""
        return np.append(self.gamma, self.targets[self.targets > 0])

    def cost(self, z: Array) -> float:
        """Return the cost at z (p,), zero for a perfect fit at the prior."""
        S, (F, f), ratios = self.matrices(z), self.rows, self.scalars.ratios(z)
        divergences = np.trace(S, axis1=1, axis2=2) - np.linalg.slogdet(S)[1] - 4.0
        scalars = self.weight * self.scalars.weights @ (ratios - np.log(ratios) - 1.0)
        return float(0.5 * np.square(F @ z - f).sum() + self.gamma @ divergences + scalars)


def _undetermined(rows: Array, scalars: NDArray[np.intp]) -> Array:
    """Return weak rows for directions of the scalars that no row determines."""
    if not len(scalars):
        return np.zeros((0, rows.shape[1]))
    _, sizes, directions = np.linalg.svd(triangular_factor([rows[:, scalars]]))
    unknown = directions[sizes <= _UNDETERMINED * max(sizes[0], 1e-300)]
    return _FIXING * unknown @ np.eye(rows.shape[1])[scalars]


class Iterate(NamedTuple):
    """A point of the iteration, or a step."""

    z: Array  # (p,) coordinates
    Z: Array  # (n, 4, 4) dual matrices of the blocks
    slack: Array  # (m,) slacks s of the inequalities
    multipliers: Array  # (m,) multipliers λ of the inequalities
    forces: Array  # (l,) multipliers ν of the equalities

    def moved(self, step: Iterate, length: float) -> Iterate:
        """Return this point moved by a step times a length."""
        return Iterate(*(value + length * by for value, by in zip(self, step, strict=True)))


class Solution(Protocol):
    """A solution with coordinates."""

    @property
    def z(self) -> Array:
        """Coordinates (p,)."""


Program = TypeVar("Program", bound=NewtonProgram)
Minimum = TypeVar("Minimum", bound=Solution)


def solve_with_bound(
    program: Program,
    solve: Callable[[Program, Minimum | None], Minimum],
    guess: float | None = None,
) -> tuple[Minimum, float]:
    """Return the minimum of a program and the weight of its prior, by `solve`.

    In the point-to-set form the weight is that for which the residual equals the bound, close to
    `guess`; inf if the data are inactive. `solve` maps a program and the last minimum, at first
    None, to its minimum.

    Brent's method on logarithms, as the residual grows with the weight of the prior ([Lee2019]
    Propositions A.4 and A.5).
    """
    bound = program.coordinates.problem.residual_bound
    if bound is None:
        return solve(program, None), 1.0
    wanted = max(bound - program.floor, np.finfo(float).tiny)
    scale = (program.excess(program.middle) + wanted) / program.strength
    low, high = np.log([_RIGID * scale, _IDLE * scale])
    trials: list[tuple[float, Minimum, float, float]] = []

    @cache
    def error(log_weight: float) -> float:
        weight = float(np.exp(log_weight))
        minimum = solve(program.weighted(weight), trials[-1][1] if trials else None)
        excess = program.excess(minimum.z)
        trials.append((abs(excess - wanted), minimum, weight, excess))
        if trials[-1][0] <= _SAME_RESIDUAL * bound:
            return 0.0
        return float(np.log(max(excess, np.finfo(float).tiny) / wanted))

    guess = wanted / program.strength if guess is None else guess
    u, step = float(np.clip(np.log(guess), low, high)), 0.0
    while error_here := error(u):
        step = min(max(2.0 * abs(error_here), 2.0 * step), _LEAP)
        next_u = float(np.clip(u - np.copysign(step, error_here), low, high))
        if next_u == u:
            break
        if error(next_u) * error_here <= 0.0:
            ends = min(u, next_u), max(u, next_u)
            brentq(error, *ends, xtol=_NARROW, maxiter=_MOST_TRIALS, disp=False)
            break
        u = next_u
    _, minimum, weight, excess = min(trials, key=lambda trial: trial[0])
    if u == high and error_here < 0.0:
        return minimum, np.inf
    if abs(excess - wanted) <= _NEARLY * bound:
        return minimum, weight
    if u == low and error_here > 0.0:
        raise unreachable_bound(bound, program.floor + excess)
    raise IdentificationError(
        f"No weight of the prior has the residual {bound:.10g}; the closest was "
        f"{program.floor + excess:.10g}.",
        advice="Check units and noise levels, or use the solver clarabel. With the Riemannian "
        "distance, try another bound: at this one the fit may jump between two minima.",
        residual=program.floor + excess,
        solver="newton",
    )


def minimize(program: NewtonProgram) -> Iterate:
    """Return the minimum of a program, by damped Newton steps in the interior."""
    best: tuple[float, _Linearization] | None = None
    gamma, stalled = program.weights.min(initial=np.inf), 0
    last = _cold_start(program)
    current = _linearized(program, last)
    for _ in range(_STEPS):
        if current is None:
            break
        last, gap, cost = current.at, current.gap(), program.cost(current.at.z)
        feasible, stalled = current.is_feasible, stalled + 1
        if feasible and (best is None or gap < best[0]):
            stalled = 0 if best is None or gap < 0.5 * best[0] else stalled
            best = gap, current
        least = max(_EXACT * gamma, min(_QUADRATIC * gamma, _ROUNDING * cost))
        if feasible and gap <= (least if np.isfinite(gamma) else _ROUNDING * cost):
            break
        if best is not None and stalled > _PATIENCE and best[0] <= _GOOD * cost:
            break
        current = _next(current)
    size = 0.0 if best is None else max(program.cost(best[1].at.z), float(program.weights.sum()))
    if best is None or best[0] > _GOOD * size:
        (G, h), (E, e) = program.inequalities, program.equalities
        missed = np.append(h - G @ last.z, np.abs(E @ last.z - e)).max(initial=0.0)
        contradict = missed > 1e-7 * (1.0 + np.abs(last.z).max(initial=0.0))
        why = CONTRADICTION if contradict else OTHER_CAUSE
        raise solver_error("newton", why, violation=float(missed))
    gap, current = best
    point = current.at
    if gap <= _QUADRATIC * gamma:
        # Another step with the last factor nearly squares the error.
        step = current.direction(0.0)
        point = point.moved(step.step, min(1.0, (1.0 - _LEAST_ROOM) * current.reach(step)))
    return point


def _cold_start(program: NewtonProgram) -> Iterate:
    """Return the prior, with multipliers larger than all slopes of the cost."""
    z, (F, f), (G, h) = program.middle, program.rows, program.inequalities
    slack, errors = G @ z - h, F @ z - f
    slope = F.T @ errors + G.T @ program.targets  # without logarithms and traces of blocks
    push = _PUSH * float(np.abs(slope).max(initial=0.0))
    if np.any(slack < 0):
        push = max(push, float(program.gamma.max(initial=0.0)))
    push = push or 1.0
    # Columns of scalars have unit length, so that scalars move about as much as the error.
    scalars = np.ones(len(z))
    scalars[program.blocks] = 0.0
    shift = np.linalg.norm(errors) * np.linalg.norm(G * scalars, axis=1)
    slack = np.maximum(slack, _SLACK * (1.0 + shift))
    Z = (program.gamma + push)[:, None, None] * _UNIT
    multipliers = (push + program.targets) / slack
    return Iterate(z, Z, slack, multipliers, np.zeros(len(program.equalities[1])))


class _Direction(NamedTuple):
    """A step, and its effect on the scaled S and Z, (n, 4, 4)."""

    step: Iterate
    primal: Array
    dual: Array


class _Linearization:
    """The optimality conditions of a program linearized at a point, factored once.

    A step with Newton's matrix FᵀF + KᵀK + Gᵀ(λ/s)G solves a least-squares problem with the rows F,
    K and √(λ/s) G, where K_i maps z_i to the change of the scaled S_i. It is solved by QR, as
    normal equations would lose a tiny γ next to strong data.
    """

    def __init__(self, program: NewtonProgram, at: Iterate) -> None:
        self.program, self.at = program, at
        (F, f), (G, h), (E, e) = program.rows, program.inequalities, program.equalities
        self._slack_error = G @ at.z - h - at.slack
        self._equality_error = E @ at.z - e
        # Nesterov–Todd scaling: T⁻¹ S T⁻ᵀ = Tᵀ Z T = diag(d).
        root_S = np.linalg.cholesky(program.matrices(at.z))
        root_Z = np.linalg.cholesky(at.Z)
        _, self._d, V = np.linalg.svd(np.swapaxes(root_Z, 1, 2) @ root_S)
        self._products = self._d**2  # eigenvalues of S Z
        T = root_S @ np.swapaxes(V, 1, 2) / np.sqrt(self._d)[:, None, :]
        self._D = self._d[:, :, None] * _UNIT
        self._prior_gradient = program.gamma[:, None, None] * (np.swapaxes(T, 1, 2) @ T)
        self._scaling = np.linalg.inv(T)
        self._errors = f - F @ at.z
        floor = _FLOOR * float(self._errors @ self._errors)
        self._aim = np.maximum(program.gamma, floor)
        self._targets = np.where(program.targets > 0, np.maximum(program.targets, floor), 0.0)
        self._stiffness = at.multipliers / at.slack
        scaling = self._scaling[:, None]
        K = np.zeros((*program.blocks.shape, len(f)))
        images = svec(scaling @ SYMMETRIC_BASIS @ np.swapaxes(scaling, 2, 3))
        for rows, block, image in zip(K, program.blocks, images, strict=True):
            rows[:, block] = image.T
        below = [K.reshape(-1, len(f)), np.sqrt(self._stiffness)[:, None] * G]
        self._R, self._reflectors = F, list[Array]()
        if len(rows := np.asfortranarray(np.vstack(below))):
            panel = min(_PANEL, len(f))
            self._R, *self._reflectors, _ = dtpqrt(0, panel, F, rows, overwrite_b=True)
        self._spread = _solve(self._R, E.T, transposed=True)

    @property
    def is_feasible(self) -> bool:
        """Whether equalities hold, and inequalities up to their slacks."""
        errors = np.abs(np.append(self._slack_error, self._equality_error))
        scale = 1.0 + np.abs(self.at.z).max(initial=0.0)
        return bool(errors.max(initial=0.0) <= _FEASIBLE * scale)

    def _reduced(self, matrices: Array, forces: Array) -> Array:
        """Return the reduced right-hand side (p,) for those of K (n, 4, 4) and λ (m,)."""
        if not self._reflectors:
            return self._errors.copy()
        gradients = svec(matrices - self._prior_gradient).ravel()
        rows = (forces - self.program.targets) / np.sqrt(self._stiffness)
        sides = self._errors[:, None], np.concatenate([gradients, rows])[:, None]
        return np.asarray(dtpmqrt(0, *self._reflectors, *sides, side="L", trans="T")[0][:, 0])

    def gap(self) -> float:
        """Return the first-order gap of the cost to its minimum; inf if it overflows."""
        at, weighted = self.at, self._targets > 0
        try:
            with np.errstate(over="raise", divide="raise", invalid="raise"):
                error = self._reduced(self._D, at.multipliers) + self._spread @ at.forces
                products = at.slack * at.multipliers
                aims = np.append(np.repeat(self._aim, 4), self._targets[weighted])
                ratio = np.append(self._products.ravel(), products[weighted]) / aims
                logs = aims @ (ratio - 1.0 - np.log(ratio))
                return float(logs + products[~weighted].sum() + 0.5 * error @ error)
        except FloatingPointError:
            return np.inf

    def direction(self, centre: float, predicted: _Direction | None = None) -> _Direction:
        """Return the step to S Z = (γ + centre) I and s λ = centre.

        It includes the second-order terms of a `predicted` step.
        """
        at, d, G = self.at, self._d, self.program.inequalities[0]
        wanted = (self._aim[:, None] + centre - self._products)[:, :, None] * _UNIT
        force = (self._targets + centre) / at.slack
        if predicted is not None:
            product = predicted.primal @ predicted.dual
            wanted = wanted - 0.5 * (product + np.swapaxes(product, 1, 2))
            force = force - predicted.step.slack * predicted.step.multipliers / at.slack
        force = force - self._stiffness * self._slack_error
        M = 2.0 * wanted / (d[:, :, None] + d[:, None, :])
        right = self._reduced(M + self._D, force)
        spread = self._spread
        forces: Array = np.empty(0)
        if len(self._equality_error):
            missing = -self._equality_error - spread.T @ right
            forces = np.asarray(np.linalg.lstsq(spread.T @ spread, missing)[0], float)
            right += spread @ forces
        dz = _solve(self._R, right)
        turn = np.swapaxes(self._scaling, 1, 2)
        primal = self._scaling @ smat(dz[self.program.blocks]) @ turn
        dual, nearing = M - primal, G @ dz
        step = Iterate(
            z=dz,
            Z=turn @ dual @ self._scaling,
            slack=nearing + self._slack_error,
            multipliers=force - at.multipliers - self._stiffness * nearing,
            forces=forces - at.forces,
        )
        return _Direction(step, primal, dual)

    def reach(self, direction: _Direction) -> float:
        """Return the step length at which S, Z, s or λ reach the boundary, or inf."""
        root = 1.0 / np.sqrt(self._d)
        scale = root[:, :, None] * root[:, None, :]
        changes = np.concatenate([direction.primal * scale, direction.dual * scale])
        shares = [
            np.linalg.eigvalsh(changes)[:, 0],
            direction.step.slack / self.at.slack,
            direction.step.multipliers / self.at.multipliers,
        ]
        fall = -np.concatenate(shares).min(initial=0.0)
        return float(1.0 / fall) if fall > 0 else np.inf

    def excess(self, direction: _Direction, length: float) -> float:
        """Return the mean of S Z − γ and s λ − γ after a step of some length."""
        S, Z = self._D + length * direction.primal, self._D + length * direction.dual
        s = self.at.slack + length * direction.step.slack
        y = self.at.multipliers + length * direction.step.multipliers
        beyond = np.maximum((S * Z).sum((1, 2)) - 4.0 * self._aim, 0.0).sum()
        plain = self._targets == 0
        beyond += np.maximum(s * y - self._targets, 0.0)[~plain].sum()
        beyond += max(s[plain] @ y[plain], 0.0)
        return float(beyond) / max(self._d.size + len(s), 1)


def _linearized(program: NewtonProgram, point: Iterate) -> _Linearization | None:
    """Return the linearization at a point; None if rounding put it onto the boundary."""
    with contextlib.suppress(np.linalg.LinAlgError):
        return _Linearization(program, point)
    return None


def _next(current: _Linearization) -> _Linearization | None:
    """Return the linearization after a predictor–corrector step; None if no step is possible.

    Multipliers of contradicting constraints grow until they overflow.
    """
    with (
        contextlib.suppress(FloatingPointError),
        np.errstate(over="raise", divide="raise", invalid="raise"),
    ):
        predictor = current.direction(0.0)
        excess = current.excess(predictor, 0.0)
        length = min(1.0, (1.0 - _LEAST_ROOM) * current.reach(predictor))
        ratio = min(1.0, current.excess(predictor, length) / excess) if excess > 0 else 0.0
        step = current.direction(ratio**3 * excess, predictor)
        reach = current.reach(step)
        if reach < _SHORT:
            # Second-order terms can mislead far from the central path; return towards it.
            back = current.direction(_BACK * excess)
            step, reach = max((step, reach), (back, current.reach(back)), key=lambda pair: pair[1])
        # Close to the solution, steps may end close to the boundary.
        length = min(1.0, (1.0 - min(_ROOM, max(ratio, _LEAST_ROOM))) * reach)
        for _ in range(_HALVINGS):
            following = _linearized(current.program, current.at.moved(step.step, length))
            if following is not None:
                return following
            length *= 0.5  # rounding crossed the boundary
    return None


def _solve(R: Array, right: Array, *, transposed: bool = False) -> Array:
    """Return R⁻¹ right, or R⁻ᵀ right, for an upper triangular R."""
    if not right.size:
        return np.zeros(right.shape)
    return np.asarray(dtrtrs(R, right, trans=int(transposed))[0])
