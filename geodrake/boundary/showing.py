"""Display of results: short `repr`, and tables and figures in notebooks."""

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
"""Maximum length of an object's `repr`."""

_VIEWS = "geodrake.report.views"
"""Module with tables and figures of results, imported by name because of the layering."""

_WORD, _FEW = 60, 3
_NUMBERS = 4  # maximum length of an array that is shown


class Short:
    """An object with a short `repr`, which shows sizes instead of arrays and long lists."""

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        if "__repr__" not in vars(cls):  # prevents the default of dataclasses
            cls.__repr__ = Short.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        return short_repr(self)


class Shown(Short):
    """A result with tables and figures, defined in `geodrake.report.views`."""

    def _repr_html_(self) -> str:
        """Return the result as HTML, for notebooks."""
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
    """Return a dataclass in one line, such as `Rollout(names=(7 str), windows=(12 Window), …)`.

    None and empty fields are omitted.
    """
    parts = []
    for field in dataclasses.fields(value):
        content = getattr(value, field.name)
        if field.repr and not (content is None or _is_empty(content)):
            parts.append(f"{field.name}={_brief(content)}")
    text = ", ".join(parts)
    name = type(value).__name__
    most = MOST_LETTERS - len(name)
    return f"{name}({text if len(text) <= most else text[:most] + '…'})"


def _is_empty(value: object) -> bool:
    """Return whether a value is an empty collection; zero-dimensional arrays are not."""
    if isinstance(value, np.ndarray):
        return not value.size
    return isinstance(value, Collection) and not len(value)


def _brief(value: object) -> str:
    """Return a short description of a value."""
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
    """Return a few plain values in full, others as their number and types."""
    is_plain = all(isinstance(value, str | int | float) for value in values)
    if is_plain and len(values) <= _FEW:
        return f"({', '.join(map(_brief, values))})"
    kinds = sorted({type(value).__name__ for value in values})
    return f"({len(values)} {' or '.join(kinds[:_FEW])})"
