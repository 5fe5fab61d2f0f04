"""Robots of the benchmark: arms of our own, and public ones of the package example-robot-data."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from tempfile import TemporaryDirectory

from diagrams.harness import MODELS
from geodrake import load_model
from geodrake.model import RobotModel

OWN = ("double_pendulum", "arm6", "arm7")
PUBLIC: Mapping[str, str] = {
    "ur5": "ur_description/urdf/ur5_joint_limited_robot.urdf",
    "panda": "panda_description/urdf/panda.urdf",
}
FURTHER: Mapping[str, str] = {
    "xarm7": "xarm_description/urdf/xarm7.urdf",
    "z1": "z1_description/urdf/z1.urdf",
    "kinova": "kinova_description/robots/kinova.urdf",
}
"""Public arms of other studies, which are not drawn here."""
_FINGERS = ("jointGripper",)
_PUBLIC_FOLDER = "cmeel.prefix/share/example-robot-data/robots"


@dataclass(frozen=True)
class RobotFile:
    """A robot as a model file describes it: a serial arm, without meshes, friction and fingers.

    Attributes:
        name: One of `robot_names`.
        text: The URDF.
    """

    name: str
    text: str


PLANAR = ("double_pendulum",)


def robot_names() -> tuple[str, ...]:
    """The robots that are installed."""
    folder = _public_folder()
    found = [] if folder is None else [n for n, path in PUBLIC.items() if (folder / path).is_file()]
    return (*OWN, *found)


def _public_folder() -> Path | None:
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        return None
    return Path(str(package.locate_file(_PUBLIC_FOLDER)))


@cache
def robot_file(name: str) -> RobotFile:
    """The model file of a robot.

    What a file states of damping and friction is taken out, so that all friction is hidden, and
    fingers are held fixed. Joints that turn without end have limits.
    """
    folder = _public_folder()
    own = name in OWN or folder is None
    path = MODELS / f"{name}.urdf" if own else folder / {**PUBLIC, **FURTHER}[name]
    root = ET.parse(path).getroot()
    for link in root.iter("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    for joint in root.iter("joint"):
        for stated in (*joint.findall("dynamics"), *joint.findall("mimic")):
            joint.remove(stated)
        if joint.get("type") == "prismatic" or joint.get("name") in _FINGERS:
            joint.set("type", "fixed")
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
    return RobotFile(name, ET.tostring(root, encoding="unicode"))


@cache
def robot_model(name: str) -> RobotModel:
    """What geodrake knows of a robot: its model file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.urdf"
        path.write_text(robot_file(name).text, encoding="utf-8")
        return load_model(path)
