"""The loop: compare, diagnose, add, until only noise is left or nothing explains the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import function, instance
from geodrake.boundary.showing import Short
from geodrake.diagnosis.final_fit import companion_notes, final_fit, freed
from geodrake.diagnosis.fixed_inertias import FixedInertias, with_fixed_inertias
from geodrake.diagnosis.judgement import judge_errors
from geodrake.diagnosis.other_bandwidth import (
    OtherBandwidth,
    errors_at,
    errors_of,
    other_bandwidths,
)
from geodrake.diagnosis.results import Explanation, Step, Verdict
from geodrake.diagnosis.search_progress import FoundStep, Progress
from geodrake.diagnosis.search_rounds import searched
from geodrake.diagnosis.stated_mass import stated_mass_notes
from geodrake.diagnosis.steps import refit_step, steps_of, with_likelier_rival, without_step
from geodrake.diagnosis.stepwise_search import Trail
from geodrake.diagnosis.transition_speed import transition_speed_notes
from geodrake.effects import Effect, Role
from geodrake.effects.lookup import effect_of
from geodrake.errors import IdentificationError
from geodrake.identification.logs.case import Case, at_bandwidth, error_table, open_case
from geodrake.identification.logs.compare import comparison
from geodrake.identification.logs.criteria import Criteria
from geodrake.identification.logs.hypothesis import Hypothesis, first_hypothesis
from geodrake.identification.logs.model_errors import ErrorTable
from geodrake.identification.logs.model_fit import ModelFit, effects_of, model_unknowns
from geodrake.identification.models.bodies import changed_bodies, common_factor_notes
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel

_STOPPED = "interrupted before the search had ended: there may be more to find, or other rivals"


@dataclass(frozen=True, eq=False)
class Investigation(Short):
    """An explanation, and what it rests on.

    Attributes:
        explanation: The explanation.
        case: The case, with the columns of what was found.
        hypothesis: What was found, fitted fold by fold to that case.
    """

    explanation: Explanation
    case: Case
    hypothesis: Hypothesis


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

    Columns are taken at their word: `check_columns` tells of those that are not what they seem.

    Args:
        model: The model as it stands.
        logs: Logs or their files; several logs are several trajectories.
        extra: Effect classes of the user's own to try beside the catalogue's.
        bandwidth: Bandwidth of the filter, Hz; by default that of the model's fit to the same logs,
            or chosen from the data; another one where play or a soft joint shows only there (a
            note says so).
        blocks: Blocks into which every log is cut for validation.
        criteria: When an effect counts as found.
        progress: Called with each `FoundStep`. It may raise `StopSearch`, as a handler of signals
            may: the steps found by then are the result, which says so.

    Returns:
        The steps with held-out errors before and after, and the final model.

    Raises:
        LogError: A log cannot be used.
        ArgumentError: There is no log, or a setting is no usable number.
    """
    if progress is not None:
        function(progress, "progress")
    if criteria is not None:
        instance(criteria, "criteria", Criteria)
    case = open_case(model, logs, candidates=True, extra=extra, bandwidth=bandwidth, blocks=blocks)
    return investigate(case, criteria=criteria, progress=progress).explanation


def investigate(
    case: Case, *, criteria: Criteria | None = None, progress: Progress | None = None
) -> Investigation:
    """Explain a case that has columns for candidates; see `explain`.

    Args:
        case: Prepared logs and the model, with columns for candidates.
        criteria: When an effect counts as found.
        progress: Called with each step.
    """
    criteria = Criteria() if criteria is None else instance(criteria, "criteria", Criteria)
    found = _investigated(case, criteria, progress)
    if found.explanation.is_interrupted:
        return found
    explained = found.explanation.verdict != "unexplained"
    for other in other_bandwidths(found.case, found.hypothesis, criteria, explained=explained):
        how = f"at which {other.effect.name} shows"
        there = at_bandwidth(case, other.bandwidth, candidates=True, how=how)
        again = _investigated(there, criteria, None)
        if _explains_more(again, found, other, criteria):
            if progress is not None:
                progress(_step_at(again.explanation, found.explanation, other))
            return _with_bandwidth_notes(again, found)
    return found


def _step_at(after: Explanation, before: Explanation, other: OtherBandwidth) -> FoundStep:
    """The step to another bandwidth."""
    name = f"{other.effect.name} at {other.bandwidth:.3g} Hz"
    where = next((s.where for s in after.steps if s.effect == other.effect.name), ())
    nrms = before.end.nrms, after.end.nrms, before.refitted.nrms, after.end.floor_nrms
    return FoundStep(name, where, *nrms)


def _explains_more(
    after: Investigation, before: Investigation, other: OtherBandwidth, criteria: Criteria
) -> bool:
    """Whether an investigation at another bandwidth has an effect and is the better one for it.

    Where all was explained, nothing else may be new, but that bodies are wrong, and what was
    explained before must be still; where it was not, clearly less must be left.
    """
    had, has = ({step.effect for step in each.explanation.steps} for each in (before, after))
    if other.effect.name not in has:
        return False
    if before.explanation.verdict == "unexplained":
        return other.explains(after.explanation.end)
    if not has - had <= {other.effect.name, effect_of(Role.INERTIA).name}:
        return False
    own = before.case.trajectories[0].filter.bandwidth
    was, now = errors_of(before.hypothesis), errors_at(after.case, after.hypothesis, own)
    return (
        after.explanation.verdict == "explained"
        and now.nrms <= (1.0 + criteria.reduction) * was.nrms
    )


def _with_bandwidth_notes(after: Investigation, before: Investigation) -> Investigation:
    """The investigation with a note on its bandwidth and, if that is lower, on what is above it."""
    own, now = (each.case.trajectories[0].filter.bandwidth for each in (before, after))
    note = f"errors are those at {now:.3g} Hz: compare others with --bandwidth {now:.3g}"
    above = errors_at(after.case, after.hypothesis, own) if now < own else None
    if above is not None and above.shows_noise:
        note += (
            f"; at {own:.3g} Hz, {above.nrms / above.floor_nrms:.1f} times the noise is left, as a "
            "log hardly shows how soft joints swing there"
        )
    notes = (*after.explanation.notes, note)
    return replace(after, explanation=replace(after.explanation, notes=notes))


def _investigated(case: Case, criteria: Criteria, progress: Progress | None) -> Investigation:
    """An investigation at the bandwidth of a case."""
    model = case.model
    before = comparison(case)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    tune = model.information is None
    fixed = effects_of(model)
    case, trail = searched(case, start, fixed, criteria, tune=tune, progress=progress)
    start = trail.start  # as before, and dry friction fades as it was found to
    whole = tune and not trail.is_stopped
    hidden = with_fixed_inertias(case, trail, fixed, criteria) if whole else FixedInertias(case)
    case = hidden.case
    after_case, fit, trail, steps = _helpful(case, (*hidden.trails, trail), criteria)
    steps = steps or refit_step(case, start, fit, criteria, rivals=hidden.rivals)
    widths, known = after_case.model.sign_widths(0.0), model.sign_widths(0.0)
    changed = bool(steps) or not np.array_equal(widths, known)
    after = comparison(after_case, fit.unknowns, fit.held_out)
    errors = after.errors if changed else before.errors
    companions = [*companion_notes(trail.end.unknowns, fit), *fit.result.notes]
    found = (*transition_speed_notes(model, fit.model), *stated_mass_notes(case, fit.model))
    bodies = changed_bodies(model, fit) if changed else ()
    more = (*companions, *found, *common_factor_notes(bodies)) if changed else ()
    explanation = Explanation(
        verdict_of(errors, changed),
        steps,
        before.errors,
        error_table(trail.start.dataset, trail.start.held_out),
        errors,
        fit.model if changed else model,
        before,
        after if changed else before,
        (*([_STOPPED] if trail.is_stopped else []), *case.notes, *more),
        bodies,
        dict(zip(case.dataset.joints, fit.of_motion.tolist(), strict=True)),
        trail.is_stopped,
        fit.result.certificate if changed else None,
    )
    end = freed(trail.end.moved(after_case.dataset, delay=0))
    return Investigation(explanation, after_case, end)


def _helpful(
    case: Case, trails: Sequence[Trail], criteria: Criteria
) -> tuple[Case, ModelFit, Trail, tuple[Step, ...]]:
    """The final fit and the steps to it, less what does not lower its error on held-out data.

    A rival takes the place of a finding that proves improbable beside it once all else is known.
    """
    after, fit, trail = _finished(case, trails, criteria)
    steps = steps_of(case, trail, fit)
    while (other := with_likelier_rival(trail, steps, criteria)) is not None:
        found = _finished(case, (other,), criteria)
        others = steps_of(case, found[2], found[1])
        if not others or others[-1].error_after >= steps[-1].error_after:
            break
        (after, fit, trail), steps = found, others
    while steps and steps[-1].error_after >= steps[-1].error_before:
        less = without_step(trail, steps[-1])
        if less is None:
            break
        after, fit, trail = _finished(case, (less,), criteria)
        steps = steps_of(case, trail, fit)
    return after, fit, trail, steps


def _finished(
    case: Case, trails: Sequence[Trail], criteria: Criteria
) -> tuple[Case, ModelFit, Trail]:
    """The final fit of the first trail that, physically consistent, does as well as the last."""
    *others, last = trails
    for trail in others:
        try:
            after, fit, end = final_fit(case, trail.end, criteria=criteria, kept=trail.kept)
        except IdentificationError:  # too far from physical for any solver
            continue
        errors = last.end.held_out, fit.held_out
        if judge_errors(errors, last.end.effective, parameters=0).left <= 1.0 + criteria.reduction:
            return after, fit, replace(trail, end=end)  # else a body lost mass: no payload
    after, fit, end = final_fit(case, last.end, criteria=criteria, kept=last.kept)
    return after, fit, replace(last, end=end)


def verdict_of(errors: ErrorTable, found: bool) -> Verdict:
    """What an end result amounts to.

    Args:
        errors: Held-out errors at the end.
        found: Whether a step was taken.
    """
    if not errors.is_noise:
        return "unexplained"
    return "explained" if found else "adequate"
