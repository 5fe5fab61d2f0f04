"""The conic program of a fit, as a Drake `MathematicalProgram`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.solvers import MathematicalProgram
from scipy.sparse import csc_matrix

from geodrake.boundary.arguments import instance, real_array
from geodrake.identification.coordinates import SYMMETRIC_BASIS, Coordinates, smat
from geodrake.identification.problem import FitProblem
from geodrake.inertia import Array
from geodrake.robot.reduction import triangular_factor

_LOGARITHM = np.array([[0.0, 1.0], [0.0, 0.0], [1.0, 0.0]])
"""Rows of the exponential cone that holds (t, y) with t ≤ log y."""


@dataclass(eq=False)
class FitProgram:
    """A fit as a conic program, ready for any of Drake's conic solvers."""

    problem: FitProblem  # what it was built from
    coordinates: Coordinates  # map between its variables and the parameters
    # The program itself; other convex costs and constraints may be added to it.
    program: MathematicalProgram
    z: Any  # (p,) decision variables, the coordinates of the parameters
    cost_scale: float = 1.0  # value by which the cost was divided
    residual_cone: Any = None  # constraint of the point-to-set form, or None
    residual_scale: float = 1.0  # value by which the residual was divided in `residual_cone`
    # Other variables, with the map from z to the most favourable values of each.
    others: list[tuple[Any, Callable[[Array], Array]]] = field(default_factory=list)

    def point(self, x: Array) -> Array:
        """Return values of all variables at parameters x (p,); a LinAlgError if not physical."""
        z, values = self.coordinates.at(x), np.zeros(self.program.num_vars())
        values[self.program.FindDecisionVariableIndices(self.z)] = z
        for variables, best in self.others:
            values[self.program.FindDecisionVariableIndices(variables)] = best(z)
        return values

    def evaluated(self, x: Array) -> tuple[float, float]:
        """Return what Drake evaluates at parameters x (p,): the cost, and the worst violation.

        The cost is in the unit of the fit's, less a constant; the violation is how far they are
        outside the constraints at most, in the program's variables.
        """
        program, values = self.program, self.point(x)
        costs = [float(program.EvalBinding(c, values)[0]) for c in program.GetAllCosts()]
        beyond = [np.zeros(1)]
        for constraint in program.GetAllConstraints():
            reached, limits = program.EvalBinding(constraint, values), constraint.evaluator()
            beyond += [limits.lower_bound() - reached, reached - limits.upper_bound()]
        return self.cost_scale * sum(costs), float(np.concatenate(beyond).max())

    def _add_errors(self, rows: Array) -> Any:
        """Return new variables F z − f for rows [F f].

        With FᵀF as the Hessian of a cost instead, its minimum is some hundred times less exact.
        """
        errors = self.program.NewContinuousVariables(len(rows), "e")
        matrix = csc_matrix(np.hstack([rows[:, :-1], -np.eye(len(rows))]))
        variables = np.concatenate([self.z, errors])
        self.program.AddLinearEqualityConstraint(matrix, rows[:, -1], variables)
        self.others.append((errors, lambda z: rows @ np.append(z, -1.0)))
        return errors

    def _add_bodies(self) -> None:
        """Keep bodies physical, and near their entropic prior."""
        problem, coordinates = self.problem, self.coordinates
        floors = coordinates.starts - problem.margin * coordinates.references
        for i, start in enumerate(problem.inertia_blocks):
            block = self.z[start : start + 10]
            if start not in problem.entropic:
                self.program.AddLinearMatrixInequalityConstraint(
                    [floors[i], *SYMMETRIC_BASIS], block
                )
                continue
            weight = problem.entropic[start][1] / self.cost_scale
            prior = np.linalg.inv(coordinates.references[i])
            slope = weight * np.einsum("ij,kji->k", prior, SYMMETRIC_BASIS)
            self.program.AddLinearCost(slope, 0.0, block)
            self._maximize_log_determinant(slice(start, start + 10), coordinates.starts[i], weight)

    def _maximize_log_determinant(self, block: slice, begin: Array, weight: float) -> None:
        """Add the cost −weight log|S| with S = begin + smat(z) ([Lee2019] Eq. (3.5.45)).

        log|S| ≥ Σ t_i holds just when [[S, Z], [Zᵀ, diag(Z)]] ⪰ 0 for some lower triangular Z with
        t_i ≤ log Z_ii.
        """
        program = self.program
        Z, t = program.NewContinuousVariables(10, "Z"), program.NewContinuousVariables(4, "t")
        rows, columns = np.tril_indices(4)
        matrices = np.zeros((21, 8, 8))
        matrices[0, :4, :4] = begin
        matrices[1:11, :4, :4] = SYMMETRIC_BASIS
        for matrix, i, j in zip(matrices[11:], rows, columns, strict=True):
            matrix[i, 4 + j] = matrix[4 + j, i] = 1.0
            if i == j:
                matrix[4 + i, 4 + i] = 1.0
        program.AddLinearMatrixInequalityConstraint(
            list(matrices), np.concatenate([self.z[block], Z])
        )
        for pair in zip(t, Z[rows == columns], strict=True):
            program.AddExponentialConeConstraint(_LOGARITHM, np.eye(3)[1], np.array(pair))
        program.AddLinearCost(np.full(4, -weight), 0.0, t)

        def best(z: Array) -> Array:
            root = np.linalg.cholesky(begin + smat(z[block]))
            pivots = np.diagonal(root)
            return np.append((root * pivots)[rows, columns], 2.0 * np.log(pivots))

        self.others.append((np.append(Z, t), best))

    def _add_scalars(self) -> None:
        """Add the cost γ (y − log y) of the entropic scalars."""
        scalars = self.coordinates.scalars(self.problem.entropic_scalars)
        if not len(scalars.columns):
            return
        t = self.program.NewContinuousVariables(len(scalars.columns), "log")
        weights = scalars.weights / self.cost_scale
        parts = zip(t, self.z[scalars.columns], scalars.begin, scalars.slope, strict=True)
        for t_k, z_k, begin, slope in parts:
            cone, offset = _LOGARITHM * [1.0, slope], np.array([begin, 1.0, 0.0])
            self.program.AddExponentialConeConstraint(cone, offset, np.array([t_k, z_k]))
        self.program.AddLinearCost(weights * scalars.slope, 0.0, self.z[scalars.columns])
        self.program.AddLinearCost(-weights, 0.0, t)

        def best(z: Array) -> Array:
            ratios = scalars.ratios(z)
            if not np.all(ratios > 0):
                raise np.linalg.LinAlgError("a scalar with an entropic prior is not positive")
            return np.log(ratios)

        self.others.append((t, best))


def build_fit(
    problem: FitProblem, *, centre: Array | None = None, size: float | None = None
) -> FitProgram:
    """Return the conic program of a problem; `solve_fit` solves it, with exact shortcuts.

    The cost is the excess over the unconstrained least squares, which keeps the solver's
    relative tolerance meaningful when the residual itself is large. The program is scaled at a
    centre (p,) close to the solution, by default the references, and its cost is divided by its
    size there, unless that is given.
    """
    instance(problem, "problem", FitProblem)
    if centre is not None:
        centre = real_array(centre, "centre", (problem.size,))
    coordinates, program = Coordinates.of(problem, centre=centre), MathematicalProgram()
    fit = FitProgram(
        problem, coordinates, program, program.NewContinuousVariables(problem.size, "z")
    )
    data, C, p = coordinates.data(), coordinates.prior_root(), problem.size
    rows = np.column_stack([C, np.zeros(len(C))])
    if problem.residual_bound is None:
        rows = np.vstack([data, rows])
    else:  # divided by the part of it that z can spend
        triangle = _reduced(data)
        least = problem.residual_bound - float(np.square(triangle[p:, p]).sum())
        fit.residual_scale = float(np.sqrt(max(least, np.finfo(float).tiny)))
        errors = fit._add_errors(triangle[:p] / fit.residual_scale)
        cone = np.eye(len(errors) + 1)
        fit.residual_cone = program.AddLorentzConeConstraint(cone[:, 1:], cone[0], errors)
    rows = _reduced(rows)[:p]
    if size is None:  # its value at the centre, and not far below its curvature
        z = np.zeros(problem.size) if centre is None else coordinates.at(centre)
        priors = (*problem.entropic.values(), *problem.entropic_scalars.values())
        value = float(np.square(rows @ np.append(z, -1.0)).sum())
        curvature = np.square(rows[:, :-1]).sum(0).max(initial=0.0)
        size = max([value, 1e-8 * curvature, *(gamma for _, gamma in priors)]) or 1.0
    fit.cost_scale = size
    if k := len(rows):
        errors = fit._add_errors(rows / np.sqrt(size))
        program.AddQuadraticCost(2.0 * np.eye(k), np.zeros(k), errors, is_convex=True)
    fit._add_bodies()
    fit._add_scalars()
    (G, h), (E, e) = coordinates.rows()
    if len(h):
        program.AddLinearConstraint(G, h, np.full(len(h), np.inf), fit.z)
    if len(e):
        program.AddLinearEqualityConstraint(E, e, fit.z)
    return fit


def _reduced(rows: Array) -> Array:
    """Return rows [F f] of the same least squares, the last one that no z changes."""
    return triangular_factor([rows]) if len(rows) >= rows.shape[1] else rows
