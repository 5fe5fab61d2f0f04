"""Fits of a `RobotModel` to a `Dataset`: physically consistent, and with what they leave known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from geodrake.effects import FittedEffect
from geodrake.effects.base import Effect
from geodrake.identification.certification import certified
from geodrake.identification.conic_fit import solve_with_fallback
from geodrake.identification.fit import FitResult
from geodrake.identification.logs.criteria import SPREAD
from geodrake.identification.logs.cross_validation import HeldOut, hold_out
from geodrake.identification.logs.dataset import Dataset, Delay, is_body
from geodrake.identification.logs.systematic import gain_shifts, unexplained_covariance
from geodrake.identification.logs.unknowns import (
    Unknowns,
    inertial_unknowns,
    pullback_information,
)
from geodrake.identification.problem import FitProblem
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.model.robot_model import RobotModel
from geodrake.robot.reduction import triangular_factor

Array = NDArray[np.float64]


def model_unknowns(dataset: Dataset, model: RobotModel, *, spread: float = SPREAD) -> Unknowns:
    """Everything a fit of the model may move, with what is known about it as the prior.

    A model that was fitted before is known as well as its information matrix says; of a model
    file, inertias are known to within `spread` and stated frictions to within their own size.

    Args:
        dataset: The logs, with columns for the model's effects.
        model: The model.
        spread: Relative uncertainty of a model file's inertias, as a geometric distance.
    """
    p, fitted = model.phi.size, [f for f in model.effects if _has_columns(f)]
    if model.information is None:
        sizes = [np.diag(1.0 / np.maximum(f.parameters**2, 1e-12)) for f in fitted]
        information = block_diag(pullback_information(model.phi, spread), *sizes)
    else:
        information = model.information
    unknowns = inertial_unknowns(model.phi, information[:p, :p])
    at = p
    for f in fitted:
        k = len(f.parameters)
        unknowns = unknowns.with_effect(
            f.effect,
            dataset.effect_columns(f.effect),
            information[at : at + k, at : at + k],
            f.parameters,
        )
        at += k
    return replace(unknowns, information=information)


def fit_problem(
    dataset: Dataset,
    unknowns: Unknowns,
    weights: Array,
    *,
    without: int | None = None,
    delay: Delay = 0,
) -> FitProblem:
    """The convex program of a fit to all folds, or to all but one.

    Args:
        dataset: The logs.
        unknowns: What the fit may move.
        weights: (nv,) weight of a squared residual of each joint.
        without: The fold to leave out.
        delay: Index of the effort column to fit.
    """
    p = len(unknowns.columns)
    triangle = np.zeros((1, p + 1))
    delays = dataset.delay_of_each(delay)
    for data, weight, late in zip(dataset.data, weights, delays, strict=True):
        local = data.local(unknowns.columns)
        used = local >= 0
        kept = [fold for fold in range(len(dataset.folds)) if fold != without]
        stacked = np.concatenate(data.factors[kept])
        rows = np.zeros((len(stacked), p + 1))
        rows[:, :p][:, used] = stacked[:, local[used]]
        rows[:, p] = stacked[:, len(data.columns) + late]
        triangle = triangular_factor([triangle, np.sqrt(weight) * rows])
    payloads = [e for e in unknowns.effects if is_body(e)]
    scalar = np.ones(p, bool)  # P ≻ 0 bounds the inertial parameters
    for start in unknowns.inertia_blocks:
        scalar[start : start + PARAMETERS_PER_BODY] = False
    return FitProblem(
        factor=triangle,
        inertia_blocks=unknowns.inertia_blocks,
        prior_mean=unknowns.mean,
        prior_information=unknowns.information,
        lower=np.where(scalar, unknowns.lower, -np.inf),
        upper=np.where(scalar, unknowns.upper, np.inf),
        reference={unknowns.span(e).start: dataset.payload for e in payloads},
    )


def held_out_physical(
    dataset: Dataset, unknowns: Unknowns, weights: Array, *, delay: Delay = 0
) -> HeldOut:
    """Held-out errors of physically consistent fits, one for every fold.

    Args:
        dataset: The reduced logs.
        unknowns: What the fits may move.
        weights: (nv,) weight of a squared residual of each joint, 1 / (N·m)² or 1 / N².
        delay: Index of the effort column to fit.
    """
    folds = range(len(dataset.folds))
    problems = (fit_problem(dataset, unknowns, weights, without=f, delay=delay) for f in folds)
    x = np.array([solve_with_fallback(problem).x for problem in problems])
    return hold_out(dataset, unknowns.columns, x, delay=delay)


@dataclass(frozen=True, eq=False)
class ModelFit:
    """A model fitted to logs.

    Attributes:
        model: The fitted model.
        held_out: Held-out errors of the same fit without each fold.
        result: The solution, with its information matrix and the certificate of its program.
        unknowns: What was fitted.
        gain_shifts: (nv, p) what the parameters change by with the gain of each joint's efforts.
        unexplained_covariance: (p, p) how far the parameters may be off by what stays unexplained.
        of_motion: (nv,) share of each joint's squared error that goes with the motion.
    """

    model: RobotModel
    held_out: HeldOut
    result: FitResult
    unknowns: Unknowns
    gain_shifts: Array
    unexplained_covariance: Array
    of_motion: Array


def fit_model(
    model: RobotModel,
    dataset: Dataset,
    unknowns: Unknowns,
    weights: Array,
    *,
    effective: Array | None = None,
    of_motion: Array | None = None,
    delays: Sequence[FittedEffect] = (),
) -> ModelFit:
    """Fit, hold out, and put the result into the model.

    Args:
        model: The model whose parameters the fit replaces.
        dataset: The logs, their efforts already advanced by the model's delay.
        unknowns: What the fit may move.
        weights: (nv,) weight of a squared residual of each joint.
        effective: (nv,) samples that the residuals are worth.
        of_motion: (nv,) share of the squared residual that goes with the motion; none if None.
        delays: Effort delays that the fitted model has.
    """
    problem = fit_problem(dataset, unknowns, weights)
    result = certified(problem, solve_with_fallback(problem))
    held_out = held_out_physical(dataset, unknowns, weights)
    deviations = result.standard_deviations()
    effects = [
        FittedEffect(e, result.x[unknowns.span(e)], deviations[unknowns.span(e)])
        for e in unknowns.effects
    ]
    inertial = len(dataset.bodies) * PARAMETERS_PER_BODY
    fitted = model.with_fit(
        result.x[:inertial].reshape(-1, PARAMETERS_PER_BODY),
        [*effects, *delays],
        information=result.information,
        effort_noise=held_out.rms,
    )
    known = model.information is not None
    shifts = gain_shifts(dataset, unknowns, weights, result, known=known)
    share = np.zeros(len(weights)) if of_motion is None else of_motion
    samples = dataset.samples.sum(axis=0) if effective is None else effective
    off = unexplained_covariance(dataset, unknowns, weights, result, samples * share)
    return ModelFit(fitted, held_out, result, unknowns, shifts, off, share)


def as_it_stands(dataset: Dataset, model: RobotModel) -> HeldOut:
    """Errors of a model on logs without any fit to them.

    Args:
        dataset: The reduced logs.
        model: The model.
    """
    unknowns = model_unknowns(dataset, model)
    x = np.tile(unknowns.mean, (len(dataset.folds), 1))
    return hold_out(dataset, unknowns.columns, x)


def _has_columns(fitted: FittedEffect) -> bool:
    return bool(fitted.effect.parameters)


def effects_of(model: RobotModel) -> tuple[Effect, ...]:
    """The model's effects that have columns."""
    return tuple(f.effect for f in model.effects if _has_columns(f))
