"""Compilation of numerical loops by Numba, cached on disk."""

from __future__ import annotations

import fcntl
import os
import pickle
import re
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, BinaryIO, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.errors import GeodrakeError

try:
    from numba import __version__ as numba_version
    from numba import config, njit
    from numba.core import compiler, event
except ImportError as error:
    raise GeodrakeError(
        f"geodrake needs Numba, which cannot be imported: {error}.",
        advice="Run `pip install numba` in this environment.",
    ) from error
if config.DISABLE_JIT:  # type: ignore[attr-defined]
    raise GeodrakeError(
        "geodrake needs Numba, but its compilation is disabled.",
        advice="Unset the environment variable NUMBA_DISABLE_JIT.",
    )

F = TypeVar("F", bound=Callable[..., Any])

_TRIES, _PAUSE = 1200, 0.05  # number of attempts to get another process's lock, and interval, s

_SOURCES: dict[Callable[..., Any], str] = {}
"""Compiled function -> hash of the compiler, files, constants and functions that it depends on.

It does not depend on paths, so that files can be copied with their cache.
"""


def compiled(function: F) -> F:
    """Return a function of numbers, arrays and tuples, compiled when it is first called.

    It may call other compiled or inlined functions. Loops compile faster than array expressions,
    sorting or solving in NumPy, each of which takes Numba up to some seconds. Compiled code is
    cached in the source folder, or in the user's cache folder if that is not writable or others can
    write to it. If neither is possible, every process compiles it again.
    """
    return _compiled(function)


def inlined(function: F) -> F:
    """Return a compiled function that is inlined into its callers."""
    return _compiled(function, forceinline=True)


def summing(function: F) -> F:
    """Return a compiled function whose sums may be reordered, which is faster for long sums."""
    return _compiled(function, fastmath={"reassoc", "contract"})


def interpreted(function: F, **others: object) -> F:
    """Return a compiled function, and all functions it calls, as interpreted Python.

    Args:
        others: Replacements of global names, such as those of array types.
    """
    python = getattr(function, "py_func", function)
    scope = {**python.__globals__, **others}
    called: dict[str, Any] = {name: scope.get(name) for name in _names(python.__code__)}
    inner = {n: interpreted(x, **others) for n, x in called.items() if hasattr(x, "py_func")}
    return cast(F, FunctionType(python.__code__, {**scope, **inner}, python.__name__))


def contiguous(x: ArrayLike) -> NDArray[np.float64]:
    """Return a contiguous, writable array; compiled functions have other versions for others."""
    array = np.asarray(x, float)
    return array if array.flags.carray else np.array(array, order="C")


@contextmanager
def while_compiling(begins: Callable[[], None], ends: Callable[[], None]) -> Iterator[None]:
    """Report compilations, some of which take seconds.

    Args:
        begins: Called when the compilation of a function starts.
        ends: Called when it ends, including functions that it calls.
    """
    depth = 0

    class Listener(event.Listener):
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

    listener = Listener()
    event.register("numba:compile", listener)  # type: ignore[no-untyped-call]
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)  # type: ignore[no-untyped-call]


def _compiled(function: F, **options: Any) -> F:
    # Division by zero is infinite, as in NumPy. No wrapper for C is needed.
    settings: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True, **options}
    dispatcher: Any = njit(**settings)(function)
    names = [function.__globals__.get(name) for name in sorted(_names(function.__code__))]
    called = [_SOURCES[x.py_func] for x in names if isinstance(x, type(dispatcher))]
    constants = [x for x in names if isinstance(x, int | float | str | tuple | np.dtype)]
    parts = numba_version, _source(function.__code__.co_filename), constants, called
    source = sha256("".join(map(str, parts)).encode())
    _SOURCES[function] = source.hexdigest()
    dispatcher._cache = _Cache(function, _SOURCES[function])
    return cast(F, dispatcher)


@cache
def _source(path: str) -> str:
    """Return the source of a file."""
    return Path(path).read_text("utf-8")


def _names(code: CodeType) -> frozenset[str]:
    """Return the global names that a function and its nested functions use."""
    nested = (_names(part) for part in code.co_consts if isinstance(part, CodeType))
    return frozenset(code.co_names).union(*nested)


class _Cache:
    """Cache of a function's compiled code, valid while its sources are unchanged.

    Of several processes that start together one compiles it, and the others wait.

    There is a file for each signature, with a hash of the sources. Numba's own cache has an index
    with file numbers, which concurrent processes corrupt. It also checks only the modification time
    of the function's file, and raises on full disks and truncated files.
    """

    def __init__(self, function: Callable[..., Any], source: str) -> None:
        path = Path(function.__code__.co_filename)
        self.cache_path = _cache_folder(path)
        name = re.sub(r"[<>]", "", function.__qualname__)
        version = f"py{sys.version_info[0]}{sys.version_info[1]}{sys.abiflags}"
        self._stem = f"{path.stem}.{name}-{function.__code__.co_firstlineno}.{version}"
        self._source = source
        self._lock: BinaryIO | None = None  # while this process compiles

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the cached code, or None after locking it for compilation by this process."""
        target_context.refresh()
        if self.cache_path is None:
            return None
        path = self._file(sig, target_context.codegen())
        result = self._read(path, target_context)
        if result is None:
            self._wait_for_others(path.with_suffix(".lock"))
            result = self._read(path, target_context)  # compiled by another process
            if result is not None:
                self._unlock()
        return result

    def _wait_for_others(self, path: Path) -> None:
        """Acquire the lock for compilation, or continue without it after a timeout."""
        self._unlock()
        with suppress(OSError):  # without file locks, each process compiles
            self._lock = path.open("wb")
            for _ in range(_TRIES):
                try:
                    fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    time.sleep(_PAUSE)

    def _read(self, path: Path, target_context: Any) -> Any:
        """Return the cached code; None if missing, outdated, a link, or writable by others."""
        with suppress(Exception):
            number = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            with os.fdopen(number, "rb") as file:
                status = os.fstat(number)
                if stat.S_ISREG(status.st_mode) and _is_own(status):
                    source, data = pickle.loads(file.read())
                    if source == self._source:
                        rebuild: Any = compiler.CompileResult._rebuild
                        return rebuild(target_context, *data)
        return None

    def _unlock(self) -> None:
        """Release the lock, for which other processes may wait."""
        if self._lock is not None:
            with suppress(OSError):
                Path(self._lock.name).unlink()
            self._lock.close()
            self._lock = None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write compiled code to the cache, if possible."""
        with suppress(Exception):
            if self.cache_path is not None and not data.library.has_dynamic_globals:
                self._write(self._file(sig, data.codegen), data)
        self._unlock()

    def _write(self, path: Path, data: Any) -> None:
        content = pickle.dumps((self._source, data._reduce()), protocol=-1)
        with tempfile.NamedTemporaryFile(dir=self.cache_path, delete=False) as file:
            try:
                os.fchmod(file.fileno(), 0o644)  # whatever the umask
                file.write(content)
                file.flush()
                Path(file.name).replace(path)
            finally:
                Path(file.name).unlink(missing_ok=True)

    def _file(self, sig: Any, codegen: Any) -> Path:
        key = sha256(repr((sig, codegen.magic_tuple())).encode()).hexdigest()[:16]
        return Path(self.cache_path or "", f"{self._stem}.{key}.nbc")


def _places(path: Path) -> Iterator[tuple[Path, int]]:
    """Yield cache folders and modes: configured, in the source folder, and the user's."""
    name = f"{path.parent.name}_{sha256(str(path.parent).encode()).hexdigest()[:16]}"
    if config.CACHE_DIR:  # type: ignore[attr-defined]
        yield Path(config.CACHE_DIR, name), 0o755  # type: ignore[attr-defined]
    yield path.parent / "__pycache__", 0o755
    home = os.environ.get("XDG_CACHE_HOME") or Path("~", ".cache").expanduser()
    yield Path(home, "geodrake", name), 0o700


def _cache_folder(path: Path) -> Path | None:
    """Return the first cache folder that is writable by this user only."""
    for folder, mode in _places(path):
        with suppress(OSError, RuntimeError):  # RuntimeError without a home folder
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(mode, exist_ok=True)
            status = folder.lstat()
            if stat.S_ISDIR(status.st_mode) and _is_own(status):
                tempfile.TemporaryFile(dir=folder).close()
                return folder
    return None


def _is_own(status: os.stat_result) -> bool:
    """Return whether only the user and root can modify a file or folder.

    Unpickling cached code can execute anything, so the cache must be as trustworthy as the source,
    which root may have installed.
    """
    return status.st_uid in (os.geteuid(), 0) and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
