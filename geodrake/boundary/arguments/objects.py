"""Objects of a class, functions, paths and words."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any, TypeVar

from geodrake.boundary.arguments.words import shown
from geodrake.errors import ArgumentError

Kind = TypeVar("Kind")
Kinds = type | tuple[type, ...]


def instance(value: Kind, name: str, kind: Kinds) -> Kind:
    """Return an object of a class.

    Raises:
        ArgumentError: It is something else.
    """
    if not isinstance(value, kind):
        raise ArgumentError(f"{name} must be a {_words(kind)}; it is {shown(value)}.", name=name)
    return value


def instances(value: Iterable[Kind], name: str, kind: Kinds) -> tuple[Kind, ...]:
    """Objects of a class, in whatever holds them.

    Raises:
        ArgumentError: It holds something else, or nothing can be taken from it; a text cannot.
    """
    wanted = f"{name} must be a tuple of {_words(kind)}"
    if isinstance(value, str | bytes | dict) or not isinstance(value, Iterable):
        raise ArgumentError(f"{wanted}; it is {shown(value)}.", name=name)
    found = tuple(value)
    for place, each in enumerate(found):
        if not isinstance(each, kind):
            raise ArgumentError(f"{wanted}; number {place} is {shown(each)}.", name=name)
    return found


def function(value: Kind, name: str) -> Kind:
    """Something that can be called.

    Raises:
        ArgumentError: It cannot.
    """
    if not callable(value):
        raise ArgumentError(f"{name} must be a function; it is {shown(value)}.", name=name)
    return value


def file_path(value: str | os.PathLike[str], name: str = "path") -> Path:
    """Return the path of a file.

    Raises:
        ArgumentError: It is something else.
    """
    if not isinstance(value, str | os.PathLike):
        raise ArgumentError(f"{name} must be a path; it is {shown(value)}.", name=name)
    path = Path(value)
    try:
        unusable = b"\0" in os.fsencode(path)
    except UnicodeEncodeError:
        unusable = True
    if unusable:
        raise ArgumentError(f"{name} must be a path; no file can be called {value!a}.", name=name)
    return path


def one_of(value: Any, name: str, choices: Collection[str]) -> str:
    """One of some words.

    Raises:
        ArgumentError: It is something else.
    """
    if not isinstance(value, str) or value not in choices:
        words = ", ".join(f'"{choice}"' for choice in choices)
        raise ArgumentError(f"{name} must be one of {words}; it is {shown(value)}.", name=name)
    return value


def _words(kind: Kinds) -> str:
    kinds = kind if isinstance(kind, tuple) else (kind,)
    return " or ".join(each.__name__ for each in kinds)
