"""Identify a robot model from logs: its inertias near their prior, its effects from the data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import function, instance, instances
from geodrake.effects import Effect, FittedEffect, Role
from geodrake.effects.dependencies import declares_signals
from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification.identify import IdentificationResult, nearest_prior
from geodrake.identification.logs.case import Case, error_table, open_case, reopen
from geodrake.identification.logs.compare import comparison
from geodrake.identification.logs.cross_validation import HeldOut, hold_out
from geodrake.identification.logs.hypothesis import first_hypothesis, settle
from geodrake.identification.logs.log_fits import LogFits, log_unknowns
from geodrake.identification.logs.weighing import Weighing, weigh
from geodrake.identification.models.bodies import (
    block_names,
    body_changes,
    bound_notes,
    boundary_blocks,
    covariance_of,
    model_notes,
    sweep_notes,
)
from geodrake.identification.models.results import (
    Alternative,
    IdentificationSettings,
    ModelIdentification,
)
from geodrake.inertia import PARAMETERS_PER_BODY, is_physical
from geodrake.logs.motion import JointLog
from geodrake.model.holding import holding
from geodrake.model.robot_model import RobotModel

_MOST_ITERATIONS = 10
"""Refits until the weights of the joints stay."""


def identify_model(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    settings: IdentificationSettings | None = None,
    *,
    effects: Sequence[Effect] = (),
    progress: Callable[[str], None] = lambda words: None,
) -> ModelIdentification:
    """Identify the inertial parameters and effects of a model.

    The inertial parameters are regularized towards those of the model. Of its effects, positive
    parameters such as friction and rotor inertias are known to within their own size, by the
    divergence of P(1) that belongs to the regularizer ([Lee2019] Remark 3.13); others and new
    effects are not regularized. A joint's residuals are weighted by its held-out error and reduced
    to effective samples, so that γ weighs d² against the log-likelihood: 1/γ is the variance of d.

    Args:
        model: The model as it stands, which is the prior.
        logs: Logs or their files.
        settings: Regularizer, its weight, and how logs are prepared.
        effects: Effects to fit beside those of the model.
        progress: Called with what is going on, in words.

    Raises:
        ArgumentError: The model has one of the effects already, or a body of it cannot exist.
        LogError: A log cannot be used.
        IdentificationError: No physical parameters reach the residual bound.
    """
    given = IdentificationSettings() if settings is None else settings
    settings = instance(given, "settings", IdentificationSettings)
    function(progress, "progress")
    instance(model, "model", RobotModel)
    _check_prior(model)
    prior = with_effects(model, effects)
    case = open_case(
        prior,
        logs,
        candidates=False,
        bandwidth=settings.bandwidth,
        blocks=settings.blocks,
        hold_resting=settings.hold_resting and settings.total_mass is None,
    )
    if case.model.joints != prior.joints:  # some are held
        held = {joint: case.model.held[joint] for joint in prior.joints if joint in case.model.held}
        model, prior = holding(model, held), case.model
    unknowns = log_unknowns(case.dataset, prior)
    settled = settle(first_hypothesis(case.dataset, unknowns), iterations=_MOST_ITERATIONS)
    fits = LogFits(case.dataset, unknowns, settled.weights, settings.total_mass)
    gamma, sweep = settings.gamma, tuple[Weighing, ...]()
    if settings.residual_ratio is None and gamma is None:
        progress(f"Choosing the weight of the {settings.regularizer} regularizer")
        gamma, sweep = weigh(fits, settings.regularizer)
    result, folds = _solved(fits, settings, gamma)
    if any(_is_friction_by_load(effect) for effect in unknowns.effects):
        # Friction by load was fitted by the prior's loads; now it is by those of the first fit.
        phi = result.phi[: len(prior.phi)]
        case = replace(reopen(case, replace(prior, phi=phi)), model=prior)
        unknowns = log_unknowns(case.dataset, prior)
        fits = replace(fits, dataset=case.dataset, unknowns=unknowns)
        result, folds = _solved(fits, settings, gamma)
    alternatives: tuple[Alternative, ...] = ()
    if settings.compare and np.isfinite(result.gamma):
        progress("Comparing regularizers")
        alternatives = _alternatives(fits, settings.regularizer, result, folds)
    held_out = fits.held_out(folds)
    stands = fits.unknowns.mean.copy()  # the prior's parameters; a new payload is not there yet
    for known in prior.effects:
        if known.effect in unknowns.effects:
            stands[unknowns.span(known.effect)] = known.parameters
    before = hold_out(case.dataset, unknowns.columns, np.tile(stands, (len(fits.folds), 1)))
    fitted = _fitted(fits, result, held_out, prior, case)
    return ModelIdentification(
        fitted,
        model,
        settings.regularizer,
        result.gamma,
        sweep,
        error_table(case.dataset, before),
        error_table(case.dataset, held_out),
        body_changes(fits, result),
        result,
        comparison(case, unknowns, held_out),
        alternatives,
        (
            *case.notes,
            *model_notes(fitted, body_changes(fits, result)),
            *sweep_notes(gamma, sweep),
            *bound_notes(result.gamma),
            *result.fit.notes,
        ),
    )


def with_effects(model: RobotModel, effects: Sequence[Effect]) -> RobotModel:
    """Return the model with further effects whose parameters are zero.

    Raises:
        ArgumentError: The model has one of them already.
    """
    instance(model, "model", RobotModel)
    for effect in (effects := instances(effects, "effects", Effect)):
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


def _is_friction_by_load(effect: Effect) -> bool:
    """Whether an effect is declared to be dry friction that depends on the load."""
    declared = declares_signals(type(effect)) and "load" in effect.depends_on
    return effect.role is Role.FORCE and effect.jumps and declared


def _solved(
    fits: LogFits, settings: IdentificationSettings, gamma: float | None
) -> tuple[IdentificationResult, list[IdentificationResult]]:
    """Return the fits to all and to all but each fold, with one γ or each at its own bound."""
    name, ratio = settings.regularizer, settings.residual_ratio or 1.0

    def solve(without: int | None) -> IdentificationResult:
        bound = ratio**2 * fits.least_residual(without) if gamma is None else None
        certify = without is None
        return fits.solve(name, gamma=gamma, residual_bound=bound, without=without, certify=certify)

    try:
        return solve(None), [solve(f) for f in fits.folds]
    except (IdentificationError, ArgumentError) as error:
        if gamma is None:
            words = ""
            if (least := error.evidence.get("minimum")) is not None:
                reached = np.sqrt(least / fits.least_residual())
                words = f" Physical bodies reach about {reached:.4g}."
            raise IdentificationError(
                f"No physical parameters have an RMS residual within {ratio:g} times the least "
                f"that any parameters reach.{words}",
                advice="Raise the bound, or give gamma instead.",
            ) from error
        if isinstance(error, ArgumentError):
            raise
        blocks = [column // PARAMETERS_PER_BODY for column in error.evidence.get("columns", ())]
        where = f" ({', '.join(block_names(fits)[k] for k in blocks)})" if blocks else ""
        raise IdentificationError(
            f"The {name} regularizer with gamma {gamma:g} leads to no solution that can be "
            f"trusted{where}.",
            advice="Give a larger gamma; check the total mass if one is given.",
        ) from error


def _check_prior(model: RobotModel) -> None:
    wrong = [name for name, ok in zip(model.bodies, is_physical(model.phi), strict=True) if not ok]
    if wrong:
        raise ArgumentError(
            f"The model's inertial parameters of {', '.join(wrong)} are those of no body, so they "
            "cannot be a prior.",
            advice="Load the model from its URDF, SDF or MJCF file, which repairs them; "
            "evidence['nearest'] of this error has the nearest ones.",
            bodies=wrong,
            nearest=nearest_prior(model.phi),
        )


def _alternatives(
    fits: LogFits,
    chosen: str,
    result: IdentificationResult,
    folds: Sequence[IdentificationResult],
) -> tuple[Alternative, ...]:
    """Every regularizer at the training residual of the one chosen, and validated with that γ."""
    found = fits.compare(chosen, result.gamma).results

    def at_same_residual(name: str) -> Alternative:
        own, parts = found[name], list(folds)
        if name != chosen:
            parts = [fits.solve(name, gamma=own.gamma, without=f) for f in fits.folds]
        errors = error_table(fits.dataset, fits.held_out(parts))
        names = block_names(fits)
        boundary = tuple(names[k] for k in boundary_blocks(own.fit))
        nb = len(fits.dataset.bodies)
        return Alternative(name, own.gamma, own.residual, errors, own.phi[:nb], boundary)

    return tuple(at_same_residual(name) for name in found)


def _fitted(
    fits: LogFits,
    result: IdentificationResult,
    held_out: HeldOut,
    prior: RobotModel,
    case: Case,
) -> RobotModel:
    """The model with the result in it."""
    x, information = result.fit.x, result.fit.information
    deviations = np.sqrt(np.diagonal(covariance_of(information)))
    effects = [
        FittedEffect(e, x[fits.unknowns.span(e)], deviations[fits.unknowns.span(e)])
        for e in fits.unknowns.effects
    ]
    delays = [f for f in prior.effects if f.effect.role is Role.DELAY]
    fitted = prior.with_fit(
        x[: prior.phi.size].reshape(prior.phi.shape),
        [*effects, *delays],
        information=information,
        effort_noise=held_out.rms,
    )
    seen = tuple(dict.fromkeys((*prior.fitted_to, *case.fingerprints)))
    return replace(fitted, fitted_to=seen, bandwidths=case.bandwidths)
