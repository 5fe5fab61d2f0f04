"""Which format a file has, and its text."""

from __future__ import annotations

from pathlib import Path

from geodrake.errors import ModelError
from geodrake.robot.files.base import ModelText
from geodrake.robot.files.given import Given
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.sdf import SdfText
from geodrake.robot.files.urdf import UrdfText
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import SUPPORTED_FORMATS, parse_xml_bytes


def read_model_text(path: Path, given: Given, scope: str | None = None) -> ModelText:
    """Reads and simplifies a URDF, SDF or MJCF file; the root element decides which it is.

    A xacro file is expanded first.

    Raises:
        ModelError: The file is no XML, or its root is not that of a robot description.
    """
    return model_text_of(read_expanded(path, given), path, given, scope)


def model_text_of(
    data: bytes, path: Path, given: Given | None = None, scope: str | None = None
) -> ModelText:
    """Reads and simplifies what is, or will be, in a file.

    Raises:
        ModelError: It is no XML, or its root is not that of a robot description.
    """
    root = parse_xml_bytes(data, path)
    for tag, kind in (("robot", UrdfText), ("sdf", SdfText), ("mujoco", MjcfText)):
        if root.tag == tag:
            return kind(root, path, scope, (given or Given()).packages)
    raise ModelError(
        f"{path} is not a robot description: its root element is <{root.tag}>.",
        advice=SUPPORTED_FORMATS,
        path=path,
    )
