"""Other columns for a case in the middle of a search: what the residual suggests, finer shapes."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.candidates import kinds
from geodrake.diagnosis.contact_window import PIECES
from geodrake.diagnosis.episodes import find_episodes, refined_episodes
from geodrake.diagnosis.judgement import gain_of, judge
from geodrake.diagnosis.proposals import suggested
from geodrake.diagnosis.search import convincing
from geodrake.diagnosis.stepwise_search import Trail
from geodrake.effects import Effect
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.robot_motion import log_number
from geodrake.identification.logs.case import Case, KeptMotion, reduced
from geodrake.identification.logs.criteria import Criteria
from geodrake.identification.logs.dataset import Dataset, is_payload
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.inertia import is_physical
from geodrake.logs.folds import dealt_out
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_MOST_EXPANSIONS = 3
_SHARES = (0.75, 0.5, 0.25, 0.0)  # of a fit without constraints that is not physical
_OTHER_LOADS = 0.02
"""Columns are made anew if a load changes by more than this share of the effort's deviation."""


def with_suggestions(
    case: Case,
    trail: Trail,
    criteria: Criteria,
    *,
    known: Sequence[Effect] = (),
    least_share: float = 0.0,
) -> tuple[Case, Trail]:
    """The case with columns for what the residual of a trail's end suggests, and that convinces.

    Suggestions are first tried alone, on the logs reduced to what the trail's end has and them:
    most fail there, and a search among all candidates is spared.

    Args:
        case: The case.
        trail: A search.
        criteria: When an effect counts as found.
        known: Effects that are tried already.
        least_share: Share of the squared error at its joint that an effect must explain.
    """
    had = case.dataset.effects
    more = suggested(
        case,
        trail.end,
        (*had, *known),
        least_share=least_share,
        hidden=least_share == 0.0,
        alarm=criteria.alarm,
    )
    more = convincing_ones(case, trail.end, more, criteria) if more else ()
    return with_columns(case, trail, [*had, *more]) if more else (case, trail)


def convincing_ones(
    case: Case, end: Hypothesis, effects: Sequence[Effect], criteria: Criteria
) -> tuple[Effect, ...]:
    """Effects of which a shape convinces at their place, beside what usually comes with them.

    Bristles come beside other friction; an actuator that two joints share turns with either.

    Args:
        case: The case.
        end: What is known so far.
        effects: Effects to try, which need no columns yet.
        criteria: When an effect counts as found.
    """
    present = end.unknowns.effects
    simple = [
        base
        for effect in effects
        for kind in effect.tried_beside
        for base in kind.shaped(*effect.where)
    ]
    more = [effect for effect in dict.fromkeys(simple) if effect not in present]
    own = {(kind, (joint,)) for e in effects for kind in e.at_each_joint for joint in e.where}
    parts = [e for e in case.dataset.effects if (type(e), e.where) in own and e not in present]
    dataset = reduced(case, [*present, *more, *parts, *effects])
    alone = end.moved(dataset, delay=end.delay)
    beside = alone.with_effects(more) if more else alone
    good = {
        (trial.package.effects[0].name, trial.package.place)
        for kind in kinds([*effects, *parts], present)
        for trial in convincing(
            beside if kind.classes[0].tried_beside else alone, kind, len(effects), criteria
        )
    }
    return tuple(effect for effect in effects if (effect.name, effect.where) in good)


def with_columns(case: Case, trail: Trail, effects: Sequence[Effect]) -> tuple[Case, Trail]:
    """The case with columns for other effects, and the trail carried over.

    Args:
        case: The case.
        trail: A search on it.
        effects: Effects that get columns, instead of those that have them.
    """
    dataset = reduced(case, effects)
    start, end = (h.moved(dataset, delay=h.delay) for h in (trail.start, trail.end))
    return replace(case, dataset=dataset), replace(trail, start=start, end=end)


def without_inner_payloads(case: Case, trail: Trail) -> tuple[Case, Trail]:
    """The case without columns for masses on bodies that carry others: those are moved bodies.

    Args:
        case: The case.
        trail: A search on it; what it has found stays.
    """
    effects = [e for e in case.dataset.effects if not is_within(case, e)]
    effects += [e for e in trail.end.unknowns.effects if e not in effects]
    same = len(effects) == len(case.dataset.effects)
    return (case, trail) if same else with_columns(case, trail, effects)


def is_within(case: Case, effect: Effect) -> bool:
    """Whether an effect is a mass on a body that carries others: rather a wrong body.

    Args:
        case: The case.
        effect: The effect.
    """
    return is_payload(effect) and effect.where[0] not in case.model.last_bodies


def with_fitted_loads(case: Case, trail: Trail) -> tuple[Case, Trail] | None:
    """The case with loads by the inertias of a trail's end; None where they are the case's.

    Friction that grows with the load, gears that give way or have play: what they do is
    known at the right instants only if the load is.

    Args:
        case: The case.
        trail: A search.
    """
    was = case.load_model.phi
    phi = _physical_loads(case.model, trail.end)
    if _change_of_load(case.dataset, (phi - was).ravel()) < _OTHER_LOADS:
        return None
    case = replace(case, loads=phi, kept=KeptMotion())
    return with_columns(case, trail.asking_anew(), case.dataset.effects)


def _physical_loads(model: RobotModel, end: Hypothesis) -> Array:
    """(nb, 10) fitted bodies with what payloads are more than the model's, as far as physical."""
    x, known = end.cv.fit_all(), {f.effect: f.parameters for f in model.effects}
    phi = x[: model.phi.size].reshape(model.phi.shape).copy()
    for effect in end.unknowns.effects:
        if is_payload(effect):
            more = x[end.unknowns.span(effect)] - known.get(effect, 0.0)
            phi[model.bodies.index(effect.where[0])] += more
    step = phi - model.phi
    for share in _SHARES:
        beyond = ~is_physical(phi)
        phi[beyond] = model.phi[beyond] + share * step[beyond]
    return phi


def _change_of_load(dataset: Dataset, step: Array) -> float:
    """What a step of all inertial parameters changes at most of a joint's effort, by its RMS."""
    shares = []
    for j, data in enumerate(dataset.data):
        local = data.local(np.arange(len(step)))
        seen = local >= 0
        gram = data.products(local[seen], local[seen]).sum(axis=2)
        power = float(step[seen] @ gram @ step[seen]) / max(int(data.samples.sum()), 1)
        shares.append(np.sqrt(max(power, 0.0)) / dataset.effort_std[j])
    return float(max(shares))


def to_expand(
    model: RobotModel, hypothesis: Hypothesis, fixed: Collection[Effect]
) -> Mapping[Effect, Effect]:
    """Effects whose columns are slopes about another place than their parameters say, and those.

    Args:
        model: The model, whose bodies the effects act on.
        hypothesis: A fit of the effects.
        fixed: Effects that stay as they are.
    """
    effects = [e for e in hypothesis.unknowns.effects if e.expandable and e not in fixed]
    if not effects:
        return {}
    bodies = RobotBodies(model.tree, np.zeros((0, model.tree.num_positions)), model.total_phi)
    x = hypothesis.cv.fit_all()
    moved = {e: e.expanded_about(x[hypothesis.unknowns.span(e)], bodies) for e in effects}
    return {before: after for before, after in moved.items() if before != after}


def with_expansions(case: Case, trail: Trail, fixed: Collection[Effect]) -> tuple[Case, Trail]:
    """The case with effects that are not linear in their parameters expanded where these are now.

    Args:
        case: The case.
        trail: A search that found such effects.
        fixed: Effects that stay as they are.
    """
    for _ in range(_MOST_EXPANSIONS):
        moved = to_expand(case.model, trail.end, fixed)
        if not moved:
            break
        had = [*case.dataset.effects, *trail.end.unknowns.effects]
        tried, there = with_columns(case, trail, [*had, *moved.values()])
        end = there.end.without([*moved]).with_effects([*moved.values()])
        if gain_of(there.end, end) <= 0.0:
            break
        kept = [e for e in (*had, *moved.values()) if e not in moved]
        case, trail = with_columns(tried, replace(there, end=end), kept)
    return case, trail


def with_episodes(
    case: Case, trail: Trail, *, alarm: float = Criteria.alarm
) -> tuple[Case, Trail, tuple[Effect, ...]]:
    """The case with the episodes that the residual of a trail's end shows, and these.

    Nothing outside of an episode tells of it. So its pieces are dealt out to the folds in turns.

    Args:
        case: The case.
        trail: A search.
        alarm: Largest probability of a false alarm, as of other findings.
    """
    contacts = find_episodes(case, trail.end, alarm=alarm)
    if not contacts:
        return case, trail, ()
    windows = [(contact.log, contact.start, contact.end) for contact in contacts]
    numbers = [log_number(trajectory.name) for trajectory in case.trajectories]
    placed = [(numbers.index(log), start, end) for log, start, end in windows]
    dealt = replace(case, folds=dealt_out(case.folds, case.trajectories, placed, pieces=PIECES))
    tried, there = with_columns(dealt, trail.asking_anew(), [*case.dataset.effects, *contacts])
    end = there.end.with_effects(contacts)
    if not judge(there.end, end).is_better:
        return case, trail, ()
    return tried, replace(there, end=end), contacts


def with_refined_episodes(case: Case, trail: Trail) -> tuple[Case, Trail, tuple[Effect, ...]]:
    """The case with its episodes anew, now that other effects are known, and these.

    Args:
        case: The case.
        trail: A search that found episodes.
    """
    moved = refined_episodes(case, trail.end)
    tried, there = with_columns(case, trail, [*case.dataset.effects, *moved.values()])
    end = there.end.without([*moved]).with_effects([*moved.values()])
    if gain_of(there.end, end) <= 0.0:
        return case, trail, tuple(moved)
    kept = [effect for effect in tried.dataset.effects if effect not in moved]
    return *with_columns(tried, replace(there, end=end), kept), tuple(moved.values())
