"""Files that model files name: packages of ROS, and what they include.

Includes are followed before Drake, which would never end in a circle.
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
from geodrake.robot.files.xml_text import LARGEST_FILE, parse_xml, parse_xml_bytes, place_of

_SCENERY = re.compile(r"(?<![a-z])(sun|ground|light|plane)+s?(?![a-z])", re.I)
_DEEPEST = 30  # files that include each other in a row


class Includes:
    """Follows what a model file includes.

    Args:
        folders: Package -> folder, which come before those that are found.

    Attributes:
        packages: The packages that were named on the way.
        absent: Sentences on suns and grounds that a world includes, and that lead nowhere.
        missing: Sentences on what else it includes, and leads nowhere: perhaps a part of a robot.
    """

    def __init__(self, path: Path, folders: Mapping[str, Path]) -> None:
        self.path, self.packages, self.names = path, PackageMap(), set[str]()
        self._folders = folders
        self.absent, self.missing = list[str](), list[str]()

    def resolve(self, url: str, folder: Path) -> Path:
        """Return where a URL, or a path relative to a folder, leads; a file need not be there.

        Args:
            url: A `package://`, `model://` or `file://` URL, or a path.
        """
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
            f"{self.path} includes {url}, which leads nowhere.",
            advice=PACKAGE_ADVICE,
            path=self.path,
        )

    def checked(self, file: Path) -> Path:
        """Return a file that can be read."""
        what = f"file that {self.path} includes,"
        return regular_file(file, what, ModelError, largest=LARGEST_FILE)

    def enter(self, chain: tuple[Path, ...], file: Path) -> tuple[Path, ...]:
        """Return the files that led to a file, and the file."""
        file = self.checked(file).resolve()
        if file in chain:
            names = " → ".join(path.name for path in (*chain[chain.index(file) :], file))
            raise self._endless(f"{file} includes itself ({names})")
        if len(chain) > _DEEPEST:
            raise self._endless(f"more than {_DEEPEST} files include each other in a row")
        return (*chain, file)

    def insert(self, root: Element, folder: Path, chain: tuple[Path, ...] = ()) -> None:
        """Replace an SDF's includes by relative paths with the models that they name.

        Those that it includes by a URL are left to Drake, but followed too.
        """
        chain = chain or (self.path.resolve(),)
        for parent in list(root.iter()):
            for include in parent.findall("include"):
                url = include.findtext("uri", "").strip()
                if parent.tag == "world" and self._leads_nowhere(url, folder):
                    parent.remove(include)
                    where = place_of(include) or self.path
                    said = self.absent if _SCENERY.search(_last_name(url)) else self.missing
                    said.append(f"{where}: {url} is not found, and is left out of the world.")
                    continue
                for file in _models_of(self.resolve(url, folder), "://" in url):
                    below = self.enter(chain, file)
                    included = parse_xml(file)
                    self.insert(included, file.parent, below)
                    model = included.find("model")
                    if "://" not in url and included.tag == "sdf" and model is not None:
                        _replace(parent, include, model)

    def _leads_nowhere(self, url: str, folder: Path) -> bool:
        try:
            self.resolve(url, folder)
        except ModelError:
            return True
        return False

    def insert_elements(self, root: Element, chain: tuple[Path, ...] = ()) -> None:
        """Replace an MJCF's includes with the contents of the files that they name.

        Paths are relative to the folder of the model file, whichever file they are in.
        """
        chain = chain or (self.path.resolve(),)
        for parent in list(root.iter()):
            for include in parent.findall("include"):
                file = self.path.parent / include.get("file", "")
                below = self.enter(chain, file)
                included = parse_xml(file)
                self.insert_elements(included, below)
                at = list(parent).index(include)
                parent[at : at + 1] = list(included)

    def _endless(self, reason: str) -> ModelError:
        return ModelError(
            f"{self.path} cannot be read: {reason}.", advice="Break the circle.", path=self.path
        )


def _last_name(url: str) -> str:
    """Return the last part of a URL that is not a version of a model."""
    parts = [part for part in url.split("/") if part and not part.isdecimal()]
    return parts[-1] if parts else ""


def _models_of(place: Path, by_url: bool) -> list[Path]:
    """Return the files that an include of a file or a folder may stand for."""
    try:
        if not place.is_dir():
            return [place]
    except OSError:  # of a name that is too long, which whoever opens it tells of
        return [place]
    config = place / "model.config"
    if not by_url or not config.exists():
        return [place / "model.sdf"]
    stated = [place / str(sdf.text).strip() for sdf in parse_xml(config).iter("sdf")]
    return [file for file in stated if file.is_file()] or stated  # one for each version of SDF


def _replace(parent: Element, include: Element, model: Element) -> None:
    """Replace an include with its model, which the include may move and rename."""
    model.set("name", include.findtext("name", model.get("name", "")).strip())
    for element in (e for tag in ("pose", "static") for e in include.findall(tag)):
        for old in model.findall(element.tag):
            model.remove(old)
        model.append(element)
    if include.get("placement_frame"):
        model.set("placement_frame", include.get("placement_frame", ""))
    parent[list(parent).index(include)] = model


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
    """Return what a folder's manifest calls the package; None if no manifest can be read."""
    manifest = folder / "package.xml"
    with suppress(ModelError):
        data = read_regular(manifest, "manifest", ModelError, largest=_LARGEST_MANIFEST)
        return str(parse_xml_bytes(data, manifest).findtext("name", "")).strip() or None
    return None
