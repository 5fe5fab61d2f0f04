"""A compiled MJCF written as one plain tree of bodies, which Drake reads as MuJoCo means it."""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis, Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from geodrake.inertia import Array
from geodrake.robot.files.mjcf_source import CompiledMjcf, located, unused
from geodrake.robot.files.values import UPPER, words


def plain_tree(
    source: CompiledMjcf, name: str, damping: Mapping[str, float], mujoco: ModuleType
) -> Element:
    """Return the root element of bodies with inertias and joints, motors and fixed tendons.

    Angles are in radians. Positions are MuJoCo's: a joint that the file draws at `ref` has the
    pose of its body turned back by that.

    Args:
        damping: Joint -> its damping, N·m·s/rad or N·s/m.
    """
    root = Element("mujoco", model=name)
    SubElement(root, "compiler", angle="radian")
    _Tree(source, damping, mujoco).write(SubElement(root, "worldbody"))
    _write_motors(root, source.model, mujoco)
    return root


def name_of(model: Any, mujoco: ModuleType, kind: str, at: int) -> str:
    """Return the name of a body, joint, tendon or actuator of a compiled model."""
    return mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind}"), at) or ""


class _Tree:
    def __init__(
        self, source: CompiledMjcf, damping: Mapping[str, float], mujoco: ModuleType
    ) -> None:
        self.source, self.model, self.mujoco = source, source.model, mujoco
        self.damping = damping
        bodies = range(self.model.nbody)
        self.free = unused({name_of(self.model, mujoco, "BODY", at) for at in bodies})
        self.kinds = {
            int(getattr(mujoco.mjtJoint, f"mjJNT_{kind.upper()}")): kind
            for kind in ("hinge", "slide", "ball", "free")
        }

    def write(self, world: Element) -> None:
        elements, m = {0: world}, self.model
        for at in range(1, m.nbody):
            elements[at] = self._write_body(elements[int(m.body_parentid[at])], at)

    def _write_body(self, parent: Element, at: int) -> Element:
        m, name = self.model, name_of(self.model, self.mujoco, "BODY", at)
        like = self.source.elements.get(name)
        X_PB = pose_of(m.body_pos[at], m.body_quat[at])
        joints = range(m.body_jntadr[at], m.body_jntadr[at] + m.body_jntnum[at])
        for joint in joints:
            own = name_of(m, self.mujoco, "JOINT", joint)
            last = joint == joints[-1]
            X_PB = X_PB @ self._back(joint)
            where = {"name": name if last else self.free(f"{name}_{own}"), **_pose_words(X_PB)}
            if not last:
                where["between"] = "true"
            parent = _append(parent, located("body", where, like))
            self._write_joint(parent, joint, own)
            X_PB = RigidTransform()
        if not joints:
            where = {"name": name, **_pose_words(X_PB)}
            parent = _append(parent, located("body", where, like))
        if m.body_mass[at] > 0.0 and name not in self.source.unknown:
            turn = _rotation(m.body_iquat[at])
            inertia = turn @ np.diag(m.body_inertia[at]) @ turn.T
            SubElement(
                parent,
                "inertial",
                pos=words(m.body_ipos[at]),
                mass=words(m.body_mass[at]),
                fullinertia=words(inertia[UPPER]),
            )
        return parent

    def _write_joint(self, body: Element, joint: int, name: str) -> None:
        m = self.model
        kind = self.kinds[int(m.jnt_type[joint])]
        if kind == "free":
            SubElement(body, "freejoint", name=name)
            return
        stated = {"name": name, "type": kind, "pos": words(m.jnt_pos[joint])}
        if kind != "ball":
            stated |= {"axis": words(m.jnt_axis[joint])}
            if m.jnt_limited[joint]:
                stated |= {"range": words(m.jnt_range[joint]), "limited": "true"}
        SubElement(body, "joint", {**stated, "damping": words(self.damping.get(name, 0.0))})

    def _back(self, joint: int) -> RigidTransform:
        """Return what turns a body back from where it is drawn to where its joint is at zero."""
        m, kind = self.model, self.kinds[int(self.model.jnt_type[joint])]
        if kind not in ("hinge", "slide"):
            return RigidTransform()
        ref = float(m.qpos0[m.jnt_qposadr[joint]])
        axis, point = np.array(m.jnt_axis[joint]), np.array(m.jnt_pos[joint])
        if not ref:
            return RigidTransform()
        if kind == "slide":
            return RigidTransform(-ref * axis)
        turn = RotationMatrix(AngleAxis(-ref, axis))
        return RigidTransform(turn, point - turn.multiply(point))


def _append(parent: Element, child: Element) -> Element:
    parent.append(child)
    return child


def pose_of(position: Array, quaternion: Array) -> RigidTransform:
    """Return the pose of a position (3,), m, and a quaternion w, x, y, z (4,)."""
    return RigidTransform(RotationMatrix(_rotation(quaternion)), np.array(position))


def _rotation(quaternion: Array) -> Array:
    return RotationMatrix(Quaternion(np.array(quaternion, float))).matrix()


def _pose_words(X: RigidTransform) -> dict[str, str]:
    return {"pos": words(X.translation()), "quat": words(X.rotation().ToQuaternion().wxyz())}


def _write_motors(root: Element, m: Any, mujoco: ModuleType) -> None:
    """Gears of motors at joints and of fixed tendons, as MuJoCo resolved their classes."""
    at_joints = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    motors, pulled = SubElement(root, "actuator"), list[int]()
    for at in range(len(m.actuator_trntype)):
        kind, on = int(m.actuator_trntype[at]), int(m.actuator_trnid[at][0])
        own, gear = name_of(m, mujoco, "ACTUATOR", at), words(m.actuator_gear[at][0])
        named = {"name": own} if own else {}
        if kind in at_joints:
            joint, type_ = name_of(m, mujoco, "JOINT", on), mujoco.mjtJoint
            if int(m.jnt_type[on]) in (int(type_.mjJNT_HINGE), int(type_.mjJNT_SLIDE)):
                SubElement(motors, "motor", {**named, "joint": joint, "gear": gear})
        elif kind == int(mujoco.mjtTrn.mjTRN_TENDON):
            fixed = fixed_tendon(m, mujoco, on)
            tendon = name_of(m, mujoco, "TENDON", on) or f"tendon_{on}"
            if fixed:
                SubElement(motors, "motor", {**named, "tendon": tendon, "gear": gear})
            if fixed and on not in pulled:
                pulled.append(on)
                group = SubElement(SubElement(root, "tendon"), "fixed", name=tendon)
                for pulling, share in fixed.items():
                    own_joint = name_of(m, mujoco, "JOINT", pulling)
                    SubElement(group, "joint", joint=own_joint, coef=words(share))


def fixed_tendon(m: Any, mujoco: ModuleType, at: int) -> dict[int, float]:
    """Return joint -> coefficient of a fixed tendon; nothing of a spatial one."""
    found = dict[int, float]()
    for k in range(m.tendon_adr[at], m.tendon_adr[at] + m.tendon_num[at]):
        if int(m.wrap_type[k]) != int(mujoco.mjtWrap.mjWRAP_JOINT):
            return {}
        joint = int(m.wrap_objid[k])
        found[joint] = found.get(joint, 0.0) + float(m.wrap_prm[k])
    return found
