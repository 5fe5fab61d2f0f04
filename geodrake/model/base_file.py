"""The model file that a saved model is based on: named when it is saved, found when it is read."""

from __future__ import annotations

from pathlib import Path

from geodrake.boundary.input_files import regular_file, sha256_of
from geodrake.errors import GeodrakeError, ModelError, OutputError


def existing_base(path: Path) -> Path:
    """Return the absolute path of the model file, which a saved model needs to be read again.

    Raises:
        OutputError: The file is gone, or its path is none that YAML can hold.
    """
    base = path.resolve()
    problem, advice = f"its file {base} is gone", "Put it back."
    if base.is_file():
        try:
            str(base).encode()
            return base
        except UnicodeEncodeError:
            problem = f"the path of its file {base} is not UTF-8"
            advice = "Rename the file or its folder."
    raise OutputError(f"Cannot save the model: {problem}.", advice=advice, path=base)


def find_base(path: Path, relative: str, absolute: str, sha256: str) -> Path:
    """Return the model file that the saved model `path` is based on, wherever both are now.

    Both may have moved together, or into one folder, or the model file stayed where it was
    (`absolute`, if known). Where there are several files, it is the one that is as it was, by its
    digest.

    Raises:
        ModelError: There is no such file.
    """
    folder = path.resolve().parent
    places = [
        folder / relative,
        folder / Path(relative).name,
        *([Path(absolute)] if absolute else ()),
    ]
    there = [place for place in places if is_file(place)] or places[:1]
    alike = [place for place in there if digest(place) == sha256] if there[1:] else []
    base = [*alike, *there][0]
    try:
        return regular_file(base, "file", ModelError)
    except ModelError as error:
        raise ModelError(
            f"{path} is based on {relative!r}, which cannot be read. {error.problem}",
            advice="Move it back or beside the saved model, or change base_model there.",
            base=base,
        ) from error


def is_file(path: Path) -> bool:
    """Return whether there is a file; no name that no file can have is an error."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def digest(path: Path) -> str:
    """Return the SHA-256 of a file; nothing if it cannot be read."""
    try:
        return sha256_of(path)
    except GeodrakeError:
        return ""
