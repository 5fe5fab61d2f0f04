"""Work in a process of its own, so that compiled code can end or lose only that one.

A panic in Rust, a failed assertion in C++ or `exit` in C end the process they are in, and nothing
in Python can catch them. A copy of this process by `fork` takes some 5 ms and has all data.
"""

from __future__ import annotations

import faulthandler
import os
import resource
import signal
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection, Pipe
from typing import Any, NoReturn, TypeVar

from geodrake.errors import GeodrakeError

T = TypeVar("T")
_INTERRUPTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class LostProcessError(Exception):
    """What became of a process that gave no answer, as the rest of a sentence."""


class LateProcessError(LostProcessError):
    """A process whose time was over."""


def in_own_process(work: Callable[[], T], *, seconds: float) -> T:
    """What a function returns or raises, called in a copy of this process.

    Args:
        work: Called without arguments; what it returns is pickled, what it prints is dropped.
        seconds: Time it may take.

    Raises:
        GeodrakeError: What the function raised.
        LateProcessError: Its time was over.
        LostProcessError: It raised something else, or its process ended.
    """
    reader, writer = Pipe(duplex=False)
    # An interrupt waits, so that it is not one of the copy's too.
    waiting = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
    try:
        with warnings.catch_warnings():
            # Python warns of other threads: the copy has none, and numerical libraries look after
            # their own locks at a fork. One that waits all the same is lost when its time is over.
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
        if not child:
            _answer(work, writer)
    except OSError as error:
        raise LostProcessError(f"could not be started: {error.strerror}") from error
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, waiting)
    writer.close()
    answer: Any = None
    try:
        if not reader.poll(seconds):
            raise LateProcessError(f"gave no answer in {seconds:g} s")
        answer = reader.recv()
    except (EOFError, OSError):
        pass  # it has ended, perhaps amid its answer
    finally:
        reader.close()
        end = _ended(child)
    if answer is None:
        raise LostProcessError(f"ended with {end}")
    result, failure = answer
    if failure is not None:
        raise failure
    return result


def _ended(child: int) -> str:
    """How a process has ended, which it has by now, or is made to."""
    try:
        os.kill(child, signal.SIGKILL)  # which does nothing to one that has ended
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    except (ProcessLookupError, ChildProcessError):
        return "nobody knows what"  # where the program has its children reaped elsewhere
    return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


def _answer(work: Callable[[], Any], writer: Connection) -> NoReturn:
    """Send what `work` returns and raises as a pair, and end this process."""
    try:
        for number in _INTERRUPTS:
            signal.signal(number, signal.SIG_DFL)  # an interrupt is the first process's
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _INTERRUPTS)
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        silence = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            os.dup2(silence, stream)
        writer.send(_outcome(work))
    finally:
        os._exit(0)


def _outcome(work: Callable[[], Any]) -> tuple[Any, Exception | None]:
    try:
        return work(), None
    except GeodrakeError as error:
        return None, error
    except BaseException as error:  # Drake raises SystemExit where its assertions fail
        return None, LostProcessError(f"raised {type(error).__name__}: {error}")
