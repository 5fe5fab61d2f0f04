"""Files of effects of the user's own: whatever they define or do, one line says which and where."""

import os
import textwrap

import pytest
from hostile import Row

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


def file(text, name="own.py"):
    """What makes a file of effects in a folder."""
    return lambda folder: (folder / name).write_text(text, encoding="utf-8")


def bytes_of(data):
    return lambda folder: (folder / "own.py").write_bytes(data)


LOAD = "compare robot.urdf log.csv --effects own.py"
ADD = "add own robot.urdf log.csv other.csv --effects own.py"
EXPLAIN = "explain robot.urdf log.csv other.csv --effects own.py"


def refused(name, text, *says):
    """A file that is refused as it is read."""
    return Row(name, LOAD, ("own.py", *says), file(text))


def unusable(name, text, *says, command=ADD):
    """An effect that is refused as its columns are taken."""
    return Row(name, command, says, file(text))


FILES = [
    Row("no file of effects", LOAD, ("own.py does not exist",)),
    Row("a folder", LOAD, ("own.py is a folder",), lambda f: (f / "own.py").mkdir()),
    Row("a pipe", LOAD, ("own.py is a pipe",), lambda f: os.mkfifo(f / "own.py")),
    Row("an empty file", LOAD, ("own.py is empty",), bytes_of(b"")),
    Row(
        "not Python by name",
        "compare robot.urdf log.csv --effects own.txt",
        ("own.txt",),
        file(effect(), "own.txt"),
    ),
    Row("not UTF-8", LOAD, ("own.py", "SyntaxError"), bytes_of(b"x = '\xff\xfe'\n")),
    Row("null characters", LOAD, ("own.py", "null bytes"), bytes_of(b"x = 1\0\n")),
    refused("no effect in it", "x = 1\n", "defines no effect"),
    refused("a syntax error", "def f(:\n", "SyntaxError", "line 1"),
    refused("an import of nothing", "\nimport no_such_module\n", "line 2", "no_such_module"),
    refused("an error at import", HEAD + "x = 1 / 0\n", "line 6", "ZeroDivisionError"),
    refused("sys.exit at import", HEAD + "sys.exit(0)\n", "line 6", "SystemExit"),
    refused("sys.exit with words", HEAD + "sys.exit('bye')\n", "line 6", "SystemExit: bye"),
    refused("recursion at import", "def f(): return f()\nf()\n", "line 1", "RecursionError"),
    refused("a made-up BaseException", "class E(BaseException): pass\nraise E('x')\n", "line 2"),
    refused("an error of many lines", "raise ValueError('a\\nb')\n", "line 1", "ValueError"),
    Row(
        "keyboard interrupt at import",
        LOAD,
        ("Interrupted",),
        file("raise KeyboardInterrupt\n"),
        code=130,
    ),
    Row(
        "it prints and warns",
        LOAD + " --json -",
        code=0,
        make=file(effect(before="print('hello')\nwarnings.warn('own')\n")),
        environment={"PYTHONWARNINGS": "default"},
    ),
    Row(
        "it changes the folder",
        LOAD,
        ("changes the working directory",),
        file(effect(before="os.chdir('/')\n")),
    ),
    Row(
        "two effects of one name",
        LOAD,
        ("'own'",),
        file(effect() + effect().replace("class Own", "class Other")),
    ),
    Row(
        "two files of one effect",
        LOAD + " --effects two.py",
        ("'own'",),
        lambda f: (file(effect())(f), file(effect(), "two.py")(f)),
    ),
    Row("one file twice", LOAD + " --effects own.py", ("'own'",), file(effect())),
    Row("all is well", LOAD, code=0, make=file(effect())),
]

CLASSES = [
    refused("no parameters", effect(parameters="()", body="return []"), "Own", "parameters"),
    refused("parameters that are none", effect(parameters="None"), "Own", "parameters"),
    refused("a lone parameter", effect(parameters='Parameter("size", "N")'), "Own", "parameters"),
    refused("parameters that are words", effect(parameters='("size",)'), "Own", "parameters"),
    refused("parameters that are numbers", effect(parameters="(1.0,)"), "Own", "parameters"),
    refused(
        "two parameters of one name",
        effect(parameters='(Parameter("a", "N"), Parameter("a", "N"))'),
        "Own",
        "'a'",
    ),
    refused(
        "crossed bounds",
        effect(parameters='(Parameter("a", "N", lower=2, upper=1),)'),
        "line",
        "lower",
        "2",
        "1",
    ),
    refused("equal bounds", effect(parameters='(Parameter("a", "N", lower=1, upper=1),)'), "lower"),
    refused(
        "a bound that is none", effect(parameters='(Parameter("a", "N", lower=np.nan),)'), "lower"
    ),
    refused(
        "bounds of infinity", effect(parameters='(Parameter("a", "N", lower=np.inf),)'), "lower"
    ),
    refused("a bound in words", effect(parameters='(Parameter("a", "N", lower="0"),)'), "lower"),
    refused(
        "a negative spread", effect(parameters='(Parameter("a", "N", spread=-1.0),)'), "spread"
    ),
    refused(
        "a spread that is none",
        effect(parameters='(Parameter("a", "N", spread=np.nan),)'),
        "spread",
    ),
    refused("a unit that is no word", effect(parameters='(Parameter("a", 3),)'), "unit"),
    refused("a unit with escapes", effect(parameters='(Parameter("a", "\\x1b[31mN"),)'), "unit"),
    refused("a parameter without a name", effect(parameters='(Parameter("", "N"),)'), "name"),
    refused("a parameter with escapes", effect(parameters='(Parameter("\\x1b[2J", "N"),)'), "name"),
    refused("a name that is empty", effect(name='""'), "Own", "name"),
    refused("a name that is no word", effect(name="3"), "Own", "name"),
    refused("a name with escapes", effect(name='"\\x1b[31mred"'), "Own", "name"),
    refused("a name that is a path", effect(name='"../x"'), "Own", "name"),
    refused("a name with spaces", effect(name='"my effect"'), "Own", "name"),
    refused("a name of Python", effect(name='"lambda"'), "Own", "name"),
    refused("a name of the catalogue", effect(name='"payload"'), "Own", "'payload'"),
    refused("no name", effect().replace('name = "own"', ""), "Own", "name"),
    Row(
        "no dataclass, and no need",
        LOAD,
        code=0,
        make=file(effect().replace("@dataclass(frozen=True)", "")),
    ),
    refused("not frozen", effect().replace("(frozen=True)", ""), "frozen"),
    refused("no columns", effect(method="colums"), "Own", "columns"),
    refused("no rows", effect(base="BodyEffect", method="colums"), "Own", "rows"),
    refused("a place that there is not", effect(more='places = "moon"'), "Own", "moon"),
    refused("a place of a wrong kind", effect(more="places = 3"), "Own", "places"),
    refused("a role in words", effect(more='role = "force"'), "Own", "role"),
    refused("shapes in words", effect(more='shapes = ("width",)'), "Own", "shapes"),
    refused("a signal that there is not", effect(more='depends_on = {"moon"}'), "Own", "moon"),
    refused("a complexity in words", effect(more='complexity = "high"'), "Own", "complexity"),
    refused("a signature that is no word", effect(more="signature = 3"), "Own", "signature"),
    refused("a number of states below zero", effect(more="state_count = -1"), "state_count"),
]

NO_RELATIONS = {
    "companion": ('"viscous_friction"', "3", "(JointEffect,)"),
    "contains": ('("coulomb_friction",)', "JointEffect"),
    "proposer": ('"waves"', "True", "Proposer.BENDING", "Proposer.SHARED_ACTUATOR"),
    "complexity": ("True", "2.0"),
    "jumps": ("1",),
}
"""Class attributes that are not what `Effect` says: each ended in an error of Python's."""

ATTRIBUTES = [
    refused(
        "a slip in a declaration", effect(more="signatrue = 'waves'"), "signatrue", "signature"
    ),
    refused("another slip", effect(more="depend_on = frozenset({'q'})"), "depend_on", "depends_on"),
    refused("a property hidden", effect(more="shape = 3"), "shape = 3", "method"),
    refused("a method hidden", effect(more="candidates = 1"), "candidates = 1", "method"),
    refused("a manifold hidden", effect(more="manifold = None"), "manifold = None", "method"),
    refused(
        "one of two effects lacks its columns",
        effect() + effect(name='"other"', method="colums").removeprefix(HEAD).replace("Own", "Two"),
        "Two",
        "lacks columns",
    ),
]
RELATIONS = [
    refused(f"{name} = {value}", effect(more=f"{name} = {value}"), "Own", name)
    for name, values in NO_RELATIONS.items()
    for value in values
]
RELATIONS += [
    refused(f"a joint's {role}", effect(more=f"role = Role.{role}"), "Own", f"Role.{role}", base)
    for role, base in {
        "BODY": "Payload",
        "SCALE": "EffortScale",
        "DELAY": "EffortDelay",
        "DEFLECTION": "DeflectionEffect",
        "EPISODE": "Episode",
        "INERTIA": "WrongInertia",
    }.items()
]
RELATIONS += [
    refused("waves without an order", effect(more="proposer = Proposer.WAVES"), "Own", "order"),
    refused("no course", effect(more="proposer = Proposer.WARMING"), "Own", "course"),
]

COLUMNS = [
    unusable("columns of 1e300", effect("return [1e300 * joint.q]"), "own", "own.py"),
    unusable("columns of 1e-300", effect("return [1e-300 * joint.q]"), "own"),
    unusable("columns of zero", effect("return [0.0 * joint.q]"), "own"),
    unusable("complex columns", effect("return [1j * joint.q]"), "own", "complex"),
    unusable("columns of words", effect("return ['a']"), "own", "own.py"),
    unusable("columns of objects", effect("return [object()]"), "own"),
    unusable(
        "a column that is none in some samples",
        effect("return [np.where(joint.q > 0, joint.q, np.nan)]"),
        "own",
        "nan",
    ),
    unusable(
        "columns of infinity", effect("return [np.inf * np.ones_like(joint.q)]"), "own", "inf"
    ),
    unusable("columns of a wrong shape", effect("return [joint.q[:-1]]"), "own", "shape"),
    unusable("columns of two dimensions", effect("return [np.ones((2, len(joint.q)))]"), "shape"),
    unusable("nothing for columns", effect("return None"), "own", "own.py"),
    unusable("a number for columns", effect("return 1.0"), "own", "own.py"),
    unusable("too many columns", effect("return [joint.q, joint.v]"), "own", "2 columns"),
    unusable("columns by chance", effect("return [joint.q] * np.random.randint(1, 3)"), "own"),
    unusable("an error in columns", effect("return [joint.qq]"), "line", "own.py", "qq"),
    unusable("sys.exit in columns", effect("sys.exit(0)"), "line", "own.py", "SystemExit"),
    unusable("a division by zero", effect("return [1 / 0]"), "line", "own.py"),
    unusable("recursion in columns", effect("return self.columns(joint)"), "own.py", "Recursion"),
    unusable(
        "a motion written to",
        effect("joint.q[:] = 0.0\nreturn [joint.q]"),
        "line",
        "own.py",
        "read-only",
    ),
    Row(
        "chance in columns",
        ADD,
        (),
        code=0,
        make=file(effect("return [np.random.normal(size=joint.q.shape)]")),
    ),
    unusable(
        "rows of nothing",
        effect("return None", method="rows", more="def columns(self, j): ..."),
        "own",
    ),
    unusable(
        "rows of a joint that there is not",
        effect(
            "return {'moon': np.ones((len(joint.v), 1))}",
            method="rows",
            more="def columns(self, j): ...",
        ),
        "own",
        "moon",
    ),
    unusable(
        "rows of a wrong shape",
        effect(
            "return {self.joint: np.ones((3, 1))}", method="rows", more="def columns(self, j): ..."
        ),
        "own",
        "shape",
    ),
    unusable(
        "rows that are none",
        effect(
            "return {self.joint: np.full((len(joint.v), 1), np.nan)}",
            method="rows",
            more="def columns(self, j): ...",
        ),
        "own",
        "nan",
    ),
    unusable(
        "complex rows",
        effect(
            "return {self.joint: np.full((len(joint.v), 1), 1j)}",
            method="rows",
            more="def columns(self, j): ...",
        ),
        "own",
        "complex",
    ),
    unusable(
        "rows by another name",
        effect(
            "return {3: np.ones((len(joint.v), 1))}",
            method="rows",
            more="def columns(self, j): ...",
        ),
        "own",
        "3",
    ),
]


def candidates(text):
    """An effect whose candidates are a piece of code."""
    return effect(more=f"@classmethod\ndef candidates(cls, joint, peak_speed):\n    {text}\n")


CANDIDATES = [
    unusable(
        "candidates that are none", candidates("return None"), "own", "candidates", command=EXPLAIN
    ),
    unusable(
        "candidates that are numbers",
        candidates("return [1, 2]"),
        "own",
        "candidates",
        command=EXPLAIN,
    ),
    unusable(
        "candidates of another kind",
        candidates("import geodrake.effects as e; return [e.EffortOffset(joint)]"),
        "own",
        "candidates",
        command=EXPLAIN,
    ),
    unusable(
        "candidates without an end",
        candidates("return iter(lambda: cls(joint), None)"),
        "own",
        "candidates",
        command=EXPLAIN,
    ),
    unusable(
        "a million candidates",
        candidates("return [cls(joint)] * 10**6"),
        "own",
        "candidates",
        command=EXPLAIN,
    ),
    unusable(
        "an error in candidates",
        candidates("raise ValueError('no')"),
        "line",
        "own.py",
        "no",
        command=EXPLAIN,
    ),
    unusable(
        "sys.exit in candidates", candidates("sys.exit(3)"), "own.py", "SystemExit", command=EXPLAIN
    ),
]


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "row",
    [*FILES, *CLASSES, *ATTRIBUTES, *RELATIONS, *COLUMNS, *CANDIDATES],
    ids=str,
)
def test_row(row, tmp_path, monkeypatch):
    row.check(tmp_path, monkeypatch)
