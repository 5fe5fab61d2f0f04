"""Odd names in code, YAML, JSON, paths and on terminals."""

import ast
import json

import pytest
import yaml
from odd_names import IN_FILES

from geodrake.boundary.escaping import (
    docstring_text,
    identifiers,
    json_text,
    path_part,
    printable,
    quoted,
)
from geodrake.cli.command import make_console


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
