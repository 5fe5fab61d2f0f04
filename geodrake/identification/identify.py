"""Identify inertial parameters from a regressor and measurements, in one call."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, number, one_of, real_array, typed
from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.fit import FitResult
from geodrake.identification.problem import (
    BodyConstraints,
    FitProblem,
    checked_bounds,
    whitened_factor,
)
from geodrake.identification.regularizer import Entropic, Euclidean, Pullback, Regularizer
from geodrake.identification.riemannian import Riemannian
from geodrake.inertia import PARAMETERS_PER_BODY, Array, is_physical, pseudo_inertia
from geodrake.robot.repairs import nearest_physical

REGULARIZERS: dict[str, type[Regularizer]] = {
    kind.name: kind for kind in (Euclidean, Pullback, Entropic, Riemannian)
}

_MARGIN = 1e-6
"""Smallest eigenvalue of P(φ⁰)⁻¹ P(φ): physical, but hardly a constraint."""


@dataclass(frozen=True, kw_only=True, eq=False)
class IdentificationResult(FitResult):
    """Identified parameters, with the fit's residual, certificate and so on."""

    phi: Array  # (nb, 10) inertial parameters, all physical
    extra: Array  # (extra,) further linear parameters, such as friction coefficients
    divergence: float  # d(Φ, Φ⁰)² of the regularizer without γ, including extra parameters
    regularizer: str  # its name
    gamma: float  # γ, in the point-to-set form that of the same solution


@typed
def identify(  # noqa: PLR0913 - the stable interface
    A: ArrayLike,
    b: ArrayLike,
    prior: ArrayLike,
    *,
    regularizer: str | Regularizer,
    gamma: float | None = None,
    residual_bound: float | None = None,
    sigma: ArrayLike | None = None,
    ellipsoids: ArrayLike | None = None,
    total_mass: float | None = None,
    extra_bounds: ArrayLike | None = None,
    extra_prior: ArrayLike | None = None,
    constraints: BodyConstraints | None = None,
    solver: str | None = None,
    certify: bool = True,
) -> IdentificationResult:
    """Fit physical parameters to A x ≈ b, close to a prior.

    The minimum is global, except with "riemannian", whose result reports its `minima`. With
    `gamma` it minimizes ‖A x − b‖²_{Σ⁻¹} + γ d(Φ, Φ⁰)² ([Lee2019] Eq. (3.2.16)); with
    `residual_bound` c, d(Φ, Φ⁰)² subject to ‖A x − b‖²_{Σ⁻¹} ≤ c (Eq. (3.5.52)), which compares
    regularizers fairly. x = [Φ, extra]. Extra parameters with an `extra_prior` are regularized as
    elements of P(1) (Remark 3.13, Eq. (3.6.60)): d² also includes

        Σ_k w_k (x_k − x_k⁰)²                           euclidean
        Σ_k w_k ½ (x_k/x_k⁰ − 1)²                       pullback
        Σ_k w_k (x_k/x_k⁰ − log(x_k/x_k⁰) − 1)          entropic
        Σ_k w_k ½ log²(x_k/x_k⁰)                        riemannian

    All but the first are independent of units, and agree to second order.

    Args:
        A: (m, 10·nb + extra) regressor; the bodies' columns come first, in their order.
        b: (m,) measurements.
        prior: (nb, 10) physical inertial parameters Φ⁰.
        regularizer: "euclidean", "pullback", "entropic" or "riemannian"; or a `Regularizer` with
            settings, such as `PointMassKL(points)`.
        gamma: Weight γ > 0; pass exactly one of gamma and residual_bound.
        residual_bound: Largest squared residual c.
        sigma: (m,) or scalar standard deviations of b, in its units; by default 1.
        ellipsoids: (nb, 4, 4) matrices Q with [x;1]ᵀ Q [x;1] ≥ 0 inside the body's hull; adds
            tr(P(φ_i) Q_i) ≥ 0 (Eq. (3.5.46)).
        total_mass: Sum of all masses, kg.
        extra_bounds: (extra, 2) bounds of extra parameters; ±inf for none.
        extra_prior: (extra,) prior values x⁰ > 0 of extra parameters such as rotor inertias and
            friction, which are then kept positive; NaN for none. Or (extra, 2) with their weights
            w relative to that of the bodies, by default 1 (Eq. (5.3.38)). Not with point masses.
        constraints: Bounds on masses and centres of mass; may also have the ellipsoids and total
            mass.
        solver: By default a closed form or Newton's method, or Clarabel if these fail (`note` of
            the result) and for point masses. Otherwise "newton", except for point masses, or a name
            of `SOLVERS`; SCS serves as a cross-check.
        certify: Whether to also solve the MathematicalProgram of the fit, and use its solution if
            it is better (`certificate` of the result). Only without a `solver`; takes about 0.1 s.

    Raises:
        ArgumentError: An argument is invalid, or no physical bodies inside all constraints reach
            the residual bound; the evidence has the `minimum` that they reach.
        IdentificationError: The solver found no solution, for instance because no physical
            bodies have the total mass inside their ellipsoids.
        ConvergenceError: A conic solver did not finish in 20 s.
    """
    kind = regularizer_of(regularizer)
    if (gamma is None) == (residual_bound is None):
        raise ArgumentError(
            f"Exactly one of gamma and residual_bound is needed; got gamma={gamma}, "
            f"residual_bound={residual_bound}."
        )
    for name, value in (("gamma", gamma), ("residual_bound", residual_bound)):
        if value is not None:
            number(value, name, lower=0.0, strict=True, finite=False)
    prior = physical_prior(prior)
    problem = build_problem(
        whitened_factor(A, b, sigma=sigma),
        prior,
        constraints=_merged(constraints, ellipsoids=ellipsoids, total_mass=total_mass),
        extra_bounds=extra_bounds,
        extra_prior=extra_prior,
    )
    problem = replace(problem, residual_bound=residual_bound)
    columns = list(problem.scalar_priors)
    values, weights = np.reshape(list(problem.scalar_priors.values()), (-1, 2)).T
    if columns:
        kind.scalar_divergence(values, values)  # raises if there is none
    try:
        weight = 1.0 if gamma is None else float(gamma)
        certify = instance(certify, "certify", bool) and solver is None
        fit = kind.solve(problem, prior, weight, solver, certify)
    except np.linalg.LinAlgError as error:
        raise _rounded(str(error)) from error
    phi, extra = fit.x[: prior.size].reshape(prior.shape), fit.x[prior.size :]
    if not (np.isfinite(fit.x).all() and np.all(is_physical(phi))):
        raise _rounded("the parameters are not physical")
    try:
        divergence = kind.divergence_of(fit, prior)
    except ArgumentError as error:  # a body is too flat for its logarithm
        raise _rounded("the parameters are not physical") from error
    if columns:
        divergence += float(weights @ kind.scalar_divergence(fit.x[columns], values))
    return IdentificationResult(
        **vars(fit),
        phi=phi,
        extra=extra,
        divergence=divergence,
        regularizer=kind.name,
        gamma=fit.prior_weight if gamma is None else weight,
    )


def _rounded(what: str) -> IdentificationError:
    return IdentificationError(
        f"Rounding errors leave no solution: {what}. Most often a body of the prior is too "
        "flat, or data and prior differ by very many orders of magnitude.",
        advice="Check the units of prior, data and ellipsoids, raise gamma, or try another solver.",
    )


def regularizer_of(regularizer: str | Regularizer) -> Regularizer:
    """Return the regularizer of a name with default settings, or the regularizer itself."""
    if isinstance(regularizer, Regularizer):
        return regularizer
    return REGULARIZERS[one_of(regularizer, "regularizer", REGULARIZERS)]()


def physical_prior(prior: ArrayLike, names: Sequence[str] = ()) -> Array:
    """Return a prior (nb, 10) after checking that all bodies, of a model if named, are physical.

    Raises:
        ArgumentError: There are no bodies, or some are not physical. The evidence then has the
            `bodies`, and a `nearest` prior (nb, 10) in which these have the smallest physical
            inertia. They keep mass and centre of mass; without a mass they get a thousandth of the
            total.
    """
    prior = real_array(prior, "prior", ("m", PARAMETERS_PER_BODY))
    if not len(prior):
        raise ArgumentError("The prior has no bodies.", advice="Use one row for every body of A.")
    physical = is_physical(prior)
    if physical.all():
        return prior
    wrong, nearest = np.flatnonzero(~physical).tolist(), prior.copy()
    spare = float(1e-3 * prior[physical, 0].sum() or 1.0)
    for body in wrong:
        nearest[body] = nearest_physical(prior[body], points=np.zeros((1, 3)), spare_mass=spare)
    if names:
        bodies = [names[body] for body in wrong]
        raise ArgumentError(
            f"The model's inertial parameters of {', '.join(bodies)} are not physical, so "
            "they cannot be a prior.",
            advice="Use model.with_volume, or load the model from its URDF, SDF or MJCF file, "
            "which repairs them; evidence['nearest'] of this error has the nearest ones.",
            bodies=bodies,
            nearest=nearest,
        )
    least = np.linalg.eigvalsh(pseudo_inertia(prior[wrong]))[:, 0]
    raise ArgumentError(
        f"The prior is not physical for bodies {wrong}: their pseudo-inertia is not positive "
        f"definite, with smallest eigenvalues {', '.join(f'{value:.3g}' for value in least)}.",
        advice="Give them a physical mass, centre of mass and inertia; evidence['nearest'] of "
        "this error is the closest valid prior.",
        bodies=wrong,
        nearest=nearest,
    )


def _merged(constraints: BodyConstraints | None, **given: Any) -> BodyConstraints:
    """Return the constraints with those given as arguments."""
    constraints = BodyConstraints() if constraints is None else constraints
    given = {name: value for name, value in given.items() if value is not None}
    for name in given:
        if getattr(constraints, name) is not None:
            raise ArgumentError(f"{name} is given twice: as an argument and in constraints.")
    return replace(constraints, **given)


def build_problem(
    factor: Array,
    prior: Array,
    *,
    constraints: BodyConstraints | None = None,
    extra_bounds: ArrayLike | None = None,
    extra_prior: ArrayLike | None = None,
) -> FitProblem:
    """Return the fit problem of bodies and extra parameters, without a regularizer.

    The arguments are those of `identify`, with a `whitened_factor` (k, 10·nb + extra + 1).
    """
    p = factor.shape[1] - 1
    extra = p - prior.size
    if extra < 0:
        raise ArgumentError(
            f"A has {p} columns, but {len(prior)} bodies of the prior need {prior.size}."
        )
    bounds = np.tile([-np.inf, np.inf], (extra, 1))
    if extra_bounds is not None:
        bounds = checked_bounds("extra_bounds", extra_bounds, (extra, 2)).copy()
    priors = _extra_priors(extra_prior, bounds)
    mean = np.zeros(extra)
    for k, (value, _) in priors.items():
        mean[k], bounds[k, 0] = value, max(bounds[k, 0], 0.0)
    free = np.full(prior.size, np.inf)
    return FitProblem(
        factor=factor,
        inertia_blocks=tuple(range(0, prior.size, PARAMETERS_PER_BODY)),
        prior_mean=np.append(prior.ravel(), mean),
        prior_information=np.zeros((p, p)),
        lower=np.append(-free, bounds[:, 0]),
        upper=np.append(free, bounds[:, 1]),
        scalar_priors={prior.size + k: pair for k, pair in priors.items()},
        constraints=(constraints or BodyConstraints()).rows(prior, p),
        margin=_MARGIN,
    )


def _extra_priors(extra_prior: ArrayLike | None, bounds: Array) -> dict[int, tuple[float, float]]:
    """Return the prior values and weights by index of the extra parameter."""
    if extra_prior is None:
        return {}
    count = len(bounds)
    given = real_array(extra_prior, "extra_prior", finite=False)
    if given.shape not in ((count,), (count, 2)):
        raise ArgumentError(
            f"extra_prior must have shape ({count},) or ({count}, 2); got {given.shape}."
        )
    values, weights = given.T if given.ndim == 2 else (given, np.ones(count))
    known = ~np.isnan(values)
    valid = np.isfinite(values) & (values > 0) & np.isfinite(weights) & (weights > 0)
    inside = (values >= bounds[:, 0]) & (values <= bounds[:, 1]) & (bounds[:, 1] > 0)
    if wrong := np.flatnonzero(known & ~(valid & inside)).tolist():
        raise ArgumentError(
            "extra_prior has values or weights that are not positive, or values outside "
            f"extra_bounds, at {wrong}.",
            advice="Use positive values inside the bounds; NaN for parameters without a prior.",
            places=wrong,
        )
    return {k: (float(values[k]), float(weights[k])) for k in np.flatnonzero(known).tolist()}
