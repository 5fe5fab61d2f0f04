"""References in model files: ROS packages and includes.

Includes are resolved before Drake, which would not terminate on circular ones.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import islice
from pathlib import Path
from xml.etree.ElementTree import Element

from pydrake.multibody.parsing import PackageMap

from geodrake.boundary.input_files import read_regular, regular_file
from geodrake.errors import ModelError
from geodrake.robot.files.xml_text import (
    LARGEST_FILE,
    parse_xml,
    parse_xml_bytes,
    place_of,
)

_SCENERY = re.compile(r"(?<![a-z])(sun|ground|light|plane)+s?(?![a-z])", re.I)
_DEEPEST = 30  # nested includes


class Includes:
    """Resolves the includes of a model file.

    Args:
        folders: Package -> folder, which takes precedence over search.
        chain: Files that led to the file, itself the last; empty for the first one.

    Attributes:
        packages: Packages named in resolved URLs.
        absent: Sentences on missing scenery of a world, such as a ground.
        missing: Sentences on other missing includes, possibly parts of a robot.
    """

    def __init__(
        self, path: Path, folders: Mapping[str, Path], chain: tuple[Path, ...] = ()
    ) -> None:
        self.path, self.packages, self.names = path, PackageMap(), set[str]()
        self.chain, self._folders = chain or (path.resolve(),), folders
        self.absent, self.missing = list[str](), list[str]()

    def resolve(self, url: str, folder: Path) -> Path:
        """Return the path of a URL, or of a path relative to a folder; it need not exist."""
        scheme, _, rest = url.rpartition("://")
        if not scheme:
            return folder / rest
        if scheme == "file":
            return Path(rest)
        name, _, inner = rest.partition("/")
        if scheme in ("package", "model"):
            self.names |= named_packages(url)
            add_packages(self.packages, self.path, self.names, self._folders)
            if self.packages.Contains(name):
                return Path(self.packages.GetPath(name)) / inner
        raise ModelError(
            f"{self.path} includes {url}, which does not exist.", advice=PACKAGE_ADVICE
        )

    def checked(self, file: Path) -> Path:
        """Return a file after checking that it can be read."""
        what = f"file that {self.path} includes,"
        return regular_file(file, what, ModelError, largest=LARGEST_FILE)

    def enter(self, chain: tuple[Path, ...], file: Path) -> tuple[Path, ...]:
        """Return the chain extended by a file; raise for circular includes."""
        file = self.checked(file).resolve()
        if file in chain:
            names = " → ".join(path.name for path in (*chain[chain.index(file) :], file))
            raise self._endless(f"{file} includes itself ({names})")
        if len(chain) > _DEEPEST:
            raise self._endless(f"includes are nested more than {_DEEPEST} deep")
        return (*chain, file)

    def model_of(self, include: Element) -> tuple[Path, tuple[Path, ...]]:
        """Return the file of an SDF include, and its chain.

        Of several files of a model, it is that of the latest SDF version.
        """
        url = include.findtext("uri", "").strip()
        files = _models_of(self.resolve(url, self.path.parent), "://" in url)
        file = files[0]
        if files[1:]:
            file = max(files, key=lambda each: _version(parse_xml(self.checked(each))))
        return file, self.enter(self.chain, file)

    def drop_absent(self, root: Element) -> None:
        """Remove the includes of worlds whose models do not exist."""
        for world in root.iter("world"):
            for include in world.findall("include"):
                url = include.findtext("uri", "").strip()
                try:
                    self.resolve(url, self.path.parent)
                except ModelError:
                    world.remove(include)
                    parts = [part for part in url.split("/") if part and not part.isdecimal()]
                    scenery = _SCENERY.search(parts[-1]) if parts else None
                    where = place_of(include, self.path)
                    notes = self.absent if scenery else self.missing
                    notes.append(f"{where}: {url} is not found, and is omitted from the world.")

    def insert_elements(self, root: Element, chain: tuple[Path, ...] = ()) -> None:
        """Replace an MJCF's includes by the contents of their files.

        Paths are relative to the folder of the model file, or else to that of their own file.
        """
        chain = chain or (self.path.resolve(),)
        for parent in list(root.iter()):
            for include in parent.findall("include"):
                name = include.get("file", "")
                file, beside = self.path.parent / name, chain[-1].parent / name
                with suppress(OSError):  # for a name that is too long
                    file = beside if beside.exists() and not file.exists() else file
                below = self.enter(chain, file)
                included = parse_xml(file)
                self.insert_elements(included, below)
                at = list(parent).index(include)
                parent[at : at + 1] = list(included)

    def _endless(self, reason: str) -> ModelError:
        return ModelError(
            f"{self.path} cannot be read: {reason}.", advice="Remove the circular include."
        )


def _models_of(place: Path, by_url: bool) -> list[Path]:
    """Return the files that an include of a file or a folder may refer to."""
    try:
        if not place.is_dir():
            return [place]
    except OSError:  # for a name that is too long, reported on opening
        return [place]
    config = place / "model.config"
    if not by_url or not config.exists():
        return [place / "model.sdf"]
    stated = [place / str(sdf.text).strip() for sdf in parse_xml(config).iter("sdf")]
    return [file for file in stated if file.is_file()] or stated  # one per SDF version


def _version(root: Element) -> tuple[int, ...]:
    """Return the SDF version of a file."""
    return tuple(int(word) for word in re.findall(r"\d{1,9}", root.get("version", "")))


_URL = re.compile(r"(?:package|model)://([^/\n\"'<>]+)")
_LARGEST_MANIFEST = 1_000_000  # bytes
_MOST_FOLDERS = 20_000  # searched below one entry of ROS_PACKAGE_PATH
_GAZEBO_PATHS = ("GZ_SIM_RESOURCE_PATH", "SDF_PATH", "GAZEBO_MODEL_PATH")
PACKAGE_ADVICE = (
    "Packages are searched by package.xml or model.config in and beside folders above the model, "
    "by the names of these folders, and in ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and "
    "GZ_SIM_RESOURCE_PATH; --package NAME=FOLDER adds one."
)
_MARKERS = frozenset({"AMENT_IGNORE", "CATKIN_IGNORE", "COLCON_IGNORE"})


def named_packages(text: str) -> set[str]:
    """Return names of the packages in URLs of a text."""
    return set(_URL.findall(text))


def add_packages(
    packages: PackageMap,
    path: Path,
    names: Iterable[str],
    folders: Mapping[str, Path] | None = None,
) -> None:
    """Register packages: given ones, those around a file, and those on ROS's paths.

    Only the named packages are searched, so unreadable manifests of others do no harm. A folder
    above the file with the package's name needs no manifest.
    """
    for name, folder in (folders or {}).items():
        if not packages.Contains(name):
            packages.Add(name, str(folder))
    wanted = {name for name in names if not packages.Contains(name)}
    around = _around(path, sorted(wanted))
    while wanted and (place := next(around, None)):
        name_there = package_name(place)
        if name_there in wanted:
            packages.Add(name_there, str(place))
            wanted.remove(name_there)
    for place in path.resolve().parents:
        if place.name in wanted:
            packages.Add(place.name, str(place))
            wanted.remove(place.name)


def folder_of_package(name: str, path: Path, folders: Mapping[str, Path]) -> Path:
    """Return the folder of a package named in a file."""
    packages = PackageMap()
    add_packages(packages, path, [name], folders)
    if not packages.Contains(name):
        raise ModelError(
            f"{path} refers to package {name!r}, which was not found.", advice=PACKAGE_ADVICE
        )
    return Path(packages.GetPath(name))


def _around(path: Path, names: Iterable[str]) -> Iterator[Path]:
    """Yield folders that may be packages or Gazebo models of some names, the nearest first."""
    for parent in path.resolve().parents:
        yield parent
        yield from (parent / inner / name for inner in ("", "models") for name in names)
    shares = [entry / "share" for entry in _entries("AMENT_PREFIX_PATH")]
    for folder in (*_entries(*_GAZEBO_PATHS), *shares):
        yield from (folder / name for name in names)
    for entry in _entries("ROS_PACKAGE_PATH"):
        yield from islice(packages_below(entry), _MOST_FOLDERS)


def _entries(*variables: str) -> list[Path]:
    words = (word for key in variables for word in os.environ.get(key, "").split(os.pathsep))
    return [Path(word) for word in words if word]


def packages_below(entry: str | Path) -> Iterator[Path]:
    """Search folders recursively, but not inside packages and marked folders."""
    visited: set[str] = set()
    for folder, below, files in os.walk(entry, followlinks=True):
        real = os.path.realpath(folder)
        if real in visited or "package.xml" in files or _MARKERS.intersection(files):
            below.clear()
        else:
            below[:] = sorted(name for name in below if not name.startswith("."))
        visited.add(real)
        yield Path(folder)


def package_name(folder: Path) -> str | None:
    """Return the name of a package or of a Gazebo model; None if the folder is neither."""
    manifest = folder / "package.xml"
    with suppress(ModelError):
        data = read_regular(manifest, "manifest", ModelError, largest=_LARGEST_MANIFEST)
        return str(parse_xml_bytes(data, manifest).findtext("name", "")).strip() or None
    return folder.name if (folder / "model.config").is_file() else None
