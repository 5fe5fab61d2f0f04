"""Find what a model lacks: the most probable explanation of logs, step by step."""

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
from geodrake.diagnosis.notes import changed_notes, left_out_notes, notes_of, unnamed_notes
from geodrake.diagnosis.results import Correlate, Explanation, Step
from geodrake.diagnosis.search import Found, searched
from geodrake.diagnosis.search_progress import Progress
from geodrake.diagnosis.steps import steps_of, vanished
from geodrake.diagnosis.terms import Term
from geodrake.diagnosis.turned_base import moved_base_notes
from geodrake.effects import Effect
from geodrake.identification.logs.case import Case, error_table, open_case
from geodrake.identification.logs.compare import comparison
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.identification.logs.model_fit import ModelFit, with_settled_effects
from geodrake.identification.models.identify import changed_bodies
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel

_STOPPED = "the search was interrupted: more effects or rivals may exist"


@dataclass(frozen=True, eq=False)
class Investigation(Short):
    """An explanation, and the search behind it."""

    explanation: Explanation
    case: Case  # the case, with the columns of what was found
    found: Found  # what was found, without what no effect describes
    correlates: tuple[Correlate, ...] = ()  # what that varies with


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
        model: The model as it stands.
        logs: Logs or their files; several logs are several trajectories.
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
        ArgumentError: There is no log, or a setting is no usable number.
    """
    if progress is not None:
        function(progress, "progress")
    if beliefs is not None:
        instance(beliefs, "beliefs", Beliefs)
    case = open_case(
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
    found, findings, rest = named(searched(case, beliefs, progress=progress))
    made = explained(case, found, findings, notes=unnamed_notes(rest))
    return replace(made, correlates=rest.motion)


def explained(
    case: Case,
    found: Found,
    findings: Sequence[Finding],
    *,
    forced: bool = False,
    notes: Sequence[str] = (),
) -> Investigation:
    """Fit the result of a search, and validate it once on held-out data."""
    found, after_case, fit, start, steps = _holding(case, found, findings, forced=forced)
    before, model = comparison(case), case.model
    fades = found.case.model.fading_speed is not model.fading_speed
    changed = bool(steps) or fades  # where known friction fades is no step, and lowers the error
    after = comparison(after_case, fit.unknowns, fit.held_out) if changed else before
    bodies = changed_bodies(model, fit) if changed else ()
    said = [*([_STOPPED] if found.is_stopped else []), *case.notes, *notes]
    said += moved_base_notes(case)
    if changed:
        said += [*changed_notes(case.model, steps), *notes_of(found, case, fit, bodies)]
    said += left_out_notes(findings, steps)
    gained = at_found_gains(found) if steps else None
    explanation = Explanation(
        verdict_of(gained or after.errors, bool(steps), left=largest_residual(found)),
        steps,
        before.errors,
        error_table(case.dataset, start.held_out),
        after.errors,
        with_settled_effects(fit.model) if changed else model,
        before,
        after,
        tuple(dict.fromkeys(said)),
        bodies,
        dict(zip(case.dataset.joints, fit.of_motion.tolist(), strict=True)),
        found.is_stopped,
        fit.result.certificate if changed else None,
        gained,
    )
    return Investigation(explanation, after_case, found)


def _holding(
    case: Case, found: Found, findings: Sequence[Finding], *, forced: bool
) -> tuple[Found, Case, ModelFit, Hypothesis, tuple[Step, ...]]:
    """Return the final fit and its steps, without last ones that lower no held-out error.

    An effect of several joints that does not hold may still hold at some of them. New effects that
    are zero in the final fit are left out, too.
    """
    while True:
        if forced:
            start, stages = staged(found, findings)
        else:
            found, start, stages = probable(case, found, findings)
        after, fit = final_fit(case, found)
        findings = [stage.finding for stage in stages]
        if not forced and (gone := _vanished(case, findings, fit)) is not None:
            found, findings = without_finding(found, findings, *gone)
            continue
        end = error_table(after.dataset, fit.held_out)
        steps = steps_of(case, found, start, stages, fit=fit, end=end)
        if forced or not steps:
            return found, after, fit, start, steps
        before = (stages[-2].validated if len(stages) > 1 else start).held_out
        last = findings[-1]
        if holds(found, last, before, fit.held_out):
            return found, after, fit, start, steps
        bad = terms_not_held(found, last, before, fit.held_out)
        found, findings = without_finding(found, findings, last, bad)


def _vanished(
    case: Case, findings: Sequence[Finding], fit: ModelFit
) -> tuple[Finding, Sequence[Term]] | None:
    """Return the first finding with terms that are zero in the final fit, and these terms.

    One that others refine stays.
    """
    for finding in findings:
        gone = vanished(case, finding, fit)
        if gone is not None and not any(refines(other, [finding]) for other in findings):
            return finding, gone
    return None
