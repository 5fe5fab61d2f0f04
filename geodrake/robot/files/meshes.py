"""Meshes that a model file names, checked before Drake opens them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from xml.etree.ElementTree import Element

from pydrake.multibody.parsing import PackageMap

from geodrake.robot.files.given import Given
from geodrake.robot.files.includes import Includes
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import parse_xml_bytes
from geodrake.robot.mesh_files import check_mesh

_ASSETS = ("meshdir", "assetdir", "texturedir")  # settings of MJCF


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


def _resolved(place: str, packages: PackageMap, folder: Path) -> Path | None:
    """Return where a URL, or a path from a folder on, leads; None if that is nowhere."""
    scheme, _, rest = place.rpartition("://")
    name, _, inner = rest.partition("/")
    if scheme in ("package", "model") and packages.Contains(name):
        return Path(packages.GetPath(name), inner)
    return folder / rest if scheme in ("", "file") else None
