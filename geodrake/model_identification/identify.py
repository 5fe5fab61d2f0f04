"""Identify a robot model from logs: its inertias near their prior, its effects from the data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from geodrake.diagnosis.case import Case, error_table, open_case
from geodrake.diagnosis.compare import comparison
from geodrake.diagnosis.hypothesis import first_hypothesis, settle
from geodrake.effects import Effect, EffortDelay
from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification import REGULARIZERS, IdentificationResult
from geodrake.identification.cross_validation import HeldOut, hold_out
from geodrake.identification.log_fits import LogFits, log_unknowns
from geodrake.identification.weighing import Weighing, weigh
from geodrake.inertia import PARAMETERS_PER_BODY, Array, to_mass_com_inertia
from geodrake.model import FittedEffect, RobotModel
from geodrake.model_identification.results import (
    Alternative,
    BodyChange,
    IdentificationSettings,
    ModelIdentification,
)
from geodrake.motion import JointLog

_MOST_ITERATIONS = 10
"""Refits until the weights of the joints stay."""

_NOTABLY = 0.95
"""Ratio of held-out errors below which a weaker weight is worth a word."""

_FAR = 2.0
"""Factor of a mass from which on a body's change is worth a word."""

FRICTIONS = ("viscous_friction", "coulomb_friction")
"""Effects that a real robot is hardly without; inertias that lack them stand in for them."""


def identify_model(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    settings: IdentificationSettings | None = None,
    *,
    effects: Sequence[Effect] = (),
    tell: Callable[[str], None] = lambda words: None,
) -> ModelIdentification:
    """Identify the inertial parameters and effects of a model.

    The inertial parameters are regularized towards those of the model; effects are not, whatever
    was known about them. A joint's residuals are weighted by its held-out error and reduced to
    effective samples, so that γ weighs d² against the log-likelihood: 1/γ is the variance of d.

    Args:
        model: The model as it stands, which is the prior.
        logs: Logs or their files.
        settings: Regularizer, its weight, and how logs are prepared.
        effects: Effects to fit beside those of the model.
        tell: Called with what is going on, in words.

    Returns:
        The fitted model, held-out errors before and after, and what became of every body.

    Raises:
        ArgumentError: The model has one of the effects already.
        LogError: A log cannot be used.
        IdentificationError: No physical parameters reach the residual bound.
    """
    settings = settings or IdentificationSettings()
    prior = with_effects(model, effects)
    case = open_case(
        prior, logs, candidates=False, bandwidth=settings.bandwidth, blocks=settings.blocks
    )
    unknowns = log_unknowns(case.dataset, prior)
    settled = settle(first_hypothesis(case.dataset, unknowns), iterations=_MOST_ITERATIONS)
    fits = LogFits(case.dataset, unknowns, settled.weights)
    gamma, sweep = settings.gamma, tuple[Weighing, ...]()
    if settings.residual_ratio is not None:
        result, folds = _bounded(fits, settings)
    else:
        if gamma is None:
            tell(f"Choosing the weight of the {settings.regularizer} regularizer")
            gamma, sweep = weigh(fits, settings.regularizer)
        result = fits.solve(settings.regularizer, gamma=gamma)
        folds = [fits.solve(settings.regularizer, gamma=gamma, without=f) for f in fits.folds]
    alternatives: tuple[Alternative, ...] = ()
    if settings.compare:
        tell("Comparing regularizers")
        alternatives = _alternatives(fits, settings.regularizer, result, folds)
    held_out = fits.held_out(folds)
    stands = np.tile(_as_it_came(fits, prior), (len(fits.folds), 1))
    fitted = _fitted(fits, result, held_out, prior, case)
    return ModelIdentification(
        fitted,
        model,
        settings.regularizer,
        result.gamma,
        sweep,
        error_table(case.dataset, hold_out(case.dataset, unknowns.columns, stands)),
        error_table(case.dataset, held_out),
        _bodies(fits, result),
        result,
        comparison(case, unknowns, held_out),
        alternatives,
        (*case.notes, *_notes(fitted, _bodies(fits, result)), *_sweep_notes(gamma, sweep)),
    )


def with_effects(model: RobotModel, effects: Sequence[Effect]) -> RobotModel:
    """The model with further effects whose parameters are zero.

    Raises:
        ArgumentError: The model has one of them already.
    """
    for effect in effects:
        if any(
            (f.effect.name, f.effect.where) == (effect.name, effect.where) for f in model.effects
        ):
            raise ArgumentError(
                f"The model has {effect.name} at {', '.join(effect.where)} already.",
                advice="It is fitted without being asked for.",
            )
    added = [FittedEffect(effect, np.zeros(len(effect.parameters))) for effect in effects]
    if not added:
        return model
    return replace(model, effects=(*model.effects, *added), information=None)


def _as_it_came(fits: LogFits, prior: RobotModel) -> Array:
    """(p,) the prior's parameters, a payload that is new not being there."""
    x = fits.unknowns.mean.copy()
    for fitted in prior.effects:
        if fitted.effect in fits.unknowns.effects:
            x[fits.unknowns.span(fitted.effect)] = fitted.parameters
    return x


def _bounded(
    fits: LogFits, settings: IdentificationSettings
) -> tuple[IdentificationResult, list[IdentificationResult]]:
    """The fits to all and to all but each fold, each at its own bound."""
    ratio = settings.residual_ratio or 1.0

    def solve(without: int | None) -> IdentificationResult:
        bound = ratio**2 * fits.least_residual(without)
        return fits.solve(settings.regularizer, residual_bound=bound, without=without)

    try:
        return solve(None), [solve(f) for f in fits.folds]
    except IdentificationError as error:
        raise IdentificationError(
            f"No physical parameters have an RMS residual within {ratio:g} times the least that "
            "any parameters reach.",
            advice="Raise the bound, or give gamma instead.",
        ) from error


def _alternatives(
    fits: LogFits,
    chosen: str,
    result: IdentificationResult,
    folds: Sequence[IdentificationResult],
) -> tuple[Alternative, ...]:
    """Every regularizer at the training residual of the one chosen, and held out with that γ."""

    def at_same_residual(name: str) -> Alternative:
        own, parts = result, list(folds)
        if name != chosen:
            own = fits.solve_at(name, result.residual)
            parts = [fits.solve(name, gamma=own.gamma, without=f) for f in fits.folds]
        errors = error_table(fits.dataset, fits.held_out(parts))
        names = _block_names(fits)
        boundary = tuple(names[k] for k in _boundary_blocks(own))
        nb = len(fits.dataset.bodies)
        return Alternative(name, own.gamma, own.residual, errors, own.phi[:nb], boundary)

    return tuple(at_same_residual(name) for name in REGULARIZERS)


def _fitted(
    fits: LogFits,
    result: IdentificationResult,
    held_out: HeldOut,
    prior: RobotModel,
    case: Case,
) -> RobotModel:
    """The model with the result in it."""
    x, information = fits.parameters(result), fits.information(result)
    deviations = np.sqrt(np.diagonal(_covariance(information)))
    effects = [
        FittedEffect(e, x[fits.unknowns.span(e)], deviations[fits.unknowns.span(e)])
        for e in fits.unknowns.effects
    ]
    delays = [f for f in prior.effects if isinstance(f.effect, EffortDelay)]
    fitted = prior.with_fit(
        x[: prior.phi.size].reshape(prior.phi.shape),
        [*effects, *delays],
        information=information,
        effort_noise=held_out.rms,
    )
    seen = tuple(dict.fromkeys((*prior.fitted_to, *case.fingerprints)))
    return replace(fitted, fitted_to=seen)


def _bodies(fits: LogFits, result: IdentificationResult) -> tuple[BodyChange, ...]:
    covariance = _covariance(result.fit.information)
    boundary = _boundary_blocks(result)
    changes = []
    for k, (name, before, after) in enumerate(
        zip(_block_names(fits), fits.prior, result.phi, strict=True)
    ):
        start = k * PARAMETERS_PER_BODY
        block = covariance[start : start + 4, start : start + 4]
        (m0, m1), com, _ = to_mass_com_inertia(np.stack([before, after]))
        jacobian = np.hstack([-com[1][:, None], np.eye(3)]) / m1  # of h/m by [m, h]
        spread = np.sqrt(np.einsum("ij,jk,ik->i", jacobian, block, jacobian))
        deviation = float(np.sqrt(block[0, 0]))
        changes.append(
            BodyChange(name, (float(m0), float(m1)), com, deviation, spread, k in boundary)
        )
    return tuple(changes)


def _covariance(information: Array) -> Array:
    """Inverse of an information matrix, whatever the units of its parameters."""
    size = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    values = np.maximum(values, np.finfo(float).eps * values[-1])
    return np.asarray((vectors / values) @ vectors.T / np.outer(size, size))


def _block_names(fits: LogFits) -> tuple[str, ...]:
    payloads = [e for e in fits.unknowns.effects if e.name == "payload"]
    return (*fits.dataset.bodies, *(f"payload on {e.where[0]}" for e in payloads))


def _boundary_blocks(result: IdentificationResult) -> set[int]:
    return {start // PARAMETERS_PER_BODY for start in result.fit.active_blocks}


def _notes(model: RobotModel, bodies: Sequence[BodyChange]) -> list[str]:
    notes = []
    if not any("friction" in fitted.effect.name for fitted in model.effects):
        notes.append(
            "the model has no friction, so inertias stand in for it as far as they can: fit some "
            f"beside them (--effects {','.join(FRICTIONS)}), or let geodrake explain find which"
        )
    far = [
        f"{body.name} {body.mass[0]:.3g} → {body.mass[1]:.3g} kg"
        for body in bodies
        if not 1 / _FAR < body.mass[1] / body.mass[0] < _FAR
    ]
    if far:
        notes.append(
            f"masses far from the prior ({', '.join(far)}): unless the prior is that wrong, the "
            "model lacks an effect that inertias stand in for, which geodrake diagnose looks for; "
            "a larger gamma holds them"
        )
    return notes


def _sweep_notes(gamma: float | None, sweep: Sequence[Weighing]) -> list[str]:
    """That a weaker weight than one is let choose would fit better."""
    chosen = [tried.nrms for tried in sweep if tried.gamma == gamma]
    weaker = [tried for tried in sweep if gamma is not None and tried.gamma < gamma]
    best = min(weaker, key=lambda tried: tried.nrms, default=None)
    if best is None or not chosen or best.nrms > _NOTABLY * chosen[0]:
        return []
    return [
        f"gamma {best.gamma:.3g} would lower the held-out nrms to {best.nrms:.3f}, by inertias "
        "that lie further from the prior than a model file usually errs: the model more likely "
        "lacks an effect, which geodrake diagnose looks for"
    ]
