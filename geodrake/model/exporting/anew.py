"""A robot written anew, in another format than that of its own file: bodies and joints alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw

from geodrake.errors import ModelError
from geodrake.inertia import Array, to_mass_com_inertia
from geodrake.model.export import repair_comments
from geodrake.model.exporting.links import Link, links_of
from geodrake.model.robot_model import RobotModel
from geodrake.robot.files.source_text import comment_words
from geodrake.robot.files.values import UPPER, tensor_words, words

_DRAKE = "http://drake.mit.edu"
_UNLIMITED = 1e9  # effort and speed, where a URDF must state some
SUFFIXES = {"urdf": ".urdf", "sdf": ".sdf", "xml": ".xml"}


def written_anew(model: RobotModel, kind: str, gravity: Array) -> bytes:
    """Return a robot's bodies and joints, without geometry.

    Args:
        model: The model, of effects that the format holds.
        kind: The format: urdf, sdf, or xml for MJCF.
        gravity: (3,) acceleration of gravity in the frame of the base, for a format that has it.

    Raises:
        ModelError: The robot floats, or has joints that no other format has alike.
    """
    if model.floating:
        raise ModelError(
            "The robot floats, and is written in the format of its own file alone.",
            advice="Choose that one.",
        )
    name = model.path.name.partition(".")[0]
    root = _WRITERS[kind](links_of(model), name, gravity)
    for at, each in enumerate(repair_comments(model)):
        root.insert(at, Comment(comment_words(each)))
    indent(root)
    return tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _inertial(phi: Array) -> tuple[str, str, Mapping[str, str], Array]:
    mass, com, inertia = to_mass_com_inertia(phi)
    return words(mass), words(com), tensor_words(inertia), inertia


def _pose(X: RigidTransform) -> tuple[str, str]:
    return words(X.translation()), words(RollPitchYaw(X.rotation()).vector())


def _urdf(links: Sequence[Link], name: str, gravity: Array) -> Element:
    del gravity
    root = Element("robot", {"name": name, "xmlns:drake": _DRAKE})
    SubElement(root, "link", name="world")
    for link in links:
        element = SubElement(root, "link", name=link.name)
        mass, com, tensor, _ = _inertial(link.phi)
        inertial = SubElement(element, "inertial")
        SubElement(inertial, "origin", xyz=com, rpy="0 0 0")
        SubElement(inertial, "mass", value=mass)
        SubElement(inertial, "inertia", dict(tensor))
        _urdf_joint(root, link)
    return root


def _urdf_joint(root: Element, link: Link) -> None:
    numbers, limited = link.numbers, bool(np.isfinite(link.limits).all())
    kind = "prismatic" if not numbers.turns else "revolute" if limited else "continuous"
    joint = SubElement(root, "joint", name=link.joint, type=kind)
    xyz, rpy = _pose(link.X_PL)
    SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    SubElement(joint, "parent", link=link.parent or "world")
    SubElement(joint, "child", link=link.name)
    SubElement(joint, "axis", xyz=words(link.axis))
    limit = {
        "effort": words(min(link.effort, _UNLIMITED)),
        "velocity": words(min(link.velocity, _UNLIMITED)),
    }
    if kind != "continuous":
        low, high = np.clip(link.limits, -_UNLIMITED, _UNLIMITED)
        limit |= {"lower": words(low), "upper": words(high)}
    SubElement(joint, "limit", limit)
    SubElement(joint, "dynamics", damping=words(numbers.damping), friction=words(numbers.friction))
    if numbers.armature:
        transmission = SubElement(root, "transmission", name=f"{link.joint}_rotor")
        SubElement(transmission, "type").text = "transmission_interface/SimpleTransmission"
        SubElement(transmission, "joint", name=link.joint)
        actuator = SubElement(transmission, "actuator", name=f"{link.joint}_motor")
        SubElement(actuator, "drake:rotor_inertia", value=words(numbers.armature))
        SubElement(actuator, "drake:gear_ratio", value="1.0")


def _sdf(links: Sequence[Link], name: str, gravity: Array) -> Element:
    del gravity
    root = Element("sdf", {"version": "1.9", "xmlns:drake": _DRAKE})
    model = SubElement(root, "model", name=name)
    for link in links:
        element = SubElement(model, "link", name=link.name)
        SubElement(element, "pose", relative_to=link.joint).text = "0 0 0 0 0 0"
        mass, com, tensor, _ = _inertial(link.phi)
        inertial = SubElement(element, "inertial")
        SubElement(inertial, "pose").text = f"{com} 0 0 0"
        SubElement(inertial, "mass").text = mass
        inertia = SubElement(inertial, "inertia")
        for key, word in tensor.items():
            SubElement(inertia, key).text = word
        _sdf_joint(model, link)
    return root


def _sdf_joint(model: Element, link: Link) -> None:
    numbers = link.numbers
    kind = "revolute" if numbers.turns else "prismatic"
    joint = SubElement(model, "joint", name=link.joint, type=kind)
    pose = SubElement(joint, "pose", relative_to=link.parent or "__model__")
    pose.text = " ".join(_pose(link.X_PL))
    SubElement(joint, "parent").text = link.parent or "world"
    SubElement(joint, "child").text = link.name
    if numbers.armature:
        SubElement(joint, "drake:rotor_inertia").text = words(numbers.armature)
        SubElement(joint, "drake:gear_ratio").text = "1.0"
    axis = SubElement(joint, "axis")
    SubElement(axis, "xyz").text = words(link.axis)
    bounds = dict(zip(("lower", "upper"), link.limits, strict=True))
    limits = bounds | {"effort": link.effort, "velocity": link.velocity}
    limit = SubElement(axis, "limit")
    for key, value in limits.items():
        if np.isfinite(value):
            SubElement(limit, key).text = words(value)
    dynamics = SubElement(axis, "dynamics")
    SubElement(dynamics, "damping").text = words(numbers.damping)
    SubElement(dynamics, "friction").text = words(numbers.friction)
    if numbers.stiffness:
        SubElement(dynamics, "spring_reference").text = words(numbers.rest)
        SubElement(dynamics, "spring_stiffness").text = words(numbers.stiffness)


def _mjcf(links: Sequence[Link], name: str, gravity: Array) -> Element:
    root = Element("mujoco", model=name)
    SubElement(root, "compiler", angle="radian")
    SubElement(root, "option", gravity=words(gravity))
    world = SubElement(root, "worldbody")
    bodies: dict[str | None, Element] = {None: world}
    for link in links:
        quaternion = Quaternion(link.X_PL.rotation().matrix()).wxyz()
        pose = {"pos": words(link.X_PL.translation()), "quat": words(quaternion)}
        body = SubElement(bodies[link.parent], "body", {"name": link.name, **pose})
        bodies[link.name] = body
        mass, com, _, inertia = _inertial(link.phi)
        full = words(inertia[UPPER])
        SubElement(body, "inertial", pos=com, mass=mass, fullinertia=full)
        SubElement(body, "joint", _mjcf_joint(link))
    return root


def _mjcf_joint(link: Link) -> dict[str, str]:
    numbers = link.numbers
    attributes = {
        "name": link.joint,
        "type": "hinge" if numbers.turns else "slide",
        "axis": words(link.axis),
    }
    if np.isfinite(link.limits).all():
        attributes |= {"range": words(np.array(link.limits)), "limited": "true"}
    if np.isfinite(link.effort):
        attributes["actuatorfrcrange"] = words(np.array([-link.effort, link.effort]))
        attributes["actuatorfrclimited"] = "true"
    values = {
        "damping": numbers.damping,
        "frictionloss": numbers.friction,
        "armature": numbers.armature,
        "stiffness": numbers.stiffness,
        "springref": numbers.rest,
    }
    return attributes | {key: words(value) for key, value in values.items() if value}


_WRITERS: Mapping[str, Callable[[Sequence[Link], str, Array], Element]] = {
    "urdf": _urdf,
    "sdf": _sdf,
    "xml": _mjcf,
}
