"""A second opinion on a model's file: MuJoCo or Pinocchio, which read the file itself.

MultibodyPlant computes with the bodies that geodrake made of a file, and so cannot see what was
lost on the way. MuJoCo compiles an MJCF whole, with what no model takes; Pinocchio reads a URDF.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import Joint

from geodrake.errors import ModelError
from geodrake.inertia import inertial_parameters
from geodrake.logs.motion import Motion
from geodrake.model.file_terms import DryFriction
from geodrake.model.robot_model import RobotModel, is_of_file
from geodrake.robot.files import read_description
from geodrake.robot.files.base import ModelText
from geodrake.robot.files.description import drake_messages
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.mjcf_source import mujoco_or_none, quiet_mujoco
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import parse_xml_bytes
from geodrake.robot.holding import moving_joints
from geodrake.robot.regressor import inverse_dynamics
from geodrake.robot.transmission.base import times

Array = NDArray[np.float64]
_ENDS = ("parent", "child")
Places = Mapping[str, float]
"""Joint -> where it is held, rad or m."""

Efforts = Callable[[Array, Array, Array], Array]
"""Efforts (N, nv of the plant) of its positions, velocities and accelerations, (N, ·) each."""


@dataclass(frozen=True, eq=False)
class SecondOpinion:
    """What another program makes of a model's file.

    Attributes:
        by: The program.
        efforts: (N, nv) by it.
        ours: (N, nv) by geodrake, of what that program takes: all of the file for MuJoCo, but dry
            friction; the bodies alone for Pinocchio.
    """

    by: str
    efforts: Array
    ours: Array


def second_opinion(
    model: RobotModel,
    states: tuple[Array, Array, Array],
    plant_states: tuple[Array, Array, Array],
    jacobians: Array,
) -> SecondOpinion | str:
    """Return what MuJoCo or Pinocchio makes of the file of a model; otherwise why there is none.

    Args:
        model: The model.
        states: (N, nq), (N, nv), (N, nv) positions, velocities and accelerations of the model.
        plant_states: The same of its plant.
        jacobians: (N, nv of the plant, nv) rates of the plant's positions by the model's.
    """
    if model.path.suffix.lower() in (".yaml", ".yml") or model.given.robot is not None:
        return "no program but Drake reads the model's file"
    joints = moving_joints(model.plant)
    if any(joint.num_velocities() != 1 or joint.num_positions() != 1 for joint in joints):
        return "the model has joints of several degrees of freedom"
    try:
        with drake_messages():
            (text, *_) = read_description(model.path, model.given).texts
        own = isinstance(text, MjcfText) and not is_of_file(model)
    except ModelError as error:
        return f"the model's file cannot be read again: {error.problem.rstrip('.')}"
    bodies_differ = not np.array_equal(model.total_phi, inertial_parameters(model.plant))
    if own or bodies_differ or model.fitted_to:
        return "the model is no longer that of its file"
    found: tuple[str, Efforts] | str = "no program but Drake reads SDF"
    ours = inverse_dynamics(model.tree, *states, model.total_phi)
    if isinstance(text, MjcfText):
        found = _by_mujoco(text, _held(model, text), joints)
        motion = Motion(*states)
        still = [f for f in model.effects if not isinstance(f.effect, DryFriction)]
        ours = replace(model, effects=tuple(still)).effort(motion)
    elif text.kind == "urdf":
        found = _by_pinocchio(model, _held(model, text), joints)
    if isinstance(found, str):
        return found
    by, efforts = found
    return SecondOpinion(by, times(np.swapaxes(jacobians, 1, 2), efforts(*plant_states)), ours)


def _held(model: RobotModel, text: ModelText) -> Places:
    """Return where joints are held, those included that follow held ones."""
    places = dict(model.held)
    followers = [(f, f.joint.split("::")[-1], f.leader.split("::")[-1]) for f in text.followers]
    for _ in followers:  # which may follow each other
        for follower, joint, leader in followers:
            if leader in places:
                places.setdefault(joint, follower.ratio * places[leader] + follower.offset)
    return places


def _by_mujoco(text: MjcfText, held: Places, joints: list[Joint]) -> tuple[str, Efforts] | str:
    mujoco = mujoco_or_none()
    if mujoco is None or text.compiled is None:
        return 'MuJoCo, which defines MJCF, is not installed: pip install "geodrake[mjcf]"'
    theirs = text.compiled
    theirs.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    numbers = {
        joint: mujoco.mj_name2id(theirs, mujoco.mjtObj.mjOBJ_JOINT, joint)
        for joint in (*held, *(joint.name() for joint in joints))
    }
    if min(numbers.values()) < 0:
        return "MuJoCo has other joints"

    def efforts(q: Array, v: Array, vd: Array) -> Array:
        data, found = mujoco.MjData(theirs), np.zeros_like(v)
        for name, place in held.items():
            data.qpos[theirs.jnt_qposadr[numbers[name]]] = place
        at = [numbers[joint.name()] for joint in joints]
        positions, dofs = theirs.jnt_qposadr[at], theirs.jnt_dofadr[at]
        q_at = [joint.position_start() for joint in joints]
        v_at = [joint.velocity_start() for joint in joints]
        with quiet_mujoco(mujoco):
            for k in range(len(q)):
                data.qpos[positions], data.qvel[dofs] = q[k, q_at], v[k, v_at]
                data.qacc[dofs] = vd[k, v_at]
                mujoco.mj_inverse(theirs, data)
                found[k, v_at] = data.qfrc_inverse[dofs]
        return found

    return f"MuJoCo {mujoco.__version__}", efforts


def pinocchio_or_none() -> ModuleType | None:
    """Return Pinocchio, where it is installed."""
    try:
        import pinocchio
    except ImportError:
        return None
    return pinocchio if hasattr(pinocchio, "buildModelFromXML") else None


def _by_pinocchio(
    model: RobotModel, held: Places, joints: list[Joint]
) -> tuple[str, Efforts] | str:
    pinocchio = pinocchio_or_none()
    if pinocchio is None:
        return 'Pinocchio, which reads URDF, is not installed: pip install "geodrake[proof]"'
    try:
        data = read_expanded(model.path, model.given)
        root = parse_xml_bytes(data, model.path)
        links = {link.get("name") for link in root.findall("link")}
        ends = [end for joint in root.findall("joint") for end in joint if end.tag in _ENDS]
        if not links.issuperset(end.get("link") for end in ends):
            return "Pinocchio does not read a file whose joints have links that it lacks"
        theirs = pinocchio.buildModelFromXML(data.decode(errors="replace"))
    except ModelError:
        raise
    except Exception as error:  # of any kind, by an extension module
        return f"Pinocchio does not read the file: {' '.join(str(error).split())[:200]}"
    theirs.gravity.linear = np.array(model.tree.gravity)
    names = [*held, *(joint.name() for joint in joints)]
    if not all(theirs.existJointName(name) for name in names):
        return "Pinocchio has other joints"
    own = {name: theirs.joints[theirs.getJointId(name)] for name in names}
    if any(joint.nv != 1 for joint in own.values()):
        return "Pinocchio has other joints"

    def efforts(q: Array, v: Array, vd: Array) -> Array:
        data, found = theirs.createData(), np.zeros_like(v)
        position = pinocchio.neutral(theirs)
        rates, accelerations = np.zeros((2, theirs.nv))
        for name, place in held.items():
            _put(position, own[name], place)
        for k in range(len(q)):
            for joint in joints:
                there, at = own[joint.name()], joint.velocity_start()
                _put(position, there, q[k, joint.position_start()])
                rates[there.idx_v], accelerations[there.idx_v] = v[k, at], vd[k, at]
            effort = pinocchio.rnea(theirs, data, position, rates, accelerations)
            for joint in joints:
                found[k, joint.velocity_start()] = effort[own[joint.name()].idx_v]
        return found

    return f"Pinocchio {pinocchio.__version__}", efforts


def _put(position: Array, joint: Any, place: float) -> None:
    """Set the position of a joint; one without limits has its cosine and sine."""
    at = joint.idx_q
    position[at : at + joint.nq] = [place] if joint.nq == 1 else [np.cos(place), np.sin(place)]
