"""Base class of the model formats that are XML."""

from __future__ import annotations

import abc
import re
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import ClassVar
from xml.etree.ElementTree import Element

import numpy as np
from pydrake.math import RigidTransform

from geodrake.inertia import Array, is_physical
from geodrake.robot.files.checks import (
    Numeric,
    check_inertia,
    check_limits,
    check_links,
    check_numbers,
    drop,
    numbers,
)
from geodrake.robot.files.model_edits import put_inertia
from geodrake.robot.files.xml_text import numbered_text, place_of, wrong_at
from geodrake.robot.joints import Follower
from geodrake.robot.stated import Closure, FileTerms, Spring
from geodrake.robot.transmission.statements import Statement

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


_BALL = "drake:ball_constraint"
_LOOPS = ("linear_bushing_rpy", "distance_constraint", "weld_constraint")


class ModelText(abc.ABC):
    """A robot description as text that Drake accepts.

    Attributes:
        numeric: Numbers of the format and what they may be.
        terms: What the file states that is not in the text.
        packages: Names of packages whose files are left for Drake to include.
        folders: Package -> folder, which come before those that are found.
    """

    kind: ClassVar[str]
    numeric: ClassVar[Numeric]

    def __init__(
        self, root: Element, path: Path, scope: str | None, folders: Mapping[str, Path]
    ) -> None:
        self.root, self.path, self.scope, self.folders = root, path, scope, folders
        self.terms, self.packages = FileTerms(), set[str]()
        self._links: dict[str, Element] = {}
        self._read()
        check_numbers(self.root, self.numeric, path)
        check_limits(self.root, path)
        check_links(self._links, path)
        for name, link in self._links.items():
            phi = self._inertia(link)
            if phi is not None:
                check_inertia(link, phi, path)
            if phi is not None and not is_physical(phi):
                self.terms.set_aside[name] = phi
                self.set_inertia(name, None)

    @property
    def links(self) -> tuple[str, ...]:
        """Scoped names of the links."""
        return tuple(self._links)

    def stated_inertia(self, link: str) -> Array | None:
        """Inertial parameters (10,) that the file states for a link, possible or not; else None."""
        if link in self.terms.set_aside or link not in self._links:
            return self.terms.set_aside.get(link)
        return self._inertia(self._links[link])

    def motors(self) -> tuple[Statement, ...]:
        """Return what the file states of motors behind transmissions."""
        return ()

    def set_inertia(self, link: str, phi: Array | None) -> bool:
        """Give a link inertial parameters (10,), or none; False if the link is not in the text."""
        if link not in self._links:
            return False
        element = self._links[link]
        for inertial in element.findall("inertial"):  # not of the bodies below it in MJCF
            element.remove(inertial)
        if phi is not None:
            put_inertia(self.root, element, phi)
        return True

    def text(self) -> tuple[str, list[str]]:
        """Return the simplified description, and each of its lines' place in the file."""
        return numbered_text(self.root)

    def _take_balls(self, scope: str, model: Element) -> None:
        """Take Drake's constraints of points that are one, which close loops, out of a model."""
        for ball in model.findall(_BALL):
            model.remove(ball)

            def stated(key: str, ball: Element = ball) -> str:
                found = ball.find(f"{_BALL}_{key}")
                words = "" if found is None else found.get("name") or found.get("value")
                return (words or (found.text if found is not None else "") or "").strip()

            first, second = stated("body_A"), stated("body_B")
            if not first or not second:
                raise wrong_at(ball, self.path, f"<{_BALL}> does not name its two bodies.")
            at, other = (RigidTransform(numbers(stated(key), 3)) for key in ("p_AP", "p_BQ"))
            bodies = f"{scope}::{first}", f"{scope}::{second}"
            name = f"<{_BALL}> of {first} and {second}"
            self.terms.closures.append(Closure(name, bodies, (at, other), False))

    def _drop_loops(self) -> None:
        tags = {f"{prefix}{tag}" for tag in _LOOPS for prefix in ("drake:", "")}
        for element in (each for each in self.root.iter() if each.tag in tags):
            where, what = place_of(element) or self.path, f"<{element.tag}> is ignored"
            self.terms.left_out.append(f"{where}: {what}: the robot is read as an open tree.")
        drop(self.root, *tags)

    def _take_weightless(self, off: Collection[str]) -> None:
        """Take scoped names of links on which gravity does not act: if all, there is none."""
        heavy = {name for name, link in self._links.items() if link.find("inertial") is not None}
        if off and heavy.issubset(off):
            self.terms.gravity = np.zeros(3)
        else:
            self.terms.carried = dict.fromkeys(off, 1.0)

    def _take_spring(self, joint: str, parent: Element, *tags: str) -> None:
        """Take the spring of a joint, by its scoped name, of the tags of stiffness and rest."""
        stated = [parent.find(tag) for tag in tags]
        texts = ["0" if each is None else each.text or "0" for each in stated]
        values = [float(numbers(text, 1)[0]) for text in texts]
        for element, text, value in zip(stated, texts, values, strict=True):
            if element is not None and not np.isfinite(value):
                what = f"<{element.tag}> has {text.strip()[:50]!r} instead of a number."
                raise wrong_at(element, self.path, what)
        self.terms.springs[joint] = Spring.linear(*values)

    def _take_mimic(self, scope: str, joint: Element) -> None:
        for mimic in [e for e in joint.iter() if e.tag in ("mimic", "drake:mimic")]:
            ratio, offset = (
                float(numbers(mimic.get(key) or mimic.findtext(key) or default, 1)[0])
                for key, default in (("multiplier", "1"), ("offset", "0"))
            )
            start = float(numbers(mimic.findtext("reference", "0"), 1)[0])  # of SDF
            own, leader = (f"{scope}::{name}" for name in (joint.get("name"), mimic.get("joint")))
            self.terms.followers.append(Follower(own, leader, ratio, offset - ratio * start))
        drop(joint, "mimic", "drake:mimic")

    @abc.abstractmethod
    def _read(self) -> None:
        """Fill the attributes and take out what Drake shall not see."""

    @abc.abstractmethod
    def _inertia(self, link: Element) -> Array | None:
        """Return inertial parameters that the file states for a link."""
