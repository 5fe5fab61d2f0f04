"""How results show themselves: short as text, as tables and figures in a notebook."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

MOST_LETTERS = 900
"""Most letters of what stands for an object, however much there is in it."""

_VIEWS = "geodrake.report.views"
"""Where results become tables and figures: above all that this module may import, so by name."""

_WORD, _FEW = 60, 3
_NUMBERS = 4  # most of an array that are shown


class Short:
    """An object whose `repr` is short: sizes in the place of arrays and long lists."""

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if "__repr__" not in vars(cls):  # or a dataclass would make its own, with all numbers
            cls.__repr__ = Short.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        return short_repr(self)


class Shown(Short):
    """A result that is a table and a figure as well.

    What there is to see of each kind of result is in `geodrake.report.views`.
    """

    def _repr_html_(self) -> str:
        """Return the result in a notebook."""
        return str(_views().html(self))

    def to_dataframe(self, *, series: bool = False) -> DataFrame:
        """Return the result as a pandas DataFrame, in SI units."""
        return _views().dataframe(self, series=series)

    def plot(self) -> Figure:
        """Return the result as a matplotlib Figure."""
        return _views().figure(self)


def _views() -> Any:
    return import_module(_VIEWS)


def short_repr(value: Any) -> str:
    """Return a dataclass in a line: `Rollout(names=(7 str), windows=(12 Window), …)`.

    What is None or empty is left out.
    """
    parts = []
    for field in dataclasses.fields(value):
        own = getattr(value, field.name)
        if field.repr and not (own is None or _is_empty(own)):
            parts.append(f"{field.name}={_brief(own)}")
    text = ", ".join(parts)
    name = type(value).__name__
    most = MOST_LETTERS - len(name)
    return f"{name}({text if len(text) <= most else text[:most] + '…'})"


def _is_empty(value: object) -> bool:
    """Return whether a collection is empty; an array without dimensions is a number."""
    if isinstance(value, np.ndarray):
        return not value.size
    return isinstance(value, Collection) and not len(value)


def _brief(value: object) -> str:
    """Return a value in a few words."""
    if isinstance(value, np.ndarray):
        if value.ndim == 1 and value.size <= _NUMBERS:
            return f"[{', '.join(map(_brief, value.tolist()))}]"
        return f"array{value.shape}".replace(",)", ")")
    if isinstance(value, Mapping):
        return f"{{{len(value)} entries}}"
    if isinstance(value, Collection) and not isinstance(value, str | bytes):
        return _listed(value)
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    text = repr(str(value)) if isinstance(value, str | Path) else repr(value)
    is_result = dataclasses.is_dataclass(value) and not isinstance(value, type)
    return type(value).__name__ if is_result or len(text) > _WORD else text


def _listed(values: Collection[Any]) -> str:
    """Return a few plain values as they are, others by their number and types."""
    plain = all(isinstance(one, str | int | float) for one in values)
    if plain and len(values) <= _FEW:
        return f"({', '.join(map(_brief, values))})"
    kinds = sorted({type(one).__name__ for one in values})
    return f"({len(values)} {' or '.join(kinds[:_FEW])})"
