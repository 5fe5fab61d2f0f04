"""Effects by name: the catalogue, and the form effects have in saved models."""

from __future__ import annotations

import difflib
import inspect
import pkgutil
import sys
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from importlib import import_module
from types import ModuleType
from typing import Any

from geodrake.boundary.arguments import instance, instances
from geodrake.effects.base import Effect
from geodrake.effects.parameter import whole_numbers
from geodrake.effects.place import PLACES
from geodrake.effects.role import Role
from geodrake.errors import ArgumentError


@cache
def catalogue() -> tuple[type[Effect], ...]:
    """The effects that come with geodrake, one a module of this package, by `list_position`."""
    package = sys.modules[__package__]
    names = [module.name for module in pkgutil.iter_modules(package.__path__)]
    modules = [import_module(f"{__package__}.{name}") for name in names]
    found = [effect for module in modules for effect in effects_in(module)]
    return tuple(sorted(found, key=lambda effect: (effect.list_position, effect.name)))


def effects_in(module: ModuleType) -> list[type[Effect]]:
    """The effects that a module defines; classes left abstract are none."""
    return [effect for effect in classes_in(module) if not inspect.isabstract(effect)]


def classes_in(module: ModuleType) -> list[type[Effect]]:
    """The classes of effects that a module defines, the abstract ones too."""
    return [
        value
        for value in dict.fromkeys(filter(inspect.isclass, vars(module).values()))
        if issubclass(value, Effect) and value.__module__ == module.__name__
    ]


def effect_of(role: Role) -> type[Effect]:
    """The first effect of the catalogue that has a role."""
    return next(effect for effect in catalogue() if effect.role is role)


def effect_class(name: str, extra: Sequence[type[Effect]] = ()) -> type[Effect]:
    """The effect of a name.

    Args:
        extra: Effects that are not in the catalogue, such as those of `load_effect_file`.

    Raises:
        ArgumentError: There is no such effect; the message has the nearest names.
    """
    instance(name, "the name of an effect", str)
    effects = {effect.name: effect for effect in (*catalogue(), *instances(extra, "extra", type))}
    if name not in effects:
        near = difflib.get_close_matches(name, effects, cutoff=0.5)
        names = ", ".join(near or effects)
        raise ArgumentError(
            f"There is no effect {name!r}.",
            advice=f"Did you mean {names}?" if near else f"Effects are: {names}.",
            nearest=near,
        )
    return effects[name]


@lru_cache
def _fields(cls: type[Effect]) -> tuple[str, ...]:
    """What an effect is made of, by name."""
    return tuple(inspect.signature(cls).parameters)


def make_effect(
    name: str,
    where: Sequence[str],
    shape: Mapping[str, Any] | None = None,
    extra: Sequence[type[Effect]] = (),
) -> Effect:
    """An effect from the form it has in a saved model: its `name`, `where` and `shape`.

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
        raise ArgumentError(f"{name} needs {place.wanted}; it got {where!r}.")
    known = [field for field in _fields(cls) if field != place.field]
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
            f"{name} cannot be made of {shape}: {error}.",
            advice=f"Its shape parameters are {', '.join(known)}.",
        ) from error
