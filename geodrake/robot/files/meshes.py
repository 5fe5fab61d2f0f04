"""Meshes that a model file names, and which of them are not there."""

from __future__ import annotations

from pathlib import Path

from pydrake.multibody.parsing import PackageMap

from geodrake.robot.files.description import ModelDescription
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import parse_xml_bytes

_MOST_NAMES = 4


def missing_meshes(description: ModelDescription) -> tuple[str, ...]:
    """Places of meshes, as the files of a model name them, at which no file is found.

    Args:
        description: The model file, of URDFs and SDFs; of MJCF files `ModelText.lost` tells.
    """
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


def mesh_notes(description: ModelDescription) -> list[str]:
    """That meshes are not found, in words."""
    missing = missing_meshes(description)
    more = f" and {len(missing) - _MOST_NAMES} more" if len(missing) > _MOST_NAMES else ""
    names = ", ".join(missing[:_MOST_NAMES])
    if not missing:
        return []
    return [f"meshes not found, so that links are not shown as they look: {names}{more}"]


def _is_there(place: str, packages: PackageMap, folder: Path) -> bool:
    scheme, _, rest = place.rpartition("://")
    if scheme in ("package", "model"):
        name, _, inner = rest.partition("/")
        return packages.Contains(name) and Path(packages.GetPath(name), inner).is_file()
    if scheme not in ("", "file"):
        return True  # of a place that is no file, nothing is known
    return (folder / rest).is_file()
