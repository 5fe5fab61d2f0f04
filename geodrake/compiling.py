"""Loops that run once a sample, compiled once and kept on disk."""

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

_TRIES, _PAUSE = 1200, 0.05  # how often a process looks whether another one is done, and s between

_SOURCES: dict[Callable[..., Any], str] = {}
"""Of each compiled function a digest of compiler, files, constants and functions it is made from.

What was kept does not depend on where the files are: a copy of them may bring it along.
"""


def compiled(function: F) -> F:
    """Return a function of numbers, arrays and tuples of them, compiled when it is first called.

    It may call others that are compiled or inlined. What was compiled is kept beside the source, or
    in the user's folder for caches where that cannot be written or others can write. Where neither
    will do, every process compiles it anew.
    """
    return _compiled(function)


def inlined(function: F) -> F:
    """Return the same, as a part of what calls it."""
    return _compiled(function, forceinline=True)


def summing(function: F) -> F:
    """Return a compiled function whose sums may be reordered, which is faster if they are long."""
    return _compiled(function, fastmath={"reassoc", "contract"})


def interpreted(function: F, **others: object) -> F:
    """Return a compiled function as Python runs it, and all that it calls.

    Args:
        others: What stands for names in it, such as those of types of arrays.
    """
    own = getattr(function, "py_func", function)
    scope = {**own.__globals__, **others}
    called: dict[str, Any] = {name: scope.get(name) for name in _names(own.__code__)}
    inner = {n: interpreted(x, **others) for n, x in called.items() if hasattr(x, "py_func")}
    return cast(F, FunctionType(own.__code__, {**scope, **inner}, own.__name__))


def contiguous(x: ArrayLike) -> NDArray[np.float64]:
    """Return an array as compiled code knows it: other layouts would be compiled once more."""
    array = np.asarray(x, float)
    return array if array.flags.carray else np.array(array, order="C")


@contextmanager
def while_compiling(begins: Callable[[], None], ends: Callable[[], None]) -> Iterator[None]:
    """Tell of what is compiled as it was not kept; some of it takes seconds.

    `begins` is called as soon as a function is compiled, `ends` when that is done, and all that it
    calls.
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
    # (Divisions by zero are infinite, as in NumPy. Nothing calls it from C.)
    settings: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True, **options}
    dispatcher: Any = njit(**settings)(function)
    names = [function.__globals__.get(name) for name in sorted(_names(function.__code__))]
    called = [_SOURCES[x.py_func] for x in names if isinstance(x, type(dispatcher))]
    constants = [x for x in names if isinstance(x, int | float | str | tuple | np.dtype)]
    parts = numba_version, _source(function.__code__.co_filename), constants, called
    source = sha256("".join(map(str, parts)).encode())
    _SOURCES[function] = source.hexdigest()
    dispatcher._cache = _Kept(function, _SOURCES[function])
    return cast(F, dispatcher)


@cache
def _source(path: str) -> str:
    """Return what is in a file of compiled functions."""
    return Path(path).read_text("utf-8")


def _names(code: CodeType) -> frozenset[str]:
    """Return names that a function uses, in what is defined within it, too."""
    within = (_names(part) for part in code.co_consts if isinstance(part, CodeType))
    return frozenset(code.co_names).union(*within)


class _Kept:
    """Compiled code of a function, valid while all that it came from is unchanged.

    Of processes that begin together one compiles it, and the others wait.

    A file for each signature, with a digest of its sources. Numba's own files have numbers that an
    index tells, which every process writes anew: of two that compile at once one may be told the
    other's. It also looks at the time of the function's own file alone, and a full disk or a file
    that was cut off would be an error of the call.
    """

    def __init__(self, function: Callable[..., Any], source: str) -> None:
        path = Path(function.__code__.co_filename)
        self.cache_path = _place_beside(path)
        name = re.sub(r"[<>]", "", function.__qualname__)
        version = f"py{sys.version_info[0]}{sys.version_info[1]}{sys.abiflags}"
        self._stem = f"{path.stem}.{name}-{function.__code__.co_firstlineno}.{version}"
        self._source = source
        self._lock: BinaryIO | None = None  # while it is compiled here

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what was kept, None without; then other processes wait for what is compiled."""
        target_context.refresh()
        if self.cache_path is None:
            return None
        path = self._file(sig, target_context.codegen())
        kept = self._read(path, target_context)
        if kept is None:
            self._wait_for_others(path.with_suffix(".lock"))
            kept = self._read(path, target_context)  # as another process may have compiled it
            if kept is not None:
                self._unlock()
        return kept

    def _wait_for_others(self, path: Path) -> None:
        """Take the lock of what is to be compiled, or go on without it after a while."""
        self._unlock()
        with suppress(OSError):  # where files cannot be locked, each compiles its own
            self._lock = path.open("wb")
            for _ in range(_TRIES):
                try:
                    fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    time.sleep(_PAUSE)

    def _read(self, path: Path, target_context: Any) -> Any:
        """Return what was kept, unless it is a link, or others can write it; None without."""
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
        """Let processes go on that wait for what was compiled here."""
        if self._lock is not None:
            with suppress(OSError):
                Path(self._lock.name).unlink()
            self._lock.close()
            self._lock = None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled, if there is room."""
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
    """Yield folders for what is compiled of a file, and their modes: asked for, beside it, own."""
    name = f"{path.parent.name}_{sha256(str(path.parent).encode()).hexdigest()[:16]}"
    if config.CACHE_DIR:  # type: ignore[attr-defined]
        yield Path(config.CACHE_DIR, name), 0o755  # type: ignore[attr-defined]
    yield path.parent / "__pycache__", 0o755
    home = os.environ.get("XDG_CACHE_HOME") or Path("~", ".cache").expanduser()
    yield Path(home, "geodrake", name), 0o700


def _place_beside(path: Path) -> Path | None:
    """Return the first folder that can be made and written, and that others cannot write."""
    for folder, mode in _places(path):
        with suppress(OSError, RuntimeError):  # or there is no home
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(mode, exist_ok=True)
            status = folder.lstat()
            if stat.S_ISDIR(status.st_mode) and _is_own(status):
                tempfile.TemporaryFile(dir=folder).close()
                return folder
    return None


def _is_own(status: os.stat_result) -> bool:
    """Return whether only the user and root can change what a file or folder holds.

    What is kept is unpickled, which runs whatever it says. So it must be as trustworthy as the
    source itself, which root may have installed.
    """
    return status.st_uid in (os.geteuid(), 0) and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
