"""The files a command writes: checked before the long work, written whole after it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geodrake.boundary.whole_files import Content, check_writable
from geodrake.errors import OutputError

STDOUT = Path("-")
PAGE = (".html", ".htm")


@dataclass(frozen=True)
class Output:
    """A file that a command writes if an option names it."""

    path: Path | None  # where it goes; None if nobody asked for it, `-` for standard output
    words: str  # what it is
    suffixes: tuple[str, ...] = PAGE  # how its name may end
    # What goes into it, of the result; None if there is nothing to write.
    make: Callable[[Any], Content | None] = lambda found: None


def files_of(outputs: Mapping[str, Output]) -> dict[str, Path]:
    """Option -> file, those asked for."""
    return {name: one.path for name, one in outputs.items() if one.path not in (None, STDOUT)}


def check_outputs(outputs: Mapping[str, Output], inputs: Iterable[Path]) -> None:
    """Refuse files that cannot be written or that would overwrite something else."""
    for name, output in outputs.items():
        if output.path == STDOUT and name != "json":
            reason = "is standard output, which takes --json alone"
            raise _refusal(name, STDOUT, reason, "Name a file.")
    taken = {_place(path): "is an input of this command" for path in inputs}
    for name, path in files_of(outputs).items():
        _check_kind(name, path, outputs[name].suffixes)
        if _place(path) in taken:
            raise _refusal(name, path, taken[_place(path)], "Choose another name.")
        taken[_place(path)] = f"is already the target of --{name}"
        reason, advice = _obstacle(path)
        if reason:
            raise _refusal(name, path, reason, advice)


def _place(path: Path) -> str:
    """Return where a path leads, also one whose links lead nowhere."""
    return os.path.realpath(path)


def _check_kind(name: str, path: Path, suffixes: tuple[str, ...]) -> None:
    if path.suffix.lower() not in suffixes:
        reason = f"does not end in {' or '.join(suffixes)}"
        raise _refusal(name, path, reason, f"Name it {path.stem or name}{suffixes[0]}.")


def _obstacle(path: Path) -> tuple[str, str]:
    """Return why a file cannot be written, and what to do about it; nothing if it can."""
    try:
        if not path.parent.is_dir():
            return f"is in {path.parent}, which is no folder", "Choose a folder that exists."
        if path.exists() and not path.is_file():
            return "is there and is no file", "Choose another name."
        if path.exists() and not os.access(path, os.W_OK):
            return "is there and is read-only", "Choose another name."
        check_writable(path)
    except OSError as error:
        return f"cannot be written: {error.strerror}", "Choose another place."
    except OutputError as error:
        return f"cannot be written: {error.evidence['reason']}", "Choose another place."
    return "", ""


def _refusal(name: str, path: Path, reason: str, advice: str) -> OutputError:
    return OutputError(f"Cannot write --{name} {path}: it {reason}.", advice=advice, path=path)
