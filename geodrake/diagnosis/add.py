"""Addition of one effect to a model, with a refit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import instance, instances
from geodrake.diagnosis.coupled import other_pairs
from geodrake.diagnosis.explain import explained
from geodrake.diagnosis.findings import findings_of
from geodrake.diagnosis.results import Explanation
from geodrake.diagnosis.search import Search
from geodrake.effects import Effect, Role, effect_class
from geodrake.effects.user_effects import candidates_of
from geodrake.errors import ArgumentError, nearest
from geodrake.identification.logs.case import Case, prepare_case
from geodrake.logs.motion import JointLog
from geodrake.model.holding import why_no_place
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
    hold_resting: bool = True,
) -> Explanation:
    """Add an effect to a model and refit, whatever the evidence for it.

    Wrong bodies free the inertial parameters, and episodes act in windows found in the residual.
    Places `where` are joints, bodies, or the two joints of a pair; by default all joints (a delay
    then applies to all efforts), or the body or pair of neighbouring joints with the largest
    improvement. Other arguments are those of `explain`. The explanation has one step, with held-out
    errors before and after.

    Raises:
        ArgumentError: There is no such effect or place, the effect takes no place, the model has it
            there already, or it is not identifiable from these logs with this model.
        LogError: A log cannot be used.
    """
    instance(model, "model", RobotModel)
    where = tuple(dict.fromkeys(instances(() if where is None else where, "where", str))) or None
    kind = effect_class(effect, extra)
    _check_effect(kind, model, where)
    case = prepare_case(
        model,
        logs,
        candidates=True,
        extra=extra,
        bandwidth=bandwidth,
        blocks=blocks,
        hold_resting=hold_resting,
    )
    _check_effect(kind, case.model, where)
    search = Search(case, everywhere=True).forced(
        kind, _places(kind, case, where), _further(kind, case, where)
    )
    findings = [finding for finding in findings_of(search) if finding.name == kind.name]
    result = explained(case, search, findings, forced=True).explanation
    added = {term.effect for term in search.fit.terms}
    _check_identifiable(result.model, {e for e in added if e is not None})
    return result


def _check_effect(kind: type[Effect], model: RobotModel, where: Sequence[str] | None) -> None:
    """Raise an ArgumentError for effects that cannot be added with any log."""
    if where and kind.role in (Role.INERTIA, Role.EPISODE):
        is_episode = kind.role is Role.EPISODE
        reason = "is found in the residual" if is_episode else "applies to the whole robot"
        raise ArgumentError(f"{kind.name} {reason}, so it takes no place.")
    kinds = ["joint"] if kind.role is Role.DELAY else ["joint", "body"]
    check_places(model, where or (), kinds=kinds)


def check_places(
    model: RobotModel, where: Sequence[str], *, kinds: Sequence[str] = ("joint", "body")
) -> None:
    """Raise an ArgumentError unless a model has joints or bodies of all names."""
    places = {"joint": model.joints, "body": model.bodies}
    known = [name for kind in kinds for name in places[kind]]
    for name in where:
        if name not in known:
            raise ArgumentError(
                f"The model has no {' or '.join(kinds)} {name!r}.",
                advice=f"{why_no_place(model, name) or nearest(name, known)}"
                f"It has {', '.join(known)}.",
            )


def _check_identifiable(fitted: RobotModel, added: set[Effect]) -> None:
    """Raise an ArgumentError for an effect without identifiable parameters."""
    missing = [
        f.effect
        for f in fitted.effects
        if f.effect in added and f.deviations is not None and not np.isfinite(f.deviations).any()
    ]
    if missing and len(missing) == len(added):
        raise ArgumentError(
            f"{missing[0].name} at {', '.join(effect.place for effect in missing)} is not "
            "identifiable from these logs, in which its columns are zero.",
            advice="Check its columns, or record a motion in which it acts.",
        )


def _further(kind: type[Effect], case: Case, where: Sequence[str] | None) -> tuple[Effect, ...]:
    """Return the requested effects at joints that are not neighbours."""
    if kind.places != "joint_pair":
        return ()
    pairs = other_pairs(case.model, case.model.single_joints)
    requested = [pair for pair in pairs if sorted(pair) == sorted(where or ())]
    return tuple(each for pair in requested for each in candidates_of(kind, pair))


def _places(
    kind: type[Effect], case: Case, where: Sequence[str] | None
) -> tuple[tuple[str, ...], ...] | None:
    """Return the places of the effect; None for all places, or for the best one."""
    offered = {e.name for e in case.dataset.effects}
    if kind.needs_known_inertia and kind.name not in offered:
        raise ArgumentError(
            f"{kind.name} is identifiable only with known inertias or payloads, and there "
            "are none.",
            advice="Use a model that was fitted to other logs (explain those, with --save), or "
            "a log with a known payload and one without.",
        )
    if kind.role in (Role.DELAY, Role.INERTIA, Role.EPISODE):
        return None if where is None else tuple((name,) for name in where)
    known = {(type(f.effect), f.effect.where) for f in case.model.effects}
    options = dict.fromkeys(
        e.where
        for e in (*case.dataset.effects, *_further(kind, case, where))
        if isinstance(e, kind) and (type(e), e.where) not in known
    )
    single = case.model.single_joints
    if kind.places == "joint" and kind.proposer is not None:  # its shapes follow from the residual
        options |= dict.fromkeys((joint,) for joint in single)
    if "temperature" in kind.depends_on and not options:
        raise ArgumentError(
            f"{kind.name} cannot be added: no log has a changing temperature of a joint, or "
            "the model already has it.",
            advice="Log it as <joint>.temperature, in °C, while the robot warms up or cools down.",
        )
    if kind.of_force_sensor and not options:
        raise ArgumentError(
            f"{kind.name} cannot be added: no log has contact forces, or the model already has it.",
            advice="Log them as <link>.force.x, y and z, in N, and use --floating.",
        )
    if not options:
        raise ArgumentError(
            f"{kind.name} cannot be added: the model already has it, or no suitable joint, "
            "pair of joints or body moves in the logs."
        )
    if where is None:
        return None
    if pair := [place for place in options if sorted(place) == sorted(where)]:
        return tuple(pair)
    missing = [name for name in where if (name,) not in options]
    possible = ", ".join(" & ".join(place) for place in options)
    if missing:
        raise ArgumentError(
            f"{kind.name} cannot be added at {', '.join(missing)}: it exists there, or "
            "cannot act there.",
            advice=f"Possible places: {possible or 'none'}.",
        )
    return tuple((name,) for name in where)
