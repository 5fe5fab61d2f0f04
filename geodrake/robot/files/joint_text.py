"""Numbers of joints written into the text of a URDF, SDF or MJCF file, which otherwise stays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from geodrake.errors import ModelError
from geodrake.robot.files.inertia_text import child_of, mjcf_bodies, sdf_models
from geodrake.robot.files.source_text import check_in_itself, edited
from geodrake.robot.files.values import numbers, words
from geodrake.robot.files.xml_text import parse_xml_bytes

Change = Mapping[str, float]
"""damping, friction, armature, stiffness and rest of a joint, those that change, SI."""

_DRAKE = "http://drake.mit.edu"
_SDF_TAGS = {
    "damping": "damping",
    "friction": "friction",
    "stiffness": "spring_stiffness",
    "rest": "spring_reference",
}
_MJCF_NAMES = {
    "damping": "damping",
    "friction": "frictionloss",
    "armature": "armature",
    "stiffness": "stiffness",
    "rest": "springref",
}

_TENDONS = ("tendon", "fixed", "spatial")
_MOTORS = ("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder")
_PASSIVE: Mapping[str, tuple[str, ...]] = {
    "option": ("density", "viscosity", "wind"),
    "body": ("gravcomp",),
    **dict.fromkeys(_TENDONS, ("stiffness", "damping", "armature", "frictionloss")),
    **dict.fromkeys(_MOTORS, ("armature", "damping")),
}
"""Tag of an MJCF -> attributes of forces that are no joint's own."""


def with_joint_numbers(data: bytes, path: Path, changes: Mapping[str, Change]) -> bytes:
    """Return a model file in which joints have other numbers.

    Args:
        path: Where they are from, for messages and for the name of a model that has none.
        changes: Scoped name of the joint -> what changes.
    """
    changes = {name: change for name, change in changes.items() if change}
    if not changes:
        return data
    root = parse_xml_bytes(data, path)
    find, put = _FORMATS[root.tag]
    joints = find(root, path)
    check_in_itself(changes, joints, path)
    for name, change in changes.items():
        put(root, joints[name], change)
    return edited(data, path, root)


def with_gravity(data: bytes, path: Path, gravity: np.ndarray) -> bytes:
    """Return an MJCF file with another gravity (3,) in the world's frame, m/s²."""
    root = parse_xml_bytes(data, path)
    options = root.findall("option") or [child_of(root, "option")]
    stated = [option for option in options if "gravity" in option.attrib]
    (stated or options)[-1].set("gravity", words(gravity))
    return edited(data, path, root)


def without_passive_forces(data: bytes, path: Path) -> bytes:
    """Return an MJCF without what tendons, motors, media and compensated gravity do; others as is.

    Joints that state powers of springs keep none of them, and those of dampers the first.
    """
    root = parse_xml_bytes(data, path)
    for element in root.iter() if root.tag == "mujoco" else ():
        for key in _PASSIVE.get(element.tag, ()):
            element.attrib.pop(key, None)
        words = {key: element.get(key, "").split() for key in ("damping", "stiffness")}
        if element.tag == "joint" and len(words["stiffness"]) > 1:
            element.set("stiffness", "0")
        if element.tag == "joint" and len(words["damping"]) > 1:
            element.set("damping", words["damping"][0])
    return edited(data, path, root)


def _urdf_joints(root: Element, path: Path) -> dict[str, Element]:
    scope = root.get("name") or path.stem
    every = [*root.findall("joint"), *root.findall("drake:joint")]
    return {f"{scope}::{joint.get('name')}": joint for joint in every}


def _sdf_joints(root: Element, path: Path) -> dict[str, Element]:
    del path
    models = sdf_models(root)
    return {f"{n}::{joint.get('name')}": joint for n, m in models for joint in m.findall("joint")}


def mjcf_joints(root: Element, path: Path) -> dict[str, Element]:
    """Return the joints of an MJCF file by scoped name, nameless ones as geodrake calls them."""
    return {
        f"{scope}::{joint.get('name') or f'{own}_joint_{i}'}": joint
        for scope, own, body in mjcf_bodies(root, path)
        for i, joint in enumerate(body.findall("joint"))
    }


def _put_urdf(root: Element, joint: Element, change: Change) -> None:
    given = {name: words(change[name]) for name in ("damping", "friction") if name in change}
    if given:
        child_of(joint, "dynamics").attrib.update(given)
    if "armature" in change:
        _put_rotor(root, joint.get("name", ""), change["armature"])


def _put_rotor(root: Element, joint: str, armature: float) -> None:
    """Write Drake's rotor inertia; with the gear ratio of the file, where it states one."""
    root.attrib.setdefault("xmlns:drake", _DRAKE)
    for actuator in _actuators(root, joint):
        ratio = actuator.find("drake:gear_ratio")
        gear = 1.0 if ratio is None else numbers(ratio.get("value", "1"), 1)[0]
        usable = bool(np.isfinite(gear) and gear)
        word = words(armature / gear**2 if usable else armature)
        child_of(actuator, "drake:rotor_inertia").set("value", word)
        if ratio is not None and not usable:
            ratio.set("value", "1.0")
        return
    transmission = child_of(root, "transmission", new=True)
    transmission.set("name", f"{joint}_rotor")
    SubElement(transmission, "type").text = "transmission_interface/SimpleTransmission"
    SubElement(transmission, "joint", name=joint)
    actuator = SubElement(transmission, "actuator", name=f"{joint}_motor")
    SubElement(actuator, "drake:rotor_inertia", value=words(armature))
    SubElement(actuator, "drake:gear_ratio", value="1.0")


def _actuators(root: Element, joint: str) -> list[Element]:
    """Return actuators of a joint in transmissions of the type that Drake reads."""
    return [
        actuator
        for transmission in root.findall("transmission")
        if any("SimpleTransmission" in (e.text or "") for e in transmission.findall("type"))
        and any(each.get("name") == joint for each in transmission.findall("joint"))
        for actuator in transmission.findall("actuator")
    ]


def _put_sdf(root: Element, joint: Element, change: Change) -> None:
    axis = joint.find("axis")
    if axis is None:
        raise ModelError(f"{joint.get('name')} has no <axis> to write numbers into.")
    given = {tag: words(change[name]) for name, tag in _SDF_TAGS.items() if name in change}
    for tag, word in given.items():
        child_of(child_of(axis, "dynamics"), tag).text = word
    if "armature" in change:
        root.attrib.setdefault("xmlns:drake", _DRAKE)
        ratio = joint.find("drake:gear_ratio")
        gear = 1.0 if ratio is None else numbers(ratio.text or "", 1)[0]
        if not (np.isfinite(gear) and gear):
            gear = 1.0
            if ratio is not None:
                ratio.text = "1.0"
        rotor = child_of(joint, "drake:rotor_inertia")
        rotor.text = words(change["armature"] / gear**2)
        if ratio is None:
            child_of(joint, "drake:gear_ratio").text = "1.0"


def _put_mjcf(root: Element, joint: Element, change: Change) -> None:
    del root
    joint.attrib.update({_MJCF_NAMES[name]: words(value) for name, value in change.items()})


_Find = Callable[[Element, Path], dict[str, Element]]
_Put = Callable[[Element, Element, Change], None]
_FORMATS: Mapping[str, tuple[_Find, _Put]] = {
    "robot": (_urdf_joints, _put_urdf),
    "sdf": (_sdf_joints, _put_sdf),
    "mujoco": (mjcf_joints, _put_mjcf),
}
"""Root element -> the joints of a format by scoped name, and what writes into one."""
