"""Arguments are checked by what annotations say of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geodrake.boundary.arguments import file_path, typed
from geodrake.errors import ArgumentError


@typed
def told(
    path: str | Path,
    names: Mapping[str, int] | None = None,
    *,
    pair: tuple[int, int] = (1, 2),
    sure: bool = True,
    size: float = 1.0,
    logs: Sequence[str] = (),
    other: Any = None,
) -> str:
    """Something."""
    return f"{path} {names} {pair} {sure} {size} {logs} {other}"


def test_what_an_annotation_admits_goes_through():
    assert told(Path("a"), None, logs=["b"], other=3, sure=np.True_).startswith("a None")
    assert told("a", {"b": 1}, size=2) == "a {'b': 1} (1, 2) True 2 () None"


@pytest.mark.parametrize(
    ("name", "value"),
    [("path", 1), ("names", np.empty(0)), ("names", [1]), ("pair", "ab"), ("sure", np.empty(0))],
)
def test_what_it_does_not_admit_is_told(name, value):
    with pytest.raises(ArgumentError, match=f"^{name} must be a"):
        told(**{"path": "a", name: value})


@pytest.mark.parametrize("path", ["a\0b", "\ud800"])
def test_names_that_no_file_can_have(path):
    with pytest.raises(ArgumentError, match="no file can be called"):
        file_path(path)
