"""Inverse dynamics of serial arms by Pinocchio and by MuJoCo, behind one interface.

Nothing here comes from geodrake. Bodies are numbered as the joints that move them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from diagrams.benchmarks.hidden.robots import RobotFile

Array = NDArray[np.float64]
GRAVITY = 9.81


class Engine(ABC):
    """A robot whose bodies and gravity can be changed.

    Attributes:
        joints: Names of the joints.
        low, high: (n,) limits of the positions, rad.
        fastest: (n,) limits of the speeds, rad/s.
    """

    joints: tuple[str, ...]
    low: Array
    high: Array
    fastest: Array

    @abstractmethod
    def bodies(self) -> Array:
        """(n, 4, 4) pseudo-inertias ∫ [x;1][x;1]ᵀ dm in the links' frames."""

    @abstractmethod
    def set_bodies(self, pseudo: Array) -> None:
        """Replaces all bodies by those of (n, 4, 4) pseudo-inertias."""

    @abstractmethod
    def set_gravity(self, gravity: Array) -> None:
        """Sets gravity (3,), m/s²."""

    @abstractmethod
    def efforts(self, q: Array, v: Array, a: Array) -> Array:
        """(N, n) efforts that a motion, (N, n) each, needs."""

    @abstractmethod
    def jacobians(self, body: int, point: Array, q: Array) -> Array:
        """(N, 6, n) Jacobians of a body in the world frame: of a point's velocity, of rotation."""

    @abstractmethod
    def rotations(self, body: int, q: Array) -> Array:
        """(N, 3, 3) orientations of a body in the world."""


class PinocchioEngine(Engine):
    """By Pinocchio."""

    def __init__(self, file: RobotFile) -> None:
        self._model = pin.buildModelFromXML(file.text)
        self._data = self._model.createData()
        self.joints = tuple(self._model.names[1:])
        self.low, self.high = self._model.lowerPositionLimit, self._model.upperPositionLimit
        self.fastest = self._model.velocityLimit

    def bodies(self) -> Array:
        """(n, 4, 4) pseudo-inertias."""
        return np.array([pseudo(b.mass, b.lever, b.inertia) for b in self._model.inertias[1:]])

    def set_bodies(self, pseudo: Array) -> None:
        """Replaces all bodies."""
        for i, P in enumerate(pseudo):
            self._model.inertias[i + 1] = pin.Inertia(*mass_com_inertia(P))

    def set_gravity(self, gravity: Array) -> None:
        """Sets gravity."""
        self._model.gravity.linear = gravity

    def efforts(self, q: Array, v: Array, a: Array) -> Array:
        """(N, n) efforts."""
        samples = zip(q, v, a, strict=True)
        return np.array([pin.rnea(self._model, self._data, *sample) for sample in samples])

    def jacobians(self, body: int, point: Array, q: Array) -> Array:
        """(N, 6, n) Jacobians."""
        found, aligned = np.empty((len(q), 6, q.shape[1])), pin.LOCAL_WORLD_ALIGNED
        for i, at in enumerate(q):
            pin.computeJointJacobians(self._model, self._data, at)
            J = pin.getJointJacobian(self._model, self._data, body + 1, aligned)
            found[i] = J
            found[i, :3] -= pin.skew(self._data.oMi[body + 1].rotation @ point) @ J[3:]
        return found

    def rotations(self, body: int, q: Array) -> Array:
        """(N, 3, 3) orientations."""
        found = np.empty((len(q), 3, 3))
        for i, at in enumerate(q):
            pin.forwardKinematics(self._model, self._data, at)
            found[i] = self._data.oMi[body + 1].rotation
        return found


class MuJoCoEngine(Engine):
    """By MuJoCo."""

    def __init__(self, file: RobotFile) -> None:
        self._model = mujoco.MjModel.from_xml_string(file.text)
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self._data = mujoco.MjData(self._model)
        self.joints = tuple(self._model.joint(i).name for i in range(self._model.njnt))
        self.low, self.high = self._model.jnt_range.T
        # MuJoCo does not read limits of speeds.
        self.fastest = PinocchioEngine(file).fastest

    def bodies(self) -> Array:
        """(n, 4, 4) pseudo-inertias."""
        m, found = self._model, []
        for i in self._model.jnt_bodyid:
            R = np.empty(9)
            mujoco.mju_quat2Mat(R, m.body_iquat[i])
            R = R.reshape(3, 3)
            inertia = R @ np.diag(m.body_inertia[i]) @ R.T
            found.append(pseudo(m.body_mass[i], m.body_ipos[i], inertia))
        return np.array(found)

    def set_bodies(self, pseudo: Array) -> None:
        """Replaces all bodies."""
        for i, P in zip(self._model.jnt_bodyid, pseudo, strict=True):
            mass, com, inertia = mass_com_inertia(P)
            moments, axes = np.linalg.eigh(inertia)
            axes[:, 2] *= np.linalg.det(axes)
            self._model.body_mass[i], self._model.body_ipos[i] = mass, com
            self._model.body_inertia[i] = moments
            mujoco.mju_mat2Quat(self._model.body_iquat[i], axes.ravel())
        # A body frame may have been taken for its principal frame, which it no longer is.
        self._model.body_sameframe[:] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
        self._model.body_simple[:] = 0

    def set_gravity(self, gravity: Array) -> None:
        """Sets gravity."""
        self._model.opt.gravity[:] = gravity

    def efforts(self, q: Array, v: Array, a: Array) -> Array:
        """(N, n) efforts."""
        found, d = np.empty_like(q), self._data
        for i, sample in enumerate(zip(q, v, a, strict=True)):
            d.qpos[:], d.qvel[:], d.qacc[:] = sample
            mujoco.mj_inverse(self._model, d)
            found[i] = d.qfrc_inverse
        return found

    def jacobians(self, body: int, point: Array, q: Array) -> Array:
        """(N, 6, n) Jacobians."""
        found, d = np.empty((len(q), 6, q.shape[1])), self._data
        number = int(self._model.jnt_bodyid[body])
        for i, at in enumerate(q):
            d.qpos[:] = at
            mujoco.mj_kinematics(self._model, d)
            mujoco.mj_comPos(self._model, d)
            world = d.xpos[number] + d.xmat[number].reshape(3, 3) @ point
            mujoco.mj_jac(self._model, d, found[i, :3], found[i, 3:], world, number)
        return found

    def rotations(self, body: int, q: Array) -> Array:
        """(N, 3, 3) orientations."""
        found, number = np.empty((len(q), 3, 3)), int(self._model.jnt_bodyid[body])
        for i, at in enumerate(q):
            self._data.qpos[:] = at
            mujoco.mj_kinematics(self._model, self._data)
            found[i] = self._data.xmat[number].reshape(3, 3)
        return found


def pseudo(mass: float, com: Array, inertia: Array) -> Array:
    """(4, 4) pseudo-inertia of a mass, its centre, and inertia about the centre."""
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    h = mass * np.asarray(com)
    return np.block([[second + np.outer(com, h), h[:, None]], [h[None], np.array([[mass]])]])


def mass_com_inertia(P: Array) -> tuple[float, Array, Array]:
    """Mass, centre (3,), and inertia (3, 3) about the centre of a pseudo-inertia."""
    com = P[:3, 3] / P[3, 3]
    second = P[:3, :3] - P[3, 3] * np.outer(com, com)
    return float(P[3, 3]), com, np.trace(second) * np.eye(3) - second


def make_engine(kind: str, file: RobotFile) -> Engine:
    """An engine "pinocchio" or "mujoco" with the bodies of a model file."""
    return {"pinocchio": PinocchioEngine, "mujoco": MuJoCoEngine}[kind](file)


ENGINES = ("pinocchio", "mujoco")


def congruent(P: Array, distance: float, rng: np.random.Generator) -> Array:
    """Bodies near (n, 4, 4) ones: L exp(S) Lᵀ with P = L Lᵀ and random symmetric S.

    S is isotropic in the affine-invariant metric tr(P⁻¹ dP P⁻¹ dP): a mass changes by a share of
    about `distance`, and so does every second moment.
    """
    S = rng.normal(size=P.shape)
    S = distance * (S + S.transpose(0, 2, 1)) / 2.0
    values, axes = np.linalg.eigh(S)
    change = (axes * np.exp(values)[:, None, :]) @ axes.transpose(0, 2, 1)
    # Thin plates and rods of model files are given a thickness of a thousandth first.
    tiny = 1e-9 * np.trace(P, axis1=1, axis2=2)[:, None, None] * np.eye(4)
    L = np.linalg.cholesky(P + tiny)
    return L @ change @ L.transpose(0, 2, 1)
