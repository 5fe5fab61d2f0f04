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
        places = self._places()
        self._at = order_of(model, places.__getitem__, file, self.name)
        self._positions = [self._qpos(at) for at in self._at]
        self._held = {places[n]: value for n, value in model.held.items() if n in places}
        self._friction = self._model.dof_frictionloss[self._at].copy()

    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Inverse dynamics; where dry friction, a soft constraint, is not in full, it is masked."""
        data, found = mujoco.MjData(self._model), np.empty_like(v)
        meant = np.full(v.shape, True)
        for at, value in self._held.items():
            data.qpos[self._qpos(at)] = value
        for k in range(len(v)):
            data.qpos[self._positions], data.qvel[self._at], data.qacc[self._at] = q[k], v[k], vd[k]
            mujoco.mj_inverse(self._model, data)
            found[k] = data.qfrc_inverse[self._at]
            held = -np.sign(v[k]) * data.qfrc_constraint[self._at]
            meant[k] = held >= _FULL * self._friction
        return found, meant

    def roll_out(self, q: Array, v: Array, effort: Array, step: float) -> Array | None:
        """Positions by MuJoCo's Runge–Kutta integrator; see `Engine.roll_out`."""
        if self._held:
            return None  # nothing holds these joints
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

    def _qpos(self, dof: int) -> int:
        """Where the position of a joint of one degree of freedom is, whose velocity is there."""
        joint = [int(each) for each in self._model.jnt_dofadr].index(dof)
        return int(self._model.jnt_qposadr[joint])

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
