"""Transmission files: what moves the joints of a robot, as YAML beside its model file.

    gears:
    - {actuator: motor_1, joint: joint_1, ratio: 100}
    coupled:
    - joints:
        joint_5: {motor_5: 0.02}
        joint_6: {motor_5: 0.01, motor_6: 0.01}

The lists that there are, and their fields, are those of `geodrake.robot.transmission.Stated`.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, get_args

from pydrake.common.yaml import yaml_dump, yaml_load_typed

from geodrake.boundary.arguments import file_path
from geodrake.boundary.yaml_text import yaml_content
from geodrake.errors import ArgumentError, GeodrakeError, ModelError
from geodrake.robot.transmission.drive import Drive
from geodrake.robot.transmission.statements import Stated, Statement

NONE, OF_FILE = "none", "file"
"""Words in the place of a transmission file: nothing, or what the model file itself states."""

_SUFFIX = ".transmission.yaml"
_MODEL_SUFFIXES = (".xacro", ".urdf", ".sdf", ".xml", ".mjcf", ".yaml", ".yml", ".world")


def file_beside(model: Path) -> Path:
    """Where a model's transmission file is: `arm.transmission.yaml` beside `arm.urdf`."""
    name = model.name
    while (suffix := Path(name).suffix.lower()) in _MODEL_SUFFIXES:
        name = name[: -len(suffix)]
    return model.with_name(f"{name}{_SUFFIX}")


def read_transmission(path: str | Path) -> tuple[Drive, ...]:
    """The parts of a transmission file.

    Args:
        path: The YAML file.

    Raises:
        ModelError: It cannot be read, has a list or a field that is none, or its numbers make no
            transmission.
    """
    path = file_path(path)
    stated = yaml_content(path, "transmission file", ModelError, advice="Correct the file there.")
    try:
        if not isinstance(stated, dict):
            raise ModelError("it has no lists of parts.", advice=_kinds_words())
        parts = [
            part for kind, given in stated.items() for part in _parts_of_kind(str(kind), given)
        ]
        if not parts:
            raise ModelError("it has no part.", advice=_kinds_words())
        return drives_of(parts)
    except GeodrakeError as error:
        raise ModelError(
            f"{path} is no transmission file: {error.problem}",
            advice=error.advice or "Correct the file there.",
            path=path,
        ) from error


def drives_of(parts: Sequence[tuple[str, Statement]]) -> tuple[Drive, ...]:
    """The drives that parts make.

    Args:
        parts: Where each is, such as `gears[0]`, and what it states.

    Raises:
        ModelError: The numbers or names of a part make none.
    """
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
    """What makes drives again, to be saved.

    Raises:
        ModelError: A drive is a function of the user's own.
    """
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


def _parts_of_kind(kind: str, given: Any) -> list[tuple[str, Statement]]:
    kinds = {field.name: get_args(field.type)[0] for field in dataclasses.fields(Stated)}
    if kind not in kinds:
        raise ModelError(f"it has {kind!r}{_near(kind, kinds)}.", advice=_kinds_words())
    if not isinstance(given, list):
        raise ModelError(f"{kind} is no list.", advice=f"Write `{kind}:`, and below it `- …`.")
    parts = []
    for number, fields in enumerate(given):
        place, schema = f"{kind}[{number}]", kinds[kind]
        known = [field.name for field in dataclasses.fields(schema)]
        advice = f"Its fields are: {', '.join(known)}."
        if not isinstance(fields, dict):
            raise ModelError(f"{place} has no fields.", advice=advice)
        for name in map(str, fields):
            if name not in known:
                raise ModelError(f"{place} has {name!r}{_near(name, known)}.", advice=advice)
        parts.append((place, _typed(place, schema, fields)))
    return parts


def _typed(place: str, schema: type[Statement], fields: dict[str, Any]) -> Statement:
    """A part as Drake reads it, field by field so that the one that is wrong is named."""
    for name, value in fields.items():
        try:
            yaml_load_typed(schema=schema, data=yaml_dump({name: value}))
        except Exception as error:  # Drake raises RuntimeError and others, depending on the fault
            raise ModelError(
                f"{place} has {name} = {str(value)[:80]}, which is not what it must be.",
                advice=f"It is a {_type_words(schema, name)}.",
            ) from error
    part: Statement = yaml_load_typed(schema=schema, data=yaml_dump(fields))
    return part


def _type_words(schema: type[Statement], name: str) -> str:
    stated: Any = schema
    kind: Any = next(field.type for field in dataclasses.fields(stated) if field.name == name)
    words: dict[Any, str] = {float: "number", str: "name", bool: "true or false"}
    return words.get(kind, str(kind).replace("float", "number").replace("str", "name"))


def _near(name: str, known: Collection[str]) -> str:
    near = difflib.get_close_matches(name, known, 1)
    return f", which is none (was {near[0]} meant?)" if near else ", which is none"


def _kinds_words() -> str:
    kinds = ", ".join(field.name for field in dataclasses.fields(Stated))
    return f"Its lists are: {kinds}."
