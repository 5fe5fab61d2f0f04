"""Model files of arms, and inverse dynamics by Pinocchio and MuJoCo.

Engines use nothing of geodrake. Bodies have the numbers of the joints that move them.
"""

from __future__ import annotations

import atexit
import xml.etree.ElementTree as ET
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from zlib import crc32

import mujoco
import numpy as np
import pinocchio as pin

from diagrams.harness import MODELS
from diagrams.public_data import installed_model
from geodrake import load_model
from geodrake.inertia import Array
from geodrake.model import RobotModel

Generator = np.random.Generator

PENDULUM = "double_pendulum"
OWN = (PENDULUM, "arm6", "arm7")
PUBLIC: Mapping[str, str] = {
    "ur5": "ur_description/urdf/ur5_joint_limited_robot.urdf",
    "panda": "panda_description/urdf/panda.urdf",
}
FURTHER: Mapping[str, str] = {
    "xarm7": "xarm_description/urdf/xarm7.urdf",
    "z1": "z1_description/urdf/z1.urdf",
    "kinova": "kinova_description/robots/kinova.urdf",
    "ur3": "ur_description/urdf/ur3_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
    "so101": "so_arm_description/urdf/so101.urdf",
    "baxter": "baxter_description/urdf/baxter.urdf",
    "tiago": "tiago_description/robots/tiago_no_hand.urdf",
}
"""Public arms that only some studies use."""
_FINGERS = ("jointGripper",)


def number_of(words: str) -> int:
    """Return a number for words, to seed the random numbers of a purpose."""
    return crc32(words.encode())


@dataclass(frozen=True)
class RobotFile:
    """Model file of a serial arm, without meshes, friction and fingers."""

    name: str
    text: str  # the URDF

    def changed(self, name: str, **attributes: Mapping[str, str]) -> RobotFile:
        """Return a file with other attributes of joints: `type` or `effort` -> joint -> value."""
        root = ET.fromstring(self.text)
        for joint in root.iter("joint"):
            for key, values in attributes.items():
                place = joint if key == "type" else joint.find("limit")
                if place is not None and joint.get("name") in values:
                    place.set(key, values[joint.get("name", "")])
        return RobotFile(name, ET.tostring(root, encoding="unicode"))

    def holding(self, name: str, held: Sequence[str]) -> RobotFile:
        """Return a file with some joints fixed."""
        return self.changed(name, type=dict.fromkeys(held, "fixed"))

    @cached_property
    def model(self) -> RobotModel:
        """Geodrake's model of the robot; simulations read the file themselves."""
        path = Path(_folder().name) / f"{self.name}.urdf"
        path.write_text(self.text, encoding="utf-8")
        return load_model(path)


@cache
def _folder() -> TemporaryDirectory[str]:
    folder = TemporaryDirectory()
    atexit.register(folder.cleanup)
    return folder


def robot_names() -> tuple[str, ...]:
    """Return the names of the installed robots."""
    return (*OWN, *(name for name, path in PUBLIC.items() if installed_model(path).is_file()))


def bare(path: Path) -> ET.Element:
    """Return the root of a URDF without shapes and friction."""
    root = ET.parse(path).getroot()
    for link in root.iter("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    for joint in root.iter("joint"):
        for stated in joint.findall("dynamics"):
            joint.remove(stated)
    return root


@cache
def robot_file(name: str) -> RobotFile:
    """Return the model file of a robot.

    Damping and friction of the file are removed, so that all friction is hidden. Fingers are fixed.
    Continuous joints become revolute.
    """
    public = {**PUBLIC, **FURTHER}
    root = bare(installed_model(public[name]) if name in public else MODELS / f"{name}.urdf")
    for joint in root.iter("joint"):
        for stated in joint.findall("mimic"):
            joint.remove(stated)
        if joint.get("type") == "prismatic" or joint.get("name") in _FINGERS:
            joint.set("type", "fixed")
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
    return RobotFile(name, ET.tostring(root, encoding="unicode"))


def robot_model(name: str) -> RobotModel:
    """Return geodrake's model of a robot."""
    return robot_file(name).model


GRAVITY = np.array([0.0, 0.0, -9.81])
Body = tuple[float, Array, Array]
"""Mass, centre (3,), and inertia (3, 3) about the centre."""


class Engine(ABC):
    """A robot with variable bodies and gravity."""

    joints: tuple[str, ...]  # names of the joints
    # low, high: (n,) limits of the positions, rad.
    low: Array
    high: Array
    fastest: Array  # (n,) limits of the speeds, rad/s

    def bodies(self) -> Array:
        """Return the pseudo-inertias (n, 4, 4) ∫ [x;1][x;1]ᵀ dm in the links' frames."""
        return np.array([pseudo(*body) for body in self._bodies()])

    def set_bodies(self, pseudo: Array) -> None:
        """Replace all bodies by those of pseudo-inertias (n, 4, 4)."""
        self._set_bodies([mass_com_inertia(P) for P in pseudo])

    @abstractmethod
    def set_gravity(self, gravity: Array) -> None:
        """Set gravity (3,), m/s²."""

    def efforts(self, q: Array, v: Array, a: Array) -> Array:
        """Return the efforts (N, n) of a motion, (N, n) each."""
        return np.array([self._effort(*sample) for sample in zip(q, v, a, strict=True)])

    def frames(self, body: int, point: Array, q: Array) -> tuple[Array, Array]:
        """Return Jacobians (N, 6, n) and orientations (N, 3, 3) of a body at positions (N, n).

        Jacobians are of the velocity of a point and of the angular velocity, in the world frame.
        """
        jacobians, rotations = zip(*(self._frame(body, at) for at in q), strict=True)
        J, R = np.array(jacobians), np.array(rotations)
        J[:, :3] -= np.cross((R @ point)[:, :, None], J[:, 3:], axis=1)
        return J, R

    @abstractmethod
    def _bodies(self) -> list[Body]: ...

    @abstractmethod
    def _set_bodies(self, bodies: Sequence[Body]) -> None: ...

    @abstractmethod
    def _effort(self, q: Array, v: Array, a: Array) -> Array: ...

    @abstractmethod
    def _frame(self, body: int, q: Array) -> tuple[Array, Array]:
        """Return the Jacobian (6, n) of a body's origin, and its orientation (3, 3)."""


class PinocchioEngine(Engine):
    """Inverse dynamics by Pinocchio."""

    def __init__(self, file: RobotFile) -> None:
        self._model = pin.buildModelFromXML(file.text)
        self._data = self._model.createData()
        self.joints = tuple(self._model.names[1:])
        self.low, self.high = self._model.lowerPositionLimit, self._model.upperPositionLimit
        self.fastest = self._model.velocityLimit

    def set_gravity(self, gravity: Array) -> None:
        """Set gravity."""
        self._model.gravity.linear = gravity

    def _bodies(self) -> list[Body]:
        return [(b.mass, b.lever, b.inertia) for b in self._model.inertias[1:]]

    def _set_bodies(self, bodies: Sequence[Body]) -> None:
        for i, body in enumerate(bodies, 1):
            self._model.inertias[i] = pin.Inertia(*body)

    def _effort(self, q: Array, v: Array, a: Array) -> Array:
        return pin.rnea(self._model, self._data, q, v, a)

    def _frame(self, body: int, q: Array) -> tuple[Array, Array]:
        pin.computeJointJacobians(self._model, self._data, q)
        J = pin.getJointJacobian(self._model, self._data, body + 1, pin.LOCAL_WORLD_ALIGNED)
        return J, self._data.oMi[body + 1].rotation.copy()


class MuJoCoEngine(Engine):
    """Inverse dynamics by MuJoCo."""

    def __init__(self, file: RobotFile) -> None:
        self._model = mujoco.MjModel.from_xml_string(file.text)
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self._data = mujoco.MjData(self._model)
        self.joints = tuple(self._model.joint(i).name for i in range(self._model.njnt))
        self.low, self.high = self._model.jnt_range.T
        # MuJoCo does not read limits of speeds.
        self.fastest = PinocchioEngine(file).fastest

    def set_gravity(self, gravity: Array) -> None:
        """Set gravity."""
        self._model.opt.gravity[:] = gravity

    def _bodies(self) -> list[Body]:
        m, bodies = self._model, []
        for i in m.jnt_bodyid:
            R = np.empty(9)
            mujoco.mju_quat2Mat(R, m.body_iquat[i])
            R = R.reshape(3, 3)
            inertia = R @ np.diag(m.body_inertia[i]) @ R.T
            bodies.append((m.body_mass[i], m.body_ipos[i], inertia))
        return bodies

    def _set_bodies(self, bodies: Sequence[Body]) -> None:
        for i, (mass, com, inertia) in zip(self._model.jnt_bodyid, bodies, strict=True):
            moments, axes = np.linalg.eigh(inertia)
            axes[:, 2] *= np.linalg.det(axes)
            self._model.body_mass[i], self._model.body_ipos[i] = mass, com
            self._model.body_inertia[i] = moments
            mujoco.mju_mat2Quat(self._model.body_iquat[i], axes.ravel())
        # MuJoCo may have identified body frames with principal frames.
        self._model.body_sameframe[:] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
        self._model.body_simple[:] = 0

    def _effort(self, q: Array, v: Array, a: Array) -> Array:
        d = self._data
        d.qpos[:], d.qvel[:], d.qacc[:] = q, v, a
        mujoco.mj_inverse(self._model, d)
        return d.qfrc_inverse.copy()

    def _frame(self, body: int, q: Array) -> tuple[Array, Array]:
        J, number, d = np.empty((6, len(q))), int(self._model.jnt_bodyid[body]), self._data
        d.qpos[:] = q
        mujoco.mj_kinematics(self._model, d)
        mujoco.mj_comPos(self._model, d)
        mujoco.mj_jac(self._model, d, J[:3], J[3:], d.xpos[number], number)
        return J, d.xmat[number].reshape(3, 3).copy()


ENGINES = ("pinocchio", "mujoco")


def make_engine(kind: str, file: RobotFile) -> Engine:
    """Return one of `ENGINES` with the bodies of a model file."""
    return {"pinocchio": PinocchioEngine, "mujoco": MuJoCoEngine}[kind](file)


def pseudo(mass: float, com: Array, inertia: Array) -> Array:
    """Return the pseudo-inertia (4, 4) of a mass, its centre, and inertia about the centre."""
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    h = mass * np.asarray(com)
    return np.block([[second + np.outer(com, h), h[:, None]], [h[None], np.array([[mass]])]])


def mass_com_inertia(P: Array) -> Body:
    """Return the body of a pseudo-inertia (4, 4)."""
    com = P[:3, 3] / P[3, 3]
    second = P[:3, :3] - P[3, 3] * np.outer(com, com)
    return float(P[3, 3]), com, np.trace(second) * np.eye(3) - second


def congruent(P: Array, distance: float, rng: Generator) -> Array:
    """Perturb pseudo-inertias (n, 4, 4): L exp(S) Lᵀ with P = L Lᵀ and random symmetric S.

    S is isotropic in the affine-invariant metric tr(P⁻¹ dP P⁻¹ dP). Masses and second moments
    change by a relative amount of about `distance`.
    """
    S = rng.normal(size=P.shape)
    S = distance * (S + S.transpose(0, 2, 1)) / 2.0
    values, axes = np.linalg.eigh(S)
    change = (axes * np.exp(values)[:, None, :]) @ axes.transpose(0, 2, 1)
    # Thin plates and rods of model files first get a thickness of a thousandth.
    tiny = 1e-9 * np.trace(P, axis1=1, axis2=2)[:, None, None] * np.eye(4)
    L = np.linalg.cholesky(P + tiny)
    return L @ change @ L.transpose(0, 2, 1)
