"""Files that a model file names by relative paths, named from another folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

from geodrake.robot.files.source_text import edited
from geodrake.robot.files.xml_text import parse_xml_bytes

_MJCF_ASSETS = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir", "texture": "texturedir"}


def with_references(data: bytes, path: Path, folder: Path) -> bytes:
    """Return a model file whose relative paths lead from a folder to where they led before."""
    root = parse_xml_bytes(data, path)
    base, there = path.resolve().parent, Path(os.path.realpath(folder))
    for element, attribute in _references(root):
        named = element.attrib[attribute] if attribute else (element.text or "").strip()
        if not named or "://" in named or Path(named).is_absolute():
            continue
        moved = Path(os.path.relpath(base / named, there)).as_posix()
        if Path(moved) == Path(named):
            continue
        if attribute:
            element.set(attribute, moved)
        else:
            element.text = moved
    return edited(data, path, root)


def _references(root: Element) -> Iterator[tuple[Element, str]]:
    """Elements that name files, with the attribute that does; "" for their text."""
    if root.tag == "mujoco":
        yield from _mjcf_references(root)
        return
    for element in root.iter():
        if element.tag in ("mesh", "texture") and "filename" in element.attrib:
            yield element, "filename"
        elif root.tag == "sdf" and element.tag == "uri":
            yield element, ""


def _mjcf_references(root: Element) -> Iterator[tuple[Element, str]]:
    folders = {
        name
        for compiler in root.findall("compiler")
        for name in ("assetdir", "meshdir", "texturedir")
        if name in compiler.attrib
    }
    for compiler in root.findall("compiler"):
        yield from ((compiler, name) for name in sorted(folders) if name in compiler.attrib)
    for element in root.iter():
        inside = _MJCF_ASSETS.get(element.tag)
        if element.tag in ("include", "model") or (inside and not folders & {inside, "assetdir"}):
            yield from (
                (element, name)
                for name in ("file", "fileright", "fileleft", "fileup", "filedown", "fileback")
                if name in element.attrib
            )
