"""URDF."""

from __future__ import annotations

from copy import deepcopy
from xml.etree.ElementTree import Element

import numpy as np

from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.robot.files.base import ModelText
from geodrake.robot.files.checks import URDF_NUMBERS
from geodrake.robot.files.motors import urdf_motors
from geodrake.robot.files.unread import URDF_UNREAD, is_nothing, unread
from geodrake.robot.files.values import (
    TENSOR,
    drop,
    inertial_parameters_of,
    number,
    numbers,
    rotation,
    symmetric,
)
from geodrake.robot.files.xml_text import place_of
from geodrake.robot.stated import Spring
from geodrake.robot.transmission.statements import Statement


class UrdfText(ModelText):
    """A URDF file."""

    kind = "urdf"
    numeric = URDF_NUMBERS

    def _read(self) -> None:
        self.left_out += unread(self.root, URDF_UNREAD, self.path)
        gazebo = [e for e in self.root.findall("gazebo") if e.get("reference")]
        drop(self.root, "visual", "collision", "gazebo", "material", "drake:collision_filter_group")
        self._transmissions = [deepcopy(e) for e in self.root.iter("transmission")]
        for transmission in self.root.findall("transmission"):
            # Only Drake's own rotor inertia and gear ratio matter; joints state their efforts.
            if not any(element.tag.startswith("drake:") for element in transmission.iter()):
                self.root.remove(transmission)
            for kind in transmission.findall("type"):
                if not (kind.text or "").strip():  # which would end Drake, and the process with it
                    transmission.remove(kind)
        scope = self.scope or self.root.get("name") or self.path.stem
        self._take_balls(scope, self.root)
        self._drop_loops()
        self.root.set("name", self.root.get("name") or scope)
        self._links = {f"{scope}::{e.get('name')}": e for e in self.root.findall("link")}
        self._take_gazebo(scope, gazebo)
        for joint in [*self.root.findall("joint"), *self.root.findall("drake:joint")]:
            name = f"{scope}::{joint.get('name')}"
            self._take_mimic(scope, joint)
            self.friction[name] = number(joint, "dynamics", "friction")
            self.effort[name] = number(joint, "limit", "effort")
            if (limit := joint.find("limit")) is not None and self.effort[name] == 0.0:
                limit.attrib.pop("effort", None)  # with 0, Drake ignores the rotor, too

    def _take_gazebo(self, scope: str, elements: list[Element]) -> None:
        """Take springs of joints, and links without gravity.

        Raises:
            ModelError: A spring's number is invalid.
        """
        off = list[str]()
        joints = {e.get("name") for tag in ("joint", "drake:joint") for e in self.root.iter(tag)}
        for element in elements:
            name = f"{scope}::{element.get('reference')}"
            stated = element.findtext("springStiffness", "")
            if element.get("reference") in joints and stated.strip():
                numbers_of = ("springStiffness", "springReference")
                self.springs[name] = Spring.linear(
                    *(self._of_spring(element, t) for t in numbers_of)
                )
            elif not is_nothing(stated):
                self.left_out.append(
                    f"{place_of(element) or self.path}: <springStiffness> {stated.strip()[:50]} of "
                    f"{element.get('reference')}, which is no joint, is left out."
                )
            falls = [is_nothing(each.text or "") for each in element.findall("gravity")]
            falls += [not is_nothing(each.text or "") for each in element.findall("turnGravityOff")]
            if any(falls) and name in self._links:
                off.append(name)
        self._take_weightless(off)

    def _of_spring(self, element: Element, tag: str) -> float:
        stated = element.findtext(tag, "0")
        value = float(numbers(stated, 1)[0])
        if not np.isfinite(value):
            raise ModelError(
                f"{place_of(element) or self.path}: <{tag}> has {stated.strip()[:50]!r} instead of "
                "a number.",
                advice="Correct the file there.",
                path=self.path,
            )
        return value

    def motors(self) -> tuple[Statement, ...]:
        """The transmissions of ros_control."""
        return urdf_motors(self._transmissions, self.path)

    def _inertia(self, link: Element) -> Array | None:
        inertial = link.find("inertial")
        if inertial is None:
            return None
        origin, tensor = inertial.find("origin"), inertial.find("inertia")
        com, rpy = (
            numbers("" if origin is None else origin.get(key, ""), 3) for key in ("xyz", "rpy")
        )
        moments = {} if tensor is None else tensor.attrib
        inertia = symmetric(moments.get(key, "0") for key in TENSOR)
        mass = number(inertial, "mass", "value")
        return inertial_parameters_of(mass, com, rotation(rpy), inertia)
