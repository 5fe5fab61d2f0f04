"""Interrupts deferred until the end of a critical section."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class StopSearch(BaseException):  # not an error, like KeyboardInterrupt
    """Raised to end a search early; the best result so far is kept."""


def is_stop(error: BaseException | None) -> bool:
    """Return whether an error is `StopSearch`, or was raised from it."""
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
        A function that returns whether an interrupt is pending.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False  # only the main thread gets interrupts
        return
    pending: list[int] = []
    handlers = {}
    try:
        for number in _SIGNALS:
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                handlers[number] = signal.signal(number, lambda arrived, _: pending.append(arrived))
        yield lambda: bool(pending)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for arrived in dict.fromkeys(pending):
            signal.raise_signal(arrived)
