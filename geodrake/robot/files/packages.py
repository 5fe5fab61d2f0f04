"""Packages of ROS that a model names, so that package:// leads somewhere."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path

from pydrake.multibody.parsing import PackageMap

from geodrake.boundary.input_files import regular_file
from geodrake.errors import ModelError
from geodrake.robot.files.xml_text import parse_xml

_URL = re.compile(r"(?:package|model)://([^/\n\"'<>]+)")
_LARGEST_MANIFEST = 1_000_000  # bytes
_MOST_FOLDERS = 20_000  # looked through below one entry of ROS_PACKAGE_PATH
_MARKERS = frozenset({"AMENT_IGNORE", "CATKIN_IGNORE", "COLCON_IGNORE"})


def named_packages(text: str) -> set[str]:
    """Names of the packages that URLs in a text lead to."""
    return set(_URL.findall(text))


def add_packages(packages: PackageMap, path: Path, names: Iterable[str]) -> None:
    """Makes packages known that are around a file or on ROS_PACKAGE_PATH.

    Only those that are asked for are looked up: a manifest that cannot be read does no harm to
    models that do not need it.

    Args:
        packages: The map, added to.
        path: The file; folders above it may be packages.
        names: Names of the packages that it needs.
    """
    wanted = {name for name in names if not packages.Contains(name)}
    folders = _around(path)
    while wanted and (folder := next(folders, None)):
        name = _package_name(folder)
        if name in wanted:
            packages.Add(name, str(folder))
            wanted.remove(name)


def _around(path: Path) -> Iterator[Path]:
    """Folders that may be packages, the nearest first."""
    yield from path.resolve().parents
    for entry in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
        if entry:
            yield from islice(_packages_below(entry), _MOST_FOLDERS)


def _packages_below(entry: str) -> Iterator[Path]:
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


def _package_name(folder: Path) -> str | None:
    """What a folder's manifest calls the package; None if there is none that can be read."""
    manifest = folder / "package.xml"
    with suppress(ModelError):
        regular_file(manifest, "manifest", ModelError, largest=_LARGEST_MANIFEST)
        return str(parse_xml(manifest).findtext("name", "")).strip() or None
    return None
