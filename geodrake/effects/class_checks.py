"""Whether a class of effects declares what `Effect` asks for, in the form it asks for."""

from __future__ import annotations

import difflib
import keyword
from collections.abc import Mapping
from dataclasses import fields
from inspect import get_annotations
from typing import Any

from geodrake.effects.base import SIGNALS, Effect, JointEffect
from geodrake.effects.deflection import DeflectionEffect
from geodrake.effects.episode import Episode, PointEpisode
from geodrake.effects.lookup import effect_of
from geodrake.effects.parameter import Parameter
from geodrake.effects.role import Proposer, Role
from geodrake.effects.shape import Shape
from geodrake.effects.shared_actuator import SharedActuatorEffect
from geodrake.errors import ArgumentError

_ALIKE = 0.8
"""Names as similar as this, 1 being the same, are taken for the same name with a slip."""

_KINDS: Mapping[type, tuple[Any, str]] = {
    str: (str, "words"),
    bool: (bool, "True or False"),
    int: (int, "a whole number"),
    float: ((int, float), "a number"),
    tuple: ((tuple, list), "a tuple"),
    frozenset: ((frozenset, set), "a set"),
    Role: (Role, "a Role"),
}
"""What may stand where a class attribute of `Effect` is of a type, also in words."""

_RELATIONS = ("contains",)
_BASES: Mapping[Role, type] = {
    Role.DEFLECTION: DeflectionEffect,
    Role.EPISODE: Episode,
}
"""What an effect of a role derives from, where that is not the one effect that has it."""
_PROPOSED: Mapping[Proposer, type] = {
    Proposer.BENDING: DeflectionEffect,
    Proposer.PLAY: DeflectionEffect,
    Proposer.SHARED_ACTUATOR: SharedActuatorEffect,
    Proposer.WAVES: JointEffect,
    Proposer.WARMING: JointEffect,
    Proposer.BRISTLES: JointEffect,
    Proposer.EPISODE: PointEpisode,
    Proposer.HANDLING: Episode,
}
"""What an effect of a proposer derives from."""
_BY_COURSE = (Proposer.WARMING, Proposer.BRISTLES)


def check_class(effect: type[Effect]) -> None:
    """Refuse a class of effects whose class attributes are not what `Effect` says.

    Raises:
        ArgumentError: One is not.
    """
    _check_names(effect)
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
    for attribute in Effect.__annotations__:
        kind = type(getattr(Effect, attribute, None))
        value = getattr(effect, attribute)
        if kind in _KINDS and not isinstance(value, property):
            kinds, wanted = _KINDS[kind]
            if not isinstance(value, kinds) or (isinstance(value, bool) and kind is not bool):
                raise _of_class(effect, f"{attribute} = {value!r:.60}", wanted)
    if not effect.depends_on <= SIGNALS:
        signals = ", ".join(sorted(SIGNALS))
        raise _of_class(effect, f"depends_on = {effect.depends_on!r:.60}", f"some of {signals}")
    if not all(isinstance(shape, Shape) for shape in effect.shapes):
        raise _of_class(effect, f"shapes = {effect.shapes!r:.60}", "a tuple of Shape")
    if effect.state_count < 0:
        raise _of_class(effect, f"state_count = {effect.state_count}", "0 or more")
    _check_relations(effect)
    _check_base(effect)


def _check_names(effect: type[Effect]) -> None:
    """Refuse attributes that hide a method of geodrake's, or are a declaration but for a letter."""
    own = [kind for kind in effect.__mro__ if issubclass(kind, Effect) and not _is_ours(kind)]
    ours: Any = next(kind for kind in effect.__mro__ if _is_ours(kind))
    declared = set(Effect.__annotations__)
    for kind in own:
        known = declared | set(get_annotations(kind))
        for attribute, value in tuple(vars(kind).items()):
            if attribute in known or attribute.startswith("_") or _is_code(value):
                continue
            has, hidden = f"{attribute} = {value!r:.60}", getattr(ours, attribute, None)
            if hidden is not None and not getattr(hidden, "__isabstractmethod__", False):
                raise _of_class(effect, has, "a method of that name")
            if near := difflib.get_close_matches(attribute, declared, 1, _ALIKE):
                raise _of_class(effect, f"{has}, which nothing reads", near[0])


def _is_ours(kind: type) -> bool:
    return kind.__module__.partition(".")[0] == "geodrake"


def _is_code(value: Any) -> bool:
    """Return whether what a class has is a method, a property or another class."""
    return callable(value) or hasattr(value, "__get__")


def _check_relations(effect: type[Effect]) -> None:
    """Refuse what names other effects in another form than `Effect` says."""
    for attribute in _RELATIONS:
        if not all(_is_effect(each) for each in getattr(effect, attribute)):
            has = f"{attribute} = {getattr(effect, attribute)!r:.60}"
            raise _of_class(effect, has, "a tuple of classes of effects")
    if not (effect.companion is None or _is_effect(effect.companion)):
        has = f"companion = {effect.companion!r:.60}"
        raise _of_class(effect, has, "the class of an effect, or None")


def _check_base(effect: type[Effect]) -> None:
    """Refuse a role or a proposer whose methods and fields the effect does not have."""
    role, proposer = effect.role, effect.proposer
    if role is not Role.FORCE:
        base = _BASES.get(role) or effect_of(role)
        if not issubclass(effect, base):
            raise _of_class(effect, f"role = {role}", f"the base {base.__name__} for it")
    if proposer is None:
        return
    if not isinstance(proposer, Proposer):
        raise _of_class(effect, f"proposer = {proposer!r:.60}", "a Proposer, or None")
    base = _PROPOSED[proposer]
    if not issubclass(effect, base):
        raise _of_class(effect, f"proposer = {proposer}", f"the base {base.__name__} for it")
    if proposer is Proposer.WAVES and len(field_names(effect)) != 2:
        has = f"proposer = {proposer} and the fields {field_names(effect)}"
        raise _of_class(effect, has, "the joint and the order of the waves as its fields")
    if proposer in _BY_COURSE and effect.course is Effect.course:
        raise _of_class(effect, f"proposer = {proposer}", "the method course() for it")


def _is_effect(value: Any) -> bool:
    return isinstance(value, type) and issubclass(value, Effect)


def _of_class(effect: type[Effect], has: str, wanted: str) -> ArgumentError:
    return ArgumentError(f"The effect {effect.__name__} has {has}; it needs {wanted}.")


def field_names(effect: type[Effect]) -> list[str]:
    """Return the fields of an effect: where it is, and its shape parameters."""
    return [field.name for field in fields(effect)]  # type: ignore[arg-type]
