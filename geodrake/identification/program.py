"""The conic program of a fit, as a Drake `MathematicalProgram`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.solvers import MathematicalProgram
from scipy.sparse import csc_matrix

from geodrake.boundary.arguments import instance, real_array
from geodrake.identification.coordinates import SYMMETRIC_BASIS, Coordinates
from geodrake.identification.problem import FitProblem
from geodrake.inertia import Array
from geodrake.robot.reduction import triangular_factor


@dataclass(frozen=True, eq=False)
class FitProgram:
    """A fit as a conic program, ready for any of Drake's conic solvers.

    Attributes:
        problem: What it was built from.
        coordinates: Map between its variables and the parameters.
        program: The program itself; other convex costs and constraints may be added to it.
        z: (p,) decision variables, the coordinates of the parameters.
        residual_cone: Constraint of the point-to-set form, or None.
        cost_scale: Value by which the cost was divided.
        residual_scale: Value by which the residual was divided in `residual_cone`.
        errors: Variables F z − f with their rows [F f]: of the cost ‖F z − f‖² and of the bound.
        logarithms: Number of an entropic block -> the variables (10,) and (4,) of its log|S|.
        scalar_logarithms: (k,) variables, the logarithms of the entropic scalars over their priors.
    """

    problem: FitProblem
    coordinates: Coordinates
    program: MathematicalProgram
    z: Any
    residual_cone: Any
    cost_scale: float
    residual_scale: float
    errors: Sequence[tuple[Any, Array]]
    logarithms: Mapping[int, tuple[Any, Any]]
    scalar_logarithms: Any

    def point(self, x: Array) -> Array:
        """Values of all variables at parameters x (p,), each as favourable as x allows.

        Args:
            x: (p,) parameters whose entropic blocks are physical, and scalars positive.
        """
        z = self.coordinates.at(x)
        values = np.zeros(self.program.num_vars())

        def put(variables: Any, numbers: Array) -> None:
            values[self.program.FindDecisionVariableIndices(variables)] = numbers

        put(self.z, z)
        for variables, triangle in self.errors:
            put(variables, triangle @ np.append(z, -1.0))
        for i, (Z, t) in self.logarithms.items():
            start = self.problem.inertia_blocks[i]
            change = np.einsum("k,kij->ij", z[start : start + 10], SYMMETRIC_BASIS)
            root = np.linalg.cholesky(self.coordinates.starts[i] + change)
            pivots = np.diagonal(root)
            put(Z, (root * pivots)[np.tril_indices(4)])
            put(t, 2.0 * np.log(pivots))
        if len(self.scalar_logarithms):
            ratios = self.coordinates.scalars(self.problem.entropic_scalars).ratios(z)
            if not np.all(ratios > 0):
                raise np.linalg.LinAlgError("a scalar with an entropic prior is not positive")
            put(self.scalar_logarithms, np.log(ratios))
        return values


def build_fit(
    problem: FitProblem, *, centre: Array | None = None, size: float | None = None
) -> FitProgram:
    """The conic program of a problem; `solve_fit` solves it, with shortcuts where they are exact.

    The cost is the excess over the unconstrained least squares, which keeps the solver's
    relative tolerance meaningful when the residual itself is large.

    Args:
        problem: What is to be fitted.
        centre: (p,) parameters close to the solution, where it is scaled; None for the references.
        size: What the cost is divided by; its size at the centre if None.

    Returns:
        The program and its variables.
    """
    instance(problem, "problem", FitProblem)
    if centre is not None:
        centre = real_array(centre, "centre", (problem.size,))
    coordinates = Coordinates.of(problem, centre=centre)
    program = MathematicalProgram()
    z = program.NewContinuousVariables(problem.size, "z")
    M, d = coordinates.data()
    C = coordinates.prior_root()
    cone, residual_scale, errors = None, 1.0, []
    if problem.residual_bound is None:
        rows = np.block([[M, d[:, None]], [C, np.zeros((len(C), 1))]])
    else:
        rows = np.column_stack([C, np.zeros(len(C))])
        cone, residual_scale, parts = _bound_residual(program, z, M, d, problem.residual_bound)
        errors.append(parts)
    triangle = _without_floor(rows)
    priors = (*problem.entropic.values(), *problem.entropic_scalars.values())
    gammas = [gamma for _, gamma in priors]
    start = np.zeros(problem.size) if centre is None else coordinates.at(centre)
    cost_scale = _cost_scale(triangle, gammas, start) if size is None else size
    triangle = triangle / np.sqrt(cost_scale)
    if k := len(triangle):
        errors.append(_add_errors(program, z, triangle))
        program.AddQuadraticCost(2.0 * np.eye(k), np.zeros(k), errors[-1][0], is_convex=True)
    logarithms = _add_bodies(program, z, coordinates, cost_scale)
    scalar_logarithms = _add_scalars(program, z, coordinates, cost_scale)
    _add_bounds(program, z, coordinates)
    return FitProgram(
        problem=problem,
        coordinates=coordinates,
        program=program,
        z=z,
        residual_cone=cone,
        cost_scale=cost_scale,
        residual_scale=residual_scale,
        errors=errors,
        logarithms=logarithms,
        scalar_logarithms=scalar_logarithms,
    )


def _without_floor(rows: Array) -> Array:
    """Return rows [F f] of the same least squares, without the residual that any z leaves."""
    p = rows.shape[1] - 1
    return triangular_factor([rows])[:p] if len(rows) > p else rows


def _cost_scale(triangle: Array, gammas: list[float], z: Array) -> float:
    """Size of the cost: its value at z, and not far below its curvature."""
    F, f = triangle[:, :-1], triangle[:, -1]
    value = float(np.square(F @ z - f).sum())
    curvature = np.square(F).sum(0).max(initial=0.0)
    return max([value, 1e-8 * curvature, *gammas]) or 1.0


def _add_errors(program: MathematicalProgram, z: Any, triangle: Array) -> tuple[Any, Array]:
    """Return new variables F z − f for the triangle [F f], and that.

    With FᵀF as the Hessian of a cost instead, its minimum is some hundred times less exact.
    """
    p = len(z)
    errors = program.NewContinuousVariables(len(triangle), "e")
    matrix = csc_matrix(np.hstack([triangle[:, :p], -np.eye(len(triangle))]))
    program.AddLinearEqualityConstraint(matrix, triangle[:, p], np.concatenate([z, errors]))
    return errors, triangle


def _bound_residual(
    program: MathematicalProgram, z: Any, M: Array, d: Array, bound: float
) -> tuple[Any, float, tuple[Any, Array]]:
    """Constrain ‖M z − d‖² ≤ bound, divided by the part of the bound that z can spend."""
    p = len(z)
    rows = np.column_stack([M, d])
    triangle = triangular_factor([rows]) if len(rows) > p else rows
    floor = float(np.square(triangle[p:, p]).sum())
    scale = float(np.sqrt(max(bound - floor, np.finfo(float).tiny)))
    errors = _add_errors(program, z, triangle[:p] / scale)
    cone = np.eye(len(errors[0]) + 1)
    return program.AddLorentzConeConstraint(cone[:, 1:], cone[0], errors[0]), scale, errors


def _add_bodies(
    program: MathematicalProgram, z: Any, coordinates: Coordinates, cost_scale: float
) -> dict[int, tuple[Any, Any]]:
    """Bodies that are physical, and near their entropic prior; the variables of `logarithms`."""
    problem, logarithms = coordinates.problem, {}
    floors = coordinates.starts - problem.margin * coordinates.references
    for i, start in enumerate(problem.inertia_blocks):
        block = z[start : start + 10]
        if start not in problem.entropic:
            program.AddLinearMatrixInequalityConstraint([floors[i], *SYMMETRIC_BASIS], block)
            continue
        weight = problem.entropic[start][1] / cost_scale
        prior = np.linalg.inv(coordinates.references[i])
        slope = weight * np.einsum("ij,kji->k", prior, SYMMETRIC_BASIS)
        program.AddLinearCost(slope, 0.0, block)
        logarithms[i] = _maximize_log_determinant(program, block, coordinates.starts[i], weight)
    return logarithms


def _add_scalars(
    program: MathematicalProgram, z: Any, coordinates: Coordinates, cost_scale: float
) -> Any:
    """Cost γ (y − log y) of the entropic scalars; the variables t ≤ log y."""
    scalars = coordinates.scalars(coordinates.problem.entropic_scalars)
    if not len(scalars.columns):
        return np.empty(0)
    t = program.NewContinuousVariables(len(scalars.columns), "log")
    weights = scalars.weights / cost_scale
    for t_k, column, begin, slope in zip(
        t, scalars.columns.tolist(), scalars.begin, scalars.slope, strict=True
    ):
        cone = np.array([[0.0, slope], [0.0, 0.0], [1.0, 0.0]])
        offset = np.array([begin, 1.0, 0.0])
        program.AddExponentialConeConstraint(cone, offset, np.array([t_k, z[column]]))
    program.AddLinearCost(weights * scalars.slope, 0.0, z[scalars.columns])
    program.AddLinearCost(-weights, 0.0, t)
    return t


def _maximize_log_determinant(
    program: MathematicalProgram, z: Any, begin: Array, weight: float
) -> tuple[Any, Any]:
    """Cost −weight log|S| with S = begin + smat(z), the barrier of [Lee2019] Eq. (3.5.45).

    log|S| ≥ Σ t_i holds just when [[S, Z], [Zᵀ, diag(Z)]] ⪰ 0 for some lower triangular Z with
    t_i ≤ log Z_ii. Returns the variables of Z, row by row, and t.
    """
    Z = program.NewContinuousVariables(10, "Z")
    t = program.NewContinuousVariables(4, "t")
    rows, columns = np.tril_indices(4)
    matrices = np.zeros((21, 8, 8))
    matrices[0, :4, :4] = begin
    matrices[1:11, :4, :4] = SYMMETRIC_BASIS
    for matrix, i, j in zip(matrices[11:], rows, columns, strict=True):
        matrix[i, 4 + j] = matrix[4 + j, i] = 1.0
        if i == j:
            matrix[4 + i, 4 + i] = 1.0
    program.AddLinearMatrixInequalityConstraint(list(matrices), np.concatenate([z, Z]))
    for t_i, Z_ii in zip(t, Z[rows == columns], strict=True):
        cone = np.array([[0.0, 1.0], [0.0, 0.0], [1.0, 0.0]])
        program.AddExponentialConeConstraint(cone, np.array([0.0, 1.0, 0.0]), np.array([t_i, Z_ii]))
    program.AddLinearCost(np.full(4, -weight), 0.0, t)
    return Z, t


def _add_bounds(program: MathematicalProgram, z: Any, coordinates: Coordinates) -> None:
    lower, upper = coordinates.bounds()
    bounded = np.isfinite(lower) | np.isfinite(upper)
    if bounded.any():
        program.AddBoundingBoxConstraint(lower[bounded], upper[bounded], z[bounded])
    constraints = coordinates.problem.constraints
    if constraints is not None:
        rows = constraints.matrix @ coordinates.transform
        begin = constraints.matrix @ coordinates.problem.prior_mean
        norms = np.linalg.norm(rows, axis=1)
        scale = 1.0 / np.where(norms > 0, norms, 1.0)
        program.AddLinearConstraint(
            scale[:, None] * rows,
            scale * (constraints.lower - begin),
            scale * (constraints.upper - begin),
            z,
        )
