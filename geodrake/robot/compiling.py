"""Loops over samples, compiled once and kept on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.core import event

F = TypeVar("F", bound=Callable[..., Any])


def compiled(function: F) -> F:
    """A function of numbers, arrays and tuples of them, compiled when it is first called.

    What was compiled is kept beside the source, or in the user's folder for caches where that
    cannot be written. Where neither can be, every process compiles it anew.

    Args:
        function: The function. It may call others that are compiled or inlined, of its own module
            and of those of this folder.
    """
    return _compiled(function)


def inlined(function: F) -> F:
    """The same, as a part of what calls it.

    Args:
        function: A function as for `compiled`.
    """
    return _compiled(function, forceinline=True)


def _compiled(function: F, **options: Any) -> F:
    dispatcher: Any
    try:
        dispatcher = njit(cache=True, **options)(function)
    except RuntimeError:  # there is no place for a cache
        dispatcher = njit(**options)(function)
        return cast(F, dispatcher)
    # Numba looks at the function's own file alone, not at those of what it calls.
    kept = dispatcher._cache._cache_file
    kept._source_stamp = (kept._source_stamp, _sources())
    return cast(F, dispatcher)


@contextmanager
def while_compiling(begins: Callable[[], None], ends: Callable[[], None]) -> Iterator[None]:
    """Tells of every function that is compiled as it was not kept; some take seconds.

    Args:
        begins: Called as soon as one is compiled.
        ends: Called when that is done.
    """

    class Teller(event.Listener):
        def on_start(self, event: Any) -> None:
            begins()

        def on_end(self, event: Any) -> None:
            ends()

    teller = Teller()
    event.register("numba:compile", teller)  # type: ignore[no-untyped-call]
    try:
        yield
    finally:
        event.unregister("numba:compile", teller)  # type: ignore[no-untyped-call]


@cache
def _sources() -> tuple[tuple[str, int, int], ...]:
    """Name, time and size of the modules of this folder."""
    files = [(path.name, path.stat()) for path in sorted(Path(__file__).parent.glob("*.py"))]
    return tuple((name, status.st_mtime_ns, status.st_size) for name, status in files)
