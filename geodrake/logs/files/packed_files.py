"""Compressed logs, such as `log.csv.gz`, decompressed while they are read."""

from __future__ import annotations

import bz2
import gzip
import lzma
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from geodrake.boundary.input_files import open_regular
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import LogError


def _zstandard(file: BinaryIO) -> Any:
    pyarrow = optional_package("pyarrow", "logs", "files packed by zstd", LogError)
    return pyarrow.CompressedInputStream(file, "zstd")


PACKED: Mapping[str, Callable[[Any], Any]] = {
    ".gz": gzip.open,
    ".bz2": bz2.open,
    ".xz": lzma.open,
    ".zst": _zstandard,
}
"""Suffix of compressed files -> function that decompresses an open one."""


def unpacked(path: Path) -> Path:
    """Return the path without the suffix of its compression."""
    return path.with_suffix("") if path.suffix.lower() in PACKED else path


def log_name(path: Path) -> str:
    """Return the name of a log for messages, from a file or several joined by `+`."""
    parts = [Path(part) for part in path.name.split("+")]
    are_files = all(part.suffix[1:].isalnum() for part in parts)
    return "+".join(unpacked(part).stem for part in (parts if are_files else [path]))


@contextmanager
def open_log(path: Path) -> Iterator[BinaryIO]:
    """Open a regular file for its bytes, unpacked if it is packed."""
    with open_regular(path, "log", LogError) as file:
        if unpacked(path) == path:
            yield file
        else:
            with PACKED[path.suffix.lower()](file) as stream:
                yield stream
