"""Effects by name: the catalogue, and the form effects have in saved models."""

from __future__ import annotations

import difflib
import inspect
import pkgutil
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

from geodrake.boundary.arguments import instance, instances
from geodrake.effects.base import Effect
from geodrake.effects.parameter import whole_numbers
from geodrake.effects.role import Role
from geodrake.errors import ArgumentError

PLACE_FIELDS = {
    "joint": "joint",
    "joint_pair": "joints",
    "body": "body",
    "bodies": "",
    "robot": "",
    "log": "joint",
}
"""The field that says where an effect is, by what it is bound to."""


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


def table_rows() -> list[tuple[str, str, str]]:
    """Name, needed effort and place of every effect of the catalogue, for the table of README."""
    return [(effect.name, effect.law, _place_in_words(effect)) for effect in catalogue()]


def stub() -> str:
    """The text of `__init__.pyi`: the package's names, where type checkers find their types."""
    package = sys.modules[__package__]
    modules: dict[str, list[str]] = {}
    for name in sorted(package.__all__):
        modules.setdefault(getattr(package, name).__module__, []).append(name)
    lines = [f"from {module} import {', '.join(modules[module])}" for module in sorted(modules)]
    names = [f'    "{name}",' for name in sorted(package.__all__)]
    head = "# Written by geodrake.effects.lookup.stub(), as effects are found at run time."
    return "\n".join([head, "", *lines, "", "__all__ = [", *names, "]", ""])


def _place_in_words(effect: type[Effect]) -> str:
    words = {"joint_pair": "joint pair", "log": "log, or joint"}.get(effect.places, effect.places)
    return f"{words}, window" if effect.role is Role.EPISODE else words


def effect_of(role: Role) -> type[Effect]:
    """The first effect of the catalogue that has a role."""
    return next(effect for effect in catalogue() if effect.role is role)


def effect_class(name: str, extra: Sequence[type[Effect]] = ()) -> type[Effect]:
    """The effect of a name.

    Args:
        name: Such as "coulomb_friction".
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


def make_effect(
    name: str,
    where: Sequence[str],
    shape: Mapping[str, Any] | None = None,
    extra: Sequence[type[Effect]] = (),
) -> Effect:
    """An effect from the form it has in a saved model: its `name`, `where` and `shape`.

    Args:
        name: Name of the effect.
        where: Names of its joints, or of its body.
        shape: Its shape parameters by name; those left out have their default.
        extra: Effects that are not in the catalogue.

    Raises:
        ArgumentError: There is no such effect, or place or shape parameters do not fit it.
    """
    cls = effect_class(name, extra)
    shape = {} if shape is None else dict(instance(shape, "shape", Mapping))
    where = where if isinstance(where, str) else instances(where, "where", str)
    place = PLACE_FIELDS[cls.places]
    counts = {"joint_pair": (2,), "log": (0, 1), "robot": (0,), "bodies": (0,)}.get(
        cls.places, (1,)
    )
    if isinstance(where, str) or len(where) not in counts:
        wanted = {
            "joint_pair": "two joints",
            "log": "one joint or none",
            "robot": "no place, as it is one of the whole robot",
            "bodies": "no place, as it is one of all bodies",
        }.get(cls.places, f"one {cls.places}")
        raise ArgumentError(f"{name} needs {wanted}; it got {where!r}.")
    known = [field for field in inspect.signature(cls).parameters if field != place]
    unknown = [key for key in shape if key not in known]
    if unknown:
        raise ArgumentError(
            f"{name} has no shape parameter {unknown[0]!r}.",
            advice=f"It has {', '.join(known)}." if known else "It has none.",
        )
    shape = whole_numbers(cls, shape)
    if where:
        shape[place] = tuple(where) if cls.places == "joint_pair" else where[0]
    try:
        return cls(**shape)
    except TypeError as error:
        raise ArgumentError(
            f"{name} cannot be made of {shape}: {error}.",
            advice=f"Its shape parameters are {', '.join(known)}.",
        ) from error
