"""The files a command writes: checked before the long work, written whole after it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from geodrake.errors import OutputError

if TYPE_CHECKING:
    from geodrake.model import RobotModel

STDOUT = Path("-")
_SUFFIXES = {
    "json": (".json",),
    "report": (".html", ".htm"),
    "save": (".yaml", ".yml"),
    "export": (".urdf", ".sdf", ".xml", ".mjcf", ".world"),
    "ellipsoids": (".png", ".pdf", ".svg"),
    "meshcat": (".html", ".htm"),
    "draft-effect": (".py",),
}


@dataclass(frozen=True)
class Targets:
    """Where to write what; None for what is not asked for.

    Attributes:
        save: The model, YAML.
        json: The numbers, JSON; `-` is standard output.
        report: The page with the figures, HTML.
        more: Option -> what else a command writes.
        suffixes: Option -> suffixes of its file, where they are others than usual.
    """

    save: Path | None = None
    json: Path | None = None
    report: Path | None = None
    more: Mapping[str, Path | None] = field(default_factory=dict)
    suffixes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def files(self) -> dict[str, Path]:
        """Option -> file, those asked for."""
        named = {"save": self.save, "json": self.json, "report": self.report, **self.more}
        return {name: path for name, path in named.items() if path and path != STDOUT}

    def check(self, inputs: Iterable[Path]) -> None:
        """Refuse targets that cannot be written or that would overwrite something else.

        Args:
            inputs: Files that the command reads.

        Raises:
            OutputError: A target has another kind's suffix, is an input or another target, is no
                regular file, or its folder is missing or cannot be written to.
        """
        taken = {path.resolve(): "is an input of this command" for path in inputs}
        for name, path in self.files.items():
            _check_kind(name, path, self.suffixes.get(name, _SUFFIXES.get(name, ())))
            reason = taken.get(path.resolve())
            if reason:
                raise _refusal(name, path, reason, "Choose another name.")
            taken[path.resolve()] = f"is already the target of --{name}"
            try:
                _check_writable(name, path)
            except OSError as error:
                reason = f"cannot be written: {error.strerror or error}"
                raise _refusal(name, path, reason, "Choose another place.") from error

    def write(
        self, model: RobotModel, makers: Mapping[str, Callable[[], str | bytes]]
    ) -> dict[str, Path]:
        """Write what was asked for, each file whole or not at all; contents are made first.

        Args:
            model: The model to save.
            makers: Option -> makes the content of its file; nothing is written without one.

        Returns:
            Option -> file, those written.

        Raises:
            OutputError: A file cannot be written after all.
        """
        from geodrake.saved_model import save_model, write_whole

        contents = {name: makers[name]() for name in self.files if name in makers}
        for name, content in contents.items():
            write_whole(self.files[name], content)
        if self.save:
            save_model(model, self.save)
        return {name: path for name, path in self.files.items() if name in {*contents, "save"}}


def _check_kind(name: str, path: Path, suffixes: tuple[str, ...]) -> None:
    if path.suffix.lower() not in suffixes:
        reason = f"does not end in {' or '.join(suffixes)}"
        raise _refusal(name, path, reason, f"Name it {path.stem or name}{suffixes[0]}.")


def _check_writable(name: str, path: Path) -> None:
    if not path.parent.is_dir():
        raise _refusal(
            name, path, f"is in {path.parent}, which is no folder", "Choose a folder that exists."
        )
    if path.exists() and not path.is_file():
        raise _refusal(name, path, "is there and is no file", "Choose another name.")
    if path.exists() and not os.access(path, os.W_OK):
        raise _refusal(name, path, "is there and is read-only", "Choose another name.")
    with tempfile.TemporaryFile(dir=path.parent):
        pass


def _refusal(name: str, path: Path, reason: str, advice: str) -> OutputError:
    return OutputError(f"Cannot write --{name} {path}: it {reason}.", advice=advice, path=path)
