"""URDF."""

from __future__ import annotations

from copy import deepcopy
from xml.etree.ElementTree import Element

from geodrake.inertia import Array
from geodrake.robot.files.base import URDF_UNREAD, ModelText, is_nothing, unread
from geodrake.robot.files.checks import (
    TENSOR,
    URDF_NUMBERS,
    drop,
    inertial_parameters_of,
    number,
    numbers,
    rotation,
    symmetric,
)
from geodrake.robot.files.motors import urdf_motors
from geodrake.robot.files.xml_text import wrong_at
from geodrake.robot.transmission.statements import Statement


class UrdfText(ModelText):
    """A URDF file."""

    kind = "urdf"
    numeric = URDF_NUMBERS

    def _read(self) -> None:
        root, terms = self.root, self.terms
        terms.left_out += unread(root, URDF_UNREAD, self.path)
        gazebo = [e for e in root.findall("gazebo") if e.get("reference")]
        drop(root, "visual", "collision", "gazebo", "material", "drake:collision_filter_group")
        self._transmissions = [deepcopy(e) for e in root.iter("transmission")]
        for transmission in root.findall("transmission"):
            # Only Drake's own rotor inertia and gear ratio matter; joints state their efforts.
            if not any(element.tag.startswith("drake:") for element in transmission.iter()):
                root.remove(transmission)
            for kind in transmission.findall("type"):
                if not (kind.text or "").strip():  # which would end Drake, and the process with it
                    transmission.remove(kind)
        scope = self.scope or root.get("name") or self.path.stem
        self._take_balls(scope, root)
        self._drop_loops()
        root.set("name", root.get("name") or scope)
        self._links = {f"{scope}::{e.get('name')}": e for e in root.findall("link")}
        joints = [*root.findall("joint"), *root.findall("drake:joint")]
        self._check_floating(joints)
        every = {e.get("name") for tag in ("joint", "drake:joint") for e in root.iter(tag)}
        self._take_gazebo(scope, gazebo, every)
        for joint in joints:
            name = f"{scope}::{joint.get('name')}"
            self._take_mimic(scope, joint)
            terms.friction[name] = number(joint, "dynamics", "friction")
            terms.effort[name] = number(joint, "limit", "effort")
            if (limit := joint.find("limit")) is not None and terms.effort[name] == 0.0:
                limit.attrib.pop("effort", None)  # with 0, Drake ignores the rotor, too

    def _check_floating(self, joints: list[Element]) -> None:
        """Refuse links that float beside one that moves, whose joints Drake leaves out."""
        ends = {
            tag: {j: getattr(j.find(tag), "attrib", {}).get("link") for j in joints}
            for tag in ("parent", "child")
        }
        holding = {child: joint for joint, child in ends["child"].items()}
        for joint in (each for each in joints if each.get("type") == "floating"):
            inner, seen = holding.get(ends["parent"][joint]), {joint}
            while inner is not None and inner not in seen and inner.get("type") == "fixed":
                seen.add(inner)
                inner = holding.get(ends["parent"][inner])
            if inner is not None and inner.get("type") != "floating":
                what = f"the joint {joint.get('name')!r} is floating, and what it hangs on moves."
                raise wrong_at(joint, self.path, what)

    def _take_gazebo(self, scope: str, elements: list[Element], joints: set[str | None]) -> None:
        """Take springs of joints, and links without gravity."""
        off = list[str]()
        for element in elements:
            name = f"{scope}::{element.get('reference')}"
            stated = element.findtext("springStiffness", "")
            if element.get("reference") in joints and stated.strip():
                self._take_spring(name, element, "springStiffness", "springReference")
            elif not is_nothing(stated):
                said = wrong_at(
                    element,
                    self.path,
                    f"<springStiffness> {stated.strip()[:50]} of {element.get('reference')}, which "
                    "is no joint, is left out.",
                )
                self.terms.left_out.append(said.problem)
            falls = [is_nothing(each.text or "") for each in element.findall("gravity")]
            falls += [not is_nothing(each.text or "") for each in element.findall("turnGravityOff")]
            if any(falls) and name in self._links:
                off.append(name)
        self._take_weightless(off)

    def motors(self) -> tuple[Statement, ...]:
        """Return the transmissions of ros_control."""
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
