"""Model files of named robots from the package robot_descriptions.

The package clones a robot's repository into its cache at first use
(`~/.cache/robot_descriptions`, or `ROBOT_DESCRIPTIONS_CACHE`).
"""

from __future__ import annotations

import importlib
import os
import re
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NamedTuple

from geodrake.boundary.arguments import file_path
from geodrake.boundary.escaping import printable
from geodrake.boundary.input_files import read_regular
from geodrake.errors import ModelError
from geodrake.robot.files.includes import named_packages, package_name, packages_below
from geodrake.robot.files.load_options import Given
from geodrake.robot.files.xml_text import LARGEST_FILE

_WORD = re.compile(r"[A-Za-z]\w*(-\w+)*", re.ASCII)  # neither a path nor a file with a suffix
_FOUND = re.compile(r"\$\(find ([^()\s]+)\)")
_END = "_description"


class RobotFile(NamedTuple):
    """A model file, options for reading it, and notes on its source."""

    path: Path
    given: Given
    notes: tuple[str, ...] = ()


def robot_file(path: str | os.PathLike[str], given: Given) -> RobotFile:
    """Return the file of a named robot, downloaded if necessary; paths are unchanged.

    Args:
        path: A model file, or else a name, which has neither folder nor suffix.
        given: Options whose packages and xacro arguments take precedence over the robot's.
    """
    path = whole_if_folder(path, file_path(path))
    if not _is_name(path):
        return RobotFile(path, given)
    module, *others = _descriptions(path)
    try:
        robot: Any = importlib.import_module(f"robot_descriptions.{module}")
    except Exception as error:  # by git, the network or the disk
        words = " ".join(str(getattr(error, "stderr", "") or error).split())
        reason = printable(words.removeprefix("stderr: ").strip("'"))[:300].rstrip(".")
        url, folder = _repository(module)
        raise ModelError(
            f"Robot {path} cannot be downloaded ({url}): {reason}.",
            advice=f"Check the network; it is needed only once, as the files are kept in {folder}.",
        ) from error
    plain = getattr(robot, "URDF_PATH", None) or getattr(robot, "MJCF_PATH", None)
    file = Path(plain or robot.XACRO_PATH)
    xacro = {} if plain else {k: str(v) for k, v in getattr(robot, "XACRO_ARGS", {}).items()}
    stated = {
        name: Path(place) for name, place in getattr(robot, "XACRO_PACKAGE_PATHS", {}).items()
    }
    packages = {**_packages(file, Path(robot.REPOSITORY_PATH)), **stated, **given.packages}
    notes = [f"{path} is {module} of robot_descriptions: {file}."]
    notes += [f"The MJCF of {path} is {other}; the URDF is used." for other in others]
    given = replace(given, xacro={**xacro, **given.xacro}, packages=packages)
    return RobotFile(file, given, tuple(notes))


def planned_download(path: Path) -> str:
    """Return a sentence on the download by `robot_file`, or ""."""
    if not _is_name(path):
        return ""
    url, folder = _repository(_descriptions(path)[0])
    git: Any = importlib.import_module("git")
    try:
        if git.Repo(folder).head.is_valid():
            return ""
    except git.exc.GitError:
        pass  # no repository yet
    return f"Downloading {url} to {folder} (only once)."


def whole_if_folder(written: str | os.PathLike[str], path: Path) -> Path:
    """Return a path, made absolute if written as ./ur5e, which `Path` would turn into a name."""
    return path.absolute() if _is_name(path) and os.fspath(written) != str(path) else path


def _is_name(path: Path) -> bool:
    return _WORD.fullmatch(str(path)) is not None and not os.path.lexists(path)


def _descriptions(path: Path) -> list[str]:
    """Return the names of a robot's URDF and MJCF descriptions, if they exist."""
    gone = f"The model file {path} does not exist"
    try:
        package: Any = importlib.import_module("robot_descriptions")
    except ImportError as error:
        advice = 'Check the path; names of robots need pip install "geodrake[robots]".'
        raise ModelError(f"{gone}.", advice=advice) from error
    name = str(path).lower().replace("-", "_").removesuffix(_END)
    names = [each for each in (f"{name}{_END}", f"{name}_mj{_END}") if each in package.DESCRIPTIONS]
    if not names:
        known = sorted(each.removesuffix(_END) for each in package.DESCRIPTIONS)
        nearest = ", ".join(get_close_matches(name, known, 3, 0.0))
        raise ModelError(
            f"{gone}, and robot_descriptions has no robot of that name.",
            advice=f"Check the path; the nearest robot names are {nearest}.",
        )
    return names[:1] if str(path).endswith(_END) else names


def _repository(module: str) -> tuple[str, Path]:
    """Return the URL of a robot's repository and its folder in the cache."""
    package: Any = importlib.import_module("robot_descriptions._repositories")
    known: Any = importlib.import_module("robot_descriptions").DESCRIPTIONS
    repository = package.REPOSITORIES[known[module].repository]
    place, commit = repository.cache_path, os.environ.get("ROBOT_DESCRIPTION_COMMIT")
    place = place if commit is None else f"{place}-{commit}/{place}"
    cache = os.environ.get("ROBOT_DESCRIPTIONS_CACHE", "~/.cache/robot_descriptions")
    return repository.url, Path(cache).expanduser() / place


def _packages(file: Path, repository: Path) -> dict[str, Path]:
    """Return package name -> folder of a repository, for packages named in a file.

    A package is a folder with a manifest of that name, or else a folder of that name.
    """
    text = read_regular(file, "model file", ModelError, largest=LARGEST_FILE).decode("latin-1")
    above = [each for each in file.parents if each.is_relative_to(repository)]
    packages = dict[str, Path]()
    for name in sorted(named_packages(text) | set(_FOUND.findall(text))):
        below = (each / name for each in above if (each / name).is_dir())
        places = [*above, *below, *packages_below(repository)]
        with_manifest = [each for each in places if package_name(each) == name]
        with_name = [each for each in places if each.name == name]
        if with_manifest or with_name:
            packages[name] = (*with_manifest, *with_name)[0]
    return packages
