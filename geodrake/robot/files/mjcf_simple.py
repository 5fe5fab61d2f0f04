"""MJCF without MuJoCo: simple files, which Drake reads as MuJoCo does; others are refused."""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree.ElementTree import Element

import numpy as np

from geodrake.errors import ModelError
from geodrake.robot.files.base import ModelText
from geodrake.robot.files.values import drop, numbers
from geodrake.robot.files.xml_text import place_of
from geodrake.robot.stated import Spring

_IGNORED = (
    "asset",
    "camera",
    "contact",
    "custom",
    "keyframe",
    "light",
    "sensor",
    "site",
    "size",
    "statistic",
    "visual",
)
_MOTORS = ("motor", "position", "velocity", "general", "intvelocity", "damper", "cylinder")
_READ = frozenset(
    (
        *("mujoco", "compiler", "option", "flag", "default", "worldbody", "body", "inertial"),
        *("joint", "freejoint", "geom", "mesh", "material", "tendon", "fixed"),
        "actuator",
        *_MOTORS,
    )
)
_SHAPES = ("sphere", "capsule", "cylinder", "box", "ellipsoid")
_MORE = {
    "option": ("density", "viscosity", "wind"),
    "flag": ("gravity", "passive", "spring", "damper", "frictionloss", "constraint", "equality"),
    "compiler": (
        "settotalmass",
        "boundmass",
        "boundinertia",
        "inertiafromgeom",
        "inertiagrouprange",
        "balanceinertia",
        "fitaabb",
        "coordinate",
    ),
    "body": ("gravcomp", "mocap"),
    "joint": ("ref", "springyield", "springdamper", "actuatorfrcrange", "actuatorgravcomp"),
    "geom": ("mesh", "hfield", "shellinertia", "fluidshape"),
    **dict.fromkeys(_MOTORS, ("armature", "damping")),
    "fixed": ("springyield", "stiffness", "damping", "frictionloss", "armature"),
}
"""Tag -> attributes that only MuJoCo reads, or reads as it means them."""


def read_simple(text: ModelText, scope: str, *, degrees: bool) -> None:
    """Read a file without MuJoCo: bodies with one joint at most, and one class of defaults.

    Args:
        text: The file, its includes in their places; changed.
        degrees: Whether angles in it are in degrees.

    Raises:
        ModelError: It holds something that only MuJoCo reads exactly.
    """
    root = text.root
    drop(root, *_IGNORED)
    worlds = root.findall("worldbody")
    bodies = [body for world in worlds for body in world.iter("body")]
    for k, body in enumerate(bodies):
        body.set("name", body.get("name") or f"body_{k}")
        for i, joint in enumerate(body.findall("joint")):
            joint.set("name", joint.get("name") or f"{body.get('name')}_joint_{i}")
    for parent in [*worlds, *(body for body in bodies if body.find("inertial") is not None)]:
        for geom in parent.findall("geom"):
            parent.remove(geom)
    for element, what in _beyond(root):
        raise ModelError(
            f"{place_of(element) or text.path}: {what} is read by MuJoCo, which is not installed.",
            advice='Install it: pip install "geodrake[mjcf]".',
            path=text.path,
        )
    root.set("model", root.get("model") or scope)
    usual = root.find("default/joint")
    for joint in (joint for body in bodies for joint in body.findall("joint")):
        stated = {**({} if usual is None else usual.attrib), **joint.attrib}
        name = f"{scope}::{joint.get('name')}"
        friction, armature, stiffness, rest = (
            float(numbers(stated.get(key, "0"), 1)[0])
            for key in ("frictionloss", "armature", "stiffness", "springref")
        )
        text.friction[name], text.armature[name] = friction, armature
        turns = degrees and stated.get("type", "hinge") == "hinge"
        if stiffness:
            text.springs[name] = Spring.linear(stiffness, np.deg2rad(rest) if turns else rest)
    for actuator in (element for group in root.findall("actuator") for element in group):
        gear = abs(numbers(actuator.get("gear", "1").partition(" ")[0], 1)[0])
        ranges = [actuator.get("forcerange")]
        ranges += [actuator.get("ctrlrange")] if actuator.tag == "motor" else []
        limits = [gear * np.abs(numbers(each, 2)).max() for each in ranges if each]
        if limits and actuator.get("joint"):
            text.effort[f"{scope}::{actuator.get('joint')}"] = float(min(limits))


def _beyond(root: Element) -> Iterator[tuple[Element, str]]:
    """Yield what Drake skips or reads otherwise than MuJoCo, in words."""
    for element in root.iter():
        tag = element.tag
        if tag not in _READ:
            yield element, f"<{tag}>"
        for key in _MORE.get(tag, ()):
            if element.get(key):
                yield element, f"{key} of <{tag}>"
        for key in ("damping", "stiffness"):
            if tag == "joint" and len((element.get(key) or "").split()) > 1:
                yield element, f"{key} of several numbers"
        shape = element.get("type", "sphere")
        if tag == "geom" and shape not in _SHAPES:
            yield element, f"<geom type={shape!r}> that makes an inertia"
        if tag == "geom" and element.get("fromto") and shape not in _SHAPES[1:3]:
            yield element, "fromto of <geom>"
        if tag == "joint" and element.get("type") == "ball" and element.get("stiffness"):
            yield element, "stiffness of a ball joint"
        if tag == "body" and len(element.findall("joint")) > 1:
            yield element, "a body of several joints"
    if len(root.findall("default")) > 1 or root.find(".//default/default") is not None:
        yield root, "several classes in <default>"
