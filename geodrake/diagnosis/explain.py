"""Search for missing effects: the most probable explanation of logs, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from geodrake.boundary.arguments import function, instance
from geodrake.boundary.showing import Short
from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.final_fit import final_fit
from geodrake.diagnosis.findings import (
    Finding,
    at_found_gains,
    holds,
    largest_residual,
    named,
    probable,
    refines,
    staged,
    terms_not_held,
    verdict_of,
    without_finding,
)
from geodrake.diagnosis.notes import (
    changed_notes,
    gain_notes,
    left_out_notes,
    notes_of,
    unnamed_notes,
)
from geodrake.diagnosis.results import Correlate, Explanation, Step
from geodrake.diagnosis.search import SearchResult, find_explanation
from geodrake.diagnosis.search_progress import Progress
from geodrake.diagnosis.steps import steps_of, vanished
from geodrake.diagnosis.terms import Term
from geodrake.diagnosis.turned_base import logs_apart_notes, moved_base_notes
from geodrake.effects import Effect
from geodrake.identification.logs.case import Case, error_table, prepare_case
from geodrake.identification.logs.compare import comparison
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.identification.logs.model_fit import ModelFit, with_settled_effects
from geodrake.identification.models.identify import changed_bodies
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel

_UNUSUAL = 3.0  # deviations beyond which the error of a gain is said first
_STOPPED = "the search was interrupted: more effects or rivals may exist"


@dataclass(frozen=True, eq=False)
class Investigation(Short):
    """An explanation and the search behind it."""

    explanation: Explanation
    case: Case  # the case, with the columns of the findings
    result: SearchResult  # the result of the search, without unknown functions
    correlates: tuple[Correlate, ...] = ()  # signals of the unknown functions


def explain(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    extra: Sequence[type[Effect]] = (),
    bandwidth: float | None = None,
    blocks: int | None = None,
    hold_resting: bool = True,
    beliefs: Beliefs | None = None,
    progress: Progress | None = None,
) -> Explanation:
    """Find what a model lacks, add it, and refit.

    Columns are assumed to be correct; `check_columns` finds mistakes in them.

    Args:
        model: The model.
        logs: Logs or their files; each is a trajectory of its own.
        extra: User-defined effect classes to try in addition to the catalogue.
        bandwidth: Bandwidth of the filter, Hz; by default that of the model's fit to the same logs,
            or chosen from the data.
        blocks: Number of validation blocks of each log.
        hold_resting: Whether joints that hardly move in any log are fixed; see
            `geodrake.model.logged_joints.holding_resting`.
        beliefs: Prior odds and widths.
        progress: Called with each `FoundStep`. It or a signal handler may raise `StopSearch` to
            return the steps found so far, with a note.

    Returns:
        The steps with held-out errors before and after, and the final model.

    Raises:
        LogError: A log cannot be used.
        ArgumentError: There is no log, or a setting is invalid.
    """
    if progress is not None:
        function(progress, "progress")
    if beliefs is not None:
        instance(beliefs, "beliefs", Beliefs)
    case = prepare_case(
        model,
        logs,
        candidates=True,
        extra=extra,
        bandwidth=bandwidth,
        blocks=blocks,
        hold_resting=hold_resting,
    )
    return investigate(case, beliefs=beliefs, progress=progress).explanation


def investigate(
    case: Case, *, beliefs: Beliefs | None = None, progress: Progress | None = None
) -> Investigation:
    """Explain a case that has columns for candidates; see `explain`."""
    result, findings, rest = named(find_explanation(case, beliefs, progress=progress))
    unusual = gain_notes(rest, beyond=_UNUSUAL)
    investigation = explained(case, result, findings, notes=unnamed_notes(rest), first=unusual)
    return replace(investigation, correlates=rest.motion)


def explained(
    case: Case,
    result: SearchResult,
    findings: Sequence[Finding],
    *,
    forced: bool = False,
    notes: Sequence[str] = (),
    first: Sequence[str] = (),
) -> Investigation:
    """Fit the result of a search, and validate it once on held-out data.

    `first` are the notes that results print before all else.
    """
    result, after_case, fit, start, steps = _validated_steps(case, result, findings, forced=forced)
    before, model = comparison(case), case.model
    fades = result.case.model.fading_speed is not model.fading_speed
    changed = bool(steps) or fades  # a fading speed is no step, but lowers the error
    after = comparison(after_case, fit.unknowns, fit.held_out) if changed else before
    bodies = changed_bodies(model, fit) if changed else ()
    all_notes = [*([_STOPPED] if result.is_stopped else []), *case.notes, *notes]
    all_notes += moved_base_notes(case)
    if changed:
        all_notes += [*changed_notes(case.model, steps), *notes_of(result, case, fit, bodies)]
    all_notes += left_out_notes(findings, steps)
    noise_of = after_case.dataset if changed else None
    gained, left = at_found_gains(result, noise_of), largest_residual(result, noise_of)
    verdict = verdict_of(gained or after.errors, bool(steps), left=left)
    if verdict == "unexplained":
        apart = logs_apart_notes(result.case, result.model, result.fit)
        all_notes, first = [*all_notes, *apart], [*first, *apart]
    before, after = (replace(each, first=(*each.first, *first)) for each in (before, after))
    explanation = Explanation(
        verdict,
        steps,
        before.errors,
        error_table(case.dataset, start.held_out),
        after.errors,
        with_settled_effects(fit.model) if changed else model,
        before,
        after,
        tuple(dict.fromkeys(all_notes)),
        bodies,
        dict(zip(case.dataset.joints, fit.of_motion.tolist(), strict=True)),
        result.is_stopped,
        fit.result.certificate if changed else None,
        gained,
    )
    return Investigation(explanation, after_case, result)


def _validated_steps(
    case: Case, result: SearchResult, findings: Sequence[Finding], *, forced: bool
) -> tuple[SearchResult, Case, ModelFit, Hypothesis, tuple[Step, ...]]:
    """Return the final fit and its steps, without last ones that lower no held-out error.

    An effect of several joints may be kept at some of them. New effects that are zero in the final
    fit are removed, too.
    """
    while True:
        if forced:
            start, stages = staged(result, findings)
        else:
            result, start, stages = probable(case, result, findings)
        after, fit = final_fit(case, result)
        findings = [stage.finding for stage in stages]
        if not forced and (zero := _vanished(case, findings, fit)) is not None:
            result, findings = without_finding(result, findings, *zero)
            continue
        end = error_table(after.dataset, fit.held_out)
        steps = steps_of(case, result, start, stages, fit=fit, end=end)
        if forced or not steps:
            return result, after, fit, start, steps
        before = (stages[-2].validated if len(stages) > 1 else start).held_out
        last = findings[-1]
        if holds(result, last, before, fit.held_out):
            return result, after, fit, start, steps
        failing = terms_not_held(result, last, before, fit.held_out)
        result, findings = without_finding(result, findings, last, failing)


def _vanished(
    case: Case, findings: Sequence[Finding], fit: ModelFit
) -> tuple[Finding, Sequence[Term]] | None:
    """Return the first finding with terms that are zero in the final fit, and these terms.

    A finding that others refine is kept.
    """
    for finding in findings:
        zero = vanished(case, finding, fit)
        if zero is not None and not any(refines(other, [finding]) for other in findings):
            return finding, zero
    return None
