"""Which motion would tell apart the effects that logs cannot: what to ask `geodrake excite` for."""

from __future__ import annotations

from collections.abc import Sequence

from geodrake.diagnosis.results import Diagnosis, Explanation
from geodrake.effects import effect_class
from geodrake.errors import ArgumentError

_MOST = 4


def telling_commands(found: Diagnosis | Explanation) -> tuple[str, ...]:
    """Commands that design the motions by which ambiguous findings would be settled.

    Args:
        found: What logs told. Its findings may have rivals that the logs cannot tell from them.

    Returns:
        `geodrake excite MODEL --tell-apart A,B[@PLACE]`, one for each pair that a motion can tell
        apart, a few at most; a delay and a wrong inertia are none of these.
    """
    pairs: dict[str, None] = {}
    if isinstance(found, Diagnosis):
        best, *others = found.candidates or [None]
        for other in others:
            if best is not None and other is not None and other.tied:
                pair = _pair((best.effect, best.where), (other.effect, other.where))
                pairs |= dict.fromkeys(pair)
    else:
        for step in found.steps:
            for rival in step.indistinguishable_from:
                pairs |= dict.fromkeys(_pair((step.effect, step.where), (rival, step.where)))
    return tuple(f"geodrake excite MODEL --tell-apart {pair}" for pair in [*pairs][:_MOST])


def _pair(one: tuple[str, Sequence[str]], other: tuple[str, Sequence[str]]) -> list[str]:
    """`A,B@PLACE` of what one finding has and the other has not; nothing if there is no such."""
    (name, where), (rival, there) = one, other
    first, second = name.split(" + "), rival.split(" + ")
    mine = [_named(n, where) for n in first if n not in second]
    yours = [_named(n, there) for n in second if n not in first]
    a, b = next(filter(None, mine), None), next(filter(None, yours), None)
    if a is None or b is None:
        return []
    if a.partition("@")[2] == b.partition("@")[2]:
        a = a.partition("@")[0]
    return [f"{a},{b}"]


def _named(name: str, where: Sequence[str]) -> str | None:
    """`name@place`, or the name alone if it is everywhere or at several joints."""
    try:
        cls = effect_class(name)
    except ArgumentError:  # wrong_inertia, or an effect of the user's own
        return None
    if not getattr(cls, "parameters", ()) or cls.places == "log":
        return None
    if cls.places == "body":
        return f"{name}@{where[0]}" if where else None
    count = {"joint": 1, "joint_pair": 2}.get(cls.places)
    return f"{name}@{'+'.join(where)}" if len(where) == count else name
