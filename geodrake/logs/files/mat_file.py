"""Logs in MATLAB's files and in HDF5: arrays, and those in structs by `<struct>.<field>`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from geodrake.boundary.input_files import open_regular
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import LogError
from geodrake.logs.files.damage import readable
from geodrake.logs.files.numeric_columns import numeric_table, rows_of
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.room import check_room
from geodrake.logs.files.table import LogTable

_MOST_VARIABLES, _DEEPEST = 10_000, 30
_HDF5 = b"\x89HDF\r\n\x1a\n"
_HDF5_STARTS = (0, 512)  # MATLAB puts a header of its own before
_ADVICE = "Save arrays or structs of them: save('log.mat', 'time', 'q', 'tau', '-v7')."


def read_mat(path: Path, reading: Reading) -> LogTable:
    """Return the columns of a MATLAB file; see `read_bag` for arguments."""
    with readable(path, "MATLAB file", _ADVICE):
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
            advice=f"Tables and timeseries are MATLAB's own. {_ADVICE}",
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
                advice=_ADVICE,
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
