"""Transmission files: what moves the joints of a robot, as YAML beside its model file.

    gears:
    - {actuator: motor_1, joint: joint_1, ratio: 100}
    coupled:
    - joints:
        joint_5: {motor_5: 0.02}
        joint_6: {motor_5: 0.01, motor_6: 0.01}

The lists that there are, and their fields, are those of `geodrake.robot.transmission.statements`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from geodrake.boundary.arguments import file_path
from geodrake.boundary.yaml_schema import as_schema
from geodrake.boundary.yaml_text import yaml_content
from geodrake.errors import ArgumentError, GeodrakeError, ModelError
from geodrake.robot.transmission.drive import Drive
from geodrake.robot.transmission.statements import Stated, Statement

NONE, OF_FILE = "none", "file"
"""Words in the place of a transmission file: nothing, or what the model file itself states."""

_SUFFIX = ".transmission.yaml"
_MODEL_SUFFIXES = (".xacro", ".urdf", ".sdf", ".xml", ".mjcf", ".yaml", ".yml", ".world")


def file_beside(model: Path) -> Path:
    """Return where a model's transmission file is: `arm.transmission.yaml` beside `arm.urdf`."""
    name = model.name
    while (suffix := Path(name).suffix.lower()) in _MODEL_SUFFIXES:
        name = name[: -len(suffix)]
    return model.with_name(f"{name}{_SUFFIX}")


def read_transmission(path: str | Path) -> tuple[Drive, ...]:
    """Return the parts of a transmission file."""
    path = file_path(path)
    content = yaml_content(path, "transmission file", ModelError, advice="Correct the file there.")
    try:
        stated = as_schema(content, Stated)
        order = list(content) if isinstance(content, dict) else []
        parts = sorted(stated.parts(), key=lambda part: order.index(part[0].partition("[")[0]))
        drives = drives_of(parts)
        if not drives:
            lists = ", ".join(Stated.__struct_fields__)
            raise ModelError("it has no part.", advice=f"Its lists are: {lists}.")
        return drives
    except GeodrakeError as error:
        raise ModelError(
            f"{path} is no transmission file: {error.problem}",
            advice=error.advice or "Correct the file there.",
            path=path,
        ) from error


def drives_of(parts: Iterable[tuple[str, Statement]]) -> tuple[Drive, ...]:
    """Return the drives that parts make; each comes with where it is, such as `gears[0]`."""
    drives = []
    for place, part in parts:
        for what, names in (("actuator", part.actuator_names()), ("joint", part.joint_names())):
            if not names or not all(names):
                raise ModelError(f"{place} does not name its {what}.", advice="Name it there.")
        try:
            drives.append(Drive.of(part))
        except ArgumentError as error:
            raise ModelError(f"{place}: {error.problem}", advice=error.advice) from error
    return tuple(drives)


def stated_of(drives: Sequence[Drive]) -> Stated:
    """Return what makes drives again, to be saved."""
    stated = Stated()
    for drive in drives:
        if drive.statement is None:
            raise ModelError(
                f"The transmission of {', '.join(drive.actuators)} is a function of your own, "
                "which cannot be saved.",
                advice="Write it as a table of a transmission file, or leave it out.",
            )
        stated.add(drive.statement)
    return stated
