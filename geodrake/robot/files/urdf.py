"""URDF, and what it states of motors behind transmissions.

Most logs of robots with such files are of joints all the same, so that this counts only where it
is asked for. The transmissions are those of ros_control, whose formulas are (reductions n_a of
actuators and n_j of joints, offsets θ₀):

    Simple:        θ = q / (n_a n_j) + θ₀
    Differential:  θ₁ = (q₁/n_a1 + q₂/n_a2) / (2 n_j1) + θ₀₁,  θ₂ the same with a difference
    FourBar:       θ₁ = q₁ / (n_j1 n_a1) + θ₀₁,  θ₂ = (q₂/n_a2 − q₁/(n_j1 n_a1)) / n_j2 + θ₀₂
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import deepcopy
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from geodrake.errors import ModelError
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
from geodrake.robot.files.xml_text import wrong_at
from geodrake.robot.transmission.statements import Coupled, Gear, Statement

_KINDS = ("SimpleTransmission", "DifferentialTransmission", "FourBarLinkageTransmission")
_REDUCTIONS = ("mechanicalReduction", "mechanical_reduction")


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
        return tuple(part for e in self._transmissions for part in _motors(e, self.path))

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


def _motors(element: Element, path: Path) -> Iterator[Statement]:
    """Yield what a transmission of a URDF states."""
    words = element.findtext("type") or element.findtext("plugin") or element.get("type") or ""
    kind = words.strip().rpartition("/")[2]
    if kind not in _KINDS:
        return
    what = f"{path}: the transmission {element.get('name', '')!r}"
    joints, actuators = (_in_roles(element, tag) for tag in ("joint", "actuator"))
    count = 1 if kind == "SimpleTransmission" else 2
    if len(joints) != count or len(actuators) != count:
        raise ModelError(
            f"{what} has {len(joints)} joints and {len(actuators)} actuators instead of {count}.",
            advice="Correct it there, or write a transmission file.",
        )
    names = [[e.get("name", "") for e in group] for group in (joints, actuators)]
    nj, na = ([_reduction(e, what) for e in group] for group in (joints, actuators))
    shifts = [_value(e, ("offset",), 0.0, what) for e in joints]
    (j1, *j2), (a1, *a2) = names
    if kind == "SimpleTransmission":
        yield Gear(a1, j1, na[0] * nj[0], shifts[0])
        return
    if kind == "DifferentialTransmission":
        first = {a1: 0.5 / (nj[0] * na[0]), a2[0]: 0.5 / (nj[0] * na[1])}
        second = {a1: 0.5 / (nj[1] * na[0]), a2[0]: -0.5 / (nj[1] * na[1])}
    else:
        through = 1.0 / (nj[0] * na[0])
        first = {a1: through}
        second = {a1: -through / nj[1], a2[0]: 1.0 / (nj[1] * na[1])}
    yield Coupled({j1: first, j2[0]: second}, dict(zip(names[0], shifts, strict=True)))


def _in_roles(element: Element, tag: str) -> list[Element]:
    """Return its joints or actuators in the order of their roles, such as joint1 and joint2."""
    found = element.findall(tag)
    return sorted(found, key=lambda e: (e.get("role") or e.findtext("role") or "").strip())


def _reduction(element: Element, what: str) -> float:
    value = _value(element, _REDUCTIONS, 1.0, what)
    if not value:
        raise ModelError(f"{what} has a reduction of 0.", advice="Correct it there.")
    return value


def _value(element: Element, tags: Sequence[str], default: float, what: str) -> float:
    text = next((t for tag in tags if (t := element.findtext(tag)) is not None), None)
    value = default if text is None else float(numbers(text.strip() or "none", 1)[0])
    if not np.isfinite(value):
        raise ModelError(f"{what} has {text!r:.52}, which is no number.", advice="Correct it.")
    return value
