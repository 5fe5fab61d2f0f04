"""The loop: compare, diagnose, add, until only noise is left or nothing explains the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.case import Case, error_table, open_case
from geodrake.diagnosis.compare import comparison
from geodrake.diagnosis.delay import fine_delay
from geodrake.diagnosis.evidence import Criteria
from geodrake.diagnosis.final_fit import companion_notes, final_fit
from geodrake.diagnosis.forward import Progress, Trail, search
from geodrake.diagnosis.hypothesis import first_hypothesis, settle
from geodrake.diagnosis.results import ErrorTable, Explanation, Verdict
from geodrake.diagnosis.steps import refit_step, steps_of
from geodrake.effects import EffortDelay
from geodrake.effects.base import Effect
from geodrake.identification.model_fit import effects_of, model_unknowns
from geodrake.identification.reduce import reduce_logs
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
        step = abs(case.dataset.delays[1])
        case, trail = with_exact_delay(case, trail, origin=model.delay, step=step)
        more = search(trail.end, effects_of(model), criteria, tune=tune, progress=progress)
        trail = Trail(trail.start, more.end, {**more.rivals, **trail.rivals})
        case, trail = with_exact_delay(case, trail, origin=model.delay, step=0.5 * step)
    after_case, fit, end = final_fit(case, trail.end, criteria=criteria)
    trail = replace(trail, end=end)
    steps = steps_of(case, trail, fit) or refit_step(case, start, fit, criteria)
    after = comparison(after_case, fit.unknowns, fit.held_out)
    errors = after.errors if steps else before.errors
    return Explanation(
        verdict_of(errors, bool(steps)),
        steps,
        before.errors,
        error_table(case.dataset, start.held_out),
        errors,
        fit.model if steps else model,
        before,
        after if steps else before,
        (*case.notes, *(companion_notes(trail.end.unknowns, fit) if steps else ())),
    )


def with_exact_delay(case: Case, trail: Trail, *, origin: float, step: float) -> tuple[Case, Trail]:
    """The case with its efforts advanced by the delay that was found, and the trail carried over.

    A delay that is off by a part of the grid's step would look like further effects.

    Args:
        case: The case, its dataset with delays around that of the trail's end.
        trail: A search that found a delay.
        origin: Delay of the model before the search, s: where the trail starts.
        step: Step of the grid of delays, s; the next grid has half of it.
    """
    delay = case.model.delay + fine_delay(trail.end)[0]
    lag = FittedEffect(EffortDelay(delay), np.empty(0), np.empty(0))
    kept = [f for f in case.model.effects if not isinstance(f.effect, EffortDelay)]
    model = replace(case.model, effects=(*kept, lag))
    dataset = reduce_logs(
        model,
        case.trajectories,
        case.folds,
        effects=case.dataset.effects,
        delays=(0.0, origin - delay, 0.5 * step, -0.5 * step),
    )
    start = settle(replace(trail.start, dataset=dataset, delay=1))
    end = settle(replace(trail.end, dataset=dataset, delay=0))
    return replace(case, model=model, dataset=dataset), Trail(start, end, trail.rivals)


def verdict_of(errors: ErrorTable, found: bool) -> Verdict:
    """What an end result amounts to."""
    if errors.nrms > NOISE_MARGIN * errors.floor_nrms:
        return "unexplained"
    return "explained" if found else "adequate"
