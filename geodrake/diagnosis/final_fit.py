"""Final, physically consistent fit of the findings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geodrake.diagnosis.refinements import delays_of, fitted_delays
from geodrake.diagnosis.rest import share_of_motion
from geodrake.diagnosis.search import SearchResult
from geodrake.effects import FittedEffect, Role
from geodrake.identification.logs.case import Case, reduce_fitted
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.hypothesis import CrossValidation, Hypothesis
from geodrake.identification.logs.model_fit import ModelFit, fit_model, model_unknowns
from geodrake.identification.logs.unknowns import Unknowns, effect_prior
from geodrake.model.robot_model import RobotModel


def final_fit(case: Case, result: SearchResult) -> tuple[Case, ModelFit]:
    """Fit the findings with physically consistent bodies and updated loads and delays.

    The case with its columns is returned with the fit.
    """
    search, best = result.model, result.fit
    width, loads = search.likely_priors(best)
    near = search.unbounded(replace(best.choice, width=width), search.shares(best), best.noise)
    end = search.validated(near)
    delays = result.case.model.delays + delays_of(result.model, result.fit)[0]
    lags = fitted_delays(delays, case.model.joints)
    # Compute load-dependent columns with the fitted inertias.
    model, previous = searched_model(result.case.model, end), end.unknowns
    if all(trajectory.is_grounded for trajectory in result.case.trajectories):
        model = _with_gains_of_loads(model)
    companions = _with_companions(previous, result.case.dataset).effects[len(previous.effects) :]
    added = [FittedEffect(effect, np.zeros(1)) for effect in companions]
    reopened = reduce_fitted(result.case, replace(model, effects=(*model.effects, *added, *lags)))
    dataset = reopened.dataset
    unknowns = _with_companions(previous.on(dataset), dataset)
    if case.model.information is None:  # stated effects may be off, even if no log shows it
        stated, others = model_unknowns(dataset, case.model), result.fit.terms
        for effect in {*stated.effects} - {term.effect for term in others}:
            span = stated.span(effect)
            unknowns = unknowns.released(effect, stated.information[span, span], stated.mean[span])
    for effect, (mean, information) in loads.items():
        unknowns = unknowns.released(effect, information, mean)
    # The search's noise excludes errors of gains, so that a wrong gain does not lower a weight.
    noise = np.maximum(search.noise_without_reversals(near), search.floor)
    weights = search.shares(near) / noise
    cv = CrossValidation(dataset, unknowns, weights)
    settled = replace(
        end, dataset=dataset, unknowns=unknowns, weights=weights, delay=cv.delay, cv=cv
    )
    fingerprints = tuple(dict.fromkeys((*case.model.fitted_to, *case.fingerprints)))
    base = replace(reopened.model, effects=case.model.effects, information=case.model.information)
    base = replace(base, phi=case.model.phi, fitted_to=fingerprints, bandwidths=case.bandwidths)
    fit = fit_model(
        base,
        dataset,
        settled.unknowns,
        settled.weights,
        held_out=settled.held_out,
        effective=settled.effective,
        of_motion=share_of_motion(reopened, settled),
        delays=lags,
    )
    return reopened, fit


def searched_model(model: RobotModel, found: Hypothesis) -> RobotModel:
    """Return the model fitted to all data of a hypothesis, without delays."""
    x, unknowns = found.cv.fit_all, found.unknowns
    fitted = [FittedEffect(effect, x[unknowns.span(effect)]) for effect in unknowns.effects]
    phi = x[: model.phi.size].reshape(model.phi.shape)
    return replace(model, phi=phi, effects=tuple(fitted))


def _with_gains_of_loads(model: RobotModel) -> RobotModel:
    """Return a model whose gains apply to loads instead of logged efforts.

    Of an effort (1 + ε) τ, the part x = ε / (1 + ε) is too much.
    """
    effects = [
        replace(f, parameters=f.parameters / (1.0 - f.parameters))
        if f.effect.role is Role.SCALE
        else f
        for f in model.effects
    ]
    return replace(model, effects=tuple(effects))


def _with_companions(unknowns: Unknowns, dataset: Dataset) -> Unknowns:
    """Return unknowns with companions of effects, which are fitted too to avoid bias.

    If viscous friction is not worth a step beside dry friction, for example, leaving it out would
    bias the latter.
    """
    for effect in unknowns.effects:
        kind, effects = effect.companion, unknowns.effects
        offered = kind.shaped(*effect.where) if kind is not None else ()
        for companion in offered:
            if companion not in dataset.effects or companion in effects:
                continue
            mean, information = effect_prior(dataset, companion)
            unknowns = unknowns.with_effect(
                companion, dataset.effect_columns(companion), information, mean
            )
    return unknowns
