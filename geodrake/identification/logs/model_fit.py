"""Physically consistent fits of a `RobotModel` to a `Dataset`, with information."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from geodrake.effects import FittedEffect, Role
from geodrake.effects.base import Effect
from geodrake.effects.body_motion import RobotBodies
from geodrake.identification.conic_fit import certified, solve_with_fallback
from geodrake.identification.fit import FitResult
from geodrake.identification.logs.criteria import SPREAD, WORTH
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.hypothesis import CrossValidation, HeldOut, hold_out
from geodrake.identification.logs.unknowns import (
    Unknowns,
    fit_problem,
    inertial_unknowns,
    pullback_information,
)
from geodrake.identification.normal_equations import scaled_cholesky, solved
from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel

_STEP = 1e-6  # of finite differences


def known_information(model: RobotModel, *, spread: float = SPREAD, stated: float = 1.0) -> Array:
    """Return the prior information (n, n) about a model's inertias and effects.

    It is the information matrix of a fitted model. For a model file, inertias have an uncertainty
    of `spread`, a geometric distance, and effect parameters a relative one of `stated`.
    """
    if model.information is not None:
        return model.information
    sizes = [
        np.diag(1.0 / np.maximum((stated * fitted.parameters) ** 2, 1e-12))
        for fitted in model.effects
        if fitted.effect.parameters
    ]
    return np.asarray(block_diag(pullback_information(model.with_volume.phi, spread), *sizes))


def model_unknowns(
    dataset: Dataset, model: RobotModel, *, spread: float = SPREAD, stated: float = 1.0
) -> Unknowns:
    """Return all free parameters of a model with their prior."""
    p, information = model.phi.size, known_information(model, spread=spread, stated=stated)
    unknowns = inertial_unknowns(model.phi, information[:p, :p])
    for f in (fitted for fitted in model.effects if fitted.effect.parameters):
        zero = np.zeros((len(f.parameters),) * 2)  # the joint information is set below
        columns = dataset.effect_columns(f.effect)
        unknowns = unknowns.with_effect(f.effect, columns, zero, f.parameters)
    return replace(unknowns, information=information)


@dataclass(frozen=True, eq=False)
class ModelFit:
    """A model fitted to logs."""

    model: RobotModel  # the fitted model
    held_out: HeldOut  # errors of the same fit without each fold
    result: FitResult  # with information matrix and certificate
    unknowns: Unknowns  # the fitted parameters
    gain_shifts: Array  # (nv, p) slopes of the parameters with respect to the efforts' gains
    unexplained_covariance: Array  # (p, p) covariance due to unexplained error
    of_motion: Array  # (nv,) share of each joint's squared error that varies with the motion


def fit_model(
    model: RobotModel,
    dataset: Dataset,
    unknowns: Unknowns,
    weights: Array,
    *,
    held_out: HeldOut | None = None,
    effective: Array | None = None,
    of_motion: Array | None = None,
    delays: Sequence[FittedEffect] = (),
) -> ModelFit:
    """Fit, validate, and return the fitted model.

    The efforts of the dataset are already advanced by the model's `delays`. The residuals have
    `effective` samples (nv,); a share `of_motion` (nv,) of their square varies with the motion.
    """
    problem = fit_problem(dataset, unknowns, weights)
    result = certified(problem, solve_with_fallback(problem))
    if held_out is None:
        held_out = CrossValidation(dataset, unknowns, weights).held_out
    fitted = model_with(model, unknowns, result, noise=held_out.rms, delays=delays)
    is_fitted = model.information is not None
    shifts = _gain_shifts(dataset, unknowns, weights, result, known=is_fitted)
    share = np.zeros(len(weights)) if of_motion is None else of_motion
    samples = dataset.samples.sum(axis=0) if effective is None else effective
    off = _unexplained_covariance(dataset, unknowns, weights, result, samples * share)
    return ModelFit(fitted, held_out, result, unknowns, shifts, off, share)


def model_with(
    model: RobotModel,
    unknowns: Unknowns,
    fit: FitResult,
    *,
    noise: Array,
    delays: Sequence[FittedEffect],
) -> RobotModel:
    """Return the model with fitted parameters and effort delays.

    `noise` (nv,) is the held-out RMS.
    """
    deviations = fit.standard_deviations()
    spans = [(effect, unknowns.span(effect)) for effect in unknowns.effects]
    return model.with_fit(
        fit.x[: model.phi.size].reshape(model.phi.shape),
        [*(FittedEffect(e, fit.x[span], deviations[span]) for e, span in spans), *delays],
        information=fit.information,
        effort_noise=noise,
    )


def with_settled_effects(model: RobotModel) -> RobotModel:
    """Return a fitted model whose effects reproduce the columns of the fit (`Effect.fit_rows`)."""
    bodies = model.bodies_at_rest
    return replace(model, effects=tuple(settled_effect(f, bodies) for f in model.effects))


def settled_effect(fitted: FittedEffect, bodies: RobotBodies) -> FittedEffect:
    """Return the effect that reproduces the columns of the fit, with first-order deviations."""
    x, deviations = fitted.parameters, fitted.deviations
    effect, settled = fitted.effect.settled(x, bodies)
    if effect is fitted.effect or deviations is None or not np.isfinite(deviations).all():
        return FittedEffect(effect, settled, deviations)
    perturbed = [fitted.effect.settled(x + step, bodies)[1] for step in _STEP * np.eye(len(x))]
    slopes = (np.array(perturbed) - settled) / _STEP
    return FittedEffect(effect, settled, np.linalg.norm(slopes * deviations[:, None], axis=0))


def _gain_shifts(
    dataset: Dataset, unknowns: Unknowns, weights: Array, fit: FitResult, *, known: bool
) -> Array:
    """Return slopes (nv, p) of the fitted parameters with respect to the efforts' gains.

    To first order, a wrong gain 1 + g of joint j shifts the parameters by g times row j; rows of
    joints with fitted gains are zero. The gain scales the measured effort, including that of known
    payloads. If the prior is `known` from a fit to efforts with the same gains, only the change
    since then is shifted.
    """
    pulls = np.zeros((len(dataset.joints), len(unknowns.columns)))
    fitted = {effect.where[0] for effect in unknowns.effects if effect.role is Role.SCALE}
    for j, (data, weight) in enumerate(zip(dataset.data, weights, strict=True)):
        if dataset.joints[j] in fitted:
            continue
        rows = np.concatenate(data.factors_of(unknowns.columns))
        A, b = rows[:, :-1], rows[:, -1]
        pull = A.T @ (A @ (fit.x - unknowns.mean) if known else b)
        carried = np.append(data.carried.sum(axis=0), 0.0)  # 0 for columns of other joints
        pulls[j] = weight * (pull + carried[data.local(unknowns.columns)])
    return _moved(fit, pulls.T).T


def _unexplained_covariance(
    dataset: Dataset, unknowns: Unknowns, weights: Array, fit: FitResult, samples: Array
) -> Array:
    """Return the covariance (p, p) of fitted parameters due to unexplained error.

    With A the information of the fit and G_j the weighted normal matrix of joint j, noise with n_j
    effective samples gives Σ_j A⁻¹ G_j A⁻¹. The part of the residual that is not noise has only
    `WORTH` effective samples. `samples` (nv,) are n_j times the share of the squared residual that
    varies with the motion.
    """
    gram = np.zeros((len(unknowns.columns),) * 2)
    for data, weight, count in zip(dataset.data, weights, samples, strict=True):
        A = np.concatenate(data.factors_of(unknowns.columns))[:, :-1]
        gram += count / WORTH * weight * (A.T @ A)
    return _moved(fit, _moved(fit, gram).T)


def _moved(fit: FitResult, pulls: Array) -> Array:
    """Return changes (p, k) of the parameters due to gradients (p, k) of the fit's cost."""
    factor, scale = scaled_cholesky(fit.information)
    return np.asarray(scale[:, None] * solved(factor, scale[:, None] * pulls))


def unfitted_errors(dataset: Dataset, model: RobotModel) -> HeldOut:
    """Return the errors of a model on logs without any fit to them."""
    unknowns = model_unknowns(dataset, model)
    x = np.tile(unknowns.mean, (len(dataset.folds), 1))
    return hold_out(dataset, unknowns.columns, x)


def effects_of(model: RobotModel) -> tuple[Effect, ...]:
    """Return the model's effects that have columns."""
    return tuple(f.effect for f in model.effects if f.effect.parameters)
