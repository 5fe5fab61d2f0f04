"""Logs in NPZ files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import LogError
from geodrake.log_files.columns import Columns, Recording
from geodrake.motion import JointLog

Array = NDArray[np.float64]


def read_npz(path: Path, joints: Sequence[str] | None) -> JointLog:
    """Read a log from an NPZ file; see `read_log`."""
    with np.load(path, allow_pickle=False) as file:
        if not isinstance(file, np.lib.npyio.NpzFile):
            raise ValueError("it holds a single array, not named ones")
        members = {name.strip(): name for name in file.files}
        columns = Columns.of(path, list(members), joints)
        rows = -1
        for name in columns.names:
            numbers = _real_numbers(path, name, file[members[name]])
            if rows < 0:
                rows = len(numbers)
                recording = Recording(columns, rows)
            if len(numbers) != rows:
                raise LogError(
                    f"The arrays of log {str(path)!r} are not of one length: 'time' has {rows} "
                    f"numbers and {name!r} has {len(numbers)}.",
                    advice="Store one 1-D array for each column, all equally long.",
                )
            recording.put(name, slice(0, rows), numbers)
    return recording.log(rows)


def _real_numbers(path: Path, name: str, array: NDArray[np.generic]) -> Array:
    if array.ndim != 1:
        raise LogError(
            f"Array {name!r} of log {str(path)!r} is not 1-D: its shape is {array.shape}.",
            advice="Store one 1-D array for each column, all equally long.",
        )
    if array.dtype.kind not in "iuf":
        raise LogError(
            f"Array {name!r} of log {str(path)!r} holds {array.dtype}, not real numbers."
        )
    return np.asarray(array, float)
