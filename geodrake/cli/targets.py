"""The files a command writes: checked before the long work, written whole after it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from geodrake.boundary.whole_files import check_writable
from geodrake.errors import OutputError

STDOUT = Path("-")
_SUFFIXES = {
    "json": (".json",),
    "report": (".html", ".htm"),
    "save": (".yaml", ".yml"),
    "export": (".urdf", ".sdf", ".xml", ".mjcf", ".world"),
    "ellipsoids": (".png", ".pdf", ".svg"),
    "meshcat": (".html", ".htm"),
    "out": (".html", ".htm"),
    "video": (".mp4", ".gif"),
    "to": (".rrd", ".mcap"),
    "draft-effect": (".py",),
    "series": (".csv", ".parquet"),
}


SAVED = {
    "save": "model",
    "json": "numbers",
    "report": "report",
    "export": "model file with the identified inertias",
    "ellipsoids": "ellipsoids",
    "meshcat": "page of ellipsoids",
    "draft-effect": "drafted effects",
    "series": "samples",
}
"""Option -> what its file is."""


@dataclass(frozen=True)
class Targets:
    """Where to write what.

    Attributes:
        asked: Option -> its file; None for what is not asked for, `-` for standard output.
        suffixes: Option -> suffixes of its file, where they are others than usual.
    """

    asked: Mapping[str, Path | None]
    suffixes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def files(self) -> dict[str, Path]:
        """Option -> file, those asked for."""
        return {name: path for name, path in self.asked.items() if path not in (None, STDOUT)}

    def check(self, inputs: Iterable[Path]) -> None:
        """Refuse targets that cannot be written or that would overwrite something else."""
        for name, path in self.asked.items():
            if path is not None and path == STDOUT and name != "json":
                reason = "is standard output, which takes --json alone"
                raise _refusal(name, path, reason, "Name a file.")
        taken = {_place(path): "is an input of this command" for path in inputs}
        for name, path in self.files.items():
            _check_kind(name, path, self.suffixes.get(name, _SUFFIXES.get(name, ())))
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
