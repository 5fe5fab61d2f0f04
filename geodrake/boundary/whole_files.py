"""Atomic writing of files: one completely or not at all, several together or none of them.

A file is written under a temporary name beside its target and then renamed. Permissions and owner
of a file that is replaced stay, and a symbolic link stays one: what it points to is replaced.
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

_MOST_BYTES = 230  # of a name that a temporary one may repeat; file systems take 255


def write_whole(path: str | Path, content: Content) -> None:
    """Write a file; text in UTF-8.

    Raises:
        OutputError: It cannot be written; what was there is as it was.
    """
    write_together({Path(path): content})


def write_together(contents: Mapping[Path, Content]) -> None:
    """Write several files, all of them or none.

    Interrupts wait until the files are there; one that comes before the first is renamed leaves
    none of them.
    """
    with deferred_interrupts() as interrupted, ExitStack() as stack:
        parts = _parts(contents, stack)
        if goes_on := not interrupted():
            _rename(parts)
    if not goes_on:  # the handler of the interrupt did not end the program
        write_together(contents)


def write_new(path: Path, content: Content, beside: Mapping[Path, Content]) -> bool:
    """Write a file unless it is there already, and others with it: of several processes one does.

    Args:
        beside: Other targets, which are written if this one is -> what goes into them.
    """
    with deferred_interrupts(), ExitStack() as stack:
        parts = _parts({path: content, **beside}, stack)
        with _refusing(path):
            if not parts[0].rename_if_new():
                return False
        _rename(parts[1:])
        return True


@contextmanager
def made_folder(path: Path) -> Iterator[None]:
    """Make a folder and its missing parents; they are removed after an error if they are empty."""
    made = list[Path]()
    try:
        try:
            made += [each for each in (path, *path.parents) if not each.exists()]
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
        for each in made:
            with suppress(OSError):  # another run has written into it, or it is not there
                each.rmdir()
        raise


def check_writable(path: str | Path) -> None:
    """Raise if a target cannot be written, before its content is computed."""
    path = Path(path)
    with deferred_interrupts(), _refusing(path), _Part(path):
        pass


class _Part:
    """A file that is written beside its target, and locked so that nobody else removes it.

    Args:
        path: What is to be written; through a symbolic link, its target.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.target = Path(os.path.realpath(path))
        self._before: Path | None = None
        self._replaced: os.stat_result | None = None

    def __enter__(self) -> _Part:
        replaced = _status(self.target)
        _clear_left_overs(self.target)
        self._file, self._temporary = _new_file(self.target)
        self._replaced = replaced
        if replaced is not None:
            with suppress(OSError):  # file systems without permissions
                os.fchmod(self._file.fileno(), stat.S_IMODE(replaced.st_mode))
        return self

    def write(self, content: Content) -> None:
        """Fill the file. Halves of surrogate pairs, as in names that are not UTF-8, are escaped."""
        if callable(content):
            content(self._file)
        else:
            if isinstance(content, str):
                content = content.encode("utf-8", "backslashreplace")
            self._file.write(content)
        self._file.flush()

    def keep_before(self) -> None:
        """Keep the file that is replaced, so that it can be restored."""
        if _status(self.target) is None:
            return
        self._before = _free_name(self.target)
        try:
            if _is_of_another_user(self.target):
                raise PermissionError  # a link of it could not be removed again
            self._before.hardlink_to(self.target)
        except OSError:  # a file system without links
            shutil.copy2(self.target, self._before)

    def rename(self) -> None:
        """Move the file to its target."""
        self._temporary.replace(self.target)
        if self._replaced is not None:  # before, it could not be removed where others may not
            with suppress(OSError):  # only root may give files away
                os.fchown(self._file.fileno(), self._replaced.st_uid, self._replaced.st_gid)

    def rename_if_new(self) -> bool:
        """Move the file to its target unless that exists; return whether it was moved."""
        try:
            self.target.hardlink_to(self._temporary)
        except FileExistsError:
            return False
        except OSError:  # a file system without links: one that comes just now is replaced
            if _status(self.target) is not None:
                return False
            self.rename()
        return True

    def bring_back(self) -> None:
        """Undo `rename`."""
        if self._before is None:
            self.target.unlink()
        else:
            self._before.replace(self.target)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for left in (self._temporary, self._before):
            if left is not None:
                with suppress(OSError):
                    left.unlink(missing_ok=True)
        with suppress(OSError):  # a full disk was told by write() already
            self._file.close()


def _parts(contents: Mapping[Path, Content], stack: ExitStack) -> list[_Part]:
    """Return temporary files beside the targets, written but not moved yet."""
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
                part.keep_before()
        for part in parts:
            with _refusing(part.path):
                part.rename()
            done.append(part)
    except BaseException:
        for part in reversed(done):
            with suppress(OSError):
                part.bring_back()
        raise


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError) as error:  # a ValueError for names that no file can have
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
    short = len(name) <= _MOST_BYTES
    return f".{target.name if short else hashlib.sha256(name).hexdigest()[:16]}."


def _free_name(target: Path) -> Path:
    names = (f"{_stem(target)}{number}.part" for number in itertools.count(os.getpid()))
    return next(path for path in map(target.with_name, names) if not os.path.lexists(path))


def _new_file(target: Path) -> tuple[BinaryIO, Path]:
    """Return a new file beside a target, locked."""
    while True:
        path = _free_name(target)
        try:
            file = path.open("xb")
        except FileExistsError:  # another thread was quicker
            continue
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        with suppress(FileNotFoundError):  # cleared away before it was locked
            if os.path.samestat(path.stat(), os.fstat(file.fileno())):
                return file, path
        file.close()


def _clear_left_overs(target: Path) -> None:
    """Remove the temporary files that killed runs left for this target; locked ones are in use."""
    pattern = re.compile(rf"{re.escape(_stem(target))}\d+\.part")
    with suppress(OSError), os.scandir(target.parent) as entries:
        left = [e.name for e in entries if pattern.fullmatch(e.name) and e.is_file()]
        for path in map(target.with_name, left):
            with suppress(OSError), path.open("rb+") as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
