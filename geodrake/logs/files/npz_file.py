"""Logs in NPZ files: what an archive declares is checked before anything of it is unpacked."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from geodrake.errors import GeodrakeError, LogError
from geodrake.logs.files.column_names import Columns, Recording
from geodrake.logs.motion import JointLog

Array = NDArray[np.float64]

_ADVICE = "Store one 1-D array for each column, all equally long."
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def read_npz(path: Path, joints: Sequence[str] | None, *, partial: bool = False) -> JointLog:
    """Read a log from an NPZ file; see `read_log`."""
    with _reading(path), zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        names = [entry.filename.removesuffix(".npy").strip() for entry in entries]
        columns = Columns.of(path, names, joints, partial=partial)
        members = {name: entries[names.index(name)] for name in columns.names}
        lengths = {name: _length(path, archive, name, entry) for name, entry in members.items()}
        rows = _common(path, lengths)
        recording = Recording(columns, rows)
        for name, entry in members.items():
            with archive.open(entry) as file, np.errstate(over="ignore"):  # of long doubles
                numbers = np.asarray(npy.read_array(file, allow_pickle=False), float)
            recording.put(name, slice(0, rows), numbers)
    return recording.log(rows)


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Whatever an archive raises that is damaged, or made to do harm, is an error of the log."""
    try:
        yield
    except (GeodrakeError, MemoryError):
        raise
    except Exception as error:  # of zipfile, its decompressors and numpy: no list would be whole
        raise LogError(
            f"Log {str(path)!r} is no NPZ archive that can be read: {str(error).rstrip('.')}.",
            advice=f"Write it by numpy.savez. {_ADVICE}",
        ) from error


def _length(path: Path, archive: zipfile.ZipFile, name: str, entry: zipfile.ZipInfo) -> int:
    """How many numbers a member has, by its header and by its declared size."""
    with archive.open(entry) as file:
        version = npy.read_magic(file)
        if version not in _HEADERS:
            raise ValueError(f"array {name!r} is of version {version} of the NPY format")
        shape, _, dtype = _HEADERS[version](file)
        header = file.tell()
    if len(shape) != 1:
        raise LogError(
            f"Array {name!r} of log {str(path)!r} is not 1-D: its shape is {shape}.",
            advice=_ADVICE,
        )
    if dtype.kind not in "iuf":
        raise LogError(
            f"Array {name!r} of log {str(path)!r} holds {dtype}, not real numbers.",
            advice="Store numbers such as float64, in SI units.",
        )
    rows = int(shape[0])
    if header + dtype.itemsize * rows != entry.file_size:
        raise LogError(
            f"Array {name!r} of log {str(path)!r} is to have {rows} numbers of {dtype.itemsize} "
            f"bytes, but takes {entry.file_size - header} bytes.",
            advice="The file is damaged: write it again.",
        )
    return rows


def _common(path: Path, lengths: Mapping[str, int]) -> int:
    """The length that all arrays have."""
    rows = lengths["time"]
    for name, length in lengths.items():
        if length != rows:
            raise LogError(
                f"The arrays of log {str(path)!r} are not of one length: 'time' has {rows} "
                f"numbers and {name!r} has {length}.",
                advice=_ADVICE,
            )
    return rows
