"""Loops that run once a sample, compiled once and kept on disk."""

from __future__ import annotations

import fcntl
import os
import pickle
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import CodeType
from typing import Any, BinaryIO, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.errors import GeodrakeError

try:
    from numba import __version__ as numba_version
    from numba import config, njit
    from numba.core import caching, event
    from numba.core.compiler_lock import global_compiler_lock
except ImportError as error:
    raise GeodrakeError(
        f"geodrake needs Numba, which cannot be imported: {error}.",
        advice="Run `pip install numba` in this environment.",
    ) from error
if config.DISABLE_JIT:  # type: ignore[attr-defined]
    raise GeodrakeError(
        "geodrake needs Numba, which is told not to compile.",
        advice="Unset the environment variable NUMBA_DISABLE_JIT.",
    )

F = TypeVar("F", bound=Callable[..., Any])

_LONGEST_WAIT, _PAUSE = 120.0, 0.02  # s, for what another process compiles

_SOURCES: dict[Callable[..., Any], str] = {}
"""Of each compiled function a digest of compiler, files, constants and functions it is made from.

What was kept does not depend on where the files are: a copy of them may bring it along.
"""


def compiled(function: F) -> F:
    """Return a function of numbers, arrays and tuples of them, compiled when it is first called.

    What was compiled is kept beside the source, or in the user's folder for caches where that
    cannot be written or others can write. Where neither will do, every process compiles it anew.

    Args:
        function: The function. It may call others that are compiled or inlined.
    """
    return _compiled(function)


def inlined(function: F) -> F:
    """Return the same, as a part of what calls it."""
    return _compiled(function, forceinline=True)


def contiguous(x: ArrayLike) -> NDArray[np.float64]:
    """Return an array as compiled code knows it: other layouts would be compiled once more.

    Args:
        x: (...) numbers.
    """
    array = np.asarray(x, float)
    return array if array.flags.carray else np.array(array, order="C")


@contextmanager
def while_compiling(begins: Callable[[], None], ends: Callable[[], None]) -> Iterator[None]:
    """Tells of what is compiled as it was not kept; some of it takes seconds.

    Args:
        begins: Called as soon as a function is compiled.
        ends: Called when that is done, and all that it calls.
    """
    depth = 0

    class Teller(event.Listener):
        def on_start(self, event: Any) -> None:
            nonlocal depth
            depth += 1
            if depth == 1:
                begins()

        def on_end(self, event: Any) -> None:
            nonlocal depth
            depth -= 1
            if depth == 0:
                ends()

    teller = Teller()
    event.register("numba:compile", teller)  # type: ignore[no-untyped-call]
    try:
        yield
    finally:
        event.unregister("numba:compile", teller)  # type: ignore[no-untyped-call]


def _compiled(function: F, **options: Any) -> F:
    # (Divisions by zero are infinite, as in NumPy.)
    dispatcher: Any = njit(error_model="numpy", **options)(function)
    names = [function.__globals__.get(name) for name in sorted(_names(function.__code__))]
    called = [_SOURCES[x.py_func] for x in names if isinstance(x, type(dispatcher))]
    constants = [x for x in names if isinstance(x, int | float | str | tuple | np.dtype)]
    parts = numba_version, _source(function.__code__.co_filename), constants, called
    source = sha256("".join(map(str, parts)).encode())
    _SOURCES[function] = source.hexdigest()
    with suppress(RuntimeError):  # there is no place for a cache
        dispatcher._cache = kept = _Kept(function, _SOURCES[function])
        dispatcher.compile = kept.in_turn(dispatcher.compile)
    return cast(F, dispatcher)


@cache
def _source(path: str) -> str:
    """Return what is in a file of compiled functions."""
    return Path(path).read_text("utf-8")


def _names(code: CodeType) -> frozenset[str]:
    """Names that a function uses, in what is defined within it, too."""
    within = (_names(part) for part in code.co_consts if isinstance(part, CodeType))
    return frozenset(code.co_names).union(*within)


def _is_own(status: os.stat_result) -> bool:
    """Return whether only the user and root can change what a file or folder holds.

    What is kept is unpickled, which runs whatever it says. So it must be as trustworthy as the
    source itself, which root may have installed.
    """
    return status.st_uid in (os.geteuid(), 0) and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


class _OwnFolder:
    """Return a cache for compiled code, if no other user can write into the folder."""

    mode = 0o755

    def ensure_cache_path(self) -> None:
        """Make the folder, unless it is there.

        Raises:
            OSError: It cannot be made or written, or others can write it.
        """
        path = Path(self.get_cache_path())  # type: ignore[attr-defined]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.mkdir(self.mode, exist_ok=True)
        status = path.lstat()
        if not (stat.S_ISDIR(status.st_mode) and _is_own(status)):
            raise PermissionError(f"others can write {path}")
        tempfile.TemporaryFile(dir=path).close()


_AsAsked: Any = caching.UserProvidedCacheLocator
_InTree: Any = caching.InTreeCacheLocator
_UserWide: Any = caching.UserWideCacheLocator


class _OwnAsAsked(_OwnFolder, _AsAsked):
    """Return the folder of NUMBA_CACHE_DIR."""


class _OwnInTree(_OwnFolder, _InTree):
    """Beside the source, where Python keeps bytecode, which whoever can write there decides too."""


class _OwnUserWide(_OwnFolder, _UserWide):
    """The user's folder for caches."""

    mode = 0o700


_DataFiles: Any = caching.IndexDataCacheFile


class _Files(_DataFiles):
    """What was compiled of a function, a file for each signature, with what it came from.

    Numba's own files have numbers that an index tells, which every process writes anew: of two
    that compile at once one may be told the other's.
    """

    def load(self, key: object) -> Any:
        """Return what was kept under a key, if it came from the same."""
        source, data = self._load_data(self._name(key))
        return data if source == self._source_stamp else None

    def save(self, key: object, data: object) -> None:
        """Keeps data in the place of what is there."""
        self._save_data(self._name(key), (self._source_stamp, data))

    def _load_data(self, name: str) -> Any:
        """Return what a file holds.

        Raises:
            OSError: It is not there, is a link, or others can write it.
        """
        number = os.open(self._data_path(name), os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        with os.fdopen(number, "rb") as file:
            status = os.fstat(number)
            if not (stat.S_ISREG(status.st_mode) and _is_own(status)):
                raise PermissionError(f"others can write {name}")
            return pickle.loads(file.read())

    @contextmanager
    def _open_for_write(self, path: str) -> Iterator[BinaryIO]:
        with super()._open_for_write(path) as file:
            os.fchmod(file.fileno(), 0o644)  # whatever the umask
            yield file

    def _name(self, key: object) -> str:
        signature = sha256(repr(key).encode()).hexdigest()[:16]
        return str(self._data_name_pattern.replace("{number:d}", signature))


_Implementation: Any = caching.CompileResultCacheImpl


class _OwnPlaces(_Implementation):
    _locator_classes = (_OwnAsAsked, _OwnInTree, _OwnUserWide)


_FunctionCache: Any = caching.FunctionCache


class _Kept(_FunctionCache):
    """What was compiled of a function, as long as all that it came from is what it was.

    Numba looks at the time of the function's own file alone, and a full disk or a file that was
    cut off would be an error of the call. Of processes that need the same, one compiles it.
    """

    _impl_class = _OwnPlaces

    def __init__(self, function: Callable[..., Any], source: str) -> None:
        super().__init__(function)
        base = self._impl.filename_base
        self._cache_file = _Files(self.cache_path, base, source)
        self._lock = Path(self.cache_path, f"{base}.lock")
        self._turns = list[BinaryIO]()

    def in_turn(self, compile_one: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Numba's way to compile the function for a signature, after which it is others' turn."""

        def alone(signature: Any) -> Any:
            with global_compiler_lock:
                try:
                    return compile_one(signature)
                finally:
                    while self._turns:
                        with suppress(OSError):
                            self._lock.unlink(missing_ok=True)
                        self._turns.pop().close()

        return alone

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was kept; None if nothing was that can be read, when it is our turn to make it."""
        found = self._read(sig, target_context)
        if found is None:
            self._take_turn()
            found = self._read(sig, target_context)  # another process may have made it
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps what was compiled, if there is room."""
        with suppress(Exception):
            super().save_overload(sig, data)

    def _read(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:
            return None

    def _take_turn(self) -> None:
        """Waits while another process compiles, unless that takes too long."""
        end = time.monotonic() + _LONGEST_WAIT
        with suppress(OSError):  # a folder that cannot be written, or one without locks
            self._impl.locator.ensure_cache_path()
            file = self._lock.open("wb")
            self._turns.append(file)
            while not _is_locked(file) and time.monotonic() < end:
                time.sleep(_PAUSE)


def _is_locked(file: BinaryIO) -> bool:
    """Locks a file, unless another has."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
