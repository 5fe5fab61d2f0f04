"""What becomes of errors: one clear message and an exit code, never a traceback unasked."""

from __future__ import annotations

import importlib
import os
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import typer

from geodrake.boundary.escaping import kind_and_line, one_line
from geodrake.boundary.interrupts import deferred_interrupts
from geodrake.cli.interruption import was_interrupted
from geodrake.cli.surroundings import PIPE_CLOSED, check_surroundings, results_apart, warn
from geodrake.errors import GeodrakeError

BAD_INPUT = 2
INTERNAL_ERROR = 1
_SMALLER = "Check that the files are what they should be, and give less at once."
INTERRUPTED = 130  # 128 + SIGINT, as shells have it


@contextmanager
def guarded(*, debug: bool = False, effect_files: Sequence[Path] = ()) -> Iterator[None]:
    """Turn errors into a message on stderr and an exit code.

    Args:
        debug: Show the traceback too; so does the environment variable GEODRAKE_DEBUG.
        effect_files: Python files of the user's own, which may be what fails.
    """
    try:
        check_surroundings()
        with results_apart():
            _load_drake()
            yield
    except typer.Exit:
        raise
    except BrokenPipeError:
        raise typer.Exit(PIPE_CLOSED) from None
    except KeyboardInterrupt:
        _stop("Interrupted.", INTERRUPTED)
    except Exception as error:  # whatever it is, the user gets a sentence
        if was_interrupted():  # extensions make an error of their own of an interrupt
            raise
        if debug or os.environ.get("GEODRAKE_DEBUG", "0") not in ("", "0"):
            lines = "".join(traceback.format_exception(error)).splitlines()
            for shown in lines:
                warn(shown)
        if isinstance(error, GeodrakeError):
            _stop(f"Error: {error}", BAD_INPUT)
        if isinstance(error, MemoryError):
            _stop(f"Error: There is not enough memory: {one_line(error)}. {_SMALLER}", BAD_INPUT)
        line = _line_of_user(error, effect_files)
        if line:
            _stop(f"Error: {line} raises {kind_and_line(error)}.", BAD_INPUT)
        _stop(
            f"Internal error: {kind_and_line(error)}. This is a bug in geodrake; please report it "
            "with what --debug shows.",
            INTERNAL_ERROR,
        )


def _load_drake() -> None:
    """Import what every command needs, and what prints errors of its own if it is interrupted."""
    with deferred_interrupts():
        importlib.import_module("pydrake")


def _stop(message: str, code: int) -> None:
    warn(message)
    raise typer.Exit(code) from None


def _line_of_user(error: Exception, effect_files: Sequence[Path]) -> str | None:
    """Return the innermost line of a user's file that an error came through."""
    files = {path.resolve(): path for path in effect_files}
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename).resolve()
        if path in files:
            return f"line {frame.lineno} of {files[path]}"
    return None
