"""Work in a process of its own, so that compiled code can end or lose only that one.

A panic in Rust, a failed assertion in C++ or `exit` in C end the process they are in, and nothing
in Python can catch them. A copy of this process by `fork` has all data, whatever they are.
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


def in_subprocess(work: Callable[[], T], *, seconds: float) -> T:
    """Return or raise what a function does, called in a copy of this process that prints nothing.

    What it returns is pickled. What it raises is a LostProcessError, unless it is a GeodrakeError,
    as are its end and, as a LateProcessError, the end of its time.
    """
    line, other = Pipe()
    # An interrupt waits, so that it is not one of the copy's too.
    waiting = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
    try:
        with warnings.catch_warnings():
            # Python warns of other threads: the copy has none, and numerical libraries look after
            # their own locks at a fork. One that waits all the same is lost when its time is over.
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
        if not child:
            line.close()
            _serve(work, other)
    except OSError as error:
        raise LostProcessError(f"could not be started: {error.strerror}") from error
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, waiting)
    other.close()
    answer: tuple[T, Exception | None] | None = None
    patience = os.WNOHANG
    try:
        if not line.poll(max(seconds, 0.0)):
            raise LateProcessError(f"gave no answer in {seconds:g} s")
        answer = line.recv()
    except (EOFError, OSError):
        patience = 0  # it is ending, perhaps amid its answer
    finally:
        line.close()
        end = _ended(child, patience)
    if answer is None:
        raise LostProcessError(f"ended with {end}")
    result, failure = answer
    if failure is not None:
        raise failure
    return result


def _ended(child: int, patience: int) -> str:
    """Make sure that a process has ended, and return how."""
    try:
        found, status = os.waitpid(child, patience)
        if not found:
            os.kill(child, signal.SIGKILL)
            _, status = os.waitpid(child, 0)
    except (ProcessLookupError, ChildProcessError):
        # The program has its children reaped elsewhere, and the number may be another's.
        return "nobody knows what"
    code = os.waitstatus_to_exitcode(status)
    return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


def _serve(work: Callable[[], Any], line: Connection) -> NoReturn:
    """Send what `work` returns and raises, as a pair, and end this process."""
    try:
        for number in _INTERRUPTS:
            signal.signal(number, signal.SIG_DFL)  # an interrupt is the first process's
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _INTERRUPTS)
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        silence = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            os.dup2(silence, stream)
        try:
            line.send((work(), None))
        except GeodrakeError as error:
            line.send((None, error))
        except BaseException as error:  # Drake raises SystemExit where its assertions fail
            line.send((None, LostProcessError(f"raised {type(error).__name__}: {error}")))
    finally:
        os._exit(0)
