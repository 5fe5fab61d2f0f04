"""Words of arguments, and names in any kind of text."""

from __future__ import annotations

import ast
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from odd_names import IN_FILES

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
from geodrake.boundary.escaping import (
    docstring_text,
    identifiers,
    json_text,
    path_part,
    printable,
    quoted,
)
from geodrake.cli.command import make_console
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


def test_joints_that_differ_in_punctuation_alone_have_names_of_their_own():
    assert identifiers(["a-b", "a.b", "a_b_2", "a b", "A B"]) == {
        "a-b": "a_b",
        "a.b": "a_b_2",
        "a_b_2": "a_b_2_2",
        "a b": "a_b_3",
        "A B": "a_b_4",
    }


@pytest.mark.parametrize("what", IN_FILES)
def test_each_kind_of_text_gives_the_name_back(what):
    name = IN_FILES[what]
    assert ast.literal_eval(quoted(name)) == name
    assert quoted(name).isprintable()
    assert printable(name).isprintable()
    if "\udcff" not in name:
        assert yaml.safe_load(quoted(name)) == name
    assert ast.literal_eval(f'"""{docstring_text(name)}"""') == printable(name)
    text = json.dumps(name, ensure_ascii=False)
    assert json.loads(json_text(text)) == name.replace("\udcff", printable("\udcff"))
    assert json_text(text).isprintable()
    assert all(i.isidentifier() for i in identifiers([name]).values())
    part = path_part(name)
    assert part.isprintable()
    assert not set(part) & {"/", "\\"}
    assert part not in ("", ".", "..")


def test_parts_of_paths_differ_where_names_do():
    names = [".", "..", "a/b", "a%2Fb", "a_b", "a\\b", "a\nb"]
    assert len({path_part(name) for name in names}) == len(names)


@pytest.mark.parametrize("what", IN_FILES)
def test_a_terminal_shows_a_name_as_one_line(what, monkeypatch):
    name = IN_FILES[what]
    monkeypatch.setenv("TERM", "xterm-256color")
    console = make_console()
    with console.capture() as captured:
        console.print(name, soft_wrap=True)
    assert captured.get() == f"{printable(name)}\n"
