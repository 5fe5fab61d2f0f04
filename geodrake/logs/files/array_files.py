"""Logs in files of arrays: JSON, MATLAB's, HDF5, Parquet, Feather and NPZ."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray
from scipy.io import loadmat

from geodrake.boundary.input_files import open_regular, open_text
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import GeodrakeError, LogError
from geodrake.logs.files.column_mapping import check_once, is_used
from geodrake.logs.files.name_rules import is_time, meaning_of, names_joints
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.table import (
    Groups,
    LogTable,
    Part,
    TornRows,
    check_room,
    dates,
    numeric_table,
    readable,
    rows_of,
)

_LINES = (".jsonl", ".ndjson")
_JSON_ADVICE = (
    'Write {"time": [...], "joint.position": [...], ...}, or a record of these in each line.'
)


def read_json(path: Path, reading: Reading) -> LogTable:
    """Return the columns of a JSON file: fields of records by their paths, as in `state.q[0]`."""
    with readable(path, "JSON file", _JSON_ADVICE), open_text(path, "log", LogError) as file:
        if path.suffix.lower() in _LINES:
            content: Any = [json.loads(line) for line in file if line.strip()]
        else:
            content = json.load(file)
    if isinstance(content, Mapping):
        found = {name: values for name, values in _lists(content) if len(values) > 1}
        return numeric_table(path, found, rows_of(found))
    if not isinstance(content, list) or not all(isinstance(row, Mapping) for row in content):
        raise LogError(f"Log {str(path)!r} is neither an object nor records.", advice=_JSON_ADVICE)
    columns = dict[str, list[Any]]()
    for k, record in enumerate(content):
        for name, value in _fields(record):
            columns.setdefault(name, [None] * k).append(value)
            check_room(path, len(content) * len(columns), f"{len(columns)} fields")
        for values in columns.values():
            values.extend([None] * (k + 1 - len(values)))
    arrays = {name: np.array(values, object) for name, values in columns.items()}
    return numeric_table(path, arrays, len(content))


def _lists(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, list[Any]]]:
    """Yield the arrays of an object, and of those in it, by their paths."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _lists(value, f"{prefix}{name}.")
        elif isinstance(value, list):
            yield f"{prefix}{name}", value


def _fields(record: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the numbers and words of a record by their paths."""
    for name, value in record.items():
        if isinstance(value, Mapping):
            yield from _fields(value, f"{prefix}{name}.")
        elif isinstance(value, list):
            inner = {f"{name}[{k}]": each for k, each in enumerate(value)}
            yield from _fields(inner, prefix)
        else:
            yield f"{prefix}{name}", value


_MOST_VARIABLES, _DEEPEST = 10_000, 30
_HDF5 = b"\x89HDF\r\n\x1a\n"
_HDF5_STARTS = (0, 512)  # MATLAB puts a header of its own before
_MAT_ADVICE = "Save arrays or structs of them: save('log.mat', 'time', 'q', 'tau', '-v7')."


def read_mat(path: Path, reading: Reading) -> LogTable:
    """Return the columns of a MATLAB file; see `read_bag` for arguments."""
    with readable(path, "MATLAB file", _MAT_ADVICE):
        variables = _of_hdf5(path) if _is_hdf5(path) else loadmat(path, simplify_cells=True)
    own = {name: value for name, value in variables.items() if not name.startswith(("__", "#"))}
    arrays = dict(_flattened(own))
    rows = max((max(array.shape) for array in arrays.values()), default=0)
    sides = {name: _upright(array, rows) for name, array in arrays.items()}
    table = numeric_table(path, sides, rows)
    if not table.columns:
        raise LogError(
            f"Log {str(path)!r} has no arrays of numbers; its variables are "
            f"{', '.join(list(own)[:8]) or 'none'}.",
            advice=f"Tables and timeseries are MATLAB's own. {_MAT_ADVICE}",
        )
    return table


def read_hdf5(path: Path, reading: Reading) -> LogTable:
    """Return the arrays of an HDF5 file by their paths; images and the like are left out."""
    with readable(path, "HDF5 file"):
        arrays = dict(_flattened(_of_hdf5(path, matlab=False)))
    return numeric_table(path, arrays, rows_of(arrays))


def _is_hdf5(path: Path) -> bool:
    with open_regular(path, "log", LogError) as file:
        for start in _HDF5_STARTS:
            file.seek(start)
            if file.read(len(_HDF5)) == _HDF5:
                return True
    return False


def _of_hdf5(path: Path, *, matlab: bool = True) -> dict[str, Any]:
    """Return the arrays of a file: every object once, whatever leads to it."""
    what = "MATLAB files of version 7.3 (or save them with -v7)" if matlab else "HDF5 files"
    h5py = optional_package("h5py", "logs", what, LogError)
    names: list[str] = []

    def take(name: str) -> bool | None:
        if not name.startswith("#"):
            names.append(name)
        return len(names) > _MOST_VARIABLES or name.count("/") > _DEEPEST or None

    variables: dict[str, Any] = {}
    with h5py.File(path, "r") as file:
        if file.visit(take):
            raise LogError(
                f"Log {str(path)!r} has more than {_MOST_VARIABLES} variables, or structs in more "
                f"than {_DEEPEST} others.",
                advice=_MAT_ADVICE,
            )
        found = {name: file[name] for name in names}
        arrays = {n: v for n, v in found.items() if isinstance(v, h5py.Dataset) and v.shape}
        arrays = {n: v for n, v in arrays.items() if matlab or len(v.shape) <= 2}
        size = sum(value.size for value in arrays.values())
        check_room(path, size, f"{size} numbers")
        for name, value in arrays.items():
            *structs, last = name.split("/")
            inside = variables
            for struct in structs:
                inside = inside.setdefault(struct, {})
            is_text = value.attrs.get("MATLAB_class", b"double") in (b"char", b"cell")
            array = None if is_text else np.asarray(value)
            inside[last] = array.T if matlab and array is not None else array  # columns come first
    return variables


def _flattened(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Arrays with one number or more, fields of structs by their paths."""
    inner = [value for value in values.values() if isinstance(value, Mapping)]
    for name, value in values.items():
        if isinstance(value, Mapping):  # a struct around all else says nothing
            around = not prefix and len(values) == len(inner) == 1
            yield from _flattened(value, "" if around else f"{prefix}{name}.")
        elif isinstance(value, np.ndarray) and value.size > 1:
            yield f"{prefix}{name}", value


def _upright(array: Any, rows: int) -> Any:
    """Return an array with its rows first."""
    squeezed = np.squeeze(array)
    return squeezed.T if squeezed.ndim == 2 and squeezed.shape[0] != rows else squeezed


Array = NDArray[np.float64]


def read_parquet(path: Path, reading: Reading) -> LogTable:
    """Return the columns of a Parquet file; see `read_bag` for arguments."""
    parquet = optional_package("pyarrow.parquet", "logs", "Parquet files", LogError)
    with readable(path, "Parquet file"):
        file = parquet.ParquetFile(path)
        rows, width = file.metadata.num_rows, file.metadata.num_columns
        check_room(path, rows * width, f"{rows} rows of {width} columns")
        return arrow_table(path, file.read())


def read_feather(path: Path, reading: Reading) -> LogTable:
    """Return the columns of a Feather or Arrow file; see `read_bag` for arguments."""
    feather = optional_package("pyarrow.feather", "logs", "Feather files", LogError)
    with readable(path, "Feather file"):
        return arrow_table(path, feather.read_table(path))


def arrow_table(path: Path, table: Any) -> LogTable:
    """Return columns of an Arrow table: structs by `<struct>.<field>`, lists by `<list>[0]`."""
    while any(str(field.type).startswith("struct") for field in table.schema):
        table = table.flatten()
    check_once(path, table.column_names)
    arrays = {name: arrow_numbers(table[name]) for name in table.column_names}
    return numeric_table(path, arrays, table.num_rows)


def arrow_numbers(column: Any) -> Any:
    """Return the values of a column of Arrow, lists of one length as (N, n)."""
    if not hasattr(column.type, "value_type") or not hasattr(column.type, "value_field"):
        return column.to_numpy()
    values = column.combine_chunks()
    rows, flat = len(values), values.flatten()
    lengths = np.asarray(values.value_lengths())
    if values.null_count or not rows or np.any(lengths != lengths[0]):
        return column.to_numpy()
    return np.asarray(flat.to_numpy(zero_copy_only=False)).reshape(rows, -1)


_NPZ_ADVICE = "Store one 1-D array for each column, all equally long."
_MOST_JOINTS = 1000  # columns of a matrix
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def read_npz(path: Path) -> LogTable:
    """Return the columns of an NPZ file, of which nothing is unpacked before it is asked for."""
    with _archive(path) as archive:
        places = [place for entry in archive.infolist() for place in _places(archive, entry)]
        table = ArchiveTable(path, places, _origins(archive, places))
    lists = (name for name in table.names if names_joints(name) and meaning_of(name) is None)
    return table.loaded() if any(lists) else table


class ArchiveTable(LogTable):
    """A table whose columns are members of an archive, read one by one."""

    def __init__(self, path: Path, places: Sequence[_Place], origins: Mapping[str, int]) -> None:
        super().__init__(path, {}, origins=origins)
        self._places = places

    @property
    def names(self) -> Sequence[str]:
        """Names of the columns."""
        return [place.name for place in self._places]

    def rows(self, names: Sequence[str]) -> int:
        """Return the length that some columns have, by their headers."""
        places = {name: self._places[self.names.index(name)] for name in names}
        with _archive(self.path) as archive:
            lengths = {n: _length(self.path, archive, n, place) for n, place in places.items()}
        return _common(self.path, lengths)

    def parts(self, groups: Groups, torn: TornRows) -> Iterator[Part]:
        """Yield the numbers of each group in all rows; see `LogTable`."""
        places, last = {place.name: place for place in reversed(self._places)}, _Read()
        with _archive(self.path) as archive:
            for group in groups:
                numbers = {name: last.column(archive, places[name]) for name in group}
                yield slice(0, len(numbers[group[0]])), numbers

    def loaded(self) -> LogTable:
        """Return the table of all arrays of numbers; others are left out."""
        arrays: dict[str, Any] = {}
        with _archive(self.path) as archive:
            for entry in archive.infolist():
                name = entry.filename.removesuffix(".npy").strip()
                shape, dtype = _declared(self.path, archive, name, entry)
                if not dtype.hasobject and shape:
                    with archive.open(entry) as file:
                        arrays[name] = npy.read_array(file, allow_pickle=False)
        return numeric_table(self.path, arrays, max(map(len, arrays.values()), default=0))


@dataclass(frozen=True)
class _Place:
    """Where the numbers of a column are: in an array, or in a column of one.

    Attributes:
        column: Which column of a matrix; None for an array of numbers.
    """

    name: str
    entry: zipfile.ZipInfo
    column: int | None = None


class _Read:
    """The array that was read last, of which further columns may be asked for."""

    def __init__(self) -> None:
        self._entry: zipfile.ZipInfo | None = None
        self._array: Array = np.empty(0)

    def column(self, archive: zipfile.ZipFile, place: _Place) -> Array:
        if place.entry is not self._entry:
            self._array = np.empty(0)  # its memory is free before the next is read
            with archive.open(place.entry) as file, np.errstate(over="ignore"):  # of long doubles
                array = npy.read_array(file, allow_pickle=False)
                self._array = (
                    dates(array)[0] if array.dtype.kind == "M" else np.asarray(array, float)
                )
            self._entry = place.entry
        return self._array if place.column is None else self._array[:, place.column]


def _origins(archive: zipfile.ZipFile, places: Sequence[_Place]) -> dict[str, int]:
    """Columns of dates -> the first, ns since 1970."""
    found = {}
    for place in places:
        if not is_time(place.name):
            continue
        with (
            suppress(Exception),
            archive.open(place.entry) as file,
        ):  # what is damaged is said later
            if _HEADERS[npy.read_magic(file)](file)[2].kind == "M":
                file.seek(0)
                found[place.name] = dates(npy.read_array(file, allow_pickle=False))[1]
    return found


def _places(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> list[_Place]:
    """Return the columns of a member: those of a matrix (N, n) are `q[0]`, `q[1]` and so on."""
    name = entry.filename.removesuffix(".npy").strip()
    shape: tuple[int, ...] = ()
    if not is_used(name) and meaning_of(name) is not None:
        with suppress(Exception), archive.open(entry) as file:  # what is damaged is said later
            version = npy.read_magic(file)
            shape = _HEADERS[version](file)[0]
    if len(shape) == 2 and 0 < shape[1] <= _MOST_JOINTS:
        return [_Place(f"{name}[{k}]", entry, k) for k in range(shape[1])]
    return [_Place(name, entry)]


@contextmanager
def _archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive; whatever it raises that is damaged, or made to do harm, is a `LogError`."""
    try:
        with open_regular(path, "log", LogError) as file, zipfile.ZipFile(file) as archive:
            yield archive
    except (GeodrakeError, MemoryError):
        raise
    except Exception as error:  # of zipfile, its decompressors and numpy: no list would be whole
        raise LogError(
            f"Log {str(path)!r} is no NPZ archive that can be read: {str(error).rstrip('.')}.",
            advice=f"Write it by numpy.savez. {_NPZ_ADVICE}",
        ) from error


def _length(path: Path, archive: zipfile.ZipFile, name: str, place: _Place) -> int:
    """Return how many rows a member has, by its header and by its declared size."""
    shape, dtype = _declared(path, archive, name, place.entry)
    if len(shape) != (1 if place.column is None else 2):
        raise LogError(
            f"Array {name!r} of log {str(path)!r} is not 1-D: its shape is {shape}.",
            advice=_NPZ_ADVICE,
        )
    if dtype.kind not in ("iufM" if is_time(name) else "iuf"):
        raise LogError(
            f"Array {name!r} of log {str(path)!r} holds {dtype}, not real numbers.",
            advice="Store numbers such as float64, in SI units.",
        )
    return int(shape[0])


def _declared(
    path: Path, archive: zipfile.ZipFile, name: str, entry: zipfile.ZipInfo
) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of a member by its header, which its size must be of."""
    with archive.open(entry) as file:
        version = npy.read_magic(file)
        if version not in _HEADERS:
            raise ValueError(f"array {name!r} is of version {version} of the NPY format")
        shape, _, dtype = _HEADERS[version](file)
        header = file.tell()
    if not dtype.hasobject and header + dtype.itemsize * math.prod(shape) != entry.file_size:
        raise LogError(
            f"Array {name!r} of log {str(path)!r} is to have {math.prod(shape)} numbers of "
            f"{dtype.itemsize} bytes, but takes {entry.file_size - header} bytes.",
            advice="The file is damaged: write it again.",
        )
    return shape, dtype


def _common(path: Path, lengths: Mapping[str, int]) -> int:
    """Return the length that all arrays have."""
    first, rows = next(iter(lengths.items()))
    for name, length in lengths.items():
        if length != rows:
            raise LogError(
                f"The arrays of log {str(path)!r} are not of one length: {first!r} has {rows} "
                f"numbers and {name!r} has {length}.",
                advice=_NPZ_ADVICE,
            )
    return rows
