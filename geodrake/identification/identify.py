"""Identify inertial parameters from a regressor and measurements, in one call."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from geodrake.errors import ArgumentError
from geodrake.identification.entropic import Entropic
from geodrake.identification.euclidean import Euclidean
from geodrake.identification.fit import FitResult
from geodrake.identification.problem import (
    FitProblem,
    LinearConstraints,
    checked,
    whitened_factor,
)
from geodrake.identification.pullback import Pullback
from geodrake.identification.regularizer import Regularizer
from geodrake.inertia import PARAMETERS_PER_BODY, Array, is_physical, pseudo_inertia_basis

REGULARIZERS: dict[str, type[Regularizer]] = {
    kind.name: kind for kind in (Euclidean, Pullback, Entropic)
}

_MARGIN = 1e-6
"""Smallest eigenvalue of P(φ⁰)⁻¹ P(φ): physical, and next to no constraint otherwise."""


@dataclass(frozen=True, kw_only=True, eq=False)
class IdentificationResult:
    """Identified parameters.

    Attributes:
        phi: (nb, 10) inertial parameters, all physical.
        extra: (extra,) further linear parameters, such as friction coefficients.
        residual: ‖A x − b‖²_{Σ⁻¹} at the solution, dimensionless when sigma was given.
        divergence: d(Φ, Φ⁰)² of the regularizer, without γ.
        regularizer: Its name.
        gamma: The weight γ given, or in the point-to-set form the γ of the same solution.
        fit: The solution's details: information, standard deviations, active constraints.
    """

    phi: Array
    extra: Array
    residual: float
    divergence: float
    regularizer: str
    gamma: float
    fit: FitResult

    @property
    def solver(self) -> str:
        """What solved it: "closed form", "bounded least squares" or a conic solver's name."""
        return self.fit.solver

    @property
    def solve_time(self) -> float:
        """Time of the solution, s."""
        return self.fit.solve_time


def identify(  # noqa: PLR0913 - the stable interface
    A: ArrayLike,
    b: ArrayLike,
    prior: ArrayLike,
    *,
    regularizer: str,
    gamma: float | None = None,
    residual_bound: float | None = None,
    sigma: ArrayLike | None = None,
    ellipsoids: ArrayLike | None = None,
    total_mass: float | None = None,
    extra_bounds: ArrayLike | None = None,
    solver: str = "clarabel",
) -> IdentificationResult:
    """Physical parameters that fit A x ≈ b and stay near a prior; the minimum is global.

    With `gamma` it minimizes ‖A x − b‖²_{Σ⁻¹} + γ d(Φ, Φ⁰)² ([Lee2019] Eq. (3.2.16)); with
    `residual_bound` c, d(Φ, Φ⁰)² subject to ‖A x − b‖²_{Σ⁻¹} ≤ c (Eq. (3.5.52)), which compares
    regularizers fairly. x = [Φ, extra], and the extra parameters are not regularized.

    Args:
        A: (m, 10·nb + extra) regressor; the bodies' columns come first, in their order.
        b: (m,) measurements.
        prior: (nb, 10) physical inertial parameters Φ⁰.
        regularizer: "euclidean", "pullback" or "entropic".
        gamma: Weight γ > 0; exactly one of gamma and residual_bound.
        residual_bound: Greatest squared residual c.
        sigma: (m,) or scalar standard deviations of b, in its units; None for 1.
        ellipsoids: (nb, 4, 4) matrices Q with [x;1]ᵀ Q [x;1] ≥ 0 inside the body's hull; adds
            tr(P(φ_i) Q_i) ≥ 0 (Eq. (3.5.46)).
        total_mass: Sum of all masses, kg.
        extra_bounds: (extra, 2) least and greatest extra parameters; ±inf for none.
        solver: Drake's conic solver: "clarabel" or "scs".

    Returns:
        The parameters and how they were found.

    Raises:
        ArgumentError: A shape, value or name is wrong, or no parameters reach the residual bound.
        IdentificationError: The solver found no solution, for instance because no physical
            bodies reach the residual bound or the total mass inside their ellipsoids.
    """
    kind = _regularizer(regularizer)
    if (gamma is None) == (residual_bound is None):
        raise ArgumentError(
            f"Exactly one of gamma and residual_bound is needed; got gamma={gamma}, "
            f"residual_bound={residual_bound}."
        )
    if gamma is not None and not (np.isfinite(gamma) and gamma > 0):
        raise ArgumentError(f"gamma must be positive; got {gamma:g}.")
    prior = _physical_prior(prior)
    factor = whitened_factor(A, b, sigma=sigma)
    problem = _problem(factor, prior, extra_bounds)
    constraints = _constraints(prior, problem.size, ellipsoids, total_mass)
    problem = replace(problem, constraints=constraints, residual_bound=residual_bound)
    fit = kind.solve(problem, prior, 1.0 if gamma is None else gamma, solver)
    phi, extra = fit.x[: prior.size].reshape(prior.shape), fit.x[prior.size :]
    return IdentificationResult(
        phi=phi,
        extra=extra,
        residual=fit.residual,
        divergence=kind.divergence(phi, prior),
        regularizer=regularizer,
        gamma=fit.prior_weight if gamma is None else gamma,
        fit=fit,
    )


def _regularizer(name: str) -> Regularizer:
    if name not in REGULARIZERS:
        known = ", ".join(f'"{known}"' for known in REGULARIZERS)
        raise ArgumentError(f'There is no regularizer "{name}"; there are {known}.')
    return REGULARIZERS[name]()


def _physical_prior(prior: ArrayLike) -> Array:
    prior = checked("prior", prior, (None, PARAMETERS_PER_BODY))
    wrong = np.flatnonzero(~is_physical(prior)).tolist()
    if wrong:
        raise ArgumentError(
            f"The prior is not physical for bodies {wrong}: their pseudo inertia is not positive "
            "definite.",
            advice="Give them a mass, a centre of mass and an inertia that a solid body can have.",
            bodies=wrong,
        )
    return prior


def _problem(factor: Array, prior: Array, extra_bounds: ArrayLike | None) -> FitProblem:
    p = factor.shape[1] - 1
    extra = p - prior.size
    if extra < 0:
        raise ArgumentError(
            f"A has {p} columns, but {len(prior)} bodies of the prior need {prior.size}."
        )
    limits: dict[str, Any] = {}
    if extra_bounds is not None:
        bounds = np.asarray(extra_bounds, float)
        if bounds.shape != (extra, 2):
            raise ArgumentError(f"extra_bounds must have shape ({extra}, 2); got {bounds.shape}.")
        free = np.full(prior.size, np.inf)
        limits = {"lower": np.append(-free, bounds[:, 0]), "upper": np.append(free, bounds[:, 1])}
    return FitProblem(
        factor=factor,
        inertia_blocks=tuple(range(0, prior.size, PARAMETERS_PER_BODY)),
        prior_mean=np.append(prior.ravel(), np.zeros(extra)),
        prior_information=np.zeros((p, p)),
        margin=_MARGIN,
        **limits,
    )


def _constraints(
    prior: Array, p: int, ellipsoids: ArrayLike | None, total_mass: float | None
) -> LinearConstraints | None:
    """Rows for the ellipsoids and the total mass."""
    nb = len(prior)
    rows, lower, upper = np.zeros((0, p)), np.empty(0), np.empty(0)
    if ellipsoids is not None:
        Q = checked("ellipsoids", ellipsoids, (nb, 4, 4))
        wrong = np.flatnonzero(np.linalg.eigvalsh(Q[:, :3, :3])[:, -1] >= 0).tolist()
        if wrong:
            raise ArgumentError(
                f"The ellipsoids of bodies {wrong} are not bounded regions [x;1]ᵀQ[x;1] ≥ 0.",
                advice="Q is positive inside: use −Q if yours is negative there.",
                bodies=wrong,
            )
        blocks = np.zeros((nb, nb, PARAMETERS_PER_BODY))
        blocks[range(nb), range(nb)] = np.einsum("bij,kji->bk", Q, pseudo_inertia_basis())
        rows = np.hstack([blocks.reshape(nb, -1), np.zeros((nb, p - prior.size))])
        lower, upper = np.zeros(nb), np.full(nb, np.inf)
    if total_mass is not None:
        if not (np.isfinite(total_mass) and total_mass > 0):
            raise ArgumentError(f"total_mass must be positive, in kg; got {total_mass:g}.")
        masses = np.zeros(p)
        masses[: prior.size : PARAMETERS_PER_BODY] = 1.0
        rows = np.vstack([rows, masses])
        lower, upper = np.append(lower, total_mass), np.append(upper, total_mass)
    return LinearConstraints(matrix=rows, lower=lower, upper=upper) if len(rows) else None
