"""Loops that run once a sample, compiled once and kept on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.errors import GeodrakeError

try:
    from numba import config, njit
    from numba.core import caching, event
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

_FILES: dict[str, frozenset[str]] = {}
"""Of each file with compiled functions: all whose functions are in them."""


def compiled(function: F) -> F:
    """A function of numbers, arrays and tuples of them, compiled when it is first called.

    What was compiled is kept beside the source, or in the user's folder for caches where that
    cannot be written. Where neither can be, every process compiles it anew.

    Args:
        function: The function. It may call others that are compiled or inlined.
    """
    return _compiled(function)


def inlined(function: F) -> F:
    """The same, as a part of what calls it.

    Args:
        function: A function as for `compiled`.
    """
    return _compiled(function, forceinline=True)


def contiguous(x: ArrayLike) -> NDArray[np.float64]:
    """An array as compiled code knows it: other layouts would be compiled once more.

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
    own = function.__code__.co_filename
    called = [x for x in function.__globals__.values() if isinstance(x, type(dispatcher))]
    files = {own}.union(*(_FILES[each.py_func.__code__.co_filename] for each in called))
    _FILES[own] = _FILES.get(own, frozenset()) | files
    with suppress(RuntimeError):  # there is no place for a cache
        dispatcher._cache = _Kept(function, _FILES[own])
    return cast(F, dispatcher)


_FunctionCache: Any = caching.FunctionCache


class _Kept(_FunctionCache):
    """What was compiled of a function, as long as all files that it came from are what they were.

    Numba looks at the function's own file alone, and a full disk or a file that was cut off would
    be an error of the call.
    """

    def __init__(self, function: Callable[..., Any], files: frozenset[str]) -> None:
        super().__init__(function)
        times = [(Path(file).name, Path(file).stat()) for file in sorted(files)]
        stamp = tuple((name, status.st_mtime_ns, status.st_size) for name, status in times)
        self._cache_file._source_stamp = stamp

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was kept; None if there is nothing that can be read."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps what was compiled, if there is room."""
        with suppress(Exception):
            super().save_overload(sig, data)
