"""What a URDF or SDF states that changes motion or effort, and that nothing here reads.

Each is a sentence with the file, the line and the value: a robot without it is not that of its
file.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

from geodrake.robot.files.xml_text import place_of

URDF_UNREAD: Mapping[str, Collection[str]] = {
    "gazebo": ("dampingFactor", "velocity_decay", "enable_wind"),
    "actuator": ("motorInertia", "rotorInertia"),
    "contact": ("inertia_scaling",),
    "joint": ("joint_properties",),
    "robot": ("drake:linear_spring_damper", "drake:prismatic_spring", "drake:revolute_spring"),
}
SDF_UNREAD: Mapping[str, Collection[str]] = {
    "link": ("velocity_decay", "enable_wind"),
    "inertial": ("fluid_added_mass",),
    "axis2": ("friction", "spring_stiffness"),
    "model": ("drake:linear_spring_damper", "drake:prismatic_spring", "drake:revolute_spring"),
}
"""Tag -> tags of its children, or of theirs, that bear on efforts unless they are zero."""

DYNAMICS_READ = frozenset({"damping", "friction"})
"""Attributes of <dynamics> in a URDF that are read; others are a simulator's own."""

_FORCES = re.compile(
    r"buoyan|lift.?drag|hydrodyn|wind(?!ow)|spring|apply.?(force|wrench)|thruster", re.I
)
_NOTHING = frozenset({"", "false"})


def unread(root: Element, table: Mapping[str, Collection[str]], path: Path) -> Iterator[str]:
    """Yield a sentence on each element that bears on efforts and is not read."""
    for element in root.iter():
        for child in element if element.tag in table else ():
            yield from _of(child, table[element.tag], path)
        if element.tag == "plugin":
            name = element.get("filename") or element.get("name") or ""
            if _FORCES.search(name):
                yield f"{place_of(element) or path}: the plugin {name.strip()} is left out."
        if element.tag == "dynamics" and root.tag == "robot":
            for key in sorted(set(element.attrib) - DYNAMICS_READ):
                value = element.get(key, "").strip()
                if not is_nothing(value):
                    where = place_of(element) or path
                    yield f"{where}: {key}={value[:50]} of <dynamics> is left out."


def _of(element: Element, tags: Collection[str], path: Path) -> Iterator[str]:
    if element.tag not in tags:
        for child in element if element.tag == "dynamics" else ():
            yield from _of(child, tags, path)
        return
    words = [*element.attrib.values(), *(part.text or "" for part in element.iter())]
    stated = [word.strip() for word in words if not is_nothing(word)]
    if stated:
        value = " ".join(" ".join(stated).split())[:80]
        yield f"{place_of(element) or path}: <{element.tag}> {value} is left out."


def is_nothing(text: str) -> bool:
    """Return whether a text says that there is none: no text, `false`, or numbers that are 0."""
    words = text.split()
    if not words or text.strip().lower() in _NOTHING:
        return True
    try:
        return not any(float(word) for word in words)
    except ValueError:
        return False
