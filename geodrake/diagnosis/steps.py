"""The steps of an explanation: the effects of a search, grouped by name, in order of their gain."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.alternatives import instead, weighed
from geodrake.diagnosis.body_gains import gains_of_bodies
from geodrake.diagnosis.final_fit import searched_model
from geodrake.diagnosis.judgement import Judgement, acted_upon, judge, judge_errors, parameters_of
from geodrake.diagnosis.results import FittedRival, Step
from geodrake.diagnosis.step_values import (
    factor_of,
    late_joints,
    reported_delays,
    reported_parameters,
    systematic_parameters,
)
from geodrake.diagnosis.stepwise_search import Trail
from geodrake.effects import Effect, Role
from geodrake.effects.lookup import effect_of
from geodrake.identification.logs.case import Case, error_table, series
from geodrake.identification.logs.criteria import MOST, Criteria
from geodrake.identification.logs.cross_validation import HeldOut
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.identification.logs.model_errors import Series
from geodrake.identification.logs.model_fit import ModelFit, as_it_stands
from geodrake.inertia import pullback_metric
from geodrake.model.effort_signal import signal_of
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Values = dict[str, dict[str, float]]

_HEAVIER = 0.25
"""A last body that got heavier carries something if its way is this share of the farthest one's."""


@dataclass(frozen=True, eq=False)
class _Group:
    """What one step adds: effects of one name, a payload let go, a delay, a looser prior."""

    name: str
    effects: tuple[Effect, ...] = ()
    released: Effect | None = None
    delay: tuple[int, ...] | None = None
    looseness: float | None = None

    def added_to(self, hypothesis: Hypothesis) -> Hypothesis:
        if self.delay is not None:
            return hypothesis.delayed(self.delay)
        if self.looseness is not None:
            return hypothesis.loosened(self.looseness)
        if self.released is not None:
            return hypothesis.release(self.released)
        return hypothesis.with_effects(self.effects)

    def taken_from(self, trail: Trail) -> Trail | None:
        """A trail that ends without it; None for a payload let go, which is known to be there."""
        end = trail.end
        if self.released is not None:
            return None
        if self.delay is not None:
            return replace(trail, end=end.delayed(trail.start.delay))
        if self.looseness is not None:
            return replace(trail, end=end.loosened(1.0 / self.looseness))
        kept = tuple(effect for effect in trail.kept if effect not in self.effects)
        return replace(trail, end=end.without(self.effects), kept=kept)


def without_step(trail: Trail, step: Step) -> Trail | None:
    """A trail without what a step added; None if that cannot be taken back.

    Args:
        trail: The search.
        step: One of its steps.
    """
    places = set(step.where)
    return next(
        group
        for group in _groups(trail)
        if group.name == step.effect
        and (not group.effects or {place for e in group.effects for place in e.where} == places)
    ).taken_from(trail)


def with_likelier_rival(trail: Trail, steps: Sequence[Step], criteria: Criteria) -> Trail | None:
    """A trail in which a rival takes the place of a finding; None if no finding is improbable.

    Args:
        trail: The search.
        steps: Its steps, with their rivals.
        criteria: Findings less probable than its `tie` are improbable beside one likelier rival.
    """
    for step in steps:
        for rival, probability in zip(step.rivals, step.probabilities_of_rivals, strict=True):
            improbable = step.probability < criteria.tie and probability > MOST
            less = without_step(trail, step) if improbable else None
            end = None if less is None else instead(less.end, rival.names, rival.where)
            if less is not None and end is not None:
                also = {step.effect, *trail.rivals.get(step.effect, ())}
                new = {name: tuple(sorted(also - {name})) for name in rival.names}
                error, chance = rival.error_of_choice, 1.0 - rival.tie_probability
                lost = FittedRival(step.effect, step.where, rival.names, error, rival.error, chance)
                fits = (*trail.fits, lost)
                return replace(less, end=end, rivals={**trail.rivals, **new}, fits=fits)
    return None


def steps_of(case: Case, trail: Trail, fit: ModelFit) -> tuple[Step, ...]:
    """Steps from the model refitted within its prior to the final fit, largest gain first.

    Args:
        case: The case that was searched.
        trail: The search.
        fit: The final fit; the last step ends at its physically consistent held-out errors.
    """
    groups = _groups(trail)
    if not groups:
        return ()
    hypotheses = [trail.start]
    ordered: list[_Group] = []
    while groups:
        trials = [(group, group.added_to(hypotheses[-1])) for group in groups]
        group, after = min(trials, key=lambda trial: trial[1].nrms)
        groups.remove(group)
        ordered.append(group)
        hypotheses.append(after)
    errors = [*(h.held_out for h in hypotheses[:-1]), fit.held_out]
    tables = [error_table(case.dataset, held_out) for held_out in errors]
    tried = len(case.dataset.effects)
    steps = []
    for i, group in enumerate(ordered):
        parameters, deviations = _values(case, group, trail, fit)
        systematic = _systematic(case, group, fit)
        before, after = hypotheses[i : i + 2]
        alone = 2 * len(case.model.bodies) if group.looseness is not None else 1
        count = parameters_of(group.effects) or alone
        found = judge(before, after, parameters=count, tried=tried)
        where = _where(case, group, trail, fit)
        rivals = _rivals(case, trail, group, where, fit.model.phi)
        steps.append(
            Step(
                group.name,
                where,
                tables[i].nrms,
                tables[i + 1].nrms,
                parameters,
                deviations,
                rivals,
                found.alarm,
                _agreement(case, group.effects, errors[i], errors[i + 1]),
                tables[i].by_joint(),
                tables[i + 1].by_joint(),
                _weighed(trail, group, rivals),
                systematic,
                *(() if group is ordered[-1] else (_series(after), _model(case, after, fit))),
            )
        )
    return tuple(steps)


def _model(case: Case, after: Hypothesis, fit: ModelFit) -> RobotModel:
    """The model after a step, efforts as late as they are in the end."""
    late = tuple(found for found in fit.model.effects if found.effect.role is Role.DELAY)
    model = searched_model(case, after)
    return replace(model, effects=(*model.effects, *late))


def _series(hypothesis: Hypothesis) -> tuple[Series, ...]:
    """What a hypothesis predicts on held-out data."""
    return series(
        hypothesis.dataset, hypothesis.unknowns, hypothesis.held_out, delay=hypothesis.delay
    )


def _agreement(case: Case, effects: tuple[Effect, ...], before: HeldOut, after: HeldOut) -> float:
    """Share of the folds in which the error falls where effects act; everywhere without any."""
    joints = np.ones(len(case.dataset.joints), bool)
    if effects:
        joints = acted_upon(case.dataset, effects)
    return judge_errors((before, after), 0.0 * joints, joints=joints, parameters=0).agreement


def refit_step(
    case: Case,
    start: Hypothesis,
    fit: ModelFit,
    criteria: Criteria,
    *,
    rivals: Sequence[str] = (),
) -> tuple[Step, ...]:
    """A step if refitting the inertias alone takes convincingly much error away.

    Args:
        case: The case.
        start: The model refitted within its prior.
        fit: The final fit, with no effect added.
        criteria: When a step counts.
        rivals: Effects that it cannot be distinguished from.
    """
    evidence = refit_evidence(case, start, criteria)
    if evidence is None:
        return ()
    before = as_it_stands(case.dataset, case.model)
    was, now = error_table(case.dataset, before), error_table(case.dataset, fit.held_out)
    moved, gained = (
        moved_bodies(case, fit.model.phi),
        gains_of_bodies(case, start, before, criteria),
    )
    if gained.enough:
        moved = {body: distance_of(case, fit.model.phi, body) for body in gained.enough}
    values = _inertias(moved, fit)
    for body, own in values.items():
        own["gain_alone"] = gained.gains[body]
    return (
        Step(
            effect_of(Role.INERTIA).name,
            tuple(moved),
            was.nrms,
            now.nrms,
            values,
            {},
            tuple(sorted({*rivals, *_carried(case, moved, fit.model.phi)})),
            evidence.alarm,
            _agreement(case, (), before, fit.held_out),
            was.by_joint(),
            now.by_joint(),
        ),
    )


def refit_evidence(case: Case, start: Hypothesis, criteria: Criteria) -> Judgement | None:
    """Evidence that refitting the inertias alone is worth it.

    Args:
        case: The case.
        start: The model refitted within its prior.
        criteria: When a step counts.

    Returns:
        None where it does not convince, or where the bodies of a model that was fitted before stay
        within what is known about them: then they are known better, and were not wrong.
    """
    if case.model.information is not None and start.is_within_prior:
        return None
    errors = as_it_stands(case.dataset, case.model), start.held_out
    found = judge_errors(errors, start.effective, parameters=2 * len(case.model.bodies))
    return found if found.convinces(criteria) else None


def _groups(trail: Trail) -> list[_Group]:
    present = trail.start.unknowns.effects
    names: dict[str, list[Effect]] = {}
    for effect in trail.end.unknowns.effects:
        if effect not in present:
            names.setdefault(effect.name, []).append(effect)
    groups = [_Group(name, tuple(effects)) for name, effects in names.items()]
    groups += [_Group(effect.name, (effect,), effect) for effect in trail.end.released]
    if trail.end.delay != trail.start.delay:
        groups.append(_Group(effect_of(Role.DELAY).name, delay=trail.end.delay))
    if trail.end.looseness > 1.0:
        groups.append(
            _Group(
                effect_of(Role.INERTIA).name,
                looseness=trail.end.looseness / trail.start.looseness,
            )
        )
    return groups


def _rivals(
    case: Case, trail: Trail, group: _Group, where: tuple[str, ...], phi: Array
) -> tuple[str, ...]:
    found = {effect.name for effect in trail.end.unknowns.effects}
    tied = set(trail.rivals.get(group.name, ()))
    if group.looseness is not None:
        tied.update(_carried(case, where, phi))
    return tuple(sorted(tied - found))


def _weighed(trail: Trail, group: _Group, rivals: Collection[str]) -> tuple[FittedRival, ...]:
    """The rivals of a group that were fitted, beside everything else that was found."""
    fitted = _fitted(trail, group.name, rivals)
    bare = group.taken_from(trail) if fitted else None
    return weighed(trail.start, trail.end, None if bare is None else bare.end, fitted)


def _fitted(trail: Trail, effect: str, rivals: Collection[str]) -> tuple[FittedRival, ...]:
    """Those rivals of an effect that were fitted in its place, each once, as at the first choice.

    Args:
        trail: The search.
        effect: Name of the effect.
        rivals: Names of its rivals.
    """
    fits: dict[str, FittedRival] = {}
    for rival in trail.fits:
        if effect in rival.instead_of and not set(rivals).isdisjoint(rival.names):
            fits.setdefault(rival.effect, rival)
    return tuple(sorted(fits.values(), key=lambda rival: rival.error))


def _carried(case: Case, bodies: Collection[str], phi: Array) -> tuple[str, ...]:
    """What wrong bodies may be as well: one at the end of the robot that carries a payload.

    Args:
        case: The case.
        bodies: Those that moved far.
        phi: (nb, 10) all bodies as fitted.
    """
    distance = _distances(case, phi)
    heavier = (phi[:, 0] > case.model.phi[:, 0]) & (distance >= _HEAVIER * distance.max())
    may = {*bodies, *np.asarray(case.model.bodies)[heavier]}
    return (effect_of(Role.BODY).name,) if may.intersection(case.model.last_bodies) else ()


def _where(case: Case, group: _Group, trail: Trail, fit: ModelFit) -> tuple[str, ...]:
    if group.looseness is not None:
        return tuple(moved_bodies(case, fit.model.phi))
    if group.delay is not None:
        return late_joints(case.model.joints, trail.start, trail.end)
    places = dict.fromkeys(place for effect in group.effects for place in effect.where)
    order = {name: i for i, name in enumerate((*case.model.joints, *case.model.bodies))}
    return tuple(sorted(places, key=lambda place: order.get(place, 0)))


def moved_bodies(case: Case, phi: Array) -> Mapping[str, float]:
    """Bodies that a fit (nb, 10) moved farthest from their prior, with the geometric distance.

    Args:
        case: The case, with the prior.
        phi: (nb, 10) fitted inertial parameters.
    """
    distance = _distances(case, phi)
    far = distance >= max(0.5 * distance.max(), 1e-9)
    return {b: float(d) for b, d, f in zip(case.model.bodies, distance, far, strict=True) if f}


def distance_of(case: Case, phi: Array, body: str) -> float:
    """How far a fit (nb, 10) moved a body, as a geometric distance.

    Args:
        case: The case, with the prior.
        phi: (nb, 10) fitted inertial parameters.
        body: Name of the body.
    """
    return float(_distances(case, phi)[case.model.bodies.index(body)])


def _distances(case: Case, phi: Array) -> Array:
    step = phi - case.model.phi
    return np.asarray(
        np.sqrt(np.einsum("bi,bij,bj->b", step, pullback_metric(case.model.phi), step))
    )


def _values(case: Case, group: _Group, trail: Trail, fit: ModelFit) -> tuple[Values, Values]:
    values: Values = {}
    deviations: Values = {}
    if group.looseness is not None:
        return _inertias(moved_bodies(case, fit.model.phi), fit), deviations
    if group.delay is not None:
        return reported_delays(case.model.joints, trail.start, trail.end, fit.model.delays)
    for fitted in fit.model.effects:
        if fitted.effect in group.effects:
            place = fitted.effect.place
            found, spread = reported_parameters(fitted)
            values.setdefault(place, {}).update(found)
            deviations.setdefault(place, {}).update(spread)
    return values, deviations


def _systematic(case: Case, group: _Group, fit: ModelFit) -> Values:
    """What gains of efforts and what is unexplained add to deviations of a group's parameters."""
    values: Values = {}
    for fitted in fit.model.effects:
        if fitted.effect in group.effects:
            span = fit.unknowns.span(fitted.effect)
            shifts = [factor_of(fit.unexplained_covariance[span, span])]
            if fitted.effect.role is not Role.SCALE:
                shifts.append(case.gain_deviations[:, None] * fit.gain_shifts[:, span])
            if fitted.effect.damps:
                shifts.append(_servo_damping(case, fitted.effect.where[0]))
            if any(each.any() for each in shifts):
                found = systematic_parameters(fitted, np.concatenate(shifts))
                values.setdefault(fitted.effect.place, {}).update(found)
    return values


def _servo_damping(case: Case, joint: str) -> Array:
    """(1, 1) how well the damping of a joint's servo is known, which friction takes the rest of."""
    signal = signal_of(case.model.effort_signals, joint)
    return np.array([[0.0 if signal is None else signal.damping_deviation]])


def _inertias(moved: Mapping[str, float], fit: ModelFit) -> Values:
    masses = dict(zip(fit.model.bodies, fit.model.phi[:, 0].tolist(), strict=True))
    return {
        body: {"mass": masses[body], "distance_from_prior": distance}
        for body, distance in moved.items()
    }
