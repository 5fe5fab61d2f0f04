"""Work in a process of its own, so that compiled code can end or lose only that one.

A panic in Rust, a failed assertion in C++ or `exit` in C end the process they are in, and nothing
in Python can catch them. A copy of this process by `fork` has all data; it then waits a moment for
more work, as to begin and end one takes five times as long as to solve a fit.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import pickle
import resource
import signal
import time
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection, Pipe
from typing import Any, NoReturn, TypeVar

from geodrake.errors import GeodrakeError

T = TypeVar("T")
_INTERRUPTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PATIENCE = 1.0  # s, for which a copy waits for more work


class LostProcessError(Exception):
    """What became of a process that gave no answer, as the rest of a sentence."""


class LateProcessError(LostProcessError):
    """A process whose time was over."""


def in_subprocess(work: Callable[[], T], *, seconds: float) -> T:
    """Return or raise what a function does, called in a copy of this process that prints nothing.

    What it returns is pickled; a copy that waits takes it if it can be pickled too. Where that one
    ends, a new one has what is left of its time. What it raises is a LostProcessError, unless it
    is a GeodrakeError, as are its end and, as a LateProcessError, the end of its time.
    """
    over = time.monotonic() + seconds
    question: bytes | None = None
    with contextlib.suppress(Exception):  # Drake's programs cannot be pickled, nor may a user's be
        question = pickle.dumps(work)
    copy = _waiting() if question is not None else None
    answer = None if copy is None else copy.answer(over, seconds, question)
    if copy is None or answer is None:
        # One that waited may have ended before it was asked: only a new one's end is told.
        copy = _Copy(work)
        answer = copy.answer(over, seconds)
    if answer is None:
        raise LostProcessError(f"ended with {copy.end}")
    result, failure = answer
    if question is None or _WAITING or isinstance(failure, LostProcessError):
        copy.stop()
    else:
        _WAITING.append(copy)
    if failure is not None:
        raise failure
    return result


class _Copy:
    """A copy of this process that works, and then waits for more to do."""

    end = ""
    """How it has ended; empty until then."""

    def __init__(self, work: Callable[[], Any]) -> None:
        self.owner = os.getpid()
        self._line, other = Pipe()
        # An interrupt waits, so that it is not one of the copy's too.
        waiting = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
        try:
            with warnings.catch_warnings():
                # Python warns of other threads: the copy has none, and numerical libraries look
                # after their own locks at a fork. One that waits all the same is lost when its
                # time is over.
                warnings.simplefilter("ignore", DeprecationWarning)
                self._child = os.fork()
            if not self._child:
                self._line.close()
                _serve(work, other)
        except OSError as error:
            raise LostProcessError(f"could not be started: {error.strerror}") from error
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, waiting)
        other.close()

    def answer(
        self, over: float, seconds: float, question: bytes | None = None
    ) -> tuple[Any, Exception | None] | None:
        """Return what its work, or a question, returned and raised; None if it has ended instead.

        Its time of so many seconds is over at a value of the monotonic clock, s. A question is
        further work, pickled.
        """
        answer: tuple[Any, Exception | None] | None = None
        try:
            if question is not None:
                self._line.send_bytes(question)
            if not self._line.poll(max(over - time.monotonic(), 0.0)):
                raise LateProcessError(f"gave no answer in {seconds:g} s")
            answer = self._line.recv()
        except (EOFError, OSError):
            pass  # it has ended, perhaps amid its answer
        finally:
            if answer is None:
                self.stop()
        return answer

    def stop(self) -> None:
        """Make sure that it has ended, and find out how."""
        self._line.close()
        try:
            child, status = os.waitpid(self._child, os.WNOHANG)
            if not child:
                os.kill(self._child, signal.SIGKILL)
                _, status = os.waitpid(self._child, 0)
        except (ProcessLookupError, ChildProcessError):
            # The program has its children reaped elsewhere, and the number may be another's.
            self.end = "nobody knows what"
        else:
            code = os.waitstatus_to_exitcode(status)
            self.end = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


_WAITING: list[_Copy] = []
"""The copy that waits, if there is one. It ends if its process does."""


def _waiting() -> _Copy | None:
    """Return a copy that waits for work of this process, if there is one."""
    with contextlib.suppress(IndexError):  # none is left; another thread may have taken it
        while (copy := _WAITING.pop()).owner != os.getpid():
            pass  # a process that forked this one has it
        return copy
    return None


def end_waiting() -> None:
    """End the copy of this process that waits for work, so that its time counts as this one's."""
    while (copy := _waiting()) is not None:
        copy.stop()


def _serve(work: Callable[[], Any], line: Connection) -> NoReturn:
    """Send what `work` and what follows return and raise, as pairs, and end this process."""
    try:
        for number in _INTERRUPTS:
            signal.signal(number, signal.SIG_DFL)  # an interrupt is the first process's
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _INTERRUPTS)
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        silence = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            os.dup2(silence, stream)
        line.send(_outcome(work))
        while line.poll(_PATIENCE):
            line.send(_outcome(pickle.loads(line.recv_bytes())))
    finally:
        os._exit(0)


def _outcome(work: Callable[[], Any]) -> tuple[Any, Exception | None]:
    try:
        return work(), None
    except GeodrakeError as error:
        return None, error
    except BaseException as error:  # Drake raises SystemExit where its assertions fail
        return None, LostProcessError(f"raised {type(error).__name__}: {error}")
