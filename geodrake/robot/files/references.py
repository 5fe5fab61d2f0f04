"""Files that a model file names by relative paths, named from another folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from geodrake.robot.files.source_text import SourceElement, SourceText

_MJCF_ASSETS = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir", "texture": "texturedir"}


def with_references(data: bytes, path: Path, folder: Path) -> bytes:
    """A model file whose relative paths lead from a folder to where they led before.

    Args:
        data: Bytes of the file.
        path: Where they are from.
        folder: Where they will be.
    """
    text = SourceText(data, path)
    base, there = path.resolve().parent, Path(os.path.realpath(folder))
    for element, attribute in _references(text.root):
        named = element.attributes[attribute] if attribute else element.text.strip()
        if not named or "://" in named or Path(named).is_absolute():
            continue
        moved = Path(os.path.relpath(base / named, there)).as_posix()
        if Path(moved) == Path(named):
            continue
        if attribute:
            text.set_attribute(element, attribute, moved)
        else:
            text.set_text(element, moved)
    return text.edited()


def _references(root: SourceElement) -> Iterator[tuple[SourceElement, str]]:
    """Elements that name files, with the attribute that does; "" for their text."""
    if root.tag == "mujoco":
        yield from _mjcf_references(root)
        return
    for element in root.walk():
        if element.tag in ("mesh", "texture") and "filename" in element.attributes:
            yield element, "filename"
        elif root.tag == "sdf" and element.tag == "uri":
            yield element, ""


def _mjcf_references(root: SourceElement) -> Iterator[tuple[SourceElement, str]]:
    folders = {
        name
        for compiler in root.all("compiler")
        for name in ("assetdir", "meshdir", "texturedir")
        if name in compiler.attributes
    }
    for compiler in root.all("compiler"):
        yield from ((compiler, name) for name in sorted(folders) if name in compiler.attributes)
    for element in root.walk():
        inside = _MJCF_ASSETS.get(element.tag)
        if element.tag in ("include", "model") or (inside and not folders & {inside, "assetdir"}):
            yield from (
                (element, name)
                for name in ("file", "fileright", "fileleft", "fileup", "filedown", "fileback")
                if name in element.attributes
            )
