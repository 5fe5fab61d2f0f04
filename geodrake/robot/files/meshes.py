"""Meshes that a model file names, and which of them are not there."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.etree.ElementTree import Element

from pydrake.multibody.parsing import PackageMap

from geodrake.robot.files.description import ModelDescription
from geodrake.robot.files.given import Given
from geodrake.robot.files.includes import Includes
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import parse_xml_bytes
from geodrake.robot.mesh_files import check_mesh

_MOST_NAMES = 4
_ASSETS = ("meshdir", "assetdir", "texturedir")  # settings of MJCF


def missing_meshes(description: ModelDescription) -> tuple[str, ...]:
    """Places of meshes, as the files of a model name them, at which no file is found."""
    packages = PackageMap()
    description.add_packages(packages, description.named_packages())
    found: dict[str, None] = {}
    for text in description.texts:
        root = parse_xml_bytes(read_expanded(text.path, description.given), text.path)
        places = [mesh.get("filename") or mesh.findtext("uri") for mesh in root.iter("mesh")]
        for place in places:
            if place and not _is_there(place.strip(), packages, text.path.parent):
                found[place.strip()] = None
    return tuple(found)


def check_geometry(files: Iterable[Path], packages: PackageMap, given: Given) -> None:
    """Raise if Drake would open what is no file, for the geometry of model files."""
    for path in files:
        root = parse_xml_bytes(read_expanded(path, given), path)
        includes = Includes(path, given.packages)
        if root.tag == "mujoco":
            includes.insert_elements(root)
        settings = [each.get(name) for each in root.iter("compiler") for name in _ASSETS]
        folders = [path.parent / (each or "") for each in dict.fromkeys([None, *settings])]
        for place in filter(None, map(_file_of, root.iter())):
            for folder in folders:
                found = _resolved(place, packages, folder)
                if found is not None:
                    check_mesh(found)


def _file_of(element: Element) -> str:
    """Return the file that an element of a model names."""
    if element.tag == "include":
        return ""
    own = element.get("filename") or element.get("file")
    return (own or (element.text if element.tag == "uri" else "") or "").strip()


def mesh_notes(description: ModelDescription) -> list[str]:
    """That meshes are not found, in words."""
    missing = missing_meshes(description)
    more = f" and {len(missing) - _MOST_NAMES} more" if len(missing) > _MOST_NAMES else ""
    names = ", ".join(missing[:_MOST_NAMES])
    if not missing:
        return []
    return [f"meshes not found, so that links are not shown as they look: {names}{more}"]


def _is_there(place: str, packages: PackageMap, folder: Path) -> bool:
    if place.rpartition("://")[0] not in ("", "file", "package", "model"):
        return True  # of a place that is no file, nothing is known
    found = _resolved(place, packages, folder)
    return found is not None and found.is_file()


def _resolved(place: str, packages: PackageMap, folder: Path) -> Path | None:
    """Return where a URL, or a path from a folder on, leads; None if that is nowhere."""
    scheme, _, rest = place.rpartition("://")
    name, _, inner = rest.partition("/")
    if scheme in ("package", "model") and packages.Contains(name):
        return Path(packages.GetPath(name), inner)
    return folder / rest if scheme in ("", "file") else None
