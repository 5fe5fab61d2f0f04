"""Efforts of a robot by MuJoCo, Pinocchio and Drake, and a check of closed loops by MuJoCo.

A joint with velocities u in Drake, in the world or the joint's frame, has velocities T u in another
program, with angular velocities in the body. With its rotation R,

    ball             T = Rᵀ               u = ω
    free, MuJoCo     T = [0 1; Rᵀ 0] B    B u = (ω, v); theirs are (v, ω) with ω in the body
    free, Pinocchio  T = [0 Rᵀ; Rᵀ 0] B   both in the body, so that v̇ is reduced by ω × v

and efforts are Tᵀ times theirs. A free base has u = (ṗ, rates of yaw, pitch and roll).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from types import ModuleType
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, MultibodyForces

from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.logs.motion import Motion
from geodrake.model.simulation.terms import Model
from geodrake.robot.arrangement import base_joints, moving_joints
from geodrake.robot.coordinates import RobotCoordinates
from geodrake.robot.files import read_description
from geodrake.robot.files.description import drake_errors, drake_messages
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.mjcf_source import load_mujoco, quiet_mujoco
from geodrake.robot.files.texts import ModelText
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import numbered_text, parse_xml_bytes
from geodrake.robot.joints import scoped, single_joints
from geodrake.robot.plant import arrange_as
from geodrake.robot.transmission import times

_APART = 1e-4  # tolerated gap of closed loops, relative to their size
BUG = "This is a bug in geodrake; please report it with the file."

_ENDS = ("parent", "child")

Units = Sequence[tuple[Joint, ...]]
"""Moving joints, the six of a free base as one."""

Places = Mapping[str, float]
"""Fixed joint -> its position, rad or m."""


@dataclass(frozen=True, eq=False)
class OtherProgram:
    """Another program with its model of a file."""

    by: str
    units: Units  # the plant's joints in this program
    # Default positions, velocities and accelerations in this program, with fixed joints.
    rest: tuple[Array, Array, Array]
    # Slices of its positions and velocities for each unit.
    places: Sequence[tuple[slice, slice]]
    # Efforts from its positions, velocities and accelerations.
    inverse_dynamics: Callable[[Array, Array, Array], Array]
    # Velocities of a free body are in its axes, and quaternions are x, y, z, w.
    in_body: bool = False

    def state(self, q: Array, v: Array, size: int) -> tuple[Array, Array, Array]:
        """Return the program's positions, T and the bias of accelerations for a joint.

        A joint of the plant has 1 or 3 positions and velocities, a free base 6.
        """
        if size == len(q):
            return q, np.eye(size), np.zeros(size)
        if len(q) == 6:
            rpy = RollPitchYaw(q[:2:-1])
            spin = np.stack(list(map(rpy.CalcAngularVelocityInParentFromRpyDt, np.eye(3))), 1)
            B, bias = np.zeros((6, 6)), np.zeros(6)
            B[:3, :2:-1], B[3:, :3] = spin, np.eye(3)
            unaccelerated = rpy.CalcRpyDDtFromRpyDtAndAngularAccelInParent(v[:2:-1], np.zeros(3))
            bias[:3] = -spin @ unaccelerated
            place, back = rpy.ToQuaternion().wxyz(), rpy.ToRotationMatrix().matrix().T
            T, extra = np.zeros((6, 6)), np.zeros(6)
            T[:3, 3:], T[3:, :3] = np.eye(3), back
            if self.in_body:
                angular, linear = (back @ each for each in np.split(B @ v, 2))
                place, T[:3, 3:], extra[:3] = np.roll(place, -1), back, -np.cross(angular, linear)
            return np.concatenate([q[:3], place]), T @ B, T @ bias + extra
        if len(q) == 3:
            rpy = RollPitchYaw(q)
            turned = rpy.ToQuaternion().wxyz()
            return turned, rpy.ToRotationMatrix().matrix().T, np.zeros(3)
        return np.array([np.cos(q[0]), np.sin(q[0])]), np.eye(1), np.zeros(1)

    def efforts(self, q: Array, v: Array, vd: Array) -> Array:
        """Return the plant's efforts (N, nv) for its motion (N, ·)."""
        result = np.zeros_like(v)
        for k in range(len(q)):
            position, rate, acceleration = (x.copy() for x in self.rest)
            maps = []
            for unit, (at_q, at_v) in zip(self.units, self.places, strict=True):
                positions, velocities = part(unit)
                value, T, bias = self.state(q[k, positions], v[k, velocities], len(position[at_q]))
                position[at_q] = value
                rate[at_v], acceleration[at_v] = T @ v[k, velocities], T @ vd[k, velocities] + bias
                maps.append((velocities, at_v, T))
            effort = self.inverse_dynamics(position, rate, acceleration)
            for velocities, at_v, T in maps:
                result[k, velocities] = T.T @ effort[at_v]
        return result

    def efforts_of(
        self, coordinates: RobotCoordinates, states: tuple[Array, Array, Array]
    ) -> Array:
        """Return efforts (N, nv) for a robot's motion (N, ·), in its own coordinates."""
        *samples, J = coordinates.tree_samples(*states)
        return times(np.swapaxes(J, 1, 2), self.efforts(*samples))


def part(unit: tuple[Joint, ...]) -> tuple[slice, slice]:
    """Return the slices of joints in the positions and velocities of a plant."""
    first, last = unit[0], unit[-1]
    return (
        slice(first.position_start(), last.position_start() + last.num_positions()),
        slice(first.velocity_start(), last.velocity_start() + last.num_velocities()),
    )


def by_mujoco(theirs: Any, held: Places, units: Units) -> OtherProgram | str:
    """Return MuJoCo with a compiled model without constraints, or the reason it is unsuitable."""
    mujoco = load_mujoco()
    theirs.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    sizes = {0: (7, 6), 1: (4, 3)}  # of free joints and balls
    data, numbers = mujoco.MjData(theirs), {theirs.joint(k).name: k for k in range(theirs.njnt)}
    if not held.keys() <= numbers.keys():
        return "MuJoCo has other joints"
    for name, place in held.items():
        data.joint(name).qpos = place
    places = []
    for *others, joint in units:
        index = numbers.get(joint.name(), -1)
        if others:
            body = theirs.body(joint.child_body().name())
            index = int(body.jntadr[0]) if body.jntnum[0] == 1 else -1
        if index < 0 or joint.num_positions() not in (1, 3):
            return "MuJoCo has other joints"
        nq, nv = sizes.get(int(theirs.jnt_type[index]), (1, 1))
        if nv != len(others) + joint.num_velocities():
            return "MuJoCo has other joints"
        start, first = int(theirs.jnt_qposadr[index]), int(theirs.jnt_dofadr[index])
        places.append((slice(start, start + nq), slice(first, first + nv)))

    def inverse_dynamics(q: Array, v: Array, vd: Array) -> Array:
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, vd
        with quiet_mujoco():
            mujoco.mj_inverse(theirs, data)
        return np.array(data.qfrc_inverse)

    rest = (np.array(data.qpos), *np.zeros((2, theirs.nv)))
    by = f"MuJoCo {mujoco.__version__}"
    return OtherProgram(by, units, rest, places, inverse_dynamics)


def with_mujoco(
    model: Model, theirs: Any, held: Places, states: tuple[Array, Array, Array]
) -> tuple[str, Array, Array] | str:
    """Return MuJoCo's name, its efforts (N, nv) and the model's, or the reason it is unsuitable.

    Dry friction is excluded.
    """
    program = by_mujoco(theirs, held, joint_units(model.plant))
    if isinstance(program, str):
        return program
    smooth = [f for f in model.effects if not f.effect.jumps]
    ours = replace(model, effects=tuple(smooth)).effort(Motion(*states))
    return program.by, program.efforts_of(model.coordinates, states), ours


def joint_units(plant: MultibodyPlant) -> list[tuple[Joint, ...]]:
    """Return the moving joints, the six of a free base as one."""
    bases = base_joints(plant)
    names = {joint.name() for base in bases for joint in base}
    others = [(joint,) for joint in moving_joints(plant) if joint.name() not in names]
    return [*others, *bases]


def check_loops(text: MjcfText, plant: MultibodyPlant, held: Places, q: Array, v: Array) -> None:
    """Raise if closed loops differ from MuJoCo's constraints in the same MJCF.

    Positions (N, nq) and velocities (N, nv) are those of the plant.
    """
    m = text.compiled
    data, names = load_mujoco().MjData(m), {m.joint(index).name for index in range(m.njnt)}
    joints = [joint for joint in single_joints(plant) if joint.name() in names]
    for index in range(m.neq):
        data.eq_active[index] = index in text.closing
    closing = list(text.closing)
    places = np.concatenate([m.body_pos.ravel(), m.eq_data[closing, :6].ravel()])
    size = float(np.abs(places).max(initial=1e-3))
    equality = int(load_mujoco().mjtConstraint.mjCNSTR_EQUALITY)
    for name, place in held.items():
        data.joint(name).qpos = place
    for k in range(len(q) if closing else 0):
        for joint in joints:
            data.joint(joint.name()).qpos = q[k, joint.position_start()]
            data.joint(joint.name()).qvel = v[k, joint.velocity_start()]
        with quiet_mujoco():
            load_mujoco().mj_forward(m, data)
        is_equality = np.array(data.efc_type) == equality
        gaps = np.concatenate([data.efc_pos[is_equality], data.efc_vel[is_equality]])
        if not np.abs(gaps).max(initial=0.0) <= _APART * size:
            raise ModelError(
                f"{text.path}: geodrake closes its loops differently from MuJoCo: the gap is "
                f"up to {np.abs(gaps).max():.3g} m or rad.",
                advice=BUG,
            )


def pinocchio_or_none() -> ModuleType | None:
    """Return Pinocchio, where it is installed."""
    try:
        import pinocchio
    except ImportError:
        return None
    return pinocchio if hasattr(pinocchio, "buildModelFromXML") else None


def by_pinocchio(model: Model, text: ModelText, held: Places, units: Units) -> OtherProgram | str:
    """Return Pinocchio with the URDF of a model, or the reason it is unsuitable."""
    pinocchio = pinocchio_or_none()
    if pinocchio is None:
        return 'Pinocchio, which reads URDF, is not installed: pip install "geodrake[export]"'
    try:
        theirs = _read_by_pinocchio(pinocchio, model, text)
    except ModelError:
        raise
    except Exception as error:  # an extension module may raise any type
        return f"Pinocchio cannot read the file: {' '.join(str(error).split())[:200].rstrip('.')}"
    names = ["root_joint" if len(unit) > 1 else unit[-1].name() for unit in units]
    counts = [len(unit) - 1 + unit[-1].num_velocities() for unit in units]
    named = dict(zip(names, counts, strict=True))
    known = [name for name in (*named, *held) if theirs.existJointName(name)]
    joints = {name: theirs.joints[theirs.getJointId(name)] for name in known}
    sizes = {**dict.fromkeys(held, 1), **named}
    if any(name not in joints or joints[name].nv != nv or nv == 3 for name, nv in sizes.items()):
        return "Pinocchio has other joints"
    places = {
        name: (slice(j.idx_q, j.idx_q + j.nq), slice(j.idx_v, j.idx_v + j.nv))
        for name, j in joints.items()
    }
    data = theirs.createData()
    position = pinocchio.neutral(theirs)
    for name, place in held.items():
        joint = joints[name]  # joints without limits are represented by cosine and sine
        at = [place] if joint.nq == 1 else [np.cos(place), np.sin(place)]
        position[joint.idx_q : joint.idx_q + joint.nq] = at
    return OtherProgram(
        f"Pinocchio {pinocchio.__version__}",
        units,
        (position, *np.zeros((2, theirs.nv))),
        [places[name] for name in names],
        lambda q, v, vd: pinocchio.rnea(theirs, data, q, v, vd),
        in_body=True,
    )


def by_drake(model: Model) -> OtherProgram | str:
    """Return Drake with the original file, without geodrake's simplifications."""
    plant, units = MultibodyPlant(time_step=0.0), [(j,) for j in moving_joints(model.plant)]
    try:
        with drake_messages(), drake_errors(model.path):
            read_description(model.path, model.given).add_to(plant, simplified=False)
            arrange_as(plant, model.plant)
            for index in plant.GetJointActuatorIndices():
                plant.get_mutable_joint_actuator(index).set_default_rotor_inertia(0.0)
            plant.mutable_gravity_field().set_gravity_vector(model.tree.gravity)
            plant.Finalize()
    except ModelError as error:
        return error.problem.rstrip(".")
    context, joints = plant.CreateDefaultContext(), {scoped(j): j for j in moving_joints(plant)}
    if {scoped(joint) for (joint,) in units} != joints.keys():
        return "Drake has other joints in the original file"

    def inverse_dynamics(q: Array, v: Array, vd: Array) -> Array:
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        effort = plant.CalcInverseDynamics(context, vd, MultibodyForces(plant))
        return np.asarray(effort - plant.CalcGravityGeneralizedForces(context))

    return OtherProgram(
        f"Drake {version('drake')} with the original file",
        units,
        (plant.GetPositions(context), *np.zeros((2, plant.num_velocities()))),
        [part((joints[scoped(joint)],)) for (joint,) in units],
        inverse_dynamics,
    )


def _read_by_pinocchio(pinocchio: ModuleType, model: Model, text: ModelText) -> Any:
    """Return Pinocchio's model of a file, with gravity in the root's axes."""
    plant, data = model.plant, read_expanded(text.path, model.given)
    xml = parse_xml_bytes(data, text.path)
    if b"<!ENTITY" in data:  # Pinocchio's parser does not expand entities
        data = numbered_text(xml)[0].encode()
    scope, name = _root_of(xml, text).rsplit("::", 1)
    root, R = plant.world_body(), RotationMatrix()
    if name != "world":
        root = plant.GetBodyByName(name, plant.GetModelInstanceByName(scope))
    floats = any(base[-1].child_body().index() == root.index() for base in base_joints(plant))
    free = [pinocchio.JointModelFreeFlyer()] if floats else []
    if not floats:
        R = root.body_frame().CalcPoseInWorld(plant.CreateDefaultContext()).rotation()
    theirs = pinocchio.buildModelFromXML(data.decode(errors="replace"), *free)
    theirs.gravity.linear = R.inverse() @ np.array(model.tree.gravity)
    return theirs


def _root_of(xml: Element, text: ModelText) -> str:
    """Return the scoped name of the root link of a file."""
    links = [link.get("name", "") for link in xml.findall("link")]
    ends = {kind: [e.get("link", "") for e in xml.findall(f"joint/{kind}")] for kind in _ENDS}
    if not set(links).issuperset(e for own in ends.values() for e in own):
        raise ValueError("it has joints without their links")
    name = next((link for link in links if link not in ends["child"]), links[0])
    return f"{text.links[0].rpartition('::')[0]}::{name}"
