"""Recognize the format of log files by suffix, folder content or first bytes; join files."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from geodrake.boundary.arguments import typed
from geodrake.boundary.input_files import open_regular, regular_file
from geodrake.errors import LogError
from geodrake.logs.files.array_files import (
    INFO,
    read_feather,
    read_gazebo,
    read_hdf5,
    read_json,
    read_lerobot,
    read_mat,
    read_npy,
    read_npz,
    read_octave,
    read_parquet,
    read_rsi,
    read_yaml,
)
from geodrake.logs.files.can_traces import BEGINNING, FIRST, TRACES, read_trace
from geodrake.logs.files.column_mapping import likely_clock
from geodrake.logs.files.grouped_arrays import regrouped
from geodrake.logs.files.joined_tables import joined_tables
from geodrake.logs.files.message_logs import MAGIC, read_bag, read_lcm
from geodrake.logs.files.name_rules import (
    PAIRS,
    by_word,
    joint_columns,
    meanings_of,
    plain_words,
    quantity_of,
    tells,
)
from geodrake.logs.files.packed_files import JSON, PACKABLE, TEXT, open_log, unpacked
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import LogTable, readable
from geodrake.logs.files.text_file import read_sheet, read_text
from geodrake.logs.files.units import WORDS

Reader = Callable[[Path, Reading], LogTable]

_SHEETS, _YAML = (".xlsx", ".xlsm"), (".yaml", ".yml")
_OTHERS = by_word(WORDS["unread"])
_MODELS = (".urdf", ".sdf", ".xml", ".mjcf", ".xacro", *_YAML)

_READERS: Mapping[Reader, Sequence[str]] = {
    read_text: TEXT,
    read_npy: (".npy",),
    read_npz: (".npz",),
    read_bag: (".bag", ".mcap", ".db3"),
    read_parquet: (".parquet", ".pq"),
    read_feather: (".feather", ".arrow"),
    read_lcm: (".lcm", ".lcmlog"),
    read_mat: (".mat",),
    read_hdf5: (".h5", ".hdf5", ".nc"),
    read_json: JSON,
    read_yaml: _YAML,
    read_sheet: _SHEETS,
    read_trace: TRACES,
}
SUFFIXES = {suffix: reader for reader, suffixes in _READERS.items() for suffix in suffixes}
"""Suffix -> reader of files."""

FOLDERS: Mapping[str, Reader] = {
    "metadata.yaml": read_bag,
    "*.mcap": read_bag,
    "*.db3": read_bag,
    INFO: read_lerobot,
}
"""Pattern of a file in a folder -> reader of the folder."""

BEGINNINGS: Mapping[bytes, Reader] = {
    MAGIC: read_lcm,
    b"header:": read_yaml,
    b"---\nheader:": read_yaml,
    b"header {": read_gazebo,
    b"<Rob ": read_rsi,
    b"# Created by Octave": read_octave,
    b'{"': read_json,
}
"""First bytes -> reader of files without a specific suffix, such as lcm-logger's."""


def table_of(path: Path, reading: Reading) -> LogTable:
    """Return the table of a file of any format, whose columns may be read later."""
    kind = unpacked(path).suffix.lower()
    if unpacked(path) != path and kind not in PACKABLE:
        raise LogError(
            f"Log {str(path)!r} is compressed, but its name does not end in a format of "
            "text, JSON or NPZ.",
            advice=f"Unpack it first, or add the format to its name: log.csv{path.suffix}.",
        )
    if (reader := reader_of(check_log(path))) is None:
        raise LogError(
            f"Log {str(path)!r} has the unknown format {path.suffix!r}.",
            advice="Is it the model? `geodrake log` takes that with --model."
            if path.suffix.lower() in _MODELS
            else _OTHERS.get(path.suffix.lower())
            or f"Name it .csv if it is text, or convert it to one of {', '.join(SUFFIXES)}.",
        )
    table = reader(path, reading)
    if reader is read_trace:
        return table
    lacks: dict[str, object] = (
        {} if reading.dbc is None else {"frames of a CAN bus": reading.dbc.name}
    )
    if kind in (*TEXT, *_SHEETS, ".npy", ".npz"):
        lacks |= _lacks(table, reading, is_sheet=kind in _SHEETS)
    notes = (f"{path.name} has no {what}, so {x!r} has no meaning" for what, x in lacks.items())
    return table.noting(*notes)


def _lacks(table: LogTable, reading: Reading, *, is_sheet: bool) -> dict[str, object]:
    """Return what is chosen but a table lacks -> the choice."""
    names = [*table.names, *table.words]
    words = frozenset().union(*map(plain_words, table.names))  # one may name a robot
    unmatched = [topic for topic in reading.topics if not plain_words(topic) & words]
    has_robots = is_sheet or any(tells(name, "robots") for name in names)
    lacks = dict[str, object](topics=", ".join(unmatched)) if unmatched and not has_robots else {}
    if reading.episode is not None and not any(tells(name, "recordings") for name in names):
        lacks["episodes"] = reading.episode
    return lacks


def reader_of(path: Path) -> Reader | None:
    """Return the reader of an existing file or folder; None for unknown formats."""
    if path.is_dir():
        return next((reader for mark, reader in FOLDERS.items() if any(path.glob(mark))), None)
    kind = unpacked(path).suffix.lower()
    if kind in (*TEXT, *_MODELS) or kind not in SUFFIXES:
        with open_regular(path, "log", LogError) as file:
            first = file.read(FIRST)
        readers = (reader for begin, reader in BEGINNINGS.items() if first.startswith(begin))
        if (special := next(readers, None)) is not None:
            return special
    if kind in TEXT:  # perhaps compressed
        with readable(path, f"{path.suffix} file"), open_log(path) as file:
            if BEGINNING.match(file.read(FIRST)):
                return read_trace
    return SUFFIXES.get(kind)


@typed
def check_log(path: Path) -> Path:
    """Return the path of a log after checking that it is a file or a folder of a known format."""
    try:
        is_folder = path.is_dir()
    except (OSError, ValueError):  # not a valid file name
        is_folder = False
    if not is_folder:
        return regular_file(path, "log", LogError)
    if reader_of(path) is None:
        raise LogError(
            f"The folder {path} is neither a rosbag2 nor a LeRobot dataset.",
            advice="Give a file, or a folder with metadata.yaml or meta/info.json.",
        )
    return path


_TOLD = re.compile(r"(?<![a-z])controls?(?![a-z])")  # in names of files of commands


@typed
def parts_of(path: Path) -> tuple[Path, ...]:
    """Split the path of a log at `+` into its files, as in `q.csv+efforts.csv`."""
    if "+" not in str(path) or path.exists():
        return (path,)
    return tuple(Path(part) for part in str(path).split("+") if part)


def file_names(path: Path) -> str:
    """Return the names of a log's files, without folders."""
    return "+".join(part.name for part in parts_of(path))


def joined_table(paths: Sequence[Path], reading: Reading) -> LogTable:
    """Join several files at the time stamps of the slowest.

    A file name may contain the quantity (`efforts.csv`), the arm (`left.csv`) or the joint.
    """
    tables = [replace(_named_table(path, reading), path=Path(path.name)) for path in paths]
    arms = {frozenset(PAIRS & plain_words(unpacked(path).stem)) for path in paths}
    if len(arms) == len(paths) and all(arms) and reading.mapping is None:
        tables = [table.under(f"{unpacked(table.path).stem}/") for table in tables]
    renames = [
        {m.column: f"{unpacked(path).stem}.{m.quantity}" for m in parsed if m.is_bare}
        for path, parsed in zip(paths, [meanings_of(each.columns) for each in tables], strict=True)
    ]
    new_names = {name for names in renames for name in names.values()}
    used = {str(mapped.column) for _, mapped in reading.mapping or ()} or new_names
    if sum(map(bool, renames)) > 1 and new_names & used:
        tables = [table.renamed(names) for table, names in zip(tables, renames, strict=True)]
    return joined_tables(Path("+".join(path.name for path in paths)), tables, reading)


def _named_table(path: Path, reading: Reading) -> LogTable:
    """Read one file, and append the quantity in its file name to bare joint names."""
    table = regrouped(table_of(path, reading).loaded(skip=reading.skip_bad_rows), reading)
    stem, meanings = unpacked(path).stem, meanings_of(table.columns)
    quantity = quantity_of(stem) or ("command" if _TOLD.search(stem.lower()) else None)
    if quantity is None or any(m.quantity == quantity for m in meanings):
        return table
    if quantity == "command" and joint_columns(table.columns):
        positions = (m.column for m in meanings if m.quantity == "position")
        joint_of = {column: column.removesuffix(".position") for column in positions}
        return table.renamed(
            {c: f"{j}.command" if j != c else f"command_{c}" for c, j in joint_of.items()}
        )
    bare, clock = [column for column in table.columns if not table.is_time(column)], "time"
    if all(map(str.isdecimal, table.columns)):  # no header
        found, _, is_sure = likely_clock(table)
        clock = found.column if found is not None and is_sure else clock
    names = {c: f"{quantity}_{c}" if c.isdecimal() else f"{c}.{quantity}" for c in bare}
    return table.renamed(names | {clock: "time"})
