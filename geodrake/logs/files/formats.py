"""The formats of log files, by suffix, by what is in a folder, and by bytes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from geodrake.boundary.arguments import file_path, typed
from geodrake.boundary.input_files import open_regular, regular_file
from geodrake.errors import LogError
from geodrake.logs.files.json_file import read_json
from geodrake.logs.files.lcm_log import MAGIC, read_lcm
from geodrake.logs.files.lerobot_dataset import INFO, read_lerobot
from geodrake.logs.files.mat_file import read_hdf5, read_mat
from geodrake.logs.files.npz_file import read_npz
from geodrake.logs.files.parquet_file import read_feather, read_parquet
from geodrake.logs.files.reading import Reading
from geodrake.logs.files.ros_bag import read_bag
from geodrake.logs.files.table import LogTable
from geodrake.logs.files.text_file import read_text

Reader = Callable[[Path, Reading], LogTable]

TEXT = (".csv", ".txt", ".dat", ".tsv", ".log")
"""Suffixes of tables of text."""

SUFFIXES: Mapping[str, Reader] = {
    ".bag": read_bag,
    ".mcap": read_bag,
    ".db3": read_bag,
    ".parquet": read_parquet,
    ".pq": read_parquet,
    ".feather": read_feather,
    ".arrow": read_feather,
    ".lcm": read_lcm,
    ".lcmlog": read_lcm,
    ".mat": read_mat,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), read_json),
}
"""Reader of files beside text and NPZ, by their suffix."""

FOLDERS: Mapping[str, Reader] = {
    "metadata.yaml": read_bag,
    "*.mcap": read_bag,
    "*.db3": read_bag,
    INFO: read_lerobot,
}
"""Reader of folders, by what is in them."""

BEGINNINGS: Mapping[bytes, Reader] = {MAGIC: read_lcm}
"""Reader of files by their first bytes: lcm-logger's names end in a date."""


def table_of(
    path: Path, reading: Reading, joints: Sequence[str] | None = None, *, numbered: bool = False
) -> LogTable:
    """Return the columns of a file of any format, which may be yet to be read.

    Args:
        joints: Names of the model's joints, if there is a model, for a proposed mapping.
        numbered: Whether columns without names may be called by their numbers.
    """
    kind = path.suffix.lower()
    if kind not in (*TEXT, ".npz"):
        reader = reader_of(check_log(path))
        if reader is None:
            raise LogError(
                f"Log {str(path)!r} ends in {path.suffix!r}, which geodrake does not read.",
                advice=f"Convert it to .csv, .npz or one of {', '.join(SUFFIXES)}.",
            )
        return reader(path, reading)
    is_text = kind in TEXT
    table = read_text(path, reading, joints, numbered=numbered) if is_text else read_npz(path)
    said = {"topic": ", ".join(reading.topics) or None, "episode": reading.episode}
    notes = [
        f"{path.name} has no {name}s, so that {value!r} chooses nothing in it"
        for name, value in said.items()
        if value is not None
    ]
    return table.noting(*notes)


@typed
def read_table(path: str | Path, reading: Reading | None = None) -> LogTable:
    """Read the columns of a log of any format.

    Args:
        path: The file, or the folder of a rosbag2 or a LeRobot dataset.
        reading: Which topic or episode of it is the log, where it has several.

    Returns:
        Its columns. Where the format says what they are: `time`, s from the first sample, and
        `<joint>.position`, `<joint>.velocity`, `<joint>.effort`, or `position[0]`, … where it does
        not name joints. Else by the names in the file, `name[0]`, … where it has lists.

    Raises:
        LogError: There is no such format or it cannot be read, a package for it is not installed,
            or it has no joints, or several topics with some.
    """
    return table_of(check_log(file_path(path)), reading or Reading(), numbered=True).loaded()


def reader_of(path: Path) -> Reader | None:
    """Return what reads a file or folder that is there; None if none of these formats is it."""
    if path.is_dir():
        return next((reader for mark, reader in FOLDERS.items() if any(path.glob(mark))), None)
    if path.suffix.lower() in SUFFIXES:
        return SUFFIXES[path.suffix.lower()]
    with open_regular(path, "log", LogError) as file:
        first = file.read(max(map(len, BEGINNINGS)))
    return BEGINNINGS.get(first)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except (OSError, ValueError):  # no name that a file could have
        return False


@typed
def check_log(path: Path) -> Path:
    """Return the path of a log that can be opened: a file, or the folder of a format that is one.

    Raises:
        LogError: It is neither, or is empty.
    """
    if not _is_folder(path):
        return regular_file(path, "log", LogError)
    if reader_of(path) is None:
        raise LogError(
            f"The log {path} is a folder, and neither a rosbag2 nor a LeRobot dataset is in it.",
            advice="Name a file, or a folder with metadata.yaml or meta/info.json.",
            path=path,
        )
    return path
