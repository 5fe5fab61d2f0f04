"""MuJoCo."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from geodrake.control.export_proof.engines.base import Array, Engine, Mask, order_of
from geodrake.errors import ModelError
from geodrake.model.robot_model import RobotModel

_FULL = 1.0 - 1e-9  # share of dry friction from which on it counts as being there in full


class MujocoEngine(Engine):
    """A model of MuJoCo, whose joints feel no limits, contacts, closed loops and actuators.

    Args:
        file: The exported file.
        model: The model, for the names of its joints.

    Raises:
        ModelError: MuJoCo cannot read the file.
    """

    def __init__(self, file: Path, model: RobotModel) -> None:
        self.name = f"MuJoCo {mujoco.__version__}"
        try:
            self._model = mujoco.MjModel.from_xml_path(str(file))
        except ValueError as error:
            line = " ".join(str(error).split())[:300]
            raise ModelError(f"MuJoCo cannot read {file.name}: {line}") from error
        off = mujoco.mjtDisableBit
        for bit in (
            off.mjDSBL_CONTACT,
            off.mjDSBL_LIMIT,
            off.mjDSBL_EQUALITY,
            off.mjDSBL_ACTUATION,
        ):
            self._model.opt.disableflags |= int(bit)
        self._at = order_of(model, self._places().__getitem__, file, self.name)
        joints = {int(d): j for j, d in enumerate(self._model.jnt_dofadr)}
        self._positions = [int(self._model.jnt_qposadr[joints[at]]) for at in self._at]
        self._friction = self._model.dof_frictionloss[self._at].copy()

    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Inverse dynamics; where dry friction, a soft constraint, is not in full, it is masked."""
        data, found = mujoco.MjData(self._model), np.empty_like(v)
        meant = np.full(v.shape, True)
        for k in range(len(v)):
            data.qpos[self._positions], data.qvel[self._at], data.qacc[self._at] = q[k], v[k], vd[k]
            mujoco.mj_inverse(self._model, data)
            found[k] = data.qfrc_inverse[self._at]
            held = -np.sign(v[k]) * data.qfrc_constraint[self._at]
            meant[k] = held >= _FULL * self._friction
        return found, meant

    def roll_out(self, q: Array, v: Array, effort: Array, step: float) -> Array:
        """Positions by MuJoCo's Runge–Kutta integrator; see `Engine.roll_out`."""
        model, data = self._model, mujoco.MjData(self._model)
        before = model.opt.timestep, model.opt.integrator, model.opt.disableflags
        model.opt.timestep, model.opt.integrator = step, int(mujoco.mjtIntegrator.mjINT_RK4)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)
        data.qpos[self._positions], data.qvel[self._at] = q, v
        found = [q]
        for own in effort:
            data.qfrc_applied[self._at] = own
            mujoco.mj_step(model, data)
            found.append(data.qpos[self._positions].copy())
        model.opt.timestep, model.opt.integrator, model.opt.disableflags = before
        return np.array(found)

    def _places(self) -> dict[str, int]:
        """Joints of one degree of freedom by name, nameless ones as geodrake calls them."""
        model, found = self._model, {}
        single = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        for j in range(model.njnt):
            if model.jnt_type[j] in single:
                body = int(model.jnt_bodyid[j])
                own = model.body(body).name or f"body_{body - 1}"
                name = model.joint(j).name or f"{own}_joint_{j - int(model.body_jntadr[body])}"
                found[name] = int(model.jnt_dofadr[j])
        return found
