"""Open compressed logs, such as `log.csv.gz` or a `.zip` archive of one log."""

from __future__ import annotations

import bz2
import gzip
import lzma
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO
from zipfile import ZipFile, is_zipfile

from geodrake.boundary.input_files import open_regular
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import LogError

TEXT = (".csv", ".txt", ".dat", ".tsv", ".log", ".lvm", ".asc", ".prn")
JSON = (".json", ".jsonl", ".ndjson")
PACKABLE = (*TEXT, *JSON, ".npz")
"""Suffixes of formats that may be compressed."""


def _zstandard(file: BinaryIO) -> Any:
    pyarrow = optional_package("pyarrow", "logs", "files packed by zstd", LogError)
    return pyarrow.CompressedInputStream(file, "zstd")


def _zipped(file: BinaryIO) -> Any:
    archive = ZipFile(file)
    return archive.open(_log_in(archive, str(file.name)))


PACKED: Mapping[str, Callable[[Any], Any]] = {
    ".gz": gzip.open,
    ".bz2": bz2.open,
    ".xz": lzma.open,
    ".zst": _zstandard,
    ".zip": _zipped,
}
"""Suffix of compressed files -> function that decompresses an open file."""


def _log_in(archive: ZipFile, called: str) -> str:
    """Return the name of the only log in an archive, ignoring hidden and system files."""
    names = [PurePosixPath(name) for name in archive.namelist() if not name.endswith("/")]
    visible = [n for n in names if not any(part.startswith((".", "__MACOSX")) for part in n.parts)]
    logs = [n for n in visible if n.suffix.lower() in PACKABLE and n.stem.lower() != "readme"]
    if len(logs) == 1:
        return str(logs[0])
    listing = ", ".join(map(str, (logs or visible)[:8])) or "nothing"
    raise LogError(
        f"Log {called!r} is an archive of {len(logs)} logs of text, JSON or NPZ; it has {listing}.",
        advice="Unpack it, and give one of its files, or several that belong together as "
        "q.csv+efforts.csv.",
    )


def unpacked(path: Path) -> Path:
    """Return the path without its compression suffix; an archive gets the suffix of its log."""
    if path.suffix.lower() not in PACKED:
        return path
    inner = path.with_suffix("")
    if path.suffix.lower() == ".zip" and path.is_file():
        with open_regular(path, "log", LogError) as file:
            if not is_zipfile(file):
                raise LogError(
                    f"Log {str(path)!r} is no complete ZIP archive: its table of contents, at the "
                    "end, is missing.",
                    advice="Was it cut off by a copy or a download? Copy it again.",
                )
            name = PurePosixPath(_log_in(ZipFile(file), str(path)))
            return inner.with_suffix(name.suffix)
    return inner


def log_name(path: Path) -> str:
    """Return the name of a log for messages, from a file or several joined by `+`."""
    parts = [Path(part) for part in path.name.split("+")]
    are_files = all(part.suffix[1:].isalnum() for part in parts)
    return "+".join(unpacked(part).stem for part in (parts if are_files else [path]))


@contextmanager
def open_log(path: Path) -> Iterator[BinaryIO]:
    """Open a regular file in binary mode, and decompress it if necessary."""
    with open_regular(path, "log", LogError) as file:
        if unpacked(path) == path:
            yield file
        else:
            with PACKED[path.suffix.lower()](file) as stream:
                yield stream
