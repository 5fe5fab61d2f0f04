"""Atomic writing of one file, or of several files together.

A file is written under a temporary name in the target's folder and then renamed. Permissions and
owner of a replaced file are preserved. A symbolic link is preserved, and its target replaced.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import itertools
import os
import re
import shutil
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from geodrake.boundary.interrupts import deferred_interrupts
from geodrake.errors import OutputError

Content = str | bytes | Callable[[BinaryIO], object]
"""The content of a file: text, bytes, or a function that writes them."""

_MOST_BYTES = 230  # of a name contained in a temporary name; file systems allow 255


def write_whole(path: str | Path, content: Content) -> None:
    """Write a file; text in UTF-8.

    Raises:
        OutputError: It cannot be written; an existing file is unchanged.
    """
    write_together({Path(path): content})


def write_together(contents: Mapping[Path, Content]) -> None:
    """Write several files, all of them or none.

    Interrupts are deferred until the files exist; after one that arrives before the first is
    renamed, none is written.
    """
    with deferred_interrupts() as interrupted, ExitStack() as stack:
        parts = _parts(contents, stack)
        if has_written := not interrupted():
            _rename(parts)
    if not has_written:  # the interrupt's handler did not end the program
        write_together(contents)


def write_new(path: Path, content: Content, others: Mapping[Path, Content]) -> bool:
    """Write a file and others unless it exists, and return whether they were written.

    Only one of several concurrent processes succeeds.

    Args:
        others: Path -> content of the other files.
    """
    with deferred_interrupts(), ExitStack() as stack:
        parts = _parts({path: content, **others}, stack)
        with _refusing(path):
            if not parts[0].rename_if_new():
                return False
        _rename(parts[1:])
        return True


@contextmanager
def made_folder(path: Path) -> Iterator[None]:
    """Create a folder and its missing parents; remove those that are empty after an error."""
    created = list[Path]()
    try:
        try:
            created += [folder for folder in (path, *path.parents) if not folder.exists()]
            path.mkdir(parents=True, exist_ok=True)
        except (OSError, ValueError) as error:
            raise OutputError(
                f"The folder {path} cannot be created: "
                f"{getattr(error, 'strerror', None) or error}.",
                advice="Choose another place.",
                path=path,
            ) from error
        yield
    except BaseException:
        for folder in created:
            with suppress(OSError):  # another run has written into it, or it does not exist
                folder.rmdir()
        raise


def check_writable(path: str | Path) -> None:
    """Raise if a target cannot be written, before its content is computed."""
    path = Path(path)
    with deferred_interrupts(), _refusing(path), _Part(path):
        pass


class _Part:
    """A temporary file in its target's folder, locked so that no other process removes it.

    Args:
        path: The file to write, or a symbolic link to it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.target = Path(os.path.realpath(path))
        self._backup: Path | None = None
        self._replaced: os.stat_result | None = None

    def __enter__(self) -> _Part:
        replaced = _status(self.target)
        _remove_leftovers(self.target)
        self._file, self._temporary = _new_file(self.target)
        self._replaced = replaced
        if replaced is not None:
            with suppress(OSError):  # a file system without permissions
                os.fchmod(self._file.fileno(), stat.S_IMODE(replaced.st_mode))
        return self

    def write(self, content: Content) -> None:
        """Write the content. Lone surrogates, as in names that are not UTF-8, are escaped."""
        if callable(content):
            content(self._file)
        else:
            if isinstance(content, str):
                content = content.encode("utf-8", "backslashreplace")
            self._file.write(content)
        self._file.flush()

    def back_up(self) -> None:
        """Keep the existing file, so that it can be restored."""
        if _status(self.target) is None:
            return
        self._backup = _free_name(self.target)
        try:
            if _is_of_another_user(self.target):
                raise PermissionError  # a link to it could not be removed
            self._backup.hardlink_to(self.target)
        except OSError:  # a file system without links
            shutil.copy2(self.target, self._backup)

    def rename(self) -> None:
        """Move the file to its target."""
        self._temporary.replace(self.target)
        if self._replaced is not None:  # earlier, a sticky folder would prevent its removal
            with suppress(OSError):  # only root can change the owner
                os.fchown(self._file.fileno(), self._replaced.st_uid, self._replaced.st_gid)

    def rename_if_new(self) -> bool:
        """Move the file to its target unless that exists; return whether it was moved."""
        try:
            self.target.hardlink_to(self._temporary)
        except FileExistsError:
            return False
        except OSError:  # a file system without links, where this is not atomic
            if _status(self.target) is not None:
                return False
            self.rename()
        return True

    def restore(self) -> None:
        """Undo `rename`."""
        if self._backup is None:
            self.target.unlink()
        else:
            self._backup.replace(self.target)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for path in (self._temporary, self._backup):
            if path is not None:
                with suppress(OSError):
                    path.unlink(missing_ok=True)
        with suppress(OSError):  # write() has already reported a full disk
            self._file.close()


def _parts(contents: Mapping[Path, Content], stack: ExitStack) -> list[_Part]:
    """Return temporary files of the targets, written but not moved yet."""
    parts = []
    for path, content in contents.items():
        with _refusing(path):
            parts.append(stack.enter_context(_Part(path)))
            parts[-1].write(content)
    return parts


def _rename(parts: list[_Part]) -> None:
    """Move all files to their targets, or none."""
    done: list[_Part] = []
    try:
        for part in parts if len(parts) > 1 else ():
            with _refusing(part.path):
                part.back_up()
        for part in parts:
            with _refusing(part.path):
                part.rename()
            done.append(part)
    except BaseException:
        for part in reversed(done):
            with suppress(OSError):
                part.restore()
        raise


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError) as error:  # ValueError for invalid names
        reason = getattr(error, "strerror", None) or error
        raise OutputError(
            f"Cannot write {path}: {reason}.",
            advice="Choose another place.",
            path=path,
            reason=str(reason),
        ) from error


def _status(target: Path) -> os.stat_result | None:
    """Return the status of a target, None if it does not exist."""
    try:
        status = target.stat()
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder")
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file")
    if os.geteuid() and _is_of_another_user(target):
        raise PermissionError(errno.EPERM, "it belongs to another user, who must replace it")
    return status


def _is_of_another_user(target: Path) -> bool:
    """Return whether a file and its sticky folder, such as /tmp, both belong to other users."""
    folder = target.parent.stat()
    owners = (target.stat().st_uid, folder.st_uid)
    return bool(folder.st_mode & stat.S_ISVTX) and os.geteuid() not in owners


def _stem(target: Path) -> str:
    """Return the prefix of the temporary names of a target."""
    name = os.fsencode(target.name)
    is_short = len(name) <= _MOST_BYTES
    return f".{target.name if is_short else hashlib.sha256(name).hexdigest()[:16]}."


def _free_name(target: Path) -> Path:
    names = (f"{_stem(target)}{number}.part" for number in itertools.count(os.getpid()))
    return next(path for path in map(target.with_name, names) if not os.path.lexists(path))


def _new_file(target: Path) -> tuple[BinaryIO, Path]:
    """Return a new, locked file in a target's folder."""
    while True:
        path = _free_name(target)
        try:
            file = path.open("xb")
        except FileExistsError:  # created by another thread
            continue
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        with suppress(FileNotFoundError):  # removed before it was locked
            if os.path.samestat(path.stat(), os.fstat(file.fileno())):
                return file, path
        file.close()


def _remove_leftovers(target: Path) -> None:
    """Remove unlocked temporary files of a target, left by runs that were killed."""
    pattern = re.compile(rf"{re.escape(_stem(target))}\d+\.part")
    with suppress(OSError), os.scandir(target.parent) as entries:
        names = [e.name for e in entries if pattern.fullmatch(e.name) and e.is_file()]
        for path in map(target.with_name, names):
            with suppress(OSError), path.open("rb+") as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
