"""Readers and writers of joint logs, as CSV and NPZ.

The columns are `time` and, for each joint, `<joint>.position`, `<joint>.effort` and, if measured,
`<joint>.velocity` and `<joint>.acceleration`: the words of ROS JointState, in SI units. What
follows the last dot is the quantity, so joint names may contain dots.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from geodrake.boundary.arguments import file_path, instances
from geodrake.boundary.input_files import regular_file
from geodrake.errors import LogError
from geodrake.logs.files.column_names import HEADER_ADVICE
from geodrake.logs.files.csv_file import read_csv
from geodrake.logs.files.npz_file import read_npz
from geodrake.logs.files.writing import log_content, write_log
from geodrake.logs.motion import JointLog

__all__ = ["log_content", "read_log", "write_log"]


def read_log(
    path: str | Path, *, joints: Sequence[str] | None = None, partial: bool = False
) -> JointLog:
    """Read a log.

    Args:
        path: A `.csv` (or `.txt`) file with a header, or an `.npz` file of 1-D arrays of the same
            names. Columns may come in any order; others than those of the format are ignored and
            noted. Empty cells and `nan` become NaN.
        joints: Names of a model's joints, if the log must have the same and in their order.
        partial: Whether it may lack some of these joints, or their efforts alone: joints that stand
            still then are `JointLog.standing`.

    Returns:
        The log, its joints in the order given or of their position columns, named after the file.

    Raises:
        LogError: If the file is no regular one or cannot be read, lacks a needed column or joint,
            has one twice, has cells that are not numbers, has fewer than ten rows or more than
            fit into memory, or if its time does not increase.
    """
    path = file_path(path)
    joints = None if joints is None else instances(joints, "joints", str)
    readers = {".csv": read_csv, ".txt": read_csv, ".npz": read_npz}
    regular_file(path, "log", LogError)
    if path.suffix.lower() not in readers:
        raise LogError(
            f"Log {str(path)!r} ends in {path.suffix!r}, which geodrake does not read.",
            advice=f"Convert it to .csv or .npz. {HEADER_ADVICE}",
        )
    try:
        return readers[path.suffix.lower()](path, joints, partial=partial)
    except UnicodeDecodeError as error:
        raise LogError(
            f"Log {str(path)!r} is no text in UTF-8: {error.reason} at byte {error.start}.",
            advice="Save it as CSV in UTF-8, or as .npz.",
        ) from error
    except (OSError, MemoryError) as error:
        raise LogError(
            f"Log {str(path)!r} cannot be read: {error}.",
            advice="Check the file's permissions, and that there is memory for it.",
        ) from error
