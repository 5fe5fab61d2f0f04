"""An entropic fit as a user writes it in CVXPY."""

from __future__ import annotations

import numpy as np

from geodrake.identification import FitProblem
from geodrake.inertia import pseudo_inertia, pseudo_inertia_basis


def has_cvxpy() -> bool:
    """Whether CVXPY and Clarabel are installed (the bench extra)."""
    try:
        import clarabel  # noqa: F401
        import cvxpy  # noqa: F401
    except ImportError:
        return False
    return True


def cvxpy_solution(problem: FitProblem) -> np.ndarray:
    """The same program as a user writes it in CVXPY, built and solved.

    The cost is divided by γ: as it stands Clarabel ends far from the minimum of the human's.
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
    """What an entropic fit minimizes."""
    value = problem.residual(x)
    for start, (phi, gamma) in problem.entropic.items():
        ratio = np.linalg.solve(pseudo_inertia(phi), pseudo_inertia(x[start : start + 10]))
        value += gamma * (np.trace(ratio) - 4.0 - np.linalg.slogdet(ratio)[1])
    return float(value)
