"""Base class of the model formats that are XML."""

from __future__ import annotations

import abc
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import ClassVar
from xml.etree.ElementTree import Element

import numpy as np
from pydrake.math import RigidTransform

from geodrake.errors import ModelError
from geodrake.inertia import Array, is_physical
from geodrake.robot.closure import Closure
from geodrake.robot.files.checks import (
    Numeric,
    check_inertia,
    check_limits,
    check_links,
    check_numbers,
)
from geodrake.robot.files.inertia_text import put_inertia
from geodrake.robot.files.values import drop, numbers
from geodrake.robot.files.xml_text import numbered_text, place_of
from geodrake.robot.followers import Follower
from geodrake.robot.stated import BoxInMedium, Spring, StatedStrut, Tendon
from geodrake.robot.transmission.statements import Followers, Statement

_BALL = "drake:ball_constraint"
_LOOPS = ("linear_bushing_rpy", "distance_constraint", "weld_constraint")


class ModelText(abc.ABC):
    """A robot description as text that Drake accepts.

    Attributes:
        kind: Drake's name of the format.
        numeric: Numbers of the format and what they may be.
        notes: Sentences on what was taken out of the text and matters.
        left_out: Sentences on what bears on efforts, and is not in the text or elsewhere here.
        gravity: (3,) acceleration of gravity that the file states, m/s²; None for Drake's.
        lost: Sentences on inertias that the text does not state and nothing else tells.
        set_aside: Scoped link names with the (10,) inertial parameters that the file gives them
            and no body can have; these are not in the text.
        friction: Scoped joint names with their dry friction, N or N·m.
        armature: Scoped joint names with their reflected inertia, kg·m² or kg.
        damping_2: Scoped joint names with c of their damping c |v| v, SI.
        damping_3: Scoped joint names with c of their damping c v³, SI.
        springs: Scoped joint names with their spring.
        tendons: Tendons over several joints, by scoped names.
        coupled_inertia: Scoped names of two joints, or one twice, and what tendons are there in the
            mass matrix.
        carried: Scoped link names with which share of their weight something else carries.
        boxes: Links as what a medium acts on.
        struts: Springs and dampers between points of links.
        start: Scoped joint names with where the file has them by default, rad or m; otherwise at 0.
        fixed: Scoped joint names with where a constraint holds them, rad or m.
        effort: Scoped joint names with their largest effort, N or N·m.
        followers: Joints that the file has follow others; whether they can is seen in the plant.
        bent: Joints that the file has follow others by a ratio that changes.
        closures: What closes loops of the robot, the bodies by their scoped names.
        between: Scoped names of bodies between several joints of one, which weigh nothing.
        packages: Names of packages whose files are left for Drake to include.
        folders: Package -> folder, which come before those that are found.
    """

    kind: ClassVar[str]
    numeric: ClassVar[Numeric]

    def __init__(
        self, root: Element, path: Path, scope: str | None, folders: Mapping[str, Path]
    ) -> None:
        self.root, self.path, self.scope, self.folders = root, path, scope, folders
        self.notes: list[str] = []
        self.left_out: list[str] = []
        self.gravity: Array | None = None
        self.lost: list[str] = []
        self.friction: dict[str, float] = {}
        self.armature: dict[str, float] = {}
        self.damping_2: dict[str, float] = {}
        self.damping_3: dict[str, float] = {}
        self.springs: dict[str, Spring] = {}
        self.tendons: list[Tendon] = []
        self.coupled_inertia: list[tuple[str, str, float]] = []
        self.carried: dict[str, float] = {}
        self.boxes: list[BoxInMedium] = []
        self.struts: list[StatedStrut] = []
        self.start: dict[str, float] = {}
        self.fixed: dict[str, float] = {}
        self.effort: dict[str, float] = {}
        self.between: set[str] = set()
        self.packages: set[str] = set()
        self.followers: list[Follower] = []
        self.bent: list[Followers] = []
        self.closures: list[Closure] = []
        self._links: dict[str, Element] = {}
        self._read()
        check_numbers(self.root, self.numeric, path)
        check_limits(self.root, path)
        check_links(self._links, path)
        self.set_aside: dict[str, Array] = {}
        for name, link in self._links.items():
            phi = self._inertia(link)
            if phi is not None:
                check_inertia(link, phi, path)
            if phi is not None and not is_physical(phi):
                self.set_aside[name] = phi
                self.set_inertia(name, None)

    @property
    def links(self) -> tuple[str, ...]:
        """Scoped names of the links."""
        return tuple(self._links)

    def stated_inertia(self, link: str) -> Array | None:
        """Inertial parameters (10,) that the file states for a link, possible or not; else None."""
        if link in self.set_aside or link not in self._links:
            return self.set_aside.get(link)
        return self._inertia(self._links[link])

    @property
    def driven_joints(self) -> frozenset[str]:
        """Names of joints that the file says are driven; see `MjcfText`."""
        return frozenset()

    def motors(self) -> tuple[Statement, ...]:
        """Return what the file states of motors behind transmissions; see `files.motors`."""
        return ()

    def set_inertia(self, link: str, phi: Array | None) -> bool:
        """Gives a link inertial parameters (10,), or none; False if the link is not in the text.

        Args:
            phi: (10,) inertial parameters about Bo, expressed in B; None takes the inertia away.
        """
        if link not in self._links:
            return False
        element = self._links[link]
        for inertial in element.findall("inertial"):  # not of the bodies below it in MJCF
            element.remove(inertial)
        if phi is not None:
            put_inertia(self.root, element, phi)
        return True

    def text(self) -> tuple[str, list[str]]:
        """The simplified description, and for each of its lines where that is in the file."""
        return numbered_text(self.root)

    def _take_balls(self, scope: str, model: Element) -> None:
        """Take Drake's constraints of points that are one, which close loops, out of a model.

        Raises:
            ModelError: One does not name its bodies.
        """
        for ball in model.findall(_BALL):
            model.remove(ball)

            def stated(key: str, ball: Element = ball) -> str:
                found = ball.find(f"{_BALL}_{key}")
                words = "" if found is None else found.get("name") or found.get("value")
                return (words or (found.text if found is not None else "") or "").strip()

            first, second = stated("body_A"), stated("body_B")
            bodies = f"{scope}::{first}", f"{scope}::{second}"
            if not first or not second:
                raise ModelError(
                    f"{place_of(ball) or self.path}: <{_BALL}> does not name its two bodies.",
                    advice="Correct the file there.",
                    path=self.path,
                )
            points = [RigidTransform(numbers(stated(key), 3)) for key in ("p_AP", "p_BQ")]
            name = f"<{_BALL}> of {first} and {second}"
            self.closures.append(Closure(name, bodies, (points[0], points[1]), False))

    def _drop_loops(self) -> None:
        tags = {f"{prefix}{tag}" for tag in _LOOPS for prefix in ("drake:", "")}
        for tag in sorted({e.tag for e in self.root.iter() if e.tag in tags}):
            drop(self.root, tag)
            self.left_out.append(f"<{tag}> is ignored: the robot is read as an open tree.")

    def _take_weightless(self, off: Collection[str]) -> None:
        """Take scoped names of links on which gravity does not act: if all, there is none."""
        heavy = {name for name, link in self._links.items() if link.find("inertial") is not None}
        if off and heavy.issubset(off):
            self.gravity = np.zeros(3)
        else:
            self.carried = dict.fromkeys(off, 1.0)

    def _take_mimic(self, scope: str, joint: Element) -> None:
        """Takes the <mimic> of a joint out of the text, and what it says in."""
        for mimic in [e for e in joint.iter() if e.tag in ("mimic", "drake:mimic")]:
            ratio, offset = (
                float(numbers(mimic.get(key) or mimic.findtext(key) or default, 1)[0])
                for key, default in (("multiplier", "1"), ("offset", "0"))
            )
            start = float(numbers(mimic.findtext("reference", "0"), 1)[0])  # of SDF
            own, leader = (f"{scope}::{name}" for name in (joint.get("name"), mimic.get("joint")))
            self.followers.append(Follower(own, leader, ratio, offset - ratio * start))
        drop(joint, "mimic", "drake:mimic")

    @abc.abstractmethod
    def _read(self) -> None:
        """Fills the attributes and takes out what Drake shall not see."""

    @abc.abstractmethod
    def _inertia(self, link: Element) -> Array | None:
        """Inertial parameters that the file states for a link."""
