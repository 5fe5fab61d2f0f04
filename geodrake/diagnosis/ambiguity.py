"""Commands of `geodrake excite` that distinguish ambiguous effects."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from geodrake.diagnosis.results import Diagnosis, Explanation, Step
from geodrake.effects import Role, effect_class
from geodrake.effects.base import Effect
from geodrake.errors import ArgumentError
from geodrake.model.robot_model import RobotModel

_MOST = 4

Finding = tuple[str, Sequence[str]]
"""Name of an effect, or names joined by " + ", and its joints or bodies."""


def distinguishing_commands(result: Diagnosis | Explanation) -> tuple[str, ...]:
    """Return commands that design motions to distinguish ambiguous findings.

    They are `geodrake excite MODEL --tell-apart A,B[@PLACE]`, one for each pair that a motion can
    distinguish, a few at most. Delays, wrong inertias, effects of one log and rivals without a
    known place are excluded.
    """
    findings = _of_diagnosis(result) if isinstance(result, Diagnosis) else _of_explanation(result)
    pairs = dict.fromkeys(pair for one, other in findings for pair in _pair(one, other))
    return tuple(f"geodrake excite MODEL --tell-apart {pair}" for pair in [*pairs][:_MOST])


def _of_diagnosis(diagnosis: Diagnosis) -> Iterator[tuple[list[Finding], list[Finding]]]:
    """Yield the best candidate with each candidate tied with it."""
    if diagnosis.candidates:
        joints = {joint.joint for joint in diagnosis.start.joints}
        best, *others = ((_single(c.effect, c.where, joints), c.tied) for c in diagnosis.candidates)
        yield from ((best[0], other) for other, tied in others if tied)


def _of_explanation(explanation: Explanation) -> Iterator[tuple[list[Finding], list[Finding]]]:
    for step in explanation.steps:
        for rival in step.indistinguishable_from:
            where = _rivals_place(step, rival, explanation.model)
            if where is not None:
                yield [(step.effect, step.where)], [(rival, where)]


def _rivals_place(step: Step, name: str, model: RobotModel) -> Sequence[str] | None:
    """Return the place of a rival of a step; None if no motion can be designed."""
    effect, rival = _class(step.effect), _class(name)
    if effect is None or rival is None:
        return None
    for fitted in step.rivals:
        if name in fitted.names:
            places = dict(_single(fitted.effect, fitted.where, set(model.joints)))[name]
            shared = effect.places == rival.places and set(places).issuperset(step.where)
            return step.where if shared else places
    return None


def _single(names: str, where: Sequence[str], joints: set[str]) -> list[Finding]:
    """Return effects found together, each with the places of its own kind."""
    findings: list[Finding] = []
    for name in names.split(" + "):
        cls, places = _class(name), where
        if cls is not None and names != name:
            places = [place for place in where if (place in joints) == (cls.places != "body")]
        findings.append((name, places))
    return findings


def _pair(one: Sequence[Finding], other: Sequence[Finding]) -> list[str]:
    """Return `A,B@PLACE` of the effects in which two findings differ, or nothing."""
    first, second = [name for name, _ in one], [name for name, _ in other]
    own = [_placed(*finding) for finding in one if finding[0] not in second]
    others = [_placed(*finding) for finding in other if finding[0] not in first]
    a, b = next(filter(None, own), None), next(filter(None, others), None)
    if a is None or b is None:
        return []
    (name, place, kind), (rival, rival_place, other_kind) = a, b
    if place == rival_place and kind == other_kind:  # stated once, it applies to both
        place = ""
    return [f"{name}{place},{rival}{rival_place}"]


def _placed(name: str, where: Sequence[str]) -> tuple[str, str, str] | None:
    """Return name, `@place` and kind of place; no place for all or several joints."""
    cls = _class(name)
    if cls is None:
        return None
    count = {"joint": 1, "joint_pair": 2, "body": 1}.get(cls.places, 0)
    place = tuple(where[:1] if cls.places == "body" else where)
    if len(place) != count:
        return None if cls.places == "body" else (name, "", cls.places)
    return name, f"@{'+'.join(place)}" if place else "", cls.places


def _class(name: str) -> type[Effect] | None:
    """Return the effect for which a motion can be designed; None if there is none."""
    try:
        cls = effect_class(name)
    except ArgumentError:  # an effect of the user's own
        return None
    is_of_robot = cls.places != "log" and cls.role is not Role.EPISODE
    return cls if getattr(cls, "parameters", ()) and is_of_robot else None
