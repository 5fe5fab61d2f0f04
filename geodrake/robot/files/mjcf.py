"""MJCF, the format of MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from xml.etree.ElementTree import Element

import numpy as np

from geodrake.inertia import Array, to_mass_com_inertia
from geodrake.robot.files.base import ModelText
from geodrake.robot.files.checks import MJCF_NUMBERS
from geodrake.robot.files.includes import Includes
from geodrake.robot.files.motors import mjcf_motors
from geodrake.robot.files.values import (
    UPPER,
    drop,
    inertial_parameters_of,
    numbers,
    rotation,
    symmetric,
    words,
)
from geodrake.robot.followers import Follower
from geodrake.robot.transmission.statements import Followers, Statement

_POSE = ("pos", "quat", "euler", "axisangle", "xyaxes", "zaxis")
_OF_MOTORS = ("actuator", "tendon", "default")
_ACTUATORS = ("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder")
_IGNORED = ("tendon", "sensor", "keyframe", "visual", "statistic", "contact", "camera", "light")
_GENERATORS = ("replicate", "composite", "flexcomp", "attach")


class MjcfText(ModelText):
    """A MuJoCo model.

    Inertias follow from the geoms of a body, unless it has an `inertial`: then geoms do not
    matter and are dropped. The geoms of missing meshes are dropped too, with a note.
    """

    kind = "xml"
    numeric = MJCF_NUMBERS

    def _read(self) -> None:
        Includes(self.path, self.folders).insert_elements(self.root)
        self._motors = Element("mujoco")
        self._motors.extend(deepcopy(e) for e in self.root if e.tag in _OF_MOTORS)
        drop(self.root, *_IGNORED)
        made = [tag for tag in _GENERATORS if self.root.find(f".//{tag}") is not None]
        if made:
            self.notes.append(f"<{'>, <'.join(made)}> is ignored: its bodies are missing.")
        drop(self.root, *_GENERATORS)
        scope = self.scope or self.root.get("model") or self.path.stem
        self._take_equalities(scope)
        self.root.set("model", self.root.get("model") or scope)
        self._name_bodies()
        self._split_joints()
        self._drop_meshes()
        bodies = [body for world in self.root.findall("worldbody") for body in world.iter("body")]
        for body in bodies:
            self._links[f"{scope}::{body.get('name')}"] = body
            if body.find("inertial") is not None:
                for geom in body.findall("geom"):
                    body.remove(geom)
        friction, armature = self._joint_values("frictionloss"), self._joint_values("armature")
        self.friction = {f"{scope}::{name}": value for name, value in friction.items()}
        self.armature = {f"{scope}::{name}": value for name, value in armature.items()}
        self._read_springs(scope)
        self.effort = {f"{scope}::{name}": value for name, value in self._efforts()}

    def motors(self) -> tuple[Statement, ...]:
        """Gears of actuators, and fixed tendons."""
        return mjcf_motors(self._motors, self.path)

    @property
    def driven_joints(self) -> frozenset[str]:
        """Names of joints that actuators of the file drive, by themselves or by fixed tendons."""
        pulled = {
            tendon.get("name"): {part.get("joint", "") for part in tendon}
            for group in self._motors.findall("tendon")
            for tendon in group.findall("fixed")
        }
        found = set[str]()
        for motor in (each for group in self._motors.findall("actuator") for each in group):
            found |= {motor.get("joint", ""), motor.get("jointinparent", "")}
            found |= pulled.get(motor.get("tendon"), set())
        return frozenset(found - {""})

    @property
    def actuator_defaults(self) -> bool:
        """Return whether actuators without a class have defaults other than MuJoCo's."""
        mains = self._motors.findall("default")
        return any(child.tag in _ACTUATORS for main in mains for child in main)

    @property
    def timestep(self) -> float:
        """Step of the simulation, s; MuJoCo's own where the file states none that can be."""
        stated = [option.get("timestep") for option in self.root.findall("option")]
        step = float(numbers(next(filter(None, reversed(stated)), ""), 1)[0])
        return step if step > 0.0 and np.isfinite(step) else 0.002

    def _take_equalities(self, scope: str) -> None:
        """Joints that follow others by polynomials; other constraints are left out."""
        others, bent = False, dict[str, dict[str, list[float]]]()
        for equality in (e for group in self.root.findall("equality") for e in group):
            if equality.get("active", "true") == "false":
                continue
            joints = [equality.get(key) for key in ("joint1", "joint2")]
            factors = [*equality.get("polycoef", "0 1").split(), *"0000"]
            offset, ratio, *higher = numbers(" ".join(factors[:5]), 5).tolist()
            if equality.tag == "joint" and all(joints) and any(higher):
                coefficients = [offset, ratio, *higher]
                bent.setdefault(str(joints[1]), {})[str(joints[0])] = coefficients
            elif equality.tag == "joint" and all(joints):
                own, leader = (f"{scope}::{joint}" for joint in joints)
                self.followers.append(Follower(own, leader, ratio, offset))
            else:
                others = True
        self.bent = [Followers(leader, own) for leader, own in bent.items()]
        drop(self.root, "equality")
        if others:
            self.notes.append("<equality> is ignored: the robot is read as an open tree.")

    def _name_bodies(self) -> None:
        for k, body in enumerate(self.root.iter("body")):
            body.set("name", body.get("name") or f"body_{k}")
            for i, joint in enumerate(body.findall("joint")):
                joint.set("name", joint.get("name") or f"{body.get('name')}_joint_{i}")

    def _split_joints(self) -> None:
        # Drake makes nameless bodies between several joints of one body; these have names.
        for parent in list(self.root.iter()):
            for body in parent.findall("body"):
                self._nest(parent, body)

    @staticmethod
    def _nest(parent: Element, body: Element) -> None:
        for joint in body.findall("joint")[:-1]:
            outer = Element("body", name=f"{body.get('name')}_{joint.get('name')}")
            for key in ("childclass", *(key for key in _POSE if key in body.attrib)):
                if key in body.attrib:
                    outer.set(key, body.get(key, ""))
            for key in _POSE:
                body.attrib.pop(key, None)
            parent[list(parent).index(body)] = outer
            body.remove(joint)
            outer.extend([joint, body])
            parent = outer

    def _drop_meshes(self) -> None:
        compiler = self.root.find("compiler")
        settings = {} if compiler is None else compiler.attrib
        folder = self.path.parent / settings.pop("meshdir", settings.pop("assetdir", ""))
        missing = set()
        for assets in self.root.findall("asset"):
            for asset in list(assets):
                file = folder / asset.get("file", "")
                asset.set("name", asset.get("name") or file.stem)
                if asset.tag == "mesh" and file.suffix.lower() == ".obj" and file.is_file():
                    asset.set("file", str(file.resolve()))
                else:
                    assets.remove(asset)
                    missing |= {asset.get("name")} if asset.tag == "mesh" else set()
        unknown = []
        for body in self.root.iter("body"):
            geoms = [geom for geom in body.findall("geom") if geom.get("mesh") in missing]
            for geom in geoms:
                body.remove(geom)
            if geoms and body.find("inertial") is None:
                unknown.append(body.get("name", ""))
        if unknown:
            self.lost.append(
                f"The inertia of {', '.join(unknown)} follows from meshes that are not there "
                f"or not .obj (in {folder}); these meshes do not count."
            )

    def _read_springs(self, scope: str) -> None:
        types = self._joint_words("type", "hinge")
        degrees = turns_in_degrees(self.root)
        rest = self._joint_values("springref")
        for name, stiffness in self._joint_values("stiffness").items():
            turned = degrees and types[name] == "hinge"
            self.stiffness[f"{scope}::{name}"] = stiffness
            self.rest[f"{scope}::{name}"] = np.deg2rad(rest[name]) if turned else rest[name]

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

    def _inertia(self, link: Element) -> Array | None:
        inertial = link.find("inertial")
        if inertial is None:
            return None
        full = inertial.get("fullinertia")
        moments = str(full or inertial.get("diaginertia", "")).split() + ["0"] * (0 if full else 3)
        if len(moments) != 6:
            moments = ["0"] * 6
        # Other orientations than a quaternion leave the size of the inertia as it is, which is
        # what is left of an impossible inertia after its repair.
        turn = numbers(inertial.get("quat", "1 0 0 0"), 4)
        mass = numbers(inertial.get("mass", ""), 1)[0]
        com = numbers(inertial.get("pos", ""), 3)
        return inertial_parameters_of(mass, com, rotation(turn), symmetric(moments))

    def _write_inertia(self, inertial: Element, phi: Array) -> None:
        mass, com, inertia = to_mass_com_inertia(phi)
        inertial.attrib.update(pos=words(com), mass=words(mass), fullinertia=words(inertia[UPPER]))


def turns_in_degrees(root: Element) -> bool:
    """Return whether angles in an MJCF file are in degrees, as they are if it does not say."""
    compilers = [compiler.get("angle") for compiler in root.findall("compiler")]
    return next((angle for angle in reversed(compilers) if angle), "degree") == "degree"
