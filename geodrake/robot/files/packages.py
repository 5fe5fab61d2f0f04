"""Packages of ROS that a model names, so that package:// leads somewhere."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import islice
from pathlib import Path

from pydrake.multibody.parsing import PackageMap

from geodrake.boundary.input_files import read_regular
from geodrake.errors import ModelError
from geodrake.robot.files.xml_text import parse_xml_bytes

_URL = re.compile(r"(?:package|model)://([^/\n\"'<>]+)")
_LARGEST_MANIFEST = 1_000_000  # bytes
_MOST_FOLDERS = 20_000  # looked through below one entry of ROS_PACKAGE_PATH
PACKAGE_ADVICE = (
    "Packages are found by their package.xml in folders above the model, below those of "
    "ROS_PACKAGE_PATH and AMENT_PREFIX_PATH, and by --package NAME=FOLDER."
)
_MARKERS = frozenset({"AMENT_IGNORE", "CATKIN_IGNORE", "COLCON_IGNORE"})


def named_packages(text: str) -> set[str]:
    """Return names of the packages that URLs in a text lead to."""
    return set(_URL.findall(text))


def add_packages(
    packages: PackageMap,
    path: Path,
    names: Iterable[str],
    folders: Mapping[str, Path] | None = None,
) -> None:
    """Make packages known: given ones, those around a file, and those on ROS' paths.

    Only those that are asked for are looked up: a manifest that cannot be read does no harm to
    models that do not need it.
    """
    for name, folder in (folders or {}).items():
        if not packages.Contains(name):
            packages.Add(name, str(folder))
    wanted = {name for name in names if not packages.Contains(name)}
    around = _around(path, sorted(wanted))
    while wanted and (place := next(around, None)):
        found = package_name(place)
        if found in wanted:
            packages.Add(found, str(place))
            wanted.remove(found)


def folder_of_package(name: str, path: Path, folders: Mapping[str, Path]) -> Path:
    """Return the folder of a package that a file names."""
    packages = PackageMap()
    add_packages(packages, path, [name], folders)
    if not packages.Contains(name):
        raise ModelError(
            f"{path} names the package {name!r}, which is not found.",
            advice=PACKAGE_ADVICE,
            path=path,
        )
    return Path(packages.GetPath(name))


def _around(path: Path, names: Iterable[str]) -> Iterator[Path]:
    """Yield folders that may be packages of some names, the nearest first."""
    yield from path.resolve().parents
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield from (Path(prefix) / "share" / name for name in names)
    for entry in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
        if entry:
            yield from islice(packages_below(entry), _MOST_FOLDERS)


def packages_below(entry: str | Path) -> Iterator[Path]:
    """Folders from a folder on down; what is within packages and marked folders is left out."""
    seen: set[str] = set()
    for folder, below, files in os.walk(entry, followlinks=True):
        real = os.path.realpath(folder)
        if real in seen or "package.xml" in files or _MARKERS.intersection(files):
            below.clear()
        else:
            below[:] = sorted(name for name in below if not name.startswith("."))
        seen.add(real)
        yield Path(folder)


def package_name(folder: Path) -> str | None:
    """Return what a folder's manifest calls the package; None if there is none that can be read."""
    manifest = folder / "package.xml"
    with suppress(ModelError):
        data = read_regular(manifest, "manifest", ModelError, largest=_LARGEST_MANIFEST)
        return str(parse_xml_bytes(data, manifest).findtext("name", "")).strip() or None
    return None
