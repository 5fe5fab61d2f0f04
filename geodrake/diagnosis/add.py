"""Add one effect to a model, refit, and see what it changes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import instance, instances
from geodrake.diagnosis.continuous_shapes import to_profile, with_continuous_shapes
from geodrake.diagnosis.coupled import other_pairs
from geodrake.diagnosis.delay import delayed_at
from geodrake.diagnosis.explain import verdict_of
from geodrake.diagnosis.final_fit import final_fit
from geodrake.diagnosis.further_columns import with_columns, with_episodes
from geodrake.diagnosis.judgement import gain_of
from geodrake.diagnosis.proposals import suggested_of
from geodrake.diagnosis.results import Explanation
from geodrake.diagnosis.steps import steps_of
from geodrake.diagnosis.stepwise_search import Trail, tuned
from geodrake.effects import Effect, FittedEffect, Role, effect_class
from geodrake.effects.user_code import candidates_of
from geodrake.errors import ArgumentError
from geodrake.identification.logs.case import Case, error_table, open_case
from geodrake.identification.logs.compare import comparison
from geodrake.identification.logs.criteria import LOOSER_PRIORS
from geodrake.identification.logs.hypothesis import Hypothesis, first_hypothesis
from geodrake.identification.logs.model_fit import model_unknowns
from geodrake.identification.models.bodies import changed_bodies
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel


def add(
    effect: str,
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    where: Sequence[str] | None = None,
    extra: Sequence[type[Effect]] = (),
    bandwidth: float | None = None,
    blocks: int | None = None,
) -> Explanation:
    """Add an effect to a model and refit, whatever the evidence for it.

    Args:
        effect: Name of the effect; one that says the bodies are wrong lets the inertial
            parameters go, and one of an episode acts in the windows that the residual shows.
        model: The model as it stands.
        logs: Logs or their files.
        where: Joints or bodies, or the two joints of a pair; by default all joints (a delay is
            then that of all efforts), or the body that helps most, or of the pairs of joints that
            follow each other the one that does.
        extra: Effect classes of the user's own that may be named.
        bandwidth: Bandwidth of the filter, Hz; by default that of the model's fit to the same logs,
            or chosen from the data.
        blocks: Blocks into which every log is cut for validation.

    Returns:
        An explanation of one step, with held-out errors before and after.

    Raises:
        ArgumentError: There is no such effect or place, the effect takes no place, the model has it
            there already, or it is not identifiable from these logs with this model.
        LogError: A log cannot be used.
    """
    instance(model, "model", RobotModel)
    where = tuple(dict.fromkeys(instances(() if where is None else where, "where", str))) or None
    _refuse_what_cannot_be(effect, model, where, extra)
    case = open_case(model, logs, candidates=True, extra=extra, bandwidth=bandwidth, blocks=blocks)
    start = first_hypothesis(case.dataset, model_unknowns(case.dataset, model))
    if model.information is None:
        start = tuned(start)
    kind = effect_class(effect, extra)
    if kind.role is Role.EPISODE:
        case, trail = _with_episodes(kind, case, start)
    else:
        case, trail = _with_shapes(kind, case, start, where)
    after_case, fit, _ = final_fit(case, trail.end)
    _refuse_unidentifiable(fit.model, set(trail.end.unknowns.effects) - set(start.unknowns.effects))
    before, after = comparison(case), comparison(after_case, fit.unknowns, fit.held_out)
    return Explanation(
        verdict_of(after.errors, found=True),
        steps_of(case, trail, fit),
        before.errors,
        error_table(case.dataset, trail.start.held_out),
        after.errors,
        fit.model,
        before,
        after,
        (*case.notes, *fit.result.notes),
        changed_bodies(model, fit),
        dict(zip(case.dataset.joints, fit.of_motion.tolist(), strict=True)),
        certificate=fit.result.certificate,
    )


def _refuse_what_cannot_be(
    effect: str,
    model: RobotModel,
    where: Sequence[str] | None,
    extra: Sequence[type[Effect]],
) -> None:
    """Raises an ArgumentError for what no log could add."""
    role = effect_class(effect, extra).role
    late = role is Role.DELAY
    if where and role in (Role.INERTIA, Role.EPISODE):
        shown = role is Role.EPISODE
        whose = "where the residual shows it" if shown else "one of the whole robot"
        raise ArgumentError(f"{effect} is {whose} and takes no place.")
    known = model.joints if late else (*model.joints, *model.bodies)
    for name in where or ():
        if name not in known:
            raise ArgumentError(
                f"There is no joint {'' if late else 'or body '}{name!r}.",
                advice=f"There are: {', '.join(known)}.",
            )


def _refuse_unidentifiable(fitted: RobotModel, added: set[Effect]) -> None:
    """Raises an ArgumentError for an effect of which no parameter is identifiable."""
    missing = [f.effect for f in fitted.effects if f.effect in added and _is_unidentifiable(f)]
    if missing and len(missing) == len(added):
        raise ArgumentError(
            f"{missing[0].name} at {', '.join(effect.place for effect in missing)} is not "
            "identifiable from these logs, in which its columns are zero.",
            advice="Check its columns, or record a motion in which it acts.",
        )


def _is_unidentifiable(fitted: FittedEffect) -> bool:
    return fitted.deviations is not None and not np.isfinite(fitted.deviations).any()


def _with_episodes(kind: type[Effect], case: Case, start: Hypothesis) -> tuple[Case, Trail]:
    """The episodes that the residual shows."""
    case, trail, found = with_episodes(case, Trail(start, start))
    if not found:
        raise ArgumentError(
            f"No {kind.name} stands out of what the model gets wrong in these logs.",
            advice="Friction may cover it up: explain the logs, or add what else is missing first.",
        )
    return case, trail


def _with_shapes(
    kind: type[Effect], case: Case, start: Hypothesis, where: Sequence[str] | None
) -> tuple[Case, Trail]:
    """An effect where it is asked for or helps most, in the shape that explains most."""
    offered = {candidate.name for candidate in case.dataset.effects}
    if kind.needs_known_inertia and kind.name not in offered:
        raise ArgumentError(
            f"{kind.name} is identifiable only if inertias or payloads are known; here none are.",
            advice="Take a model that was fitted to other logs (explain those, with --save), or a "
            "log with a known payload beside one without.",
        )
    more = _without_columns(kind, case, start, where)
    if more:
        case, trail = with_columns(case, Trail(start, start), [*case.dataset.effects, *more])
        start = trail.start
    end = _with(kind, start, case, where)
    trail, present = Trail(start, end), set(start.unknowns.effects)
    if to_profile(end, case.dataset.effects, present):
        case, trail = with_continuous_shapes(case, trail, case.dataset.effects, present)
    return case, trail


def _without_columns(
    kind: type[Effect], case: Case, start: Hypothesis, where: Sequence[str] | None
) -> tuple[Effect, ...]:
    """What may be added of a kind that a case has no columns for: by the residual, or as asked."""
    if kind.places != "joint_pair":
        return suggested_of(case, start, kind.name) if kind.proposer else ()
    pairs = other_pairs(case.model, case.model.single_joints)
    asked = [pair for pair in pairs if sorted(pair) == sorted(where or ())]
    found = [effect for pair in asked for effect in candidates_of(kind, pair)]
    return tuple(effect for effect in found if effect not in case.dataset.effects)


def _with(
    kind: type[Effect], start: Hypothesis, case: Case, where: Sequence[str] | None
) -> Hypothesis:
    if kind.role is Role.DELAY:
        return _late(start, case, where)
    if kind.role is Role.INERTIA:
        looser = [start.loosened(factor / start.looseness) for factor in LOOSER_PRIORS]
        return max(looser, key=lambda h: gain_of(start, h))
    options: dict[tuple[str, ...], list[Effect]] = {}
    for candidate in case.dataset.effects:
        if candidate.name == kind.name and candidate not in start.unknowns.effects:
            options.setdefault(candidate.where, []).append(candidate)
    if "temperature" in kind.depends_on and not options:
        raise ArgumentError(
            f"{kind.name} can be added nowhere: no log has a temperature of a joint that changes, "
            "or the model has it already.",
            advice="Log it as <joint>.temperature, in °C, while the robot warms up or cools down.",
        )
    places = _places(kind.name, options, where)
    best = [
        max((start.with_effects([c]) for c in options[place]), key=lambda h: gain_of(start, h))
        for place in places
    ]
    added = [h.unknowns.effects[-1] for h in best]
    if where is None and added[0].places != "joint":
        return max(best, key=lambda h: gain_of(start, h))
    return start.with_effects(added)


def _late(start: Hypothesis, case: Case, where: Sequence[str] | None) -> Hypothesis:
    """The best delay of all efforts, or of those of each of some joints."""
    every, grid = tuple(range(len(case.model.joints))), range(1, len(case.dataset.delays))
    together = [every] if where is None else [(case.model.joints.index(name),) for name in where]
    end = start
    for joints in together:
        end = max((delayed_at(end, joints, d) for d in grid), key=lambda h: gain_of(start, h))
    return end


def _places(
    effect: str,
    options: dict[tuple[str, ...], list[Effect]],
    where: Sequence[str] | None,
) -> list[tuple[str, ...]]:
    if where is None:
        if options:
            return list(options)
        raise ArgumentError(
            f"{effect} can be added nowhere: the model has it already, or no joint that moves in "
            "the logs, pair of joints or body can have it."
        )
    if pair := [place for place in options if sorted(place) == sorted(where)]:
        return pair
    missing = [name for name in where if (name,) not in options]
    possible = ", ".join(" & ".join(place) for place in options)
    if missing:
        raise ArgumentError(
            f"{effect} cannot be added at {', '.join(missing)}: it is there already, or does not "
            "act at such a place.",
            advice=f"It can be added {'at ' + possible if possible else 'nowhere else'}.",
        )
    return [(name,) for name in where]
