"""Texts that are written from the catalogue: rows of README's table, and `__init__.pyi`."""

from __future__ import annotations

import sys

from geodrake.effects.base import Effect
from geodrake.effects.lookup import catalogue
from geodrake.effects.place import PLACES
from geodrake.effects.role import Role


def table_rows() -> list[tuple[str, str, str]]:
    """Name, needed effort and place of every effect of the catalogue, for the table of README."""
    return [(effect.name, effect.law, _place(effect)) for effect in catalogue()]


def stub() -> str:
    """The text of `__init__.pyi`: the package's names, where type checkers find their types."""
    package = sys.modules[__package__]
    modules: dict[str, list[str]] = {}
    for name in sorted(package.__all__):
        modules.setdefault(getattr(package, name).__module__, []).append(name)
    lines = [f"from {module} import {', '.join(modules[module])}" for module in sorted(modules)]
    names = [f'    "{name}",' for name in sorted(package.__all__)]
    head = "# Written by geodrake.effects.generated.stub(), as effects are found at run time."
    return "\n".join([head, "", *lines, "", "__all__ = [", *names, "]", ""])


def _place(effect: type[Effect]) -> str:
    words = PLACES[effect.places].words
    return f"{words}, window" if effect.role is Role.EPISODE else words
