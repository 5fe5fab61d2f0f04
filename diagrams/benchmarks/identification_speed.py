"""How fast identification is: Newton's method, Drake's conic programs, and the same in CVXPY.

An arm of ten bodies with seven motors, as in [Lee2019] §3.6, from 4,100 samples of all torques (107
parameters). Times are CPU times, medians of repeats. Geodesic least squares runs on the arm's first
samples, next to the entropic fit at the same residual.

    OMP_NUM_THREADS=1 python -m diagrams.benchmarks.identification_speed --json speed.json
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia

from diagrams.harness import cpu_clock, medians, script_parser, tell
from geodrake.identification import (
    BodyConstraints,
    FitProblem,
    geodesic_least_squares,
    identify,
    solve_fit,
)
from geodrake.identification.identify import build_problem
from geodrake.identification.newton import solve_newton
from geodrake.identification.problem import whitened_factor
from geodrake.identification.regularizer import Entropic
from geodrake.inertia import Ellipsoid, inertial_parameters, pseudo_inertia
from geodrake.inertia.parameters import pseudo_inertia_basis
from geodrake.inertia.positive_definite import distance
from geodrake.robot import KinematicTree, inverse_dynamics_regressor

ROLLING = (2, 5, 8)  # Joints that share their motor with the joint after them, half a turn each.
NOISE = 0.02  # N·m
GAMMA = 0.03
HAS_CVXPY = all(find_spec(name) for name in ("cvxpy", "clarabel"))  # of the dev extra


@dataclass(frozen=True, kw_only=True)
class Case:
    """The data and bodies of a fit."""

    A: np.ndarray  # (m, p) regressor
    b: np.ndarray  # (m,) measurements
    prior: np.ndarray  # (nb, 10) prior
    ellipsoids: np.ndarray  # (nb, 4, 4) bounding ellipsoids
    extra_bounds: np.ndarray  # bounds of the parameters after the inertial ones
    truth: np.ndarray  # (p,) true parameters

    def problem(self, gamma: float) -> FitProblem:
        """Return the entropic fit on the triangular factor of the data."""
        problem = build_problem(
            whitened_factor(self.A, self.b, sigma=1.0),
            self.prior,
            constraints=BodyConstraints(ellipsoids=self.ellipsoids),
            extra_bounds=self.extra_bounds,
        )
        return Entropic().regularize(problem, self.prior, gamma)


def arm_case(*, samples: int, seed: int) -> Case:
    """Return ten bodies on seven motors, three of which turn two joints each; 107 parameters."""
    rng = np.random.default_rng(seed)
    plant = _arm()
    truth, tree = inertial_parameters(plant), KinematicTree.from_plant(plant)
    J = np.zeros((10, 7))
    motors = np.cumsum([joint - 1 not in ROLLING for joint in range(10)]) - 1
    J[range(10), motors] = [0.5 if {j, j - 1} & set(ROLLING) else 1.0 for j in range(10)]
    motion = [rng.uniform(-scale, scale, (samples, 7)) for scale in (1.5, 2.0, 6.0)]
    joints = inverse_dynamics_regressor(tree, *(part @ J.T for part in motion))
    rotors = np.eye(7) * motion[2][:, None, :]
    A = np.concatenate([J.T @ joints, rotors], -1).reshape(7 * samples, 107)
    parameters = np.append(truth.ravel(), np.full(7, 0.02))
    stretch = np.exp(rng.normal(0.0, 0.2, (10, 1)))
    radii, axes = np.tile([0.12, 0.12, 0.25], (10, 1)), np.tile(np.eye(3), (10, 1, 1))
    hulls = Ellipsoid(truth[:, 1:4] / truth[:, :1], radii, axes)
    return Case(
        A=A,
        b=A @ parameters + rng.normal(0.0, NOISE, 7 * samples),
        prior=truth * stretch,
        ellipsoids=hulls.quadric,
        extra_bounds=np.tile([0.0, np.inf], (7, 1)),
        truth=parameters,
    )


def _arm() -> MultibodyPlant:
    """Return ten cylinders in a row, hinged about x, y and z in turn."""
    plant, parent = MultibodyPlant(time_step=0.0), None
    for i in range(10):
        mass = 3.0 * 0.8**i
        inertia = SpatialInertia.SolidCylinderWithMass(mass, 0.05, 0.2, [0.0, 0.0, 1.0])
        body = plant.AddRigidBody(f"link_{i}", inertia.Shift([0.01, 0.02, -0.1]))
        frame = plant.world_frame() if parent is None else parent.body_frame()
        X = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [0.0, 0.0, 0.2])
        hinge = plant.AddFrame(FixedOffsetFrame(f"hinge_{i}", frame, X))
        axis = np.eye(3)[i % 3]
        plant.AddJoint(RevoluteJoint(f"joint_{i}", hinge, body.body_frame(), axis))
        parent = body
    plant.Finalize()
    return plant


def cvxpy_solution(problem: FitProblem) -> np.ndarray:
    """Build and solve the same program as a user writes it in CVXPY.

    The cost is divided by γ: otherwise Clarabel may end far from the minimum.
    """
    import cvxpy as cp

    x = cp.Variable(problem.size)
    scale = max(gamma for _, gamma in problem.entropic.values())
    factor = problem.factor / np.sqrt(scale)
    value = cp.sum_squares(factor[:, :-1] @ x - factor[:, -1])
    limits = []
    basis = pseudo_inertia_basis().reshape(10, 16).T
    for start, (phi, gamma) in problem.entropic.items():
        P = cp.reshape(basis @ x[start : start + 10], (4, 4), order="C")
        trace = cp.trace(np.linalg.inv(pseudo_inertia(phi)) @ P)
        value += gamma / scale * (trace - cp.log_det(P))
    rows, bounded = problem.constraints, np.isfinite(problem.lower)
    limits.append(rows.matrix @ x >= rows.lower)
    if bounded.any():
        limits.append(x[bounded] >= problem.lower[bounded])
    cp.Problem(cp.Minimize(value), limits).solve(solver="CLARABEL")
    return np.asarray(x.value)


def cost(problem: FitProblem, x: np.ndarray) -> float:
    """Return the cost of an entropic fit."""
    value = problem.residual(x)
    for start, (phi, gamma) in problem.entropic.items():
        ratio = np.linalg.solve(pseudo_inertia(phi), pseudo_inertia(x[start : start + 10]))
        value += gamma * (np.trace(ratio) - 4.0 - np.linalg.slogdet(ratio)[1])
    return float(value)


def solver_ratios(case: Case, repeats: int) -> dict[str, Any]:
    """Return Newton's time relative to Drake's and CVXPY's on one triangular factor, cold."""
    problem = case.problem(GAMMA)
    methods: dict[str, Callable[[], np.ndarray]] = {
        "newton": lambda: solve_newton(problem).x,
        "drake": lambda: solve_fit(problem).x,
    }
    if HAS_CVXPY:
        methods["cvxpy"] = lambda: cvxpy_solution(problem)
    times = medians(methods, repeats)
    costs = {name: cost(problem, solve()) for name, solve in methods.items()}
    table: dict[str, Any] = {
        "seconds": times,
        "newton / drake": times["newton"] / times["drake"],
        "cost difference, drake": costs["drake"] / costs["newton"] - 1.0,
    }
    if "cvxpy" in times:
        table |= {
            "newton / cvxpy": times["newton"] / times["cvxpy"],
            "drake / cvxpy": times["drake"] / times["cvxpy"],
            "cost difference, cvxpy": costs["cvxpy"] / costs["newton"] - 1.0,
        }
    return table


def geodesic_rows(
    case: Case, sizes: Sequence[int], gammas: Sequence[float]
) -> list[dict[str, Any]]:
    """Return geodesic fits ([Lee2019] §3.4) to few samples, and entropic ones of equal residual.

    The motors' inertia is known. Errors are of all samples, and RMS distances of the bodies.
    """
    n = case.prior.size
    truth, effort = case.truth[:n], case.b - case.A[:, n:] @ case.truth[n:]
    bodies = pseudo_inertia(truth.reshape(case.prior.shape))

    def quality(phi: np.ndarray) -> dict[str, float]:
        away = np.square(distance(pseudo_inertia(phi), bodies))
        error = case.A[:, :n] @ (phi.ravel() - truth)
        return {"error": float(np.sqrt(np.mean(error**2))), "distance": float(away.mean() ** 0.5)}

    table = []
    for size in sizes:
        A, b = case.A[: 7 * size, :n], effort[: 7 * size]
        for gamma in gammas:
            start = cpu_clock()
            own = geodesic_least_squares(A, b, case.prior, gamma=gamma, sigma=NOISE)
            seconds = cpu_clock() - start
            bound = {"residual_bound": own.residual, "sigma": NOISE}
            other = identify(A, b, case.prior, regularizer="entropic", **bound)
            row = {"samples": size, "gamma": gamma, "seconds": seconds}
            row |= {"iterations": own.iterations, "rejected": len(own.rejected)}
            row |= {"curvature": own.curvature, "residual": own.residual / len(b)}
            row |= {"entropic residual": other.residual / len(b)}
            row |= {"geodesic": quality(own.phi), "entropic": quality(other.phi)}
            table.append(row | {"prior": quality(case.prior)})
    return table


def main() -> None:
    """Measure, print and write."""
    options = script_parser(__doc__, "fewer samples and repeats").parse_args()
    samples, repeats = (300, 1) if options.quick else (4100, 9)
    if not HAS_CVXPY:
        print("CVXPY is not installed (pip install geodrake[dev]): no comparison with it.")
    case = arm_case(samples=samples, seed=options.seed)
    few = ((10,), (1.0,)) if options.quick else ((10, 30), (1.0, 10.0))
    found = {
        "size": list(case.A.shape),
        "from the factor": solver_ratios(case, repeats),
        "geodesic least squares": geodesic_rows(case, *few),
    }
    tell(options, {"cvxpy": HAS_CVXPY, "arm": found})


if __name__ == "__main__":
    main()
