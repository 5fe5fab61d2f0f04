"""Readers and writers of joint logs, as CSV and NPZ.

The columns are `time` and, for each joint, `<joint>.position`, `<joint>.effort` and, if measured,
`<joint>.velocity` and `<joint>.acceleration`: the words of ROS JointState, in SI units. What
follows the last dot is the quantity, so joint names may contain dots.
"""

from __future__ import annotations

import csv
import difflib
import itertools
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError, OutputError
from geodrake.motion import JointLog

Array = NDArray[np.float64]

LEAST_ROWS = 10
_QUANTITIES = ("position", "velocity", "acceleration", "effort")
_HEADER = "time,<joint>.position,<joint>.velocity,<joint>.effort"
_HEADER_ADVICE = f"The first line names the columns: {_HEADER}; velocity may be left out."


def read_log(path: str | Path) -> JointLog:
    """Read a log.

    Args:
        path: A `.csv` (or `.txt`) file with a header, or an `.npz` file of 1-D arrays of the same
            names. Columns may come in any order; others than those of the format are ignored and
            noted. Empty cells and `nan` become NaN.

    Returns:
        The log, its joints in the order of their position columns, named after the file.

    Raises:
        LogError: If the file cannot be read, lacks a needed column, has one twice, has cells that
            are not numbers, has fewer than ten rows, or if its time does not increase.
    """
    path = Path(path)
    readers = {".csv": _read_csv, ".txt": _read_csv, ".npz": _read_npz}
    if not path.exists():
        raise LogError(f"There is no log file {str(path)!r}.", advice="Check the path.")
    if path.is_dir():
        raise LogError(f"{str(path)!r} is a directory, not a log.", advice="Name the file in it.")
    if path.suffix.lower() not in readers:
        raise LogError(
            f"Log {str(path)!r} ends in {path.suffix!r}, which geodrake does not read.",
            advice=f"Convert it to .csv or .npz. {_HEADER_ADVICE}",
        )
    try:
        columns = readers[path.suffix.lower()](path)
    except (OSError, EOFError, ValueError, zipfile.BadZipFile, csv.Error) as error:
        raise LogError(
            f"Log {str(path)!r} cannot be read: {error}.",
            advice="Check the file's permissions and that it is a text table or an .npz file.",
        ) from error
    return _assemble(path, columns)


def write_log(log: JointLog, path: str | Path) -> None:
    """Write a log so that `read_log` returns the same numbers.

    The file appears whole or not at all: it is written beside `path` and then renamed.

    Args:
        log: The log.
        path: Target; `.npz` writes arrays, `.csv` and `.txt` write text.

    Raises:
        OutputError: If the suffix is another, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in (".csv", ".txt", ".npz"):
        raise OutputError(f"Cannot write a log to {str(path)!r}.", advice="Use .csv or .npz.")
    columns: dict[str, Any] = {"time": log.time}
    for quantity in _QUANTITIES:
        values = getattr(log, quantity)
        if values is not None:
            names = (f"{joint}.{quantity}" for joint in log.joints)
            columns.update(zip(names, values.T, strict=True))
    partial = path.with_name(f".{path.name}.partial")
    try:
        if path.suffix.lower() == ".npz":
            with partial.open("wb") as file:
                np.savez_compressed(file, **columns)
        else:
            with partial.open("w", encoding="utf-8", newline="") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(columns)
                writer.writerows(np.column_stack(list(columns.values())).tolist())
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OutputError(
            f"Log {str(path)!r} cannot be written: {error.strerror or error}.",
            advice="Choose a folder that exists and can be written to.",
        ) from error


def _is_used(name: str) -> bool:
    """Whether a column is one of the format's."""
    return name == "time" or ("." in name and name.rsplit(".", 1)[1] in _QUANTITIES)


def _read_csv(path: Path) -> dict[str, Array]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        header = [name.strip() for name in next(csv.reader(file), [])]
        _check_header(path, header)
        first = next(file, "")
        try:
            if first.strip():
                lines = itertools.chain([first], file)
                table = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2)
                if table.shape[1] == len(header):
                    return dict(zip(header, table.T, strict=True))
        except ValueError:
            pass  # empty cells, text or ragged rows: told apart below, row by row
    return _read_cells(path, header)


def _read_cells(path: Path, header: Sequence[str]) -> dict[str, Array]:
    """Read a CSV file cell by cell: slower, but exact about what is wrong where."""
    used = [(k, name) for k, name in enumerate(header) if _is_used(name)]
    values: list[list[float]] = []
    with path.open(encoding="utf-8-sig", newline="") as file:
        lines = csv.reader(file)
        next(lines)
        for cells in filter(None, lines):
            row = len(values) + 1
            if len(cells) != len(header):
                raise LogError(
                    f"Row {row} of log {str(path)!r} (line {lines.line_num}) has {len(cells)} "
                    f"cells; the header has {len(header)}.",
                    advice="Was the recording cut off? Remove or repair that line.",
                    row=row,
                )
            values.append([_number(cells[k], path, row, name) for k, name in used])
    table = np.array(values, float).reshape(-1, len(used))
    columns = dict.fromkeys(header, np.empty(0))
    columns.update(zip((name for _, name in used), table.T, strict=True))
    return columns


def _number(cell: str, path: Path, row: int, column: str) -> float:
    try:
        return float(cell) if cell and not cell.isspace() else np.nan
    except ValueError:
        raise LogError(
            f"Row {row}, column {column!r} of log {str(path)!r} holds {cell.strip()!r}, which is "
            "not a number.",
            advice="Leave a cell empty, or write nan, where nothing was measured.",
            row=row,
            column=column,
        ) from None


def _check_header(path: Path, header: Sequence[str]) -> None:
    def is_number(cell: str) -> bool:
        try:
            float(cell)
        except ValueError:
            return False
        return True

    if not any(header) or all(map(is_number, header)):
        first = ",".join(header)
        raise LogError(
            f"Log {str(path)!r} has no header: its first line is {first[:60]!r}.",
            advice=_HEADER_ADVICE,
        )
    twice = sorted({name for name in header if _is_used(name) and header.count(name) > 1})
    if twice:
        raise LogError(
            f"Log {str(path)!r} has these columns more than once: {', '.join(twice)}.",
            advice="Remove or rename one of each.",
            columns=twice,
        )


def _read_npz(path: Path) -> dict[str, Array]:
    with np.load(path, allow_pickle=False) as file:
        if not isinstance(file, np.lib.npyio.NpzFile):
            raise ValueError("it holds a single array, not named ones")
        arrays = {name.strip(): file[name] for name in file.files if _is_used(name.strip())}
        columns = dict.fromkeys((name.strip() for name in file.files), np.empty(0))
    lengths = {name: np.shape(array) for name, array in arrays.items()}
    shapes = sorted(set(lengths.values()))
    if len(shapes) > 1 or any(len(shape) != 1 for shape in shapes):
        examples = [next(n for n in lengths if lengths[n] == shape) for shape in shapes]
        raise LogError(
            f"The arrays of log {str(path)!r} are not 1-D of one length: "
            f"{', '.join(f'{n!r} {lengths[n]}' for n in examples)}.",
            advice="Store one 1-D array for each column, all equally long.",
        )
    for name, array in arrays.items():
        if not np.issubdtype(array.dtype, np.number) or np.iscomplexobj(array):
            raise LogError(
                f"Array {name!r} of log {str(path)!r} holds {array.dtype}, not real numbers."
            )
        columns[name] = array.astype(float)
    return columns


def _assemble(path: Path, columns: Mapping[str, Array]) -> JointLog:
    if "time" not in columns:
        close = difflib.get_close_matches("time", [name.lower() for name in columns], cutoff=0.4)
        raise LogError(
            f"Log {str(path)!r} has no column 'time'; it has {', '.join(list(columns)[:8])}"
            f"{' …' if len(columns) > 8 else ''}.",
            advice=(f"Is it {close[0]!r}? " if close else "") + _HEADER_ADVICE,
        )
    having = {
        quantity: [n.rsplit(".", 1)[0] for n in columns if n.endswith(f".{quantity}")]
        for quantity in _QUANTITIES
    }
    joints = _joints(path, having)
    rows = len(columns["time"])
    if rows < LEAST_ROWS:
        raise LogError(
            f"Log {str(path)!r} has {rows} rows; at least {LEAST_ROWS} are needed.",
            advice="Record several seconds of motion.",
        )
    notes = []
    known = {"time", *(f"{joint}.{quantity}" for joint in joints for quantity in _QUANTITIES)}
    others = [name for name in columns if name not in known]
    values: dict[str, Array] = {}
    for quantity in _QUANTITIES:
        names = [f"{joint}.{quantity}" for joint in joints]
        missing = [name for name in names if name not in columns]
        if not missing:
            values[quantity] = np.stack([columns[name] for name in names], 1)
        elif len(missing) < len(names):
            notes.append(f"{quantity} is not used: there is no {', '.join(missing)}")
    if others:
        more = " …" if len(others) > 8 else ""
        notes.append(f"columns ignored: {', '.join(others[:8])}{more}")
    return JointLog(
        path.stem,
        tuple(joints),
        columns["time"],
        values["position"],
        values["effort"],
        values.get("velocity"),
        values.get("acceleration"),
        tuple(notes),
    )


def _joints(path: Path, having: Mapping[str, Sequence[str]]) -> Sequence[str]:
    """Joints with position and effort; an error if a position has no effort."""
    joints = having["position"]
    silent = [joint for joint in joints if joint not in having["effort"]]
    if not joints or len(silent) == len(joints):
        raise LogError(
            f"Log {str(path)!r} has no joint with both position and effort; positions: "
            f"{', '.join(joints) or 'none'}; efforts: {', '.join(having['effort']) or 'none'}.",
            advice=f"A log without effort says nothing about dynamics. {_HEADER_ADVICE}",
        )
    if silent:
        raise LogError(
            f"Log {str(path)!r} is a log without effort of {', '.join(silent)}: the position is "
            "there, the effort is not.",
            advice="Log that joint's effort too, or leave its columns out.",
            joints=silent,
        )
    return joints
