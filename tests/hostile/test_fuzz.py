"""A fuzzer of the command line: files that were right once, changed at random places.

    FUZZ_CASES=250 pytest tests/hostile/test_fuzz.py -m "" --hypothesis-seed 5301 \
        --hypothesis-show-statistics

Hypothesis draws the changes and the command, shrinks what breaks, and counts how cases end. Each
runs in a process of its own. None may be called a bug of geodrake, end by a signal, take longer
than 30 s, print or write a number that is none, or change a file after it failed.
"""

import io
import os
import re
import tempfile
from contextlib import suppress
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from good_files import DIRECTIVES, EFFECT, MJCF, SAVED, SDF, URDF
from hostile import HEADER, KEPT, Row, csv, table
from hypothesis import strategies as st

CASES = int(os.environ.get("FUZZ_CASES", "3"))  # of each kind of file
WRITES = ("kept.json", "kept.yaml")
NUMBERS = ("nan", "inf", "-inf", "-1", "0", "1e308", "-1e308", "1e-320", "1e30", "4294967295")
NUMBERS += ("0x1F", "1_0", "٣", "", " ", "1,5", "1e", "--1", "9" * 400, "None", "true", "[1]", "'")
WORDS = ("", "..", "/", "\x00", "\x1b[31m", "\u202e", "é" * 300, "a" * 5000, "{{7*7}}", "$(id)")
WORDS += ("%s", "<!--", "]]>", "&a;", "world", "::", "time", "!!python/object:os.system", "*a")
WORDS += ("\r", "\ufeff", '"', "'")
ENTRIES = (np.nan, np.inf, -1e308, 1e30, 4294967295.0, 0.0, 1e6)
TYPES = ("complex128", "float16", "int32", "bool", "U8", "S3", "M8[s]", ">f8", "uint64")
COMMANDS = (*("compare",) * 5, *("add coulomb_friction",) * 2, "diagnose", "identify", "rollout")
COMMANDS += ("identifiable --threshold 1", "explain")
UNSAVED = ("rollout", "identifiable")  # commands without --save
TOKEN = re.compile(r"[-+]?\d[\d.eE+-]*|[A-Za-z_][\w:]*")


def good_log(kind):
    rows = table(seconds=12.0, rate=50.0)
    if kind == "NPZ log":
        file = io.BytesIO()
        np.savez(file, **dict(zip(HEADER.split(","), rows.T, strict=True)))
        return file.getvalue()
    return csv([[f"{x:.6g}" for x in row] for row in rows])


FILES = {
    "CSV log": ("log.csv", good_log("CSV log")),
    "NPZ log": ("log.npz", good_log("NPZ log")),
    "URDF": ("robot.urdf", URDF),
    "SDF": ("robot.sdf", SDF),
    "MJCF": ("robot.xml", MJCF),
    "directives": ("robot.dmd.yaml", DIRECTIVES),
    "saved model": ("robot.yaml", SAVED),
    "file of effects": ("effects.py", EFFECT),
}
"""Kind of file -> its name and good content."""


@st.composite
def cases(draw, kind):
    """Return a good file after one to four changes, and a command that reads it."""
    data = FILES[kind][1] if kind.endswith("log") else FILES[kind][1].encode()
    for _ in range(draw(st.integers(1, 4))):
        if draw(st.integers(0, 5)) == 0:
            data = draw(changed_bytes(data))
        elif kind == "NPZ log":
            data = draw(changed_arrays(data))
        else:
            text = draw(changed_text(data.decode(errors="surrogateescape")))
            data = text.encode(errors="surrogateescape")
    return data, words(kind, draw(st.sampled_from(COMMANDS)))


def words(kind, command):
    """Return the arguments of a command that reads a kind of file."""
    given = {"model": "robot.urdf", "log": "log.csv", "effects": ""}
    if kind == "file of effects":
        given["effects"] = f"--effects {FILES[kind][0]}"
    else:
        given["log" if kind.endswith("log") else "model"] = FILES[kind][0]
    save = "" if command.split()[0] in UNSAVED else "--save kept.yaml"
    return " ".join((command, *given.values(), "--json kept.json", save))


@st.composite
def changed_text(draw, text):
    """Return a text with a change of a number, a word, some lines or a part."""
    how = draw(st.sampled_from(("number", "number", "word", "gone", "twice", "swap", "cut", "put")))
    tokens, lines = list(TOKEN.finditer(text)), text.splitlines(keepends=True)
    if how in ("number", "word"):
        fitting = [t for t in tokens if (t[0][0] in "+-0123456789") == (how == "number")]
        if not fitting:
            return text
        token = fitting[draw(st.integers(0, len(fitting) - 1))]
        new = draw(st.sampled_from(NUMBERS if how == "number" else WORDS))
        return text[: token.start()] + new + text[token.end() :]
    if how in ("gone", "twice", "swap") and lines:
        k, other = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
        if how == "swap":
            lines[k], lines[other] = lines[other], lines[k]
        else:
            lines[k : k + 1] = [] if how == "gone" else [lines[k]] * draw(st.integers(2, 4))
        return "".join(lines)
    at = draw(st.integers(0, len(text)))
    return text[:at] if how == "cut" else text[:at] + draw(st.sampled_from(WORDS)) + text[at:]


@st.composite
def changed_bytes(draw, data):
    """Return bytes of which some are removed and others inserted."""
    at = draw(st.integers(0, len(data)))
    length = draw(st.sampled_from((0, 1, 4, 64)))
    return data[:at] + draw(st.binary(max_size=8)) + data[at + length :]


@st.composite
def changed_arrays(draw, data):
    """Return an NPZ file with an array of another type, shape, name, length or content."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except Exception:  # an earlier change made something else of it
        return data
    name = draw(st.sampled_from(sorted(arrays) or ["time"]))
    array = np.atleast_1d(arrays.pop(name, np.zeros(3)))
    k = draw(st.integers(0, max(array.size - 1, 0)))
    how = draw(st.sampled_from(("value", "value", "type", "shape", "name", "gone", "length")))
    if how == "value" and array.dtype.kind == "f" and array.size:
        array.flat[k] = draw(st.sampled_from(ENTRIES))
    elif how == "type":
        with suppress(ValueError, TypeError), np.errstate(all="ignore"):
            array = array.astype(draw(st.sampled_from(TYPES)))
    elif how == "shape":
        shapes = (array[:, None], array[None], array.reshape(-1)[:0], np.array(3.0))
        array = shapes[draw(st.integers(0, 3))]
    elif how == "length":
        array = array[:k]
    elif how == "name":
        name = draw(st.sampled_from(("Time", "x.position", "../up", "shoulder.Effort")))
    if how != "gone":
        arrays[name] = array
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


@pytest.fixture(scope="module", autouse=True)
def everything_is_imported(tmp_path_factory):
    """Run every command once, so that copies of this process need not import anything."""
    for command in dict.fromkeys(COMMANDS):
        row = Row(command, words("CSV log", command), code=0, writes=WRITES)
        row.check(tmp_path_factory.mktemp("good"))


@pytest.mark.thorough
@pytest.mark.parametrize("kind", FILES)
@hypothesis.settings(
    max_examples=CASES,
    derandomize="FUZZ_CASES" not in os.environ,
    suppress_health_check=list(hypothesis.HealthCheck),
)
@hypothesis.given(drawn=st.data())
def test_nothing_breaks(kind, drawn):
    data, command = drawn.draw(cases(kind))
    with tempfile.TemporaryDirectory() as name:
        make = {FILES[kind][0]: data}
        row = Row(command, command, make=make, code=None, writes=WRITES, apart=True)
        row.check(Path(name))
        kept = Path(name, "kept.json").read_text(encoding="utf-8")
    hypothesis.event("refused" if kept == KEPT["kept.json"] else "a result")
