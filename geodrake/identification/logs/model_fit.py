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

_STEP = 1e-6  # of a parameter, with which what it does is differentiated


def known_information(model: RobotModel, *, spread: float = SPREAD, stated: float = 1.0) -> Array:
    """Return what is known (n, n) of a model's inertias and effects.

    A model that was fitted before is known as well as its information matrix says; of a model
    file, inertias are known to within `spread`, a geometric distance, and parameters of effects to
    within a share `stated` of what it says.
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
    """Return all parameters of a model that a fit may change, with their prior."""
    p, information = model.phi.size, known_information(model, spread=spread, stated=stated)
    unknowns = inertial_unknowns(model.phi, information[:p, :p])
    for f in (fitted for fitted in model.effects if fitted.effect.parameters):
        own = np.zeros((len(f.parameters),) * 2)  # of all together below
        unknowns = unknowns.with_effect(
            f.effect, dataset.effect_columns(f.effect), own, f.parameters
        )
    return replace(unknowns, information=information)


@dataclass(frozen=True, eq=False)
class ModelFit:
    """A model fitted to logs."""

    model: RobotModel  # the fitted one
    held_out: HeldOut  # errors of the same fit without each fold
    result: FitResult  # with its information matrix and the certificate of its program
    unknowns: Unknowns  # what was fitted
    gain_shifts: Array  # (nv, p) change of the parameters with the gain of each joint's efforts
    unexplained_covariance: Array  # (p, p) by what stays unexplained
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

    Efforts of the dataset are advanced by the model's `delays` already. The residuals are worth
    `effective` samples (nv,); a share `of_motion` (nv,) of their square varies with the motion.
    """
    problem = fit_problem(dataset, unknowns, weights)
    result = certified(problem, solve_with_fallback(problem))
    if held_out is None:
        held_out = CrossValidation(dataset, unknowns, weights).held_out
    fitted = model_with(model, unknowns, result, noise=held_out.rms, delays=delays)
    known = model.information is not None
    shifts = _gain_shifts(dataset, unknowns, weights, result, known=known)
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
    """Return the model with a fit of the unknowns in place of its parameters, and effort delays.

    The `noise` (nv,) is the held-out RMS.
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
    """Return a fitted model whose effects do what the fit's columns say (`Effect.fit_rows`)."""
    bodies = model.bodies_at_rest
    return replace(model, effects=tuple(settled_effect(f, bodies) for f in model.effects))


def settled_effect(fitted: FittedEffect, bodies: RobotBodies) -> FittedEffect:
    """Return an effect that does what the fit's columns say, with its deviations to first order."""
    x, unsure = fitted.parameters, fitted.deviations
    effect, found = fitted.effect.settled(x, bodies)
    if effect is fitted.effect or unsure is None or not np.isfinite(unsure).all():
        return FittedEffect(effect, found, unsure)
    moved = [fitted.effect.settled(x + step, bodies)[1] for step in _STEP * np.eye(len(x))]
    slopes = (np.array(moved) - found) / _STEP
    return FittedEffect(effect, found, np.linalg.norm(slopes * unsure[:, None], axis=0))


def _gain_shifts(
    dataset: Dataset, unknowns: Unknowns, weights: Array, fit: FitResult, *, known: bool
) -> Array:
    """Return (nv, p) changes of the fitted parameters with the gain of each joint's efforts.

    A wrong gain 1 + g of joint j moves them by g times its row, to first order; that of a joint
    whose gain is fitted moves nothing else. It acts on the measured effort, of which known payloads
    are a part. If the prior is `known` by a fit to efforts of the same gains, these have gone into
    it: then what a gain moves is only what has changed since.
    """
    pulls = np.zeros((len(dataset.joints), len(unknowns.columns)))
    fitted = {effect.where[0] for effect in unknowns.effects if effect.role is Role.SCALE}
    for j, (data, weight) in enumerate(zip(dataset.data, weights, strict=True)):
        if dataset.joints[j] in fitted:
            continue
        rows = np.concatenate(data.factors_of(unknowns.columns))
        A, b = rows[:, :-1], rows[:, -1]
        pull = A.T @ (A @ (fit.x - unknowns.mean) if known else b)
        carried = np.append(data.carried.sum(axis=0), 0.0)  # 0 where the joint sees nothing
        pulls[j] = weight * (pull + carried[data.local(unknowns.columns)])
    return _moved(fit, pulls.T).T


def _unexplained_covariance(
    dataset: Dataset, unknowns: Unknowns, weights: Array, fit: FitResult, samples: Array
) -> Array:
    """Return the covariance (p, p) of fitted parameters by the unexplained error.

    With A the information of the fit and G_j the weighted normal matrix of joint j, noise gives
    Σ_j A⁻¹ G_j A⁻¹, if samples are counted by what they are worth. Of the part of the residual that
    is no noise, all n_j of them are worth no more than `WORTH`. `samples` (nv,) are n_j times the
    share of the squared residual that varies with the motion.
    """
    gram = np.zeros((len(unknowns.columns),) * 2)
    for data, weight, worth in zip(dataset.data, weights, samples, strict=True):
        A = np.concatenate(data.factors_of(unknowns.columns))[:, :-1]
        gram += worth / WORTH * weight * (A.T @ A)
    return _moved(fit, _moved(fit, gram).T)


def _moved(fit: FitResult, pulls: Array) -> Array:
    """Return (p, k) changes of parameters with slopes (p, k) of the fit's cost."""
    factor, scale = scaled_cholesky(fit.information)
    return np.asarray(scale[:, None] * solved(factor, scale[:, None] * pulls))


def as_it_stands(dataset: Dataset, model: RobotModel) -> HeldOut:
    """Return the errors of a model on logs without any fit to them."""
    unknowns = model_unknowns(dataset, model)
    x = np.tile(unknowns.mean, (len(dataset.folds), 1))
    return hold_out(dataset, unknowns.columns, x)


def effects_of(model: RobotModel) -> tuple[Effect, ...]:
    """Return the model's effects that have columns."""
    return tuple(f.effect for f in model.effects if f.effect.parameters)
