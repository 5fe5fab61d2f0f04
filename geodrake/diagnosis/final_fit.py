"""The final fit of the effects that were found, physically consistent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geodrake.diagnosis.refinements import delays_of, fitted_delays
from geodrake.diagnosis.rest import share_of_motion
from geodrake.diagnosis.search import Found
from geodrake.effects import FittedEffect, Role
from geodrake.identification.logs.case import Case, reduce_fitted
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.hypothesis import CrossValidation, Hypothesis
from geodrake.identification.logs.model_fit import ModelFit, fit_model, model_unknowns
from geodrake.identification.logs.unknowns import Unknowns, effect_prior
from geodrake.model.robot_model import RobotModel


def final_fit(case: Case, found: Found) -> tuple[Case, ModelFit]:
    """Fit the effects that were found, physically consistent, with updated loads and delays.

    Returned with the fit is the case with its columns.
    """
    search, was = found.model, found.fit
    width, loads = search.likely_priors(was)
    near = search.unbounded(replace(was.choice, width=width), search.shares(was), was.noise)
    end = search.validated(near)
    delays = found.case.model.delays + delays_of(found.model, found.fit)[0]
    lags = fitted_delays(delays, case.model.joints)
    # With load-dependent columns by the fitted inertias.
    model, known = searched_model(found.case.model, end), end.unknowns
    if all(trajectory.is_grounded for trajectory in found.case.trajectories):
        model = _with_gains_of_loads(model)
    more = _with_companions(known, found.case.dataset).effects[len(known.effects) :]
    beside = [FittedEffect(effect, np.zeros(1)) for effect in more]
    reopened = reduce_fitted(found.case, replace(model, effects=(*model.effects, *beside, *lags)))
    dataset = reopened.dataset
    unknowns = _with_companions(known.on(dataset), dataset)
    if case.model.information is None:  # what no log shows to be another may be off all the same
        stated, others = model_unknowns(dataset, case.model), found.fit.terms
        for effect in {*stated.effects} - {term.effect for term in others}:
            span = stated.span(effect)
            unknowns = unknowns.released(effect, stated.information[span, span], stated.mean[span])
    for effect, (mean, information) in loads.items():
        unknowns = unknowns.released(effect, information, mean)
    # The search's noise has no errors of gains, so that a joint whose gain is off keeps its weight.
    weights = search.shares(near) / np.maximum(search.seen_noise(near), search.floor)
    cv = CrossValidation(dataset, unknowns, weights)
    settled = replace(
        end, dataset=dataset, unknowns=unknowns, weights=weights, delay=cv.delay, cv=cv
    )
    seen = tuple(dict.fromkeys((*case.model.fitted_to, *case.fingerprints)))
    base = replace(reopened.model, effects=case.model.effects, information=case.model.information)
    base = replace(base, phi=case.model.phi, fitted_to=seen, bandwidths=case.bandwidths)
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

    Of an effort (1 + ε) τ the part x = ε / (1 + ε) is too much.
    """
    effects = [
        replace(f, parameters=f.parameters / (1.0 - f.parameters))
        if f.effect.role is Role.SCALE
        else f
        for f in model.effects
    ]
    return replace(model, effects=tuple(effects))


def _with_companions(unknowns: Unknowns, dataset: Dataset) -> Unknowns:
    """Return companions of effects, which are fitted with them to avoid bias.

    Where dry friction was found and viscous friction was not worth a step, the viscous one is
    fitted along all the same: left out, it would bias the dry one by all that it may be.
    """
    for effect in unknowns.effects:
        kind, present = effect.companion, unknowns.effects
        offered = kind.shaped(*effect.where) if kind is not None else ()
        for companion in offered:
            if companion not in dataset.effects or companion in present:
                continue
            mean, information = effect_prior(dataset, companion)
            unknowns = unknowns.with_effect(
                companion, dataset.effect_columns(companion), information, mean
            )
    return unknowns
