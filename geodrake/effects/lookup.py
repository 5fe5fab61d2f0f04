"""Effects by name: the catalogue, and effects of saved models."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

from geodrake.boundary.arguments import instance, instances
from geodrake.effects.base import Effect, JointEffect
from geodrake.effects.declarations import PLACES, Role, whole_numbers
from geodrake.errors import ArgumentError

FAMILIES = ("friction", "sensors", "motor_and_transmission", "bodies", "environment")
"""Modules of this package that define the catalogue, in its order."""


@cache
def catalogue() -> tuple[type[Effect], ...]:
    """Return geodrake's effects by family, in the order of definition."""
    modules = [import_module(f"{__package__}.{name}") for name in FAMILIES]
    return tuple(effect for module in modules for effect in effects_in(module))


@cache
def file_effects() -> tuple[type[Effect], ...]:
    """Return the effects that come from model files only; no diagnosis proposes them."""
    return tuple(effects_in(import_module(f"{__package__}.of_files")))


@cache
def servo_effects() -> dict[str, type[JointEffect]]:
    """Return the effects of a joint that a fit of its servo estimates, by parameter."""
    known = (*catalogue(), *file_effects())
    return {e.file_term.servo: e for e in known if issubclass(e, JointEffect) and e.file_term.servo}


def effects_in(module: ModuleType) -> list[type[Effect]]:
    """Return the concrete effects that a module defines."""
    return [effect for effect in classes_in(module) if not inspect.isabstract(effect)]


def classes_in(module: ModuleType) -> list[type[Effect]]:
    """Return the effect classes that a module defines, including abstract ones."""
    return [
        value
        for value in dict.fromkeys(filter(inspect.isclass, vars(module).values()))
        if issubclass(value, Effect) and value.__module__ == module.__name__
    ]


def effect_of(role: Role) -> type[Effect]:
    """Return the first effect of the catalogue that has a role."""
    return next(effect for effect in catalogue() if effect.role is role)


def table_rows() -> list[tuple[str, str, str]]:
    """Return name, needed effort and place of each catalogue effect, for the table of the docs."""
    places = [PLACES[effect.places].words for effect in catalogue()]
    return [
        (effect.name, effect.law, f"{place}, window" if effect.role is Role.EPISODE else place)
        for effect, place in zip(catalogue(), places, strict=True)
    ]


def effect_class(name: str, extra: Sequence[type[Effect]] = ()) -> type[Effect]:
    """Return the effect class with a name.

    Args:
        extra: Effects that are not in the catalogue, such as those of `load_effect_file`.

    Raises:
        ArgumentError: There is no such effect; the message suggests similar names.
    """
    instance(name, "the name of an effect", str)
    known = (*catalogue(), *instances(extra, "extra", type))
    effects = {effect.name: effect for effect in (*file_effects(), *known)}
    if name not in effects:
        valid = [effect.name for effect in known]
        similar = difflib.get_close_matches(name, valid, cutoff=0.5)
        names = ", ".join(similar or valid)
        raise ArgumentError(
            f"There is no effect {name!r}.",
            advice=f"Did you mean {names}?" if similar else f"Effects are {names}.",
            nearest=similar,
        )
    return effects[name]


def make_effect(
    name: str,
    where: Sequence[str],
    shape: Mapping[str, Any] | None = None,
    extra: Sequence[type[Effect]] = (),
) -> Effect:
    """Return the effect that a saved model describes by `name`, `where` and `shape`.

    Args:
        shape: Shape parameters by name; missing ones have their default.

    Raises:
        ArgumentError: There is no such effect, or its place or shape parameters are invalid.
    """
    cls = effect_class(name, extra)
    shape = {} if shape is None else dict(instance(shape, "shape", Mapping))
    where = where if isinstance(where, str) else instances(where, "where", str)
    place = PLACES[cls.places]
    if isinstance(where, str) or len(where) not in place.counts:
        raise ArgumentError(f"{name} needs {place.wanted}; got {where!r}.")
    shape = cls.fields_of(where, shape)
    known = [field for field in inspect.signature(cls).parameters if field != place.field]
    unknown = [key for key in shape if key not in known]
    if unknown:
        raise ArgumentError(
            f"{name} has no shape parameter {unknown[0]!r}.",
            advice=f"It has {', '.join(known)}." if known else "It has none.",
        )
    shape = whole_numbers(cls, shape)
    if where:
        shape[place.field] = tuple(where) if max(place.counts) > 1 else where[0]
    try:
        return cls(**shape)
    except TypeError as error:
        raise ArgumentError(
            f"{name} cannot be constructed with {shape}: {error}.",
            advice=f"Its shape parameters are {', '.join(known)}.",
        ) from error
