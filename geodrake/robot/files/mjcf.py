"""MJCF, the format of MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from geodrake.inertia import Array
from geodrake.robot.files.base import ModelText
from geodrake.robot.files.checks import MJCF_NUMBERS, check_limits, check_numbers
from geodrake.robot.files.includes import Includes
from geodrake.robot.files.mjcf_simple import read_simple
from geodrake.robot.files.mjcf_source import compiled, mujoco_or_none
from geodrake.robot.files.mjcf_terms import terms_of
from geodrake.robot.files.mjcf_tree import plain_tree
from geodrake.robot.files.motors import mjcf_motors
from geodrake.robot.files.values import (
    inertial_parameters_of,
    numbers,
    rotation,
    symmetric,
)
from geodrake.robot.transmission.statements import Statement

_OF_MOTORS = ("actuator", "tendon")
_ACTUATORS = ("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder")


class MjcfText(ModelText):
    """A MuJoCo model, as MuJoCo compiles it where that is installed.

    The text is then one plain tree of bodies, each with its inertia and joints, which has no
    geometry. What else the file states of joints, and what no model takes, is in the attributes.

    Attributes:
        compiled: MuJoCo's model of all of the file; None without MuJoCo.
        reference: MuJoCo's model without what is left out, which robots are compared with; None
            without MuJoCo.
        closing: Numbers of MuJoCo's constraints that close loops.
        degrees: Whether angles in the file are in degrees.
        timestep: Step of the simulation, s; MuJoCo's own where the file states none that can be.
        actuator_defaults: Whether actuators without a class have defaults other than MuJoCo's.
    """

    kind = "xml"
    numeric = MJCF_NUMBERS

    def __init__(
        self, root: Element, path: Path, scope: str | None, folders: Mapping[str, Path]
    ) -> None:
        self.reference: Any = None
        self.compiled: Any = None
        self.closing: tuple[int, ...] = ()
        super().__init__(root, path, scope, folders)

    def _read(self) -> None:
        Includes(self.path, self.folders).insert_elements(self.root)
        check_numbers(self.root, self.numeric, self.path)
        check_limits(self.root, self.path)
        self.degrees = turns_in_degrees(self.root)
        self.timestep = _timestep(self.root)
        mains = self.root.findall("default")
        self.actuator_defaults = any(child.tag in _ACTUATORS for main in mains for child in main)
        scope = self.scope or self.root.get("model") or self.path.stem
        name = self.root.get("model") or scope
        mujoco = mujoco_or_none()
        if mujoco is None:
            read_simple(self, scope, degrees=self.degrees)
        else:
            self._read_compiled(scope, name, mujoco)
        self._motors = Element("mujoco")
        self._motors.extend(deepcopy(e) for e in self.root if e.tag in _OF_MOTORS)
        for tendon in self.root.findall("tendon"):
            self.root.remove(tendon)
        for world in self.root.findall("worldbody"):
            for body in world.iter("body"):
                link = f"{scope}::{body.get('name')}"
                self._links[link] = body
                if body.attrib.pop("between", ""):
                    self.between.add(link)

    def _read_compiled(self, scope: str, name: str, mujoco: ModuleType) -> None:
        source = compiled(self.root, self.path, mujoco)
        terms = terms_of(source, mujoco)
        self.root = plain_tree(source, name, terms.of_joints["damping"], mujoco)
        for quantity, values in terms.of_joints.items():
            if quantity != "damping":
                of_joints = {f"{scope}::{joint}": value for joint, value in values.items()}
                setattr(self, quantity, of_joints)
        self.springs = {f"{scope}::{joint}": spring for joint, spring in terms.springs.items()}
        self.carried = {f"{scope}::{body}": share for body, share in terms.carried.items()}
        self.boxes = [replace(box, body=f"{scope}::{box.body}") for box in terms.boxes]
        self.struts = [each.scoped(scope) for each in terms.struts]
        self.tendons = [tendon.scoped(scope) for tendon in terms.tendons]
        self.coupled_inertia = [
            (f"{scope}::{i}", f"{scope}::{j}", own) for i, j, own in terms.coupled_inertia
        ]
        self.reference = None if source.lost else terms.reference
        self.compiled, self.gravity = source.model, terms.gravity
        self.followers, self.bent = terms.followers_in(scope), terms.bent_followers
        self.closures, self.closing = terms.closures_in(scope), tuple(terms.closures)
        self.left_out += (*source.about, *terms.left_out)
        self.notes += [
            *source.split,
            *terms.notes,
            *(f"MuJoCo: {' '.join(each.split())}" for each in source.said),
        ]
        self.lost += source.lost

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


def _timestep(root: Element) -> float:
    stated = [option.get("timestep") for option in root.findall("option")]
    step = float(numbers(next(filter(None, reversed(stated)), ""), 1)[0])
    return step if step > 0.0 and np.isfinite(step) else 0.002


def turns_in_degrees(root: Element) -> bool:
    """Return whether angles in an MJCF file are in degrees, as they are if it does not say."""
    compilers = [compiler.get("angle") for compiler in root.findall("compiler")]
    return next((angle for angle in reversed(compilers) if angle), "degree") == "degree"
