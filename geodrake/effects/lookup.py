"""Effects by name: the catalogue, and the form effects have in saved models."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

from geodrake.boundary.arguments import instance, instances
from geodrake.effects.base import Effect
from geodrake.effects.declarations import PLACES, Role, whole_numbers
from geodrake.errors import ArgumentError

FAMILIES = ("friction", "sensors", "motor_and_transmission", "bodies", "environment")
"""Modules of this package that have the effects of the catalogue, in its order."""


@cache
def catalogue() -> tuple[type[Effect], ...]:
    """Return geodrake's effects by family, in the order of definition."""
    modules = [import_module(f"{__package__}.{name}") for name in FAMILIES]
    return tuple(effect for module in modules for effect in effects_in(module))


@cache
def file_effects() -> tuple[type[Effect], ...]:
    """Return the effects that model files state, and no diagnosis proposes."""
    return tuple(effects_in(import_module(f"{__package__}.of_files")))


def effects_in(module: ModuleType) -> list[type[Effect]]:
    """Return the effects that a module defines, abstract classes left out."""
    return [effect for effect in classes_in(module) if not inspect.isabstract(effect)]


def classes_in(module: ModuleType) -> list[type[Effect]]:
    """Return the classes of effects that a module defines, the abstract ones too."""
    return [
        value
        for value in dict.fromkeys(filter(inspect.isclass, vars(module).values()))
        if issubclass(value, Effect) and value.__module__ == module.__name__
    ]


def effect_of(role: Role) -> type[Effect]:
    """Return the first effect of the catalogue that has a role."""
    return next(effect for effect in catalogue() if effect.role is role)


def table_rows() -> list[tuple[str, str, str]]:
    """Name, needed effort and place of every effect of the catalogue, for the table of the docs."""
    places = [PLACES[effect.places].words for effect in catalogue()]
    return [
        (effect.name, effect.law, f"{place}, window" if effect.role is Role.EPISODE else place)
        for effect, place in zip(catalogue(), places, strict=True)
    ]


def effect_class(name: str, extra: Sequence[type[Effect]] = ()) -> type[Effect]:
    """Return the effect of a name.

    Args:
        extra: Effects that are not in the catalogue, such as those of `load_effect_file`.

    Raises:
        ArgumentError: There is no such effect; the message has the nearest names.
    """
    instance(name, "the name of an effect", str)
    known = (*catalogue(), *instances(extra, "extra", type))
    effects = {effect.name: effect for effect in (*file_effects(), *known)}
    if name not in effects:
        own = [effect.name for effect in known]
        near = difflib.get_close_matches(name, own, cutoff=0.5)
        names = ", ".join(near or own)
        raise ArgumentError(
            f"There is no effect {name!r}.",
            advice=f"Did you mean {names}?" if near else f"Effects are {names}.",
            nearest=near,
        )
    return effects[name]


def make_effect(
    name: str,
    where: Sequence[str],
    shape: Mapping[str, Any] | None = None,
    extra: Sequence[type[Effect]] = (),
) -> Effect:
    """Return an effect from the form it has in a saved model: its `name`, `where` and `shape`.

    Args:
        shape: Its shape parameters by name; those left out have their default.

    Raises:
        ArgumentError: There is no such effect, or place or shape parameters do not fit it.
    """
    cls = effect_class(name, extra)
    shape = {} if shape is None else dict(instance(shape, "shape", Mapping))
    where = where if isinstance(where, str) else instances(where, "where", str)
    place = PLACES[cls.places]
    if isinstance(where, str) or len(where) not in place.counts:
        raise ArgumentError(f"{name} needs {place.wanted}; got {where!r}.")
    known = [field for field in inspect.signature(cls).parameters if field != place.field]
    unknown = [key for key in shape if key not in known]
    if unknown:
        raise ArgumentError(
            f"{name} has no shape parameter {unknown[0]!r}.",
            advice=f"It has {', '.join(known)}." if known else "It has none.",
        )
    shape = whole_numbers(cls, shape)
    if where:
        shape[place.field] = tuple(where) if 2 in place.counts else where[0]
    try:
        return cls(**shape)
    except TypeError as error:
        raise ArgumentError(
            f"{name} cannot be constructed with {shape}: {error}.",
            advice=f"Its shape parameters are {', '.join(known)}.",
        ) from error
