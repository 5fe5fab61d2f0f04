"""Logs in NPZ files: what an archive declares is checked before anything of it is unpacked."""

from __future__ import annotations

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

from geodrake.boundary.input_files import open_regular
from geodrake.errors import GeodrakeError, LogError
from geodrake.logs.files.column_names import is_used
from geodrake.logs.files.dates import dates
from geodrake.logs.files.numeric_columns import numeric_table
from geodrake.logs.files.recognition import is_time, meaning_of, names_joints
from geodrake.logs.files.table import Groups, LogTable, Part
from geodrake.logs.files.torn_rows import TornRows

Array = NDArray[np.float64]

_ADVICE = "Store one 1-D array for each column, all equally long."
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
        entry: The member of the archive.
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
            advice=f"Write it by numpy.savez. {_ADVICE}",
        ) from error


def _length(path: Path, archive: zipfile.ZipFile, name: str, place: _Place) -> int:
    """Return how many rows a member has, by its header and by its declared size."""
    shape, dtype = _declared(path, archive, name, place.entry)
    if len(shape) != (1 if place.column is None else 2):
        raise LogError(
            f"Array {name!r} of log {str(path)!r} is not 1-D: its shape is {shape}.",
            advice=_ADVICE,
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
                advice=_ADVICE,
            )
    return rows
