"""The last fit: what a search found, physically consistent, ready to be put into the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geodrake.diagnosis.delay import fine_delays, fitted_delays, late_together, seconds_of
from geodrake.diagnosis.pruning import prune
from geodrake.diagnosis.rest import share_of_motion
from geodrake.effects import Effect, FittedEffect, Role
from geodrake.effects.shape import when_sliding
from geodrake.identification.logs.case import Case, reopen
from geodrake.identification.logs.criteria import TIGHTER_PRIORS, Criteria
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.hypothesis import Hypothesis, settle
from geodrake.identification.logs.model_fit import ModelFit, effects_of, fit_model
from geodrake.identification.logs.unknowns import Unknowns, effect_prior
from geodrake.model.robot_model import RobotModel

_MOST_ITERATIONS = 10
"""Refits until the weights stay: a prior from another fit gives way step by step."""


def final_fit(
    case: Case,
    end: Hypothesis,
    *,
    criteria: Criteria | None = None,
    kept: Sequence[Effect] = (),
) -> tuple[Case, ModelFit, Hypothesis]:
    """The physically consistent fit of what was found, loads and delay brought up to date.

    Args:
        case: The case.
        end: What was found.
        criteria: Drop effects that do not meet these once the loads are those of the fitted model,
            and fit companions beside the effects that have them (`with_companions`); None to fit
            exactly what is given.
        kept: Effects that are not dropped.

    Returns:
        The case with the columns of the fit, the fit, and `end` less the effects dropped.
    """
    delays = [f for f in case.model.effects if f.effect.role is Role.DELAY]
    if late := late_together(seconds_of(end)):
        found = case.model.delays + fine_delays(end, late)[0]
        delays = fitted_delays(found, case.model.joints)
    reopened = _with_fitted_loads(case, end, delays, companions=criteria is not None)
    settled = end.moved(reopened.dataset, delay=0, iterations=_MOST_ITERATIONS)
    if criteria is not None:
        episodes = [e for e in settled.unknowns.effects if e.role is Role.EPISODE]
        settled = prune(settled, [*effects_of(case.model), *episodes, *kept], criteria)
        left = settled.unknowns.effects
        end = end.without([e for e in end.unknowns.effects if e not in left])
        settled = replace(settled, unknowns=with_companions(settled.unknowns, reopened.dataset))
        settled = settle(settled, iterations=_MOST_ITERATIONS)
    seen = tuple(dict.fromkeys((*case.model.fitted_to, *case.fingerprints)))
    base = replace(case.model, fitted_to=seen, bandwidths=case.bandwidths)
    # Weights of maximum likelihood, so that the information is that of the parameters.
    held_out = settled.held_out
    weights = settled.effective / held_out.samples.sum(0) / held_out.mse
    unknowns = freed(settled).unknowns
    alarm = (criteria or Criteria()).alarm
    share = share_of_motion(reopened, settled, alarm=alarm)
    fit = fit_model(
        base,
        reopened.dataset,
        unknowns,
        weights,
        effective=settled.effective,
        of_motion=share,
        delays=delays,
    )
    return reopened, fit, end


def freed(hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis with inertias as free as those that are well known, where they are fixed.

    To hold the inertias, as a search may do, does not make them known.
    """
    least = min(TIGHTER_PRIORS)
    if hypothesis.looseness >= least:
        return hypothesis
    return hypothesis.loosened(least / hypothesis.looseness)


def _with_fitted_loads(
    case: Case, end: Hypothesis, delays: Sequence[FittedEffect], *, companions: bool
) -> Case:
    """The case with the columns of what was found, load-dependent ones by the fitted inertias."""
    model, found = searched_model(case, end), end.unknowns
    more = with_companions(found, case.dataset).effects[len(found.effects) :] if companions else ()
    fitted = [FittedEffect(effect, np.zeros(1)) for effect in more]
    return reopen(case, replace(model, effects=(*model.effects, *fitted, *delays)))


def searched_model(case: Case, found: Hypothesis) -> RobotModel:
    """The model by all data of a hypothesis, as it is while a search lasts; delays left aside.

    Args:
        case: The case.
        found: The hypothesis.
    """
    x, unknowns = found.cv.fit_all(), found.unknowns
    fitted = [FittedEffect(effect, x[unknowns.span(effect)]) for effect in unknowns.effects]
    phi = x[: case.model.phi.size].reshape(case.model.phi.shape)
    return replace(case.model, phi=phi, effects=tuple(fitted))


def with_companions(unknowns: Unknowns, dataset: Dataset) -> Unknowns:
    """The companions of effects, so that neither stands in for the other in a fit.

    Where dry friction was found and viscous friction was not worth a step, the viscous one is
    fitted along all the same: left out, it would bias the dry one by all that it may be.

    Args:
        unknowns: What the final fit may move.
        dataset: The reduced logs.
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


def companion_notes(found: Unknowns, fit: ModelFit) -> list[str]:
    """What was fitted along without being a step, in words.

    Args:
        found: The unknowns of the search.
        fit: The final fit, with the companions.
    """
    added = [f for f in fit.model.effects if f.effect not in found.effects and len(f.parameters)]
    sliding = set(fit.model.sliding_joints)
    notes = []
    for fitted in added:
        unit = fitted.effect.parameters[0].unit
        unit = when_sliding(unit) if sliding.issuperset(fitted.effect.where) else unit
        notes.append(
            f"{fitted.effect.name.replace('_', ' ')} of {fitted.effect.place} was fitted along, "
            f"though not worth a step: {fitted.parameters[0]:.3g} {unit}"
        )
    return notes
