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
    try:
        with warnings.catch_warnings():
            # Other threads do not matter: the copy runs none, and waits for no lock of theirs.
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
    except OSError as error:
        raise LostProcessError(f"could not be started: {error.strerror}") from error
    if not child:
        _answer(work, writer)
    writer.close()
    answer: Any = None
    try:
        if not reader.poll(seconds):
            raise LateProcessError(f"gave no answer in {seconds:g} s")
        answer = reader.recv()
    except EOFError:
        pass  # it has ended
    finally:
        reader.close()
        os.kill(child, signal.SIGKILL)  # which does nothing to one that has ended
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if answer is None:
        end = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        raise LostProcessError(f"ended with {end}")
    result, failure = answer
    if failure is not None:
        raise failure
    return result


def _answer(work: Callable[[], Any], writer: Connection) -> NoReturn:
    """Send what `work` returns and raises as a pair, and end this process."""
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)  # an interrupt is the first process's
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
