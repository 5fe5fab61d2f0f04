"""Which effect is missing, with the evidence: one round of the search."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from geodrake.boundary.arguments import instance
from geodrake.diagnosis.body_gains import gains_of_bodies
from geodrake.diagnosis.explain import verdict_of
from geodrake.diagnosis.fixed_inertias import with_fixed_inertias
from geodrake.diagnosis.further_columns import with_episodes, with_suggestions
from geodrake.diagnosis.judgement import judge
from geodrake.diagnosis.ranked import Ranked
from geodrake.diagnosis.results import Candidate, Diagnosis
from geodrake.diagnosis.steps import moved_bodies, refit_evidence
from geodrake.diagnosis.stepwise_search import Forward, Trail, next_step, simplified, tuned
from geodrake.effects import Effect, Role
from geodrake.effects.lookup import effect_of
from geodrake.identification.logs.case import Case, error_table, open_case
from geodrake.identification.logs.compare import comparison
from geodrake.identification.logs.criteria import DOMINANT, Criteria
from geodrake.identification.logs.hypothesis import Hypothesis, first_hypothesis
from geodrake.identification.logs.model_fit import as_it_stands, effects_of, model_unknowns
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel


def diagnose(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    extra: Sequence[type[Effect]] = (),
    bandwidth: float | None = None,
    blocks: int | None = None,
    criteria: Criteria | None = None,
) -> Diagnosis:
    """Rank the effects that a model may lack by the held-out error that each would take away.

    Columns are taken at their word: `check_columns` tells of those that are not what they seem.

    Args:
        model: The model as it stands.
        logs: Logs or their files; several logs are several trajectories.
        extra: Effect classes of the user's own to try beside the catalogue's.
        bandwidth: Bandwidth of the filter, Hz; by default that of the model's fit to the same logs,
            or chosen from the data.
        blocks: Blocks into which every log is cut for validation.
        criteria: When an effect counts as found.

    Returns:
        Convincing candidates, each refitted with everything that may move. The first is the step
        that `explain` takes next at this bandwidth: the simplest of those as good as the best,
        with complex effects swapped for simpler ones wherever these stand within the criteria. A
        step of which nothing is left when all is simplified is none.
        Where no effect is needed beside bodies that move, those that spare them the way come first.

    Raises:
        LogError: A log cannot be used.
        ArgumentError: There is no log, or a setting is no usable number.
    """
    criteria = Criteria() if criteria is None else instance(criteria, "criteria", Criteria)
    case = open_case(model, logs, candidates=True, extra=extra, bandwidth=bandwidth, blocks=blocks)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    hypothesis = tuned(start) if model.information is None else start
    trail = Trail(start, hypothesis)
    for least_share in (DOMINANT, 0.0):
        case, trail = with_suggestions(case, trail, criteria, least_share=least_share)
        step = next_step(trail.end, effects_of(model), criteria)
        # What ranks behind a step that does not last may stand for the same, and is not offered.
        if step is not None and not _lasts(trail.end, step.after, effects_of(model), criteria):
            step = None
        if step is not None:
            break
    start, hypothesis = trail.start, trail.end
    if step is not None:
        first = _first(case, hypothesis, step)
        others = [r for r in step.ranked if set(r.reported) != set(first.names)]
        if set(step.chosen.reported) <= set(first.names):
            others = [r for r in others if r.hypothesis is not step.chosen.hypothesis]
        candidates = [_candidate(r, hypothesis.nrms) for r in (first, *others)]
    else:
        candidates = _episodes(case, trail, criteria) or [
            *_with_fixed_inertias(case, start, criteria),
            *_refitted(case, start, criteria),
        ]
    refitted = error_table(case.dataset, hypothesis.held_out)
    before = comparison(case)
    return Diagnosis(
        "explained" if candidates else verdict_of(refitted, found=False),
        tuple(candidates),
        before.errors,
        refitted,
        before,
        case.notes,
    )


def _lasts(
    before: Hypothesis, after: Hypothesis, fixed: Sequence[Effect], criteria: Criteria
) -> bool:
    """Whether anything is left of a step once what it led to is simplified and pruned.

    What gains of the efforts explain as well, no more than these are uncertain, does not last; nor
    do bodies that go far, if they gain less than that costs, or effects that gain no more than the
    best of all that were tried may by chance.
    """
    end = simplified(after, fixed, criteria)
    was, now = (
        (set(h.unknowns.effects), h.released, h.delay, h.looseness > 1.0) for h in (before, end)
    )
    if was == now:
        return False
    found = judge(before, end, tried=len(before.dataset.effects))
    return found.parameters <= 0 or found.alarm <= criteria.alarm


def _first(case: Case, before: Hypothesis, step: Forward) -> Ranked:
    """What a step added once it was simplified and pruned, the most frequent effect first."""
    return _added(case, before, step.after) or step.chosen


def _added(case: Case, before: Hypothesis, after: Hypothesis) -> Ranked | None:
    """The effects that a hypothesis has more than another.

    None for a delay, a looser prior or a payload that was let go.
    """
    effects = [e for e in after.unknowns.effects if e not in before.unknowns.effects]
    if not effects:
        return None
    names = Counter(sorted(effect.name for effect in effects))
    classes = {effect.name: type(effect) for effect in effects}
    places = {place for effect in effects for place in effect.where}
    found = judge(before, after, tried=len(case.dataset.effects))
    return Ranked(
        tuple(classes[name] for name, _ in names.most_common()),
        tuple(place for place in (*case.model.joints, *case.model.bodies) if place in places),
        tuple(effects),
        after,
        found,
        tied=True,
    )


def _episodes(case: Case, trail: Trail, criteria: Criteria) -> list[Candidate]:
    """Contacts, if the residual shows any."""
    there, after, found = with_episodes(case, trail, alarm=criteria.alarm)
    if not found:
        return []
    without = after.end.without(found)
    judgement = judge(without, after.end, tried=len(there.dataset.effects))
    places = tuple(dict.fromkeys(place for effect in found for place in effect.where))
    ranked = Ranked((type(found[0]),), places, found, after.end, judgement, tied=True)
    return [_candidate(ranked, without.nrms)]


def _with_fixed_inertias(case: Case, start: Hypothesis, criteria: Criteria) -> list[Candidate]:
    """What explains the logs as well as moved inertias do, if they are not well known."""
    if case.model.information is not None:
        return []
    hidden = with_fixed_inertias(case, Trail(start, start), effects_of(case.model), criteria)
    found = [(t.start, _added(hidden.case, t.start, t.end)) for t in hidden.trails]
    return [_candidate(ranked, held.nrms) for held, ranked in found if ranked is not None]


def _refitted(case: Case, start: Hypothesis, criteria: Criteria) -> list[Candidate]:
    """The inertias alone, if refitting them within their prior is worth it."""
    found = refit_evidence(case, start, criteria)
    if found is None:
        return []
    nb = len(case.model.bodies)
    moved = moved_bodies(case, start.cv.fit_all()[: case.model.phi.size].reshape(nb, -1))
    standing = as_it_stands(case.dataset, case.model)
    where = gains_of_bodies(case, start, standing, criteria).enough or tuple(moved)
    before = error_table(case.dataset, standing).nrms
    name = effect_of(Role.INERTIA).name
    return [Candidate(name, where, before, start.nrms, found.score, found.alarm, tied=True)]


def _candidate(ranked: Ranked, before: float) -> Candidate:
    return Candidate(
        " + ".join(ranked.reported),
        ranked.where,
        before,
        ranked.hypothesis.nrms,
        ranked.score,
        ranked.judgement.alarm,
        ranked.tied,
    )
