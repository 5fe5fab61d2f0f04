"""MJCF without MuJoCo: simple files, which Drake reads as MuJoCo does; others are refused."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from xml.etree.ElementTree import Element

import numpy as np

from geodrake.errors import ModelError
from geodrake.robot.files.base import ModelText
from geodrake.robot.files.mjcf_source import unused
from geodrake.robot.files.values import drop, numbers
from geodrake.robot.files.xml_text import place_of
from geodrake.robot.followers import Follower, leads_back
from geodrake.robot.stated import Spring
from geodrake.robot.transmission.statements import Followers

_POSE = ("pos", "quat", "euler", "axisangle", "xyaxes", "zaxis")
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
        *("joint", "freejoint", "geom", "mesh", "material", "equality", "tendon", "fixed"),
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
    """Reads a file without MuJoCo.

    Args:
        text: The file, its includes in their places; changed.
        scope: Name of its model.
        degrees: Whether angles in it are in degrees.

    Raises:
        ModelError: It holds something that only MuJoCo reads exactly.
    """
    _Simple(text, scope, degrees).read()


class _Simple:
    def __init__(self, text: ModelText, scope: str, degrees: bool) -> None:
        self.text, self.root, self.scope, self.degrees = text, text.root, scope, degrees

    def read(self) -> None:
        text, root, scope = self.text, self.root, self.scope
        drop(root, *_IGNORED)
        self._name_bodies()
        for body in [body for world in root.findall("worldbody") for body in world.iter("body")]:
            if body.find("inertial") is not None:
                for geom in body.findall("geom"):
                    body.remove(geom)
        for world in root.findall("worldbody"):
            for geom in world.findall("geom"):
                world.remove(geom)
        self._refuse_others()
        root.set("model", root.get("model") or scope)
        self._take_equalities(scope)
        self._split_joints()
        friction, armature = self._joint_values("frictionloss"), self._joint_values("armature")
        text.friction = {f"{scope}::{name}": value for name, value in friction.items()}
        text.armature = {f"{scope}::{name}": value for name, value in armature.items()}
        self._read_springs(scope)
        text.effort = {f"{scope}::{name}": value for name, value in self._efforts()}

    def _refuse_others(self) -> None:
        """Refuses what Drake skips, or reads otherwise than MuJoCo."""
        for element in self.root.iter():
            tag = element.tag
            if tag not in _READ:
                self._refuse(element, f"<{tag}>")
            for key in _MORE.get(tag, ()):
                if element.get(key):
                    self._refuse(element, f"{key} of <{tag}>")
            for key in ("damping", "stiffness"):
                if tag == "joint" and len((element.get(key) or "").split()) > 1:
                    self._refuse(element, f"{key} of several numbers")
            if tag == "geom" and element.get("type", "sphere") not in _SHAPES:
                self._refuse(element, f"<geom type={element.get('type')!r}> that makes an inertia")
            if tag == "geom" and element.get("fromto") and element.get("type") not in _SHAPES[1:3]:
                self._refuse(element, "fromto of <geom>")
            if tag == "joint" and element.get("type") == "ball" and element.get("stiffness"):
                self._refuse(element, "stiffness of a ball joint")
        if (
            len(self.root.findall("default")) > 1
            or self.root.find(".//default/default") is not None
        ):
            self._refuse(self.root, "several classes in <default>")
        for kind in ("weld", "connect", "tendon", "flex"):
            for each in self.root.findall(f"equality/{kind}"):
                self._refuse(each, f"<{kind}> of <equality>")

    def _refuse(self, element: Element, what: str) -> None:
        raise ModelError(
            f"{place_of(element) or self.text.path}: {what} is read by MuJoCo, which is not "
            "installed.",
            advice='Install it: pip install "geodrake[mjcf]".',
            path=self.text.path,
        )

    def _take_equalities(self, scope: str) -> None:
        """Joints that follow others by polynomials; other constraints are left out."""
        bent, leaders = dict[str, dict[str, list[float]]](), dict[str, str]()
        for equality in (e for group in self.root.findall("equality") for e in group):
            if equality.get("active", "true") == "false":
                continue
            joints = [equality.get(key) for key in ("joint1", "joint2")]
            factors = [*equality.get("polycoef", "0 1").split(), *"0000"]
            offset, ratio, *higher = numbers(" ".join(factors[:5]), 5).tolist()
            own, leader = (str(joint) for joint in joints)
            if own in leaders or leads_back(own, leader, leaders):
                self._refuse(equality, "a joint that <equality> has follow several, or itself,")
            leaders[own] = leader
            if equality.tag == "joint" and all(joints) and any(higher):
                coefficients = [offset, ratio, *higher]
                bent.setdefault(leader, {})[own] = coefficients
            elif equality.tag == "joint" and all(joints):
                follower = Follower(f"{scope}::{own}", f"{scope}::{leader}", ratio, offset)
                self.text.followers.append(follower)
            else:
                self._refuse(equality, "a joint held by <equality>")
        self.text.bent = [Followers(leader, own) for leader, own in bent.items()]
        drop(self.root, "equality")

    def _name_bodies(self) -> None:
        for k, body in enumerate(self.root.iter("body")):
            body.set("name", body.get("name") or f"body_{k}")
            for i, joint in enumerate(body.findall("joint")):
                joint.set("name", joint.get("name") or f"{body.get('name')}_joint_{i}")

    def _split_joints(self) -> None:
        # Drake makes nameless bodies between several joints of one body; these have names.
        free = unused({body.get("name") for body in self.root.iter("body")})
        for parent in list(self.root.iter()):
            for body in parent.findall("body"):
                self._nest(parent, body, free)

    @staticmethod
    def _nest(parent: Element, body: Element, free: Callable[[str], str]) -> None:
        for joint in body.findall("joint")[:-1]:
            name = free(f"{body.get('name')}_{joint.get('name')}")
            outer = Element("body", name=name, between="true")
            for key in ("childclass", *(key for key in _POSE if key in body.attrib)):
                if key in body.attrib:
                    outer.set(key, body.get(key, ""))
            for key in _POSE:
                body.attrib.pop(key, None)
            parent[list(parent).index(body)] = outer
            body.remove(joint)
            outer.extend([joint, body])
            parent = outer

    def _read_springs(self, scope: str) -> None:
        types = self._joint_words("type", "hinge")
        degrees = self.degrees
        rest = self._joint_values("springref")
        for name, stiffness in self._joint_values("stiffness").items():
            turned = degrees and types[name] == "hinge"
            center = np.deg2rad(rest[name]) if turned else rest[name]
            self.text.springs[f"{scope}::{name}"] = Spring.linear(stiffness, float(center))

    def _joint_values(self, attribute: str) -> dict[str, float]:
        """Return an attribute of all joints as a number, with the default classes applied."""
        words = self._joint_words(attribute, "0").items()
        return {name: numbers(text, 1)[0] for name, text in words}

    def _joint_words(self, attribute: str, usual: str) -> dict[str, str]:
        """Return an attribute of all joints, with the default classes applied."""
        classes = {"main": usual}

        def read_class(default: Element, inherited: str) -> None:
            joint = default.find("joint")
            value = inherited if joint is None else joint.get(attribute, inherited)
            classes[default.get("class", "main")] = value
            for child in default.findall("default"):
                read_class(child, value)

        for default in self.root.findall("default"):
            read_class(default, usual)

        def read_body(body: Element, class_name: str) -> Iterator[tuple[str, str]]:
            class_name = body.get("childclass", class_name)
            for joint in body.findall("joint"):
                default = classes.get(joint.get("class", class_name), usual)
                yield joint.get("name", ""), joint.get(attribute, default)
            for child in body.findall("body"):
                yield from read_body(child, class_name)

        worlds = self.root.findall("worldbody")
        return {name: value for world in worlds for name, value in read_body(world, "main")}

    def _efforts(self) -> Iterator[tuple[str, float]]:
        """Effort limits of the motors; Drake's reading leaves the gear out."""
        for actuator in (element for group in self.root.findall("actuator") for element in group):
            gear = abs(numbers(actuator.get("gear", "1").partition(" ")[0], 1)[0])
            ranges = [actuator.get("forcerange")]
            if actuator.tag == "motor":
                ranges.append(actuator.get("ctrlrange"))
            limits = [gear * np.abs(numbers(text, 2)).max() for text in ranges if text]
            if limits and actuator.get("joint"):
                yield actuator.get("joint", ""), min(limits)
