"""Options for reading a model file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from geodrake.boundary.arguments import file_path, instance, instances
from geodrake.errors import ArgumentError, ModelError

_NAME = re.compile(r"[^\s/:=]+")


class Expanded(NamedTuple):
    """Result of expanding a xacro file."""

    read: Mapping[Path, bytes | None]  # file that was read, itself included -> checksum
    data: bytes


@dataclass(frozen=True)
class Given:
    """Options for reading a model file.

    Attributes:
        robot: Name of one robot if the file has several; None for all.
        packages: ROS package -> its folder, which takes precedence over search.
        trust_xacro: Let xacro files evaluate any expression; only for files from trusted authors.
        leading: Names of joints preferred as independent coordinates of closed loops.
        expansions: Expanded xacro files; see `read_expanded`.
    """

    robot: str | None = None
    packages: Mapping[str, Path] = field(default_factory=dict)
    xacro: Mapping[str, str] = field(default_factory=dict)
    trust_xacro: bool = False
    leading: tuple[str, ...] = ()
    expansions: dict[Path, Expanded] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        if self.robot is not None:
            instance(self.robot, "robot", str)
        folders = {}
        for name, folder in instance(self.packages, "packages", Mapping).items():
            instance(name, "the name of a package", str)
            folders[name] = file_path(folder).absolute()
            if not folders[name].is_dir():
                raise ModelError(
                    f"Folder {folder} of package {name!r} does not exist.",
                    advice="Give the folder that has the package.xml of the package.",
                )
        object.__setattr__(self, "packages", folders)
        for name, value in instance(self.xacro, "xacro", Mapping).items():
            instance(name, "the name of a xacro argument", str)
            instance(value, f"xacro[{name!r}]", str)
        instance(self.trust_xacro, "trust_xacro", bool)
        object.__setattr__(self, "leading", instances(self.leading, "leading", str))

    @classmethod
    def of_words(
        cls,
        robot: str | None,
        packages: Sequence[str],
        xacro: Sequence[str],
        *,
        trust_xacro: bool = False,
    ) -> Given:
        """Return options from `NAME=FOLDER` and `NAME:=VALUE`."""
        folders = _pairs(packages, "=", "--package", "ur_description=~/ws/src/ur_description")
        values = _pairs(xacro, ":=", "--xacro-arg", "ur_type:=ur10e")
        paths = {name: Path(folder).expanduser() for name, folder in folders.items()}
        return cls(robot, paths, values, trust_xacro)


def _pairs(given: Sequence[str], sign: str, option: str, example: str) -> dict[str, str]:
    values: dict[str, str] = {}
    for text in given:
        name, found_sign, value = text.partition(sign)
        if not found_sign or not _NAME.fullmatch(name) or name in values:
            twice = f"{name!r} occurs twice" if name in values else "which cannot be parsed"
            raise ArgumentError(
                f"{option} has {text!r}, {'and ' if name in values else ''}{twice}.",
                advice=f"Write {option} {example}.",
            )
        values[name] = value
    return values
