"""Logs that are no logs: files that are none, archives that lie, tables that nobody can read."""

import gzip
import io
import os
import zipfile
from itertools import product

import numpy as np
import pytest
from hostile import HEADER, Row, put, table, write_log
from numpy.lib import format as npy

from geodrake.errors import LogError
from geodrake.logs.files import read_log, room

NAMES = HEADER.split(",")
NPZ, CSV = "compare robot.urdf x.npz", "compare robot.urdf x.csv"
LINES = [HEADER, *(",".join(map(repr, row)) for row in table().tolist())]
BODY = "\n".join(LINES) + "\n"
MISSING = object()


def arrays(**changes):
    """The columns of a log in order, some of them others or missing."""
    found = dict(zip(NAMES, table().T, strict=True)) | changes
    return {name: array for name, array in found.items() if array is not MISSING}


def saved(save, *given, **more):
    """Bytes that a function of NumPy saves."""
    file = io.BytesIO()
    save(file, *given, **more)
    return file.getvalue()


def archive(**changes):
    """An archive with other arrays."""
    return {"x.npz": lambda path: np.savez(path, **arrays(**changes))}


def patched(change):
    """An archive whose bytes were changed."""
    return {"x.npz": change(saved(np.savez, **arrays()))}


def members(change=lambda name, data: data, *, called=("{}.npy",), **settings):
    """An archive of members with other contents or names."""

    def make(path):
        with zipfile.ZipFile(path, "w", **settings) as file:
            for (name, array), form in product(arrays().items(), called):
                file.writestr(form.format(name), change(name, saved(np.save, array)))

    return {"x.npz": make}


def only(wanted, new):
    """Other contents for one member."""
    return members(lambda name, data: new(data) if name == wanted else data)


def claiming(shape, descr="<f8"):
    """Another header for the elbow's effort."""
    fields = {"descr": descr, "fortran_order": False, "shape": shape}
    header = saved(npy.write_array_header_1_0, fields)
    return only("elbow.effort", lambda data: header + data[128:])


def flagged(flags, method):
    """An archive whose directory has other flags and compression."""

    def change(data):
        parts = data.split(b"PK\x01\x02")
        changed = (part[:4] + bytes([flags, 0, method, 0]) + part[8:] for part in parts[1:])
        return b"PK\x01\x02".join([parts[0], *changed])

    return patched(change)


def bomb(path):
    """Columns of zeros, of which one says that it has six gigabytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name in NAMES:
            rows = 750_000_000 if name == "elbow.effort" else 2**22
            fields = {"descr": "<f8", "fortran_order": False, "shape": (rows,)}
            header = saved(npy.write_array_header_1_0, fields)
            file.writestr(f"{name}.npy", header + bytes(1 << 25))


def damaged(data):
    place = data.index(b"shoulder.effort") + 3000
    return data[:place] + bytes([data[place] ^ 255]) + data[place + 1 :]


effort = table()[:, 4]
NO_ARCHIVE = "no NPZ archive"

ARCHIVES = [
    Row("npy", NPZ, (NO_ARCHIVE,), {"x.npz": saved(np.save, table())}),
    Row("csv", NPZ, (NO_ARCHIVE,), {"x.npz": BODY}),
    Row("cut off at the end", NPZ, (NO_ARCHIVE,), patched(lambda data: data[:-200])),
    Row("checksum", NPZ, ("Bad CRC-32",), patched(damaged)),
    Row("encrypted", NPZ, ("encrypted",), flagged(1, 0)),
    Row("compression 99", NPZ, ("compression method",), flagged(0, 99)),
    Row("7 PiB", NPZ, ("1000000000000000 numbers",), claiming((10**15,))),
    Row("10^30 numbers", NPZ, ("takes 19200 bytes",), claiming((10**30,))),
    Row("more than there are", NPZ, ("2401 numbers",), claiming((2401,))),
    Row("a matrix by header", NPZ, ("not 1-D",), claiming((1200, 2))),
    Row("objects by header", NPZ, ("holds object",), claiming((2400,), "|O")),
    Row("bomb", NPZ, ("750000000 numbers",), {"x.npz": bomb}),
    Row("member of text", NPZ, (NO_ARCHIVE,), only("time", lambda data: b"hello")),
    Row("members of text", NPZ, (NO_ARCHIVE,), members(lambda *_: b"1,2,3", called=["{}"])),
    Row("nested", NPZ, ("no column 'time'",), members(called=["a/b/{}.npy"])),
    Row("in the folder above", NPZ, (), members(called=["../{}.npy"]), code=0),
    Row("columns twice", NPZ, ("more than once",), members(called=["{}.npy", " {}.npy"])),
    Row("format of the future", NPZ, ("version (9, 0)",), only(
        "time", lambda data: data[:6] + b"\x09\x00" + data[8:])),
    Row("header that runs", NPZ, (NO_ARCHIVE,), only(
        "time", lambda data: data[:10] + b"__import__('os').mkdir('x')".ljust(118) + data[128:])),
    Row("header that is deep", NPZ, (NO_ARCHIVE,), only(
        "time", lambda data: data[:10] + b"(" * 118 + data[128:])),
    Row("objects", NPZ, ("holds object",), archive(time=np.array([0.1, None] * 1200, object))),
    Row("complex", NPZ, ("holds complex128",), archive(**{"elbow.effort": effort + 1j})),
    Row("words", NPZ, ("not real numbers",), archive(time=effort.astype("U20"))),
    Row("booleans", NPZ, ("holds bool",), archive(time=effort > 0)),
    Row("dates", NPZ, ("date",), archive(**{"elbow.position": np.arange(2400).astype("M8[ms]")})),
    Row("a number", NPZ, ("not 1-D",), archive(time=np.float64(1))),
    Row("a matrix", NPZ, ("not 1-D",), archive(time=table())),
    Row("one is short", NPZ, ("not of one length",), archive(time=effort[:5])),
    Row("no numbers", NPZ, ("has 0 rows",), archive(**dict.fromkeys(NAMES, np.empty(0)))),
    Row("no time", NPZ, ("no column 'time'",), archive(time=MISSING)),
    Row("big-endian", NPZ, (), archive(**{"elbow.effort": effort.astype(">f8")}), code=0),
    Row("every other number", NPZ, (), archive(**{
        "elbow.effort": np.repeat(effort, 2)[::2]}), code=0),
    Row("long doubles", NPZ, (), archive(**{"elbow.effort": effort.astype("g")}), code=0),
    Row("too long doubles", NPZ, ("split into 2 pieces",), archive(**{"elbow.effort": np.where(
        np.arange(2400) == 1200, np.longdouble("1e4000"), effort)}), code=0),
    Row("a note beside", NPZ, ("ignored: note",), archive(note=np.array("hi")), code=0),
    Row("members without ending", NPZ, (), members(called=["{}"]), code=0),
    Row("lzma", NPZ, (), members(compression=zipfile.ZIP_LZMA), code=0),
]  # fmt: skip


def text(content, encoding="utf-8"):
    """A log of a text."""
    return {"x.csv": content.encode(encoding)}


def cell(content):
    """A log that has something else in row 6."""
    return text(BODY.replace("\n0.05,", f"\n{content},", 1))


def header(content):
    return text("\n".join([content, *LINES[1:]]))


NO_TEXT = "no text in UTF-8"
NO_NUMBER = "which is not a number"

TABLES = [
    Row("empty", CSV, ("is empty",), text("")),
    Row("header alone", CSV, ("has 0 rows",), text(HEADER)),
    Row("ten rows", CSV, ("32 samples in a row",), text("\n".join(LINES[:11]))),
    Row("null in a cell", CSV, ("Row 6", NO_NUMBER), cell("0.0\x005")),
    Row("null in front", CSV, (NO_TEXT, "null"), text("\x00" + BODY)),
    Row("nulls behind", CSV, ("Row 2401",), text(BODY + "\x00" * 5000)),
    Row("UTF-16", CSV, (NO_TEXT,), text(BODY, "utf-16")),
    Row("Latin-1 in the header", CSV, (NO_TEXT,), text("zähler," + BODY, "latin-1")),
    Row("gzip", CSV, (NO_TEXT,), {"x.csv": gzip.compress(BODY.encode())}),
    Row("a quote that opens the header", CSV, ("never closes",), text('"' + BODY)),
    Row("a quote that never closes", CSV, ("Row 6", "never closes"), cell('"0.05')),
    Row("a line of 10 MB", CSV, ("more than 8 MB",), text(
        HEADER + "\n" + "1," * 5_000_000)),
    Row("ten thousand joints", CSV, ("at most 10000 are read",), text("\n".join(
        ["time," + ",".join(f"j{k}.position,j{k}.effort" for k in range(10_000))]
        + [f"{k}" + ",0" * 20_000 for k in range(12)]))),
    Row("vertical tabs", CSV, ("has 0 rows",), text(BODY.replace("\n", "\x0b"))),
    Row("a cell too many", CSV, ("Row 6", "has 6 cells"), cell("0.05,1")),
    Row("a cell too few", CSV, ("Row 2401", "has 3 cells"), text(BODY + "24.0,1.0,1.0\n")),
    Row("semicolons", CSV, (), text(BODY.replace(",", ";")), code=0),
    Row("decimal commas", CSV, (), text("\n".join(
        [HEADER.replace(",", ";"), *(r.replace(",", ";").replace(".", ",") for r in LINES[1:])]
    )), code=0),
    Row("separators of two kinds", CSV, ("Row 1",), text(
        HEADER.replace(",", ";") + "\n" + "\n".join(LINES[1:]))),
    Row("a word", CSV, (NO_NUMBER,), cell("error")),
    Row("escapes in a cell", CSV, (NO_NUMBER,), cell("\x1b[2J")),
    Row("a cell of 200 kB", CSV, ("Row 6",), cell("z" * 200_000)),
    Row("comments", CSV, (), text(
        "# robot\n" + BODY.replace("\n0.05,", "\n# here\n0.05,")), code=0),
    Row("a column twice", CSV, ("more than once: elbow.effort",), header(
        HEADER.replace("shoulder.effort", "elbow.effort"))),
    Row("a joint without a name", CSV, ("no joint ''",),
        header(HEADER.replace("elbow.", "."))),
    Row("another joint", CSV, ("nearest: 'elbow'",),
        header(HEADER.replace("elbow", "elbwo"))),
    Row("no efforts", CSV, ("both position and effort",),
        header(HEADER.replace("effort", "amps"))),
    Row("no header", CSV, ("no header",), text("\n".join(LINES[1:]))),
    Row("a byte order mark", CSV, (), text(BODY, "utf-8-sig"), code=0),
    Row("quoted cells", CSV, (), text("\n".join(
        ",".join(f'"{part}"' for part in line.split(",")) for line in LINES)), code=0),
    Row("quoted line ends", CSV, (), cell('"0.05\n"'), code=0),
    Row("CR", CSV, (), text(BODY.replace("\n", "\r")), code=0),
    Row("CR LF", CSV, (), text(BODY.replace("\n", "\r\n")), code=0),
    Row("commas at the ends of lines", CSV, (), text(BODY.replace("\n", ",\n")), code=0),
    Row("infinite time", CSV, ("split into 2 pieces",), text(
        BODY.replace("\n12.0,", "\ninf,")), code=0),
    Row("three thousand columns", CSV, ("columns ignored",), text("\n".join(
        line + f",{'x' if k == 0 else 0}" * 2_995 for k, line in enumerate(LINES[:101]))), code=0),
]  # fmt: skip


def rows_of(*tables):
    """Logs x and y of tables."""
    names = ("x.csv", "y.csv")
    return {n: lambda path, t=t: write_log(path, t) for n, t in zip(names, tables, strict=False)}


PATHS = [
    Row("memory of the process", "compare robot.urdf /proc/self/mem", ("is empty",)),
    Row("log as model", "compare log.csv other.csv", ("log.csv",)),
    Row("model as log", "compare robot.urdf robot.urdf", ("ends in '.urdf'",)),
    Row("page as log", "compare robot.urdf kept.html", ("ends in '.html'",)),
    Row("twice", "compare robot.urdf log.csv log.csv", ("given twice",)),
    Row("twice by a hard link", "compare robot.urdf log.csv x.csv", ("given twice",),
        {"x.csv": lambda path: path.hardlink_to(path.parent / "log.csv")}),
    Row("a copy", "compare robot.urdf log.csv x.csv", ("given twice",),
        rows_of(table())),
    Row("a copy as npz", "compare robot.urdf log.csv x.npz", ("given twice",), archive()),
    Row("a copy at another time", "compare robot.urdf log.csv x.csv", ("given twice",),
        rows_of(table() + np.array([3600.0, 0, 0, 0, 0]))),
    Row("an excerpt", "compare robot.urdf log.csv x.csv", ("given twice",),
        rows_of(table()[500:2000])),
    Row("a copy of the last of three", "explain robot.urdf log.csv other.csv x.csv",
        ("given twice", "'other'"), rows_of(table(seed=2))),
    Row("two halves", "compare robot.urdf x.csv y.csv", (), rows_of(
        table()[:1200], table()[1200:]), code=0),
]  # fmt: skip


@pytest.mark.sampled(3)
@pytest.mark.parametrize("row", [*ARCHIVES, *TABLES, *PATHS], ids=str)
def test_row(row, tmp_path):
    row.check(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_what_must_not_be_read(tmp_path):
    Row("file", CSV, ("Permission denied",), {"x.csv": lambda path: path.touch(0)}).check(tmp_path)


@pytest.mark.parametrize("files", [archive(), text(BODY)], ids=["npz", "csv"])
def test_more_than_memory_is_refused_before_it_is_read(tmp_path, monkeypatch, files):
    monkeypatch.setattr(room, "machine_memory", lambda: 100_000)
    put(tmp_path, files)
    with pytest.raises(LogError, match=r"of 5 numbers, 9\.6.*; this machine has 0\.0001 GB"):
        read_log(tmp_path / next(iter(files)))
