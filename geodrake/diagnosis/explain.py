"""The loop: compare, diagnose, add, until only noise is left or nothing explains the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.case import Case, error_table, open_case, reopen
from geodrake.diagnosis.compare import comparison
from geodrake.diagnosis.delay import fine_delay
from geodrake.diagnosis.evidence import Criteria
from geodrake.diagnosis.forward import Progress, Trail, search
from geodrake.diagnosis.hypothesis import Hypothesis, first_hypothesis, settle
from geodrake.diagnosis.results import ErrorTable, Explanation, Verdict
from geodrake.diagnosis.steps import steps_of
from geodrake.effects import CoulombFriction, EffortDelay, ViscousFriction
from geodrake.effects.base import Effect
from geodrake.identification.dataset import Dataset
from geodrake.identification.model_fit import ModelFit, effects_of, fit_model, model_unknowns
from geodrake.identification.reduce import reduce_logs
from geodrake.identification.unknowns import Unknowns, effect_prior
from geodrake.model import FittedEffect, RobotModel
from geodrake.motion import JointLog

Array = NDArray[np.float64]

NOISE_MARGIN = 1.25
"""Errors up to this many times the noise floor count as noise."""


def explain(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    extra: Sequence[type[Effect]] = (),
    bandwidth: float | None = None,
    blocks: int | None = None,
    criteria: Criteria | None = None,
    progress: Progress | None = None,
) -> Explanation:
    """Find what a model lacks, add it, refit, and repeat to the floor.

    Args:
        model: The model as it stands.
        logs: Logs or their files; several logs are several trajectories.
        extra: Effect classes of the user's own to try beside the catalogue's.
        bandwidth: Bandwidth of the filter, Hz; by default chosen from the data.
        blocks: Blocks into which every log is cut for validation.
        criteria: When an effect counts as found.
        progress: Told about each step, in words and with the held-out nrms.

    Returns:
        The steps with held-out errors before and after, and the final model.

    Raises:
        LogError: A log cannot be used.
    """
    criteria = criteria or Criteria()
    case = open_case(model, logs, candidates=True, extra=extra, bandwidth=bandwidth, blocks=blocks)
    before = comparison(case)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    tune = model.information is None
    trail = search(
        start, effects_of(model), criteria, tune=tune, pause_at_delay=True, progress=progress
    )
    if trail.end.delay != trail.start.delay:
        case, trail = with_exact_delay(case, trail)
        more = search(trail.end, effects_of(model), criteria, tune=tune, progress=progress)
        trail = Trail(trail.start, more.end, {**more.rivals, **trail.rivals})
    after_case, fit = final_fit(case, trail.end)
    steps = steps_of(case, trail, fit)
    after = comparison(after_case, fit.unknowns, fit.held_out)
    end = after.errors if steps else before.errors
    return Explanation(
        verdict_of(end, bool(steps)),
        steps,
        before.errors,
        error_table(case.dataset, start.held_out),
        end,
        fit.model,
        before,
        after if steps else before,
        (*case.notes, *_companion_notes(trail.end.unknowns, fit)),
    )


def with_exact_delay(case: Case, trail: Trail) -> tuple[Case, Trail]:
    """The case with its efforts advanced by the delay that was found, and the trail carried over.

    A delay that is off by a part of the grid's step would look like further effects.
    """
    delay = fine_delay(trail.end)[0]
    step = abs(case.dataset.delays[1])
    lag = FittedEffect(EffortDelay(case.model.delay + delay), np.empty(0), np.empty(0))
    kept = [f for f in case.model.effects if not isinstance(f.effect, EffortDelay)]
    model = replace(case.model, effects=(*kept, lag))
    dataset = reduce_logs(
        model,
        case.trajectories,
        case.folds,
        effects=case.dataset.effects,
        delays=(0.0, -delay, 0.5 * step, -0.5 * step),
    )
    start = settle(replace(trail.start, dataset=dataset, delay=1))
    end = settle(replace(trail.end, dataset=dataset, delay=0))
    return replace(case, model=model, dataset=dataset), Trail(start, end, trail.rivals)


def final_fit(case: Case, end: Hypothesis, *, companions: bool = True) -> tuple[Case, ModelFit]:
    """The physically consistent fit of what a search found, loads and delay brought up to date.

    Args:
        case: The case.
        end: What was found.
        companions: Whether viscous friction is fitted beside dry friction; see `with_companions`.
    """
    delay = fine_delay(end)[0] if end.delay else 0.0
    delays = [f for f in case.model.effects if isinstance(f.effect, EffortDelay)]
    if delay:
        delays = [FittedEffect(EffortDelay(case.model.delay + delay), np.empty(0), np.empty(0))]
    x, found = end.cv.fit_all(), end.unknowns
    unknowns = with_companions(found, case.dataset) if companions else found
    fitted = [FittedEffect(effect, x[found.span(effect)]) for effect in found.effects]
    fitted += [FittedEffect(e, np.zeros(1)) for e in unknowns.effects[len(found.effects) :]]
    phi = x[: case.model.phi.size].reshape(case.model.phi.shape)
    provisional = replace(case.model, phi=phi, effects=(*fitted, *delays))
    reopened = reopen(case, provisional)
    columns = np.concatenate(
        [np.arange(10 * len(case.model.bodies))]
        + [reopened.dataset.effect_columns(effect) for effect in unknowns.effects]
    )
    unknowns = replace(unknowns, columns=columns)
    settled = settle(replace(end, dataset=reopened.dataset, unknowns=unknowns, delay=0))
    seen = tuple(dict.fromkeys((*case.model.fitted_to, *case.fingerprints)))
    base = replace(case.model, fitted_to=seen)
    fit = fit_model(base, reopened.dataset, unknowns, settled.weights, delays=delays)
    return reopened, fit


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


def _companion_notes(found: Unknowns, fit: ModelFit) -> list[str]:
    added = [f for f in fit.model.effects if f.effect not in found.effects and len(f.parameters)]
    return [
        f"viscous friction of {f.effect.where[0]} was fitted along, though not worth a step: "
        f"{f.parameters[0]:.3g} N·m·s/rad"
        for f in added
    ]


def verdict_of(errors: ErrorTable, found: bool) -> Verdict:
    """What an end result amounts to."""
    if errors.nrms > NOISE_MARGIN * errors.floor_nrms:
        return "unexplained"
    return "explained" if found else "adequate"
