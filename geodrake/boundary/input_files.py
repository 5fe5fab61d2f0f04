"""Reading of regular files only, as opening others can block forever.

Check files that a library opens by `regular_file`, and those of folders by `regular_files`.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterable
from io import BufferedReader
from pathlib import Path

from geodrake.errors import GeodrakeError

_OTHERS = {
    stat.S_IFDIR: "is a folder, not a file",
    stat.S_IFIFO: "is a pipe, not a file",
    stat.S_IFCHR: "is a device, not a file",
    stat.S_IFBLK: "is a device, not a file",
    stat.S_IFSOCK: "is a socket, not a file",
}


def open_regular(
    path: Path, what: str, error: type[GeodrakeError], *, largest: int | None = None
) -> BufferedReader:
    """Open a regular file for reading bytes.

    Args:
        path: The path given by the user; links are followed.
        what: Description of the file, such as "model file".
        error: Class of errors.
        largest: Maximum size, bytes.
    """
    try:
        reason = _kind(path.stat())  # before opening it, which may have side effects
        if reason is None:
            file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    except FileNotFoundError:
        reason = "does not exist"
    except OSError as problem:
        reason = f"cannot be read: {problem.strerror or problem}"
    except ValueError as problem:  # a null character in the path
        reason = f"cannot be read: {problem}"
    if reason is not None:
        raise error(f"The {what} {path} {reason}.", advice="Check the path.", path=path)
    status = os.fstat(file.fileno())
    reason = _kind(status)  # it may have been replaced
    if reason is None and largest is not None and status.st_size > largest:
        size, most = (f"{number / 1e6:,.0f} MB" for number in (status.st_size, largest))
        reason = f"has {size}; at most {most} are read"
    if reason is not None:
        file.close()
        advice = "Check that it is the right file."
        raise error(f"The {what} {path} {reason}.", advice=advice, path=path)
    return file


def _kind(status: os.stat_result) -> str | None:
    return _OTHERS.get(stat.S_IFMT(status.st_mode))


def read_regular(
    path: Path,
    what: str,
    error: type[GeodrakeError],
    *,
    largest: int | None = None,
    empty: bool = False,
) -> bytes:
    """Return the bytes of a regular file; raise if it is empty, unless `empty`."""
    with open_regular(path, what, error, largest=largest) as file:
        data = file.read()
    if not data and not empty:
        raise _empty(path, what, error)
    return data


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of the bytes of a file."""
    with open_regular(path, "file", GeodrakeError) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def regular_file(
    path: Path, what: str, error: type[GeodrakeError], *, largest: int | None = None
) -> Path:
    """Return a path, checked to be a regular file that can be read and is not empty."""
    with open_regular(path, what, error, largest=largest) as file:
        is_empty = not os.fstat(file.fileno()).st_size
    if is_empty:
        raise _empty(path, what, error)
    return path


def _empty(path: Path, what: str, error: type[GeodrakeError]) -> GeodrakeError:
    return error(f"The {what} {path} is empty.", advice="Check how it was written.", path=path)


def regular_files(paths: Iterable[Path], what: str, error: type[GeodrakeError]) -> list[Path]:
    """Return paths, sorted and checked to be regular files that can be read."""
    ordered = sorted(paths)
    for path in ordered:
        open_regular(path, what, error).close()
    return ordered
