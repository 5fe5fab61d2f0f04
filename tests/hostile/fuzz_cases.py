"""What the fuzzer draws: files that were right once, changed at random places, and a command."""

import io
import re
import tempfile
from contextlib import chdir, suppress
from functools import cache
from pathlib import Path

import numpy as np
from good_files import DIRECTIVES, EFFECT, MJCF, SDF
from hostile import HEADER, fill, run_here, table
from hypothesis import strategies as st

NUMBERS = ("nan", "inf", "-inf", "-1", "0", "1e308", "-1e308", "1e-320", "1e30", "4294967295")
NUMBERS += ("0x1F", "1_0", "٣", "", " ", "1,5", "1e", "--1", "9" * 400, "None", "true", "[1]", "'")
WORDS = ("", "..", "/", "\x00", "\x1b[31m", "\u202e", "é" * 300, "a" * 5000, "{{7*7}}", "$(id)")
WORDS += ("%s", "<!--", "]]>", "&a;", "world", "::", "time", "!!python/object:os.system", "*a")
WORDS += ("\r", "\ufeff", '"', "'")
ENTRIES = (np.nan, np.inf, -1e308, 1e30, 4294967295.0, 0.0, 1e6)
TYPES = ("complex128", "float16", "int32", "bool", "U8", "S3", "M8[s]", ">f8", "uint64")
COMMANDS = (*("compare",) * 5, *("add coulomb_friction",) * 2, "diagnose", "identify", "rollout")
COMMANDS += ("identifiable --threshold 1", "explain")
UNSAVED = ("rollout", "identifiable")  # which have no --save
FILES = {
    "CSV log": "log.csv",
    "NPZ log": "log.npz",
    "URDF": "robot.urdf",
    "SDF": "robot.sdf",
    "MJCF": "robot.xml",
    "directives": "robot.dmd.yaml",
    "saved model": "robot.yaml",
    "file of effects": "effects.py",
}
_TOKEN = re.compile(r"[-+]?\d[\d.eE+-]*|[A-Za-z_][\w:]*")


@cache
def good(kind):
    """Bytes of a file of a kind before anything was changed."""
    texts = {"SDF": SDF, "MJCF": MJCF, "directives": DIRECTIVES, "file of effects": EFFECT}
    if kind in texts:
        return texts[kind].encode()
    if kind.endswith("log"):
        return _good_log(kind)
    with tempfile.TemporaryDirectory() as name, chdir(name):
        fill(Path())
        if kind == "saved model":
            words = "add coulomb_friction robot.urdf log.csv --save robot.yaml"
            code, _, err = run_here(words.split())
            assert code == 0, err
        return Path(FILES[kind]).read_bytes()


def _good_log(kind):
    rows = table(seconds=24.0, rate=50.0)
    if kind == "NPZ log":
        file = io.BytesIO()
        np.savez(file, **dict(zip(HEADER.split(","), rows.T, strict=True)))
        return file.getvalue()
    lines = [HEADER, *(",".join(f"{x:.6g}" for x in row) for row in rows)]
    return ("\n".join(lines) + "\n").encode()


@st.composite
def cases(draw, kind):
    """Bytes of a good file of a kind after one to four changes, and a command that reads it."""
    data = good(kind)
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
    """What follows `geodrake` for a command that reads the file of a kind."""
    given = {"model": "robot.urdf", "log": "log.csv", "effects": ""}
    if kind == "file of effects":
        given["effects"] = f"--effects {FILES[kind]}"
    else:
        given["log" if kind.endswith("log") else "model"] = FILES[kind]
    save = "" if command.split()[0] in UNSAVED else "--save kept.yaml"
    return " ".join((command, *given.values(), "--json kept.json", save))


@st.composite
def changed_text(draw, text):
    """A text with a number, a word, some lines or a stretch changed."""
    how = draw(st.sampled_from(("number", "number", "word", "gone", "twice", "swap", "cut", "put")))
    tokens, lines = list(_TOKEN.finditer(text)), text.splitlines(keepends=True)
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
    """Bytes with some of them left out and others put in."""
    at = draw(st.integers(0, len(data)))
    length = draw(st.sampled_from((0, 1, 4, 64)))
    return data[:at] + draw(st.binary(max_size=8)) + data[at + length :]


@st.composite
def changed_arrays(draw, data):
    """An NPZ file with an array of another type, shape, name, length or content."""
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
