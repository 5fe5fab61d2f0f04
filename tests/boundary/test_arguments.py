"""Arguments that are wrong: the message says what is expected and what came."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geodrake.boundary.arguments import (
    file_path,
    instances,
    integer,
    integers,
    number,
    one_or_each,
    real_array,
    typed,
)
from geodrake.errors import ArgumentError
from geodrake.model import EffortSignal


@pytest.mark.parametrize(
    ("check", "message"),
    [
        (lambda: real_array(np.ones((3, 9)), "phi", ("N", 10)), r"\(N, 10\) .* shape is \(3, 9\)"),
        (lambda: real_array([[1.0, np.nan]], "v", ("N", 2)), r"has nan at \[0, 1\]"),
        (lambda: real_array([1j], "q"), "of type complex128"),
        (lambda: real_array([[1.0], [1.0, 2.0]], "q"), r"it is \[\[1.0\], \[1.0, 2.0\]\]"),
        (lambda: real_array([1e200], "q"), r"has 1e\+200 at \[0\]"),
        (lambda: real_array(np.ones(3), "b", ("N",), {"N": (2,)}), "with N = 2"),
        (lambda: real_array(np.ones((3, 2)), "x", ("...", 2), {"...": (4,)}), r"axes \(4,\)"),
        (lambda: number("1", "tolerance"), "tolerance must be a finite real number"),
        (lambda: number(0.0, "tolerance", lower=0.0, strict=True), "above 0; it is 0"),
        (lambda: integer(1.0, "count"), "an integer; it is 1.0"),
        (lambda: integer(True, "count", lower=0), "of at least 0; it is True"),
        *((lambda x=x: integers(x, "seeds"), "seeds must be") for x in ([1.0], [True], "12", 3)),
        (lambda: instances("elbow", "joints", str), "a tuple of str; it is 'elbow'"),
        (lambda: instances(("elbow", 2), "joints", str), "number 1 is 2"),
        (lambda: one_or_each([1.0, 2.0], "width", 3), r"one number or 3; .* \(2,\)"),
        (lambda: one_or_each(-1.0, "width", 3), "at least 0; it is -1.0"),
        (lambda: EffortSignal("a", "command", 1.0, limit="5"), "limit of a must be .* it is '5'"),
    ],
)
def test_messages_name_what_is_expected_and_what_came(check, message):
    with pytest.raises(ArgumentError, match=message):
        check()


def test_integers_of_numpy_are_integers():
    assert integers(np.arange(3), "seeds") == (0, 1, 2)


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
