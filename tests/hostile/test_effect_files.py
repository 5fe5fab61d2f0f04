"""Files of effects of the user's own: whatever they define or do, one line says which and where."""

import textwrap
from pathlib import Path

import pytest
import yaml
from hostile import Row

from geodrake.effects import load_effect_file
from geodrake.errors import GeodrakeError

ROWS = Path(__file__).parent / "rows" / "effect_files.yaml"

HEAD = """
from dataclasses import dataclass
import os, sys, warnings
import numpy as np
from geodrake.effects import BodyEffect, JointEffect, Parameter, Proposer, Role
"""
CLASS = """
@dataclass(frozen=True)
class Own({base}):
    name = {name}
    parameters = {parameters}
{more}
    def {method}(self, joint):
{body}
"""


def effect(
    body="return [joint.q]",
    *,
    base="JointEffect",
    name='"own"',
    parameters='(Parameter("size", "N·m"),)',
    more="",
    method="columns",
    before="",
):
    """The text of a file with one effect, of which all is in order but what is given."""
    own = CLASS.format(
        base=base,
        name=name,
        parameters=parameters,
        more=textwrap.indent(textwrap.dedent(more), "    "),
        method=method,
        body=textwrap.indent(textwrap.dedent(body), "        "),
    )
    return HEAD + textwrap.dedent(before) + own


LOAD = "compare robot.urdf log.csv --effects own.py"
ADD = "add own robot.urdf log.csv other.csv --effects own.py"
EXPLAIN = "explain robot.urdf log.csv other.csv --effects own.py"


def refused(name, text, *says):
    """A file that is refused as it is read."""
    return Row(name, LOAD, ("own.py", *says), {"own.py": text})


FILES = [
    Row("an empty file", LOAD, ("own.py is empty",), {"own.py": b""}),
    Row("not Python by name", "compare robot.urdf log.csv --effects own.txt", ("own.txt",),
        {"own.txt": effect()}),
    Row("not UTF-8", LOAD, ("own.py", "SyntaxError"), {"own.py": b"x = '\xff\xfe'\n"}),
    Row("null characters", LOAD, ("own.py", "null bytes"), {"own.py": b"x = 1\0\n"}),
    refused("no effect in it", "x = 1\n", "defines no effect"),
    refused("a syntax error", "def f(:\n", "SyntaxError", "line 1"),
    refused("an import of nothing", "\nimport no_such_module\n", "line 2", "no_such_module"),
    refused("an error at import", HEAD + "x = 1 / 0\n", "line 6", "ZeroDivisionError"),
    refused("sys.exit at import", HEAD + "sys.exit(0)\n", "line 6", "SystemExit"),
    refused("sys.exit with words", HEAD + "sys.exit('bye')\n", "line 6", "SystemExit: bye"),
    refused("recursion at import", "def f(): return f()\nf()\n", "line 1", "RecursionError"),
    refused("a made-up BaseException", "class E(BaseException): pass\nraise E('x')\n", "line 2"),
    refused("an error of many lines", "raise ValueError('a\\nb')\n", "line 1", "ValueError"),
    Row("keyboard interrupt at import", LOAD, ("Interrupted",),
        {"own.py": "raise KeyboardInterrupt\n"}, code=130),
    Row("it prints and warns", LOAD + " --json -", code=0,
        make={"own.py": effect(before="print('hello')\nwarnings.warn('own')\n")},
        environment={"PYTHONWARNINGS": "default"}),
    Row("it changes the folder", LOAD, ("changes the working directory",),
        {"own.py": effect(before="os.chdir('/')\n")}),
    Row("two effects of one name", LOAD, ("'own'",),
        {"own.py": effect() + effect().replace("class Own", "class Other")}),
    Row("two files of one effect", LOAD + " --effects two.py", ("'own'",),
        dict.fromkeys(("own.py", "two.py"), effect())),
    Row("one file twice", LOAD + " --effects own.py", ("'own'",), {"own.py": effect()}),
    Row("all is well", LOAD, code=0, make={"own.py": effect()}),
]  # fmt: skip

CLASSES = [
    refused("no name", effect().replace('name = "own"', ""), "Own", "name"),
    Row("no dataclass, and no need", LOAD, code=0,
        make={"own.py": effect().replace("@dataclass(frozen=True)", "")}),
    refused("not frozen", effect().replace("(frozen=True)", ""), "frozen"),
    refused("one of two effects lacks its columns", effect() + effect(name='"other"',
        method="colums").removeprefix(HEAD).replace("Own", "Two"), "Two", "lacks columns"),
    Row("chance in columns", ADD, (), code=0,
        make={"own.py": effect("return [np.random.normal(size=joint.q.shape)]")}),
]  # fmt: skip
ATTRIBUTES = (
    *("name", "parameters", "places", "role", "shapes", "depends_on", "complexity", "signature"),
    *("state_count", "companion", "contains", "proposer", "jumps", "shape", "candidates"),
    *("manifold", "signatrue", "depend_on"),
)
VALUES = (
    *("None", "3", "-1", "True", "np.nan", "object()", '""', '"lambda"', '"my effect"', '"../x"'),
    *('"payload"', '"\x1b[31mred"', '("width",)', "(1.0,)", '{"moon"}', '("viscous_friction",)'),
    *("Proposer.WAVES", "Proposer.WARMING", "Proposer.BENDING", "(JointEffect,)"),
    *('(Parameter("a", "N"), Parameter("a", "N"))', '(Parameter("a", "N", lower="0"),)'),
    *(f"Role.{role}" for role in ("BODY", "SCALE", "DELAY", "DEFLECTION", "EPISODE", "INERTIA")),
)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("attribute", ATTRIBUTES)
def test_attributes_that_no_effect_has(attribute, tmp_path):
    refused = 0
    for value in VALUES:
        path = tmp_path / "own.py"
        path.write_text(effect(more=f"{attribute} = {value}"), encoding="utf-8")
        try:
            load_effect_file(path)
        except GeodrakeError as error:
            assert "own.py" in str(error) and str(error).isprintable(), error
            refused += 1
    assert refused > len(VALUES) / 2


COMMANDS = {"added": ADD, "explained": EXPLAIN}
CHANGED = [
    Row(kind, COMMANDS[end], says, {"own.py": effect(**given)})
    for end, rows in yaml.safe_load(ROWS.read_text(encoding="utf-8")).items()
    for kind, given, *says in rows
]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("row", [*FILES, *CLASSES, *CHANGED], ids=str)
def test_row(row, tmp_path):
    row.check(tmp_path)
