"""The doors to effects of a user's own: their classes and their candidates."""

from __future__ import annotations

import keyword
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any

from geodrake.effects.base import Effect
from geodrake.effects.columns import line_of, telling
from geodrake.effects.parameter import Parameter
from geodrake.errors import ArgumentError

_MOST_CANDIDATES = 1000

_FLAGS = (
    "turning_only",
    "from_residual",
    "needs_known_inertia",
    "expandable",
    "sees_bodies",
    "sees_time",
    "is_force",
)


def check_class(effect: type[Effect]) -> None:
    """Refuse a class of effects whose class attributes are not what `Effect` says.

    Raises:
        ArgumentError: One is not.
    """
    name: Any = effect.name
    if not (isinstance(name, str) and name.isidentifier() and not keyword.iskeyword(name)):
        raise _of_class(effect, f"the name {name!r}", "words joined by underscores")
    parameters: Any = effect.parameters
    if not (
        isinstance(parameters, tuple | list)
        and len(parameters)
        and all(isinstance(parameter, Parameter) for parameter in parameters)
    ):
        raise _of_class(
            effect, f"parameters = {parameters!r:.60}", "a tuple of one Parameter or more"
        )
    names = [parameter.name for parameter in parameters]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise _of_class(effect, f"two parameters {twice[0]!r}", "a name of its own for each")
    if not isinstance(effect.signature, str):
        raise _of_class(effect, f"signature = {effect.signature!r:.60}", "words")
    confused: Any = effect.confused_with
    if not (isinstance(confused, tuple | list) and all(isinstance(n, str) for n in confused)):
        raise _of_class(effect, f"confused_with = {confused!r:.60}", "a tuple of names")
    for flag in _FLAGS:
        if not isinstance(getattr(effect, flag), bool | property):
            raise _of_class(effect, f"{flag} = {getattr(effect, flag)!r:.60}", "True or False")
    count: Any = effect.state_count
    if not (isinstance(count, int) and count >= 0):
        raise _of_class(effect, f"state_count = {count!r:.60}", "a whole number, 0 for none")


def _of_class(effect: type[Effect], has: str, wanted: str) -> ArgumentError:
    return ArgumentError(f"The effect {effect.__name__} has {has}; it needs {wanted}.")


def candidates_of(effect: type[Effect], *place: Any) -> tuple[Effect, ...]:
    """What `Effect.candidates` gives at a place.

    Raises:
        ArgumentError: They are no instances of the effect, or endlessly many.
    """
    line = line_of(effect, "candidates")
    with telling(effect.name, line):
        made: Any = effect.candidates(*place)
        listed = isinstance(made, Sequence | Iterator | frozenset | set)
        found = list(islice(made, _MOST_CANDIDATES + 1)) if listed else [made]
    if len(found) > _MOST_CANDIDATES:
        raise ArgumentError(f"{effect.name} has more than {_MOST_CANDIDATES} candidates{line}.")
    wrong = [one for one in found if getattr(one, "name", None) != effect.name]
    if wrong:
        raise ArgumentError(
            f"{effect.name} has {wrong[0]!r:.80} among its candidates{line}.",
            advice="Let candidates() return instances of the effect.",
        )
    return tuple(found)
