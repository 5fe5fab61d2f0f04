"""The last fit: what a search found, physically consistent, ready to be put into the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geodrake.diagnosis.case import Case, reopen
from geodrake.diagnosis.delay import fine_delays, fitted_delays, late_together, seconds_of
from geodrake.diagnosis.evidence import Criteria
from geodrake.diagnosis.forward import TIGHTER_PRIORS
from geodrake.diagnosis.hypothesis import Hypothesis, settle
from geodrake.diagnosis.refine import prune
from geodrake.effects import Contact, CoulombFriction, EffortDelay, ViscousFriction
from geodrake.effects.base import Effect
from geodrake.identification.dataset import Dataset
from geodrake.identification.model_fit import ModelFit, effects_of, fit_model
from geodrake.identification.unknowns import Unknowns, effect_prior
from geodrake.model import FittedEffect

_MOST_ITERATIONS = 10
"""Refits until weights stay: a prior from another fit gives way step by step."""


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
            and fit viscous friction beside dry friction (`with_companions`); None to fit exactly
            what is given.
        kept: Effects that are not dropped.

    Returns:
        The case with the columns of the fit, the fit, and `end` less the effects dropped.
    """
    delays = [f for f in case.model.effects if isinstance(f.effect, EffortDelay)]
    if late := late_together(seconds_of(end)):
        found = case.model.delays + fine_delays(end, late)[0]
        delays = fitted_delays(found, case.model.joints)
    reopened = _with_fitted_loads(case, end, delays, companions=criteria is not None)
    settled = end.moved(reopened.dataset, delay=0, iterations=_MOST_ITERATIONS)
    if criteria is not None:
        episodes = [e for e in settled.unknowns.effects if isinstance(e, Contact)]
        settled = prune(settled, [*effects_of(case.model), *episodes, *kept], criteria)
        left = settled.unknowns.effects
        end = end.without([e for e in end.unknowns.effects if e not in left])
        settled = replace(settled, unknowns=with_companions(settled.unknowns, reopened.dataset))
        settled = settle(settled, iterations=_MOST_ITERATIONS)
    seen = tuple(dict.fromkeys((*case.model.fitted_to, *case.fingerprints)))
    base = replace(case.model, fitted_to=seen)
    # Weights of maximum likelihood, so that the information is that of the parameters.
    held_out = settled.held_out
    weights = settled.effective / held_out.samples.sum(0) / held_out.mse
    unknowns = not_held(settled).unknowns
    fit = fit_model(base, reopened.dataset, unknowns, weights, delays=delays)
    return reopened, fit, end


def not_held(hypothesis: Hypothesis) -> Hypothesis:
    """The hypothesis with inertias as free as those that are well known, where they are held.

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
    x, found = end.cv.fit_all(), end.unknowns
    fitted = [FittedEffect(effect, x[found.span(effect)]) for effect in found.effects]
    if companions:
        more = with_companions(found, case.dataset).effects[len(found.effects) :]
        fitted += [FittedEffect(effect, np.zeros(1)) for effect in more]
    phi = x[: case.model.phi.size].reshape(case.model.phi.shape)
    return reopen(case, replace(case.model, phi=phi, effects=(*fitted, *delays)))


def with_companions(unknowns: Unknowns, dataset: Dataset) -> Unknowns:
    """Viscous friction beside dry friction, so that neither stands in for the other in a fit.

    Where dry friction was found and viscous friction was not worth a step, the viscous one is
    fitted along all the same: left out, it would bias the dry one by all that it may be.
    """
    for effect in unknowns.effects:
        companion = (
            ViscousFriction(effect.where[0]) if isinstance(effect, CoulombFriction) else None
        )
        if companion in dataset.effects and companion not in unknowns.effects:
            mean, information = effect_prior(dataset, companion)
            unknowns = unknowns.with_effect(
                companion, dataset.effect_columns(companion), information, mean
            )
    return unknowns


def companion_notes(found: Unknowns, fit: ModelFit) -> list[str]:
    """What was fitted along without being a step, in words."""
    added = [f for f in fit.model.effects if f.effect not in found.effects and len(f.parameters)]
    sliding = fit.model.sliding_joints
    return [
        f"viscous friction of {f.effect.where[0]} was fitted along, though not worth a step: "
        f"{f.parameters[0]:.3g} {'N·s/m' if f.effect.where[0] in sliding else 'N·m·s/rad'}"
        for f in added
    ]
