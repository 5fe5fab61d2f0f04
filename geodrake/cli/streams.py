"""Standard streams, locale and memory of a command; errors become a message, never a traceback."""

from __future__ import annotations

import codecs
import ctypes
import errno
import importlib
import io
import locale
import logging
import os
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TextIO

import typer

from geodrake.boundary.escaping import kind_and_line, one_line, printable
from geodrake.boundary.interrupts import deferred_interrupts
from geodrake.boundary.memory import limit_memory
from geodrake.cli.interruption import was_interrupted
from geodrake.errors import GeodrakeError

_RESULTS: ContextVar[TextIO] = ContextVar("results")
_ENDING: ContextVar[bool] = ContextVar("ending", default=False)
"""Whether the process ends with the command."""

INTERNAL_ERROR, BAD_INPUT, BAD_OUTPUT = 1, 2, 2
INTERRUPTED, PIPE_CLOSED = 130, 141  # 128 + SIGINT and 128 + SIGPIPE, as in shells


@contextmanager
def settled_surroundings() -> Iterator[None]:
    """Make the result of a command independent of the process environment.

    Closed standard streams are redirected to the null device. Characters that a stream cannot
    encode are replaced. Memory is limited, and the user's Matplotlib settings are ignored. Standard
    output is flushed at the end, to report a full disk or a broken pipe. Output of exit handlers,
    for example of user code, goes to standard error.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number: this one
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115, PTH123
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115, PTH123
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without ± must not cause an error
    _ENDING.set(True)
    limit_memory()
    os.environ.update(MPLBACKEND="Agg", MATPLOTLIBRC=os.devnull)
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # messages about its cache
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
            if _descriptor(sys.stdout) == 1:
                os.dup2(2, 1)
    except OSError as error:  # from printing; `guarded` handles errors of the command
        _write_nowhere(results())
        if error.errno == errno.EPIPE:
            raise SystemExit(PIPE_CLOSED) from None
        with suppress(OSError):
            print(f"Error: {_full(error)}", file=sys.stderr)
        raise SystemExit(BAD_OUTPUT) from None
    finally:
        try:
            sys.stderr.flush()
        except (OSError, ValueError):  # full, or closed by user code
            _write_nowhere(sys.stderr)


def check_surroundings() -> None:
    """Raise if the working directory is missing or the locale's encoding is ASCII."""
    try:
        os.getcwd()  # noqa: PTH109
    except OSError as error:
        raise GeodrakeError(
            f"The working directory cannot be used: {error.strerror}.",
            advice="Change to one that exists.",
        ) from error
    encoding = locale.getpreferredencoding(False)
    if codecs.lookup(encoding).name == "ascii":
        raise GeodrakeError(
            f"The locale's encoding is {encoding}, but model files are UTF-8.",
            advice="Set PYTHONUTF8=1, or LC_ALL to a locale with UTF-8, such as C.UTF-8.",
        )


def warn(message: str) -> None:
    """Print a warning on stderr."""
    with suppress(OSError):  # standard error may be full
        print(printable(message), file=sys.stderr, flush=True)


@contextmanager
def results_apart() -> Iterator[None]:
    """Reserve standard output for results, and redirect all other output to standard error.

    This includes output of user code, compiled libraries and child processes and, if the process
    ends with the command, of threads that outlive it.
    """
    stdout, copy = sys.stdout, -1
    stdout.flush()
    stream = stdout
    if _descriptor(stdout) == 1:
        copy = os.dup(1)
        stream = open(copy, "w", encoding=stdout.encoding, errors=stdout.errors)  # noqa: SIM115, PTH123
        os.dup2(2, 1)
    token = _RESULTS.set(stream)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _RESULTS.reset(token)
        if copy >= 0:
            ctypes.CDLL(None).fflush(None)  # buffered output of C libraries
            if not _ENDING.get():
                os.dup2(copy, 1)
            with suppress(OSError):  # already reported by `printing`
                stream.close()


def results() -> TextIO:
    """Return the stream for results."""
    return _RESULTS.get(None) or sys.stdout


def print_whole(text: str) -> None:
    """Print machine-readable text in UTF-8, independent of the terminal's encoding."""
    stream = results()
    if isinstance(stream, io.TextIOWrapper):
        stream.reconfigure(encoding="utf-8", errors="backslashreplace")
    print(text, end="", file=stream)


@contextmanager
def printing() -> Iterator[None]:
    """Report errors in this context as errors of standard output."""
    try:
        yield
        results().flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        _write_nowhere(results())
        raise GeodrakeError(_full(error), advice="The requested files were written.") from error


def _descriptor(stream: TextIO) -> int:
    """Return the file descriptor of a stream; -1 if it has none, as in tests."""
    try:
        return stream.fileno()
    except (OSError, ValueError):
        return -1


def _full(error: OSError) -> str:
    return f"Standard output cannot be written: {error.strerror}."


def _write_nowhere(stream: TextIO) -> None:
    """Redirect a stream to the null device, so that flushing it at exit does not fail."""
    null = os.open(os.devnull, os.O_WRONLY)
    with suppress(OSError, ValueError):
        os.dup2(null, stream.fileno())


_MEMORY_ADVICE = "Check the files, and pass fewer or shorter ones."


@contextmanager
def guarded(*, debug: bool = False, effect_files: Sequence[Path] = ()) -> Iterator[None]:
    """Turn errors, including those in user code, into a message on stderr and an exit code.

    With `debug` or GEODRAKE_DEBUG, the traceback is shown as well.
    """
    try:
        check_surroundings()
        with results_apart():
            with deferred_interrupts():  # an interrupted import prints its own errors
                importlib.import_module("pydrake")
            yield
    except typer.Exit:
        raise
    except BrokenPipeError:
        raise typer.Exit(PIPE_CLOSED) from None
    except KeyboardInterrupt:
        warn("Interrupted.")
        raise typer.Exit(INTERRUPTED) from None
    except Exception as error:  # any error becomes a sentence for the user
        if was_interrupted():  # extension modules turn an interrupt into their own error
            raise
        if debug or os.environ.get("GEODRAKE_DEBUG", "0") not in ("", "0"):
            for line in "".join(traceback.format_exception(error)).splitlines():
                warn(line)
        files = {path.resolve(): path for path in effect_files}
        lines = [
            f"line {frame.lineno} of {files[place]}"
            for frame in traceback.extract_tb(error.__traceback__)
            if (place := Path(frame.filename).resolve()) in files
        ]
        message, code = f"Error: {error}", BAD_INPUT
        if isinstance(error, MemoryError):
            message = f"Error: Out of memory: {one_line(error)}. {_MEMORY_ADVICE}"
        elif lines and not isinstance(error, GeodrakeError):
            message = f"Error: {lines[-1]} raises {kind_and_line(error)}."
        elif not isinstance(error, GeodrakeError):
            message = (
                f"Internal error: {kind_and_line(error)}. This is a bug in geodrake; please report "
                "it with the output of --debug."
            )
            code = INTERNAL_ERROR
        warn(message)
        raise typer.Exit(code) from None
