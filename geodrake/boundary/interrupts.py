"""Interrupts that wait until a critical section is done."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class StopSearch(BaseException):  # as KeyboardInterrupt, it is no error
    """Raised to end a search early; the best result so far is kept."""


def is_stop(error: BaseException | None) -> bool:
    """Return whether an error is `StopSearch`, or one that an extension raised from it."""
    while error is not None:
        if isinstance(error, StopSearch):
            return True
        error = error.__cause__ or error.__context__
    return False


_SIGNALS = (signal.SIGHUP, signal.SIGTERM, signal.SIGINT)


@contextmanager
def deferred_interrupts() -> Iterator[Callable[[], bool]]:
    """Defer interrupts to the end of the block.

    Yields:
        Whether one has come.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False  # interrupts go to the main thread alone
        return
    arrived: list[int] = []
    before = {}
    try:
        for number in _SIGNALS:
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, lambda given, _: arrived.append(given))
        yield lambda: bool(arrived)
    finally:
        for held, handler in before.items():
            signal.signal(held, handler)
        for waiting in dict.fromkeys(arrived):
            signal.raise_signal(waiting)
