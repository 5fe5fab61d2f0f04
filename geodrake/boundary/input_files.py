"""Files that the user names as input: regular ones only, as opening others can wait forever."""

from __future__ import annotations

import hashlib
import stat
from pathlib import Path

from geodrake.errors import GeodrakeError

_OTHERS = {
    stat.S_IFDIR: "is a folder, not a file",
    stat.S_IFIFO: "is a pipe, not a file",
    stat.S_IFCHR: "is a device, not a file",
    stat.S_IFBLK: "is a device, not a file",
    stat.S_IFSOCK: "is a socket, not a file",
}


def sha256_of(path: Path) -> str:
    """SHA-256 of the bytes of a file.

    Raises:
        OSError: It cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def regular_file(
    path: Path, what: str, error: type[GeodrakeError], *, largest: int | None = None
) -> Path:
    """The path of a file that can be read to its end, or an error that says why it cannot.

    Args:
        path: The path as the user gave it; links are followed.
        what: What the file is to the user, such as "model file".
        error: The kind of the error.
        largest: Most bytes that the file may have.

    Returns:
        The same path.

    Raises:
        GeodrakeError: Of the kind `error`: there is nothing, or no regular file, it is empty, too
            large, or must not be read.
    """
    try:
        status = path.stat()
        reason = _OTHERS.get(stat.S_IFMT(status.st_mode))
        if reason is None:  # so that to open it waits for nobody and changes nothing
            path.open("rb").close()
    except FileNotFoundError:
        reason = "does not exist"
    except OSError as problem:
        reason = f"cannot be read: {problem.strerror or problem}"
    except ValueError as problem:  # a null character in the path
        reason = f"cannot be read: {problem}"
    if reason is not None:
        raise error(f"The {what} {path} {reason}.", advice="Check the path.", path=path)
    if status.st_size == 0:
        raise error(f"The {what} {path} is empty.", advice="Check how it was written.", path=path)
    if largest is not None and status.st_size > largest:
        raise error(
            f"The {what} {path} has {status.st_size / 1e6:,.0f} MB; at most "
            f"{largest / 1e6:,.0f} MB are read.",
            advice="Check that it is the right file.",
            path=path,
        )
    return path
