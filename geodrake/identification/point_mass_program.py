"""The conic program of point masses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.solvers import MathematicalProgram
from scipy.linalg import block_diag
from scipy.sparse import csc_matrix

from geodrake.errors import IdentificationError
from geodrake.identification.point_mass import PointMasses
from geodrake.identification.problem import FitProblem
from geodrake.identification.residual_path import out_of_reach
from geodrake.identification.solvers import EXACTLY, Tolerances, cone_multiplier, run_solver
from geodrake.inertia import Array
from geodrake.robot.reduction import triangular_factor

_LEAST = 1e-6
"""Least share of its prior that a point mass keeps."""


@dataclass(frozen=True, eq=False)
class PointMassProgram:
    """A fit in the variables v = [μ/⁰μ, extra/scale], all of order one.

    Attributes:
        points: The points.
        problem: What is to be fitted.
        transform: (p, N + extra) parameters x = T v.
        triangle: (p, p + 1) factor [R r] of the data without their least residual.
        floor: Least residual that any parameters x reach.
    """

    points: PointMasses
    problem: FitProblem
    transform: Array
    triangle: Array
    floor: float

    @classmethod
    def of(cls, points: PointMasses, problem: FitProblem) -> PointMassProgram:
        """The program of a problem whose first columns are the points' bodies.

        Args:
            points: Point masses of the bodies, with their prior.
            problem: The fit; its first columns are those of the bodies, ten each.
        """
        p, R = problem.size, points.matrix()
        norms = np.linalg.norm(problem.factor[:, len(R) : p], axis=0)
        scales = np.diag(1.0 / np.where(norms > 0, norms, 1.0))
        transform = np.asarray(block_diag(R * points.prior, scales))
        factor = triangular_factor([problem.factor])
        return cls(points, problem, transform, factor[:p], float(factor[p, p] ** 2))

    def masses(self, v: Array) -> Array:
        """μ (N,) of variables v."""
        return v[: len(self.points.prior)] * self.points.prior

    def parameters(self, v: Array) -> Array:
        """X (p,) of variables v."""
        return self.transform @ v

    def excess(self, v: Array) -> float:
        """Residual above the floor."""
        return float(np.square(self.triangle @ np.append(self.transform @ v, -1.0)).sum())

    def solve(
        self,
        add_cost: Callable[[MathematicalProgram, Any, float], None],
        solver: str,
        gamma: float,
        scale: float,
        accuracies: Sequence[Tolerances],
    ) -> tuple[Array, float]:
        """Variables v, and γ over the given one in the point-to-set form, else 1.

        Args:
            add_cost: Adds the distance of the shares of masses to a program, with a weight.
            solver: Drake's conic solver.
            gamma: Weight of the distance.
            scale: Size of the cost, by which it is divided.
            accuracies: What accuracies to try in turn.
        """
        program = MathematicalProgram()
        v = program.NewContinuousVariables(self.transform.shape[1], "v")
        e = program.NewContinuousVariables(len(self.triangle), "e")
        bound = self.problem.residual_bound
        spare = max(bound - self.floor, np.finfo(float).tiny) if bound is not None else scale
        # e = (R T v − r)/√spare, whose square is at most 1, or enters the cost.
        rows = self.triangle[:, :-1] @ self.transform / np.sqrt(spare)
        program.AddLinearEqualityConstraint(
            csc_matrix(np.hstack([rows, -np.eye(len(e))])),
            self.triangle[:, -1] / np.sqrt(spare),
            np.concatenate([v, e]),
        )
        cone = None
        if bound is None:
            program.AddQuadraticCost(2.0 * np.eye(len(e)), np.zeros(len(e)), e, True)
        else:
            lorentz = np.vstack([np.zeros(len(e)), np.eye(len(e))])
            cone = program.AddLorentzConeConstraint(lorentz, np.eye(len(e) + 1)[0], e)
        add_cost(program, v[: len(self.points.prior)], gamma / scale)
        self._add_bounds(program, v)
        result = run_solver(program, solver, accuracies)
        found = np.asarray(result.GetSolution(v), float)
        found[: len(self.points.prior)] = np.maximum(found[: len(self.points.prior)], _LEAST)
        if cone is None:
            return found, 1.0
        # d² + μ (‖e‖ − 1) and d² + ‖e‖² spare/γ are stationary together for γ = 2 spare/μ.
        multiplier = cone_multiplier(result, cone) * scale
        idle = self.excess(found) < (1.0 - 1e-6) * spare or multiplier == 0.0
        return found, np.inf if idle else 2.0 * spare / multiplier

    def check_bound(self, solver: str, failure: IdentificationError) -> None:
        """Refuse a residual bound that no masses reach, which a solver calls infeasible.

        Args:
            solver: Drake's conic solver.
            failure: What it said of the bound.

        Raises:
            ArgumentError: The bound is too low; its evidence has the `minimum` that masses reach.
        """
        bound = self.problem.residual_bound
        if bound is None:
            return
        free = replace(self, problem=replace(self.problem, residual_bound=None))
        start = np.zeros(self.transform.shape[1])
        start[: len(self.points.prior)] = 1.0
        scale = max(self.excess(start), np.finfo(float).tiny)
        try:
            v, _ = free.solve(lambda *_: None, solver, 1.0, scale, EXACTLY)
        except IdentificationError:
            return  # the constraints contradict each other, whatever the bound
        minimum = self.floor + self.excess(v)
        if bound < minimum:
            raise out_of_reach(bound, minimum) from failure

    def _add_bounds(self, program: MathematicalProgram, v: Any) -> None:
        problem, N = self.problem, len(self.points.prior)
        scale = np.diagonal(self.transform[-(len(v) - N) :, N:]) if len(v) > N else np.empty(0)
        lower = np.append(np.full(N, _LEAST), problem.lower[problem.size - len(scale) :] / scale)
        upper = np.append(np.full(N, np.inf), problem.upper[problem.size - len(scale) :] / scale)
        program.AddBoundingBoxConstraint(lower, upper, v)
        if problem.constraints is not None:
            rows = problem.constraints.matrix @ self.transform
            norms = np.linalg.norm(rows, axis=1)
            norms = np.where(norms > 0, norms, 1.0)
            program.AddLinearConstraint(
                rows / norms[:, None],
                problem.constraints.lower / norms,
                problem.constraints.upper / norms,
                v,
            )
