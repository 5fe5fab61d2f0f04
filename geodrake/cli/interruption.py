"""Handling of Ctrl-C, SIGTERM and SIGHUP, which end a command with a one-word message."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from geodrake.boundary.interrupts import StopSearch

_WORDS = {signal.SIGINT: "Interrupted.", signal.SIGTERM: "Terminated.", signal.SIGHUP: "Hung up."}
_AGAIN = 0.05  # s after which an interrupt that could not be raised is raised again


class Interruption(BaseException):
    """A request to end the command; no `Exception`, so that error handlers do not catch it."""


class FirstInterrupt(Interruption, StopSearch):
    """The first Ctrl-C, at which a search returns its results so far."""


class _Handler:
    """A signal handler that raises an interruption and stores the signal."""

    def __init__(self) -> None:
        self.arrived: signal.Signals | None = None  # the last signal, if any

    def __call__(self, number: int, frame: FrameType | None) -> None:
        del frame
        is_first = self.arrived is None and number == signal.SIGINT
        self.arrived = signal.Signals(number)
        raise (FirstInterrupt if is_first else Interruption)(self.arrived.name)

    def unraisable(self, lost: sys.UnraisableHookArgs) -> None:
        """Raise an interruption again that was lost in a destructor."""
        if not issubclass(lost.exc_type, Interruption) or self.arrived is None:
            sys.__unraisablehook__(lost)
            return
        main = threading.main_thread().ident
        again = threading.Timer(_AGAIN, signal.pthread_kill, [main, self.arrived])
        if issubclass(lost.exc_type, FirstInterrupt):
            self.arrived = None  # it has not been handled yet
        again.daemon = True
        again.start()


def was_interrupted() -> bool:
    """Return whether `interruptible` has handled a signal, which may cause later errors."""
    handlers = map(signal.getsignal, _WORDS)
    return any(isinstance(h, _Handler) and h.arrived is not None for h in handlers)


@contextmanager
def interruptible() -> Iterator[None]:
    """End the process at a signal with one word on stderr and exit code 128 + signal number.

    Signals that the process ignores, for example under `nohup`, remain ignored.
    """
    handler = _Handler()
    numbers = [n for n in _WORDS if signal.getsignal(n) is not signal.SIG_IGN]
    try:
        for number in numbers:
            signal.signal(number, handler)
        sys.unraisablehook = handler.unraisable
        yield
    except BaseException as error:
        arrived = handler.arrived
        if arrived is None or isinstance(error, SystemExit):
            raise
        _end_quietly(numbers)
        with suppress(OSError):
            print(_WORDS[arrived], file=sys.stderr, flush=True)
        raise SystemExit(128 + arrived) from None
    finally:
        _end_quietly(numbers)  # nothing remains to be interrupted


def _end_quietly(numbers: list[signal.Signals]) -> None:
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)
