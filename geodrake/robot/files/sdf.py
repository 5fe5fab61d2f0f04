"""SDF models and worlds."""

from __future__ import annotations

from xml.etree.ElementTree import Element

import numpy as np

from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.robot.files.base import SDF_UNREAD, ModelText, is_nothing, unread
from geodrake.robot.files.checks import (
    SDF_NUMBERS,
    TENSOR,
    drop,
    inertial_parameters_of,
    numbers,
    rotation,
    symmetric,
)
from geodrake.robot.files.includes import PACKAGE_ADVICE, Includes
from geodrake.robot.files.model_edits import sdf_models
from geodrake.robot.files.xml_text import wrong_at

_SPRING = ("spring_stiffness", "spring_reference")


class SdfText(ModelText):
    """An SDF model or world."""

    kind = "sdf"
    numeric = SDF_NUMBERS

    def _read(self) -> None:
        includes, terms = Includes(self.path, self.folders), self.terms
        includes.insert(self.root, self.path.parent)
        self.packages = includes.names
        terms.notes += includes.absent
        terms.left_out += includes.missing
        terms.left_out += unread(self.root, SDF_UNREAD, self.path)
        for link in self.root.iter("link"):
            inertial = link.find("inertial")
            if inertial is None or inertial.get("auto") != "true":
                drop(link, "collision")
        drop(self.root, "visual", "sensor", "plugin", "drake:collision_filter_group")
        models = list(sdf_models(self.root, first=self.scope or ""))
        for name, model in models:
            self._take_balls(name, model)
        self._drop_loops()
        for name, model in models:
            self._links |= {f"{name}::{e.get('name')}": e for e in model.findall("link")}
            for joint in model.findall("joint"):
                self._take_mimic(name, joint)
                self._read_joint(f"{name}::{joint.get('name')}", joint)
        nowhere = [*includes.missing, *includes.absent]
        if nowhere and not self._links:
            raise ModelError(
                f"{self.path} has no model but such as lead nowhere: {nowhere[0]}",
                advice=PACKAGE_ADVICE,
                path=self.path,
            )
        self._take_gravity()

    def _take_gravity(self) -> None:
        for stated in self.root.findall("world/gravity"):
            words = stated.text or ""
            vector = numbers(words, 3)
            if not np.isfinite(vector).all():
                what = f"<gravity> has {words[:50]!r} instead of three numbers."
                raise wrong_at(stated, self.path, what)
            if words.strip():
                self.terms.gravity = vector
        of_links = {name: link.findtext("gravity") for name, link in self._links.items()}
        self._take_weightless(
            [name for name, text in of_links.items() if text is not None and is_nothing(text)]
        )

    def _read_joint(self, name: str, joint: Element) -> None:
        self.terms.friction[name] = numbers(joint.findtext("axis/dynamics/friction", "0"), 1)[0]
        for dynamics in joint.iter("dynamics"):
            if dynamics is joint.find("axis/dynamics"):
                self._take_spring(name, dynamics, *_SPRING)
            drop(dynamics, *_SPRING)

    def _inertia(self, link: Element) -> Array | None:
        inertial = link.find("inertial")
        if inertial is None or inertial.get("auto") == "true":
            return None
        pose = inertial.find("pose")
        values = np.zeros(6) if pose is None else numbers(pose.text or "", 6)
        turn = values[3:]
        if pose is not None and pose.get("degrees") == "true":
            turn = np.deg2rad(turn)
        if pose is not None and pose.get("rotation_format") == "quat_xyzw":
            values = numbers(pose.text or "", 7)
            turn = values[[6, 3, 4, 5]]
        inertia = symmetric(
            inertial.findtext(f"inertia/{key}", "1" if key in ("ixx", "iyy", "izz") else "0")
            for key in TENSOR
        )
        mass = numbers(inertial.findtext("mass", "1"), 1)[0]
        return inertial_parameters_of(mass, values[:3], rotation(turn), inertia)
