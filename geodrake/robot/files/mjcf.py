"""MJCF as compiled by MuJoCo, written as a plain tree that Drake reads alike."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RotationMatrix

from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.robot.files.checks import (
    LARGEST,
    MJCF_NUMBERS,
    UPPER,
    check_limits,
    check_numbers,
    inertial_parameters_of,
    numbers,
    symmetric,
    words,
)
from geodrake.robot.files.includes import Includes
from geodrake.robot.files.mjcf_source import CompiledMjcf, load_mujoco, unused
from geodrake.robot.files.mjcf_terms import MjcfTerms, actuator_shares, pose_of
from geodrake.robot.files.model_edits import MOTORS
from geodrake.robot.files.texts import ModelText
from geodrake.robot.files.xml_text import LocatedElement
from geodrake.robot.transmission.statements import Coupled, Gear, Statement


class MjcfText(ModelText):
    """A MuJoCo model, as MuJoCo compiles it.

    The text is one plain tree of bodies, each with its inertia and joints, which has no geometry.

    Attributes:
        compiled: MuJoCo's model of all of the file.
        reference: MuJoCo's model without what is left out, which robots are compared with; None
            where inertias are lost.
        closing: Numbers of MuJoCo's constraints that close loops.
        degrees: Whether angles in the file are in degrees, as by default.
        timestep: Step of the simulation, s; MuJoCo's own where the file states none that can be.
        actuator_defaults: Whether actuators without a class have defaults other than MuJoCo's.
    """

    kind = "xml"
    numeric = MJCF_NUMBERS

    def _read(self) -> None:
        root = self.root
        Includes(self.path, self.folders).insert_elements(root)
        check_numbers(root, self.numeric, self.path)
        check_limits(root, self.path)
        angles = [compiler.get("angle") for compiler in root.findall("compiler")]
        self.degrees = next(filter(None, reversed(angles)), "degree") == "degree"
        steps = [option.get("timestep") for option in root.findall("option")]
        step = float(numbers(next(filter(None, reversed(steps)), ""), 1)[0])
        self.timestep = step if step > 0.0 and np.isfinite(step) else 0.002
        self.actuator_defaults = any(
            child.tag in MOTORS for main in root.findall("default") for child in main
        )
        scope = self.scope or root.get("model") or self.path.stem
        source = CompiledMjcf(root, self.path)
        read = MjcfTerms(source, scope)
        name = root.get("model") or scope
        self.root = plain_tree(source, name)
        self.compiled: Any = source.model
        self.reference: Any = None if source.lost else read.reference
        self.closing, self.terms = tuple(read.closing), read.found
        for body in self.root.iter("body"):
            link = f"{scope}::{body.get('name')}"
            self._links[link] = body
            if body.attrib.pop("between", ""):
                self.terms.between.add(link)

    def motors(self) -> tuple[Statement, ...]:
        """Return gears of actuators, and fixed tendons."""
        return _motors(self.compiled, self.path)

    def _inertia(self, inertial: Element) -> Array:
        mass, com = numbers(inertial.get("mass", ""), 1)[0], numbers(inertial.get("pos", ""), 3)
        moments = symmetric(inertial.get("fullinertia", "").split())
        return inertial_parameters_of(mass, com, np.eye(3), moments)


def plain_tree(source: CompiledMjcf, name: str) -> Element:
    """Return the root element of bodies with inertias and joints, and motors.

    Angles are in radians. Positions are MuJoCo's: a joint that the file draws at `ref` has the
    pose of its body turned back by that.
    """
    root, m = Element("mujoco", model=name), source.model
    SubElement(root, "compiler", angle="radian")
    elements = {0: SubElement(root, "worldbody")}
    free = unused({m.body(at).name for at in range(m.nbody)})
    for at in range(1, m.nbody):
        own, parent = m.body(at).name, elements[int(m.body_parentid[at])]
        like, X_PB = source.elements.get(own), pose_of(m.body_pos[at], m.body_quat[at])
        joints = range(m.body_jntadr[at], m.body_jntadr[at] + m.body_jntnum[at])
        for joint in joints:
            X_PB, between = X_PB @ _back(m, joint), joint != joints[-1]
            label = free(f"{own}_{m.joint(joint).name}") if between else own
            parent = _body(parent, label, X_PB, like)
            if between:
                parent.set("between", "true")
            _write_joint(parent, m, joint)
            X_PB = RigidTransform()
        elements[at] = parent if joints else _body(parent, own, X_PB, like)
        if m.body_mass[at] > 0.0 and own not in source.unknown:
            turn = pose_of(np.zeros(3), m.body_iquat[at]).rotation().matrix()
            inertia = turn @ np.diag(m.body_inertia[at]) @ turn.T
            SubElement(
                elements[at],
                "inertial",
                pos=words(m.body_ipos[at]),
                mass=words(m.body_mass[at]),
                fullinertia=words(inertia[UPPER]),
            )
    motors = SubElement(root, "actuator")
    for at, kind in enumerate(m.actuator_trntype):
        named = {"name": own} if (own := m.actuator(at).name) else {}
        for joint in actuator_shares(m, at) if kind != load_mujoco().mjtTrn.mjTRN_TENDON else ():
            SubElement(motors, "motor", {**named, "joint": m.joint(joint).name})
    return root


def _body(parent: Element, name: str, X: RigidTransform, like: Element | None) -> Element:
    """Add a body of the compiled file to its parent."""
    turn = words(X.rotation().ToQuaternion().wxyz())
    stated = {"name": name, "pos": words(X.translation()), "quat": turn}
    made = Element("body", stated)
    if isinstance(like, LocatedElement):
        made = located = LocatedElement("body", stated)
        located.path, located.line = like.path, like.line
    parent.append(made)
    return made


def _kind(m: Any, joint: int) -> str:
    kind = load_mujoco().mjtJoint(int(m.jnt_type[joint]))
    return str(kind.name).removeprefix("mjJNT_").lower()


def _write_joint(body: Element, m: Any, joint: int) -> None:
    kind, name = _kind(m, joint), m.joint(joint).name
    if kind == "free":
        SubElement(body, "freejoint", name=name)
        return
    stated = {"name": name, "type": kind, "pos": words(m.jnt_pos[joint])}
    if kind != "ball":
        stated |= {"axis": words(m.jnt_axis[joint])}
        if m.jnt_limited[joint] and np.isfinite(m.jnt_range[joint]).any():
            ends = np.clip(m.jnt_range[joint], -LARGEST, LARGEST)  # Drake reads no infinity
            stated |= {"range": words(ends), "limited": "true"}
    SubElement(body, "joint", stated)


def _back(m: Any, joint: int) -> RigidTransform:
    """Return the rotation of a body from its drawn pose to its joint's zero."""
    kind, ref = _kind(m, joint), float(m.qpos0[m.jnt_qposadr[joint]])
    if kind not in ("hinge", "slide") or not ref:
        return RigidTransform()
    axis, point = np.array(m.jnt_axis[joint]), np.array(m.jnt_pos[joint])
    if kind == "slide":
        return RigidTransform(-ref * axis)
    turn = RotationMatrix(AngleAxis(-ref, axis))
    return RigidTransform(turn, point - turn.multiply(point))


def _motors(m: Any, path: Path) -> tuple[Statement, ...]:
    """Return the transmissions of actuators: gears, q = γ θ, and fixed tendons, q = γ Σ cᵢ θᵢ."""
    gears, pulled = list[Gear](), dict[str, dict[str, float]]()
    for at in range(len(m.actuator_trntype)):
        if not (shares := {m.joint(j).name: x for j, x in actuator_shares(m, at).items()}):
            continue
        if not m.actuator_gear[at][0]:
            what = f"{path}: an actuator has a gear of 0."
            raise ModelError(what, advice="Correct it there.")
        name, on = m.actuator(at).name, int(m.actuator_trnid[at][0])
        if int(m.actuator_trntype[at]) == load_mujoco().mjtTrn.mjTRN_TENDON:
            pulled[name or m.tendon(on).name or f"tendon_{on}"] = shares
        else:
            ((joint, gear),) = shares.items()
            gears.append(Gear(name or joint, joint, gear))
    return (*gears, *_coupled(pulled, path))


def _coupled(pulled: Mapping[str, Mapping[str, float]], path: Path) -> Iterator[Coupled]:
    """Groups of joints that tendons move together, θ = C⁻¹ q of q = C θ."""
    left = dict(pulled)
    while left:
        group, joints = [next(iter(left))], set(left[next(iter(left))])
        while more := [n for n in left if n not in group and joints.intersection(left[n])]:
            group += more
            joints |= {joint for name in more for joint in left[name]}
        names = list(dict.fromkeys(joint for name in group for joint in left[name]))
        rows = [left.pop(name) for name in group]
        C = np.array([[row.get(joint, 0.0) for joint in names] for row in rows])
        if len(names) != len(group) or np.linalg.matrix_rank(C) < len(names):
            raise ModelError(
                f"{path}: the tendons of {', '.join(group)} do not determine {', '.join(names)}.",
                advice="Write a transmission file: --transmission FILE.yaml.",
            )
        yield Coupled(_terms(names, group, np.linalg.inv(C)))


def _terms(
    joints: Sequence[str], actuators: Sequence[str], J: Array
) -> dict[str, dict[str, float]]:
    rows = zip(joints, J.tolist(), strict=True)
    return {joint: {a: x for a, x in zip(actuators, row, strict=True) if x} for joint, row in rows}
