"""MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np

from geodrake.control.export_proof.drives import Drives
from geodrake.control.export_proof.engines.base import Array, Engine, Mask, order_of
from geodrake.errors import ModelError
from geodrake.model.exporting.joints import ExportedJoint, exported_joints
from geodrake.model.robot_model import RobotModel

_FULL = 1.0 - 1e-9  # share of dry friction from which on it counts as being there in full


class MujocoEngine(Engine):
    """A model of MuJoCo, whose joints feel no limits, contacts and closed loops.

    Efforts of rollouts pass through the actuators of joints, where those are what the model has:
    motors, or servos, late or not. At other joints they are applied as they are, and other
    actuators are without force.

    Raises:
        ModelError: MuJoCo cannot read the file.
    """

    def __init__(self, file: Path, model: RobotModel) -> None:
        self.name = f"MuJoCo {mujoco.__version__}"
        try:
            with self._warning_here():
                self._model = mujoco.MjModel.from_xml_path(str(file))
        except ValueError as error:
            line = " ".join(str(error).split())[:300]
            raise ModelError(f"MuJoCo cannot read {file.name}: {line}") from error
        off = mujoco.mjtDisableBit
        for bit in (
            off.mjDSBL_CONTACT,
            off.mjDSBL_LIMIT,
            off.mjDSBL_EQUALITY,
            off.mjDSBL_CLAMPCTRL,
            off.mjDSBL_ACTUATION,  # but in rollouts
        ):
            self._model.opt.disableflags |= int(bit)
        places = self._places()
        self._at = order_of(model, places.__getitem__, file, self.name)
        self._positions = [self._qpos(at) for at in self._at]
        self._held = {places[n]: value for n, value in model.held.items() if n in places}
        self._friction = self._model.dof_frictionloss[self._at].copy()
        # Older versions have no delays, and one signal for each actuator.
        count = self._model.nu
        self._delays = getattr(self._model, "actuator_delay", np.zeros(count))
        self._signals = getattr(self._model, "actuator_ctrladr", np.arange(count))
        self._through = self._take_actuators(model)
        through = zip(model.joints, self._at, strict=True)
        self.drives = Drives.of(model, [joint for joint, at in through if at in self._through])

    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Inverse dynamics; where dry friction, a soft constraint, is not in full, it is masked."""
        data, found = mujoco.MjData(self._model), np.empty_like(v)
        meant = np.full(v.shape, True)
        for at, value in self._held.items():
            data.qpos[self._qpos(at)] = value
        for k in range(len(v)):
            data.qpos[self._positions], data.qvel[self._at], data.qacc[self._at] = q[k], v[k], vd[k]
            with self._warning_here():
                mujoco.mj_inverse(self._model, data)
            found[k] = data.qfrc_inverse[self._at]
            held = -np.sign(v[k]) * data.qfrc_constraint[self._at]
            meant[k] = held >= _FULL * self._friction
        return found, meant

    def roll_out(self, q: Array, v: Array, effort: Array, step: float) -> Array | None:
        """Positions by MuJoCo's Runge–Kutta integrator; see `Engine.roll_out`."""
        if self._held:
            return None  # nothing holds these joints
        model, off = self._model, mujoco.mjtDisableBit
        before = model.opt.timestep, model.opt.integrator, model.opt.disableflags
        model.opt.timestep, model.opt.integrator = step, int(mujoco.mjtIntegrator.mjINT_RK4)
        model.opt.disableflags |= int(off.mjDSBL_FRICTIONLOSS)
        model.opt.disableflags &= ~int(off.mjDSBL_ACTUATION)
        data = mujoco.MjData(model)
        data.qpos[self._positions], data.qvel[self._at] = q, v
        controls = effort if self.drives is None else self.drives.controls(q, effort)
        self._start_history(data, controls[0])
        found = [q]
        for own in controls:
            for at, value in zip(self._at, own.tolist(), strict=True):
                if (actuator := self._through.get(at)) is None:
                    data.qfrc_applied[at] = value
                else:
                    data.ctrl[self._signals[actuator]] = value
            with self._warning_here():
                mujoco.mj_step(model, data)
            found.append(data.qpos[self._positions].copy())
        model.opt.timestep, model.opt.integrator, model.opt.disableflags = before
        return np.array(found)

    @contextmanager
    def _warning_here(self) -> Iterator[None]:
        """Take MuJoCo's warnings, which it would print, and write into a file where it runs."""
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(self._take_warning)
        try:
            yield
        finally:
            mujoco.set_mju_user_warning(before)

    def _take_warning(self, words: str) -> None:
        self.messages = tuple(dict.fromkeys((*self.messages, words.partition(" Time =")[0])))

    def _start_history(self, data: mujoco.MjData, controls: Array) -> None:
        """Has late actuators be told the first signals all the time before."""
        for at, value in zip(self._at, controls.tolist(), strict=True):
            actuator = self._through.get(at)
            if actuator is not None and self._delays[actuator]:
                count = int(self._model.actuator_history[actuator][0])
                mujoco.mj_initCtrlHistory(self._model, data, actuator, None, np.full(count, value))

    def _take_actuators(self, model: RobotModel) -> dict[int, int]:
        """Degree of freedom -> its actuator, where the model has such a one; others do nothing."""
        own, found = self._model, dict[int, int]()
        joint_of = {int(own.jnt_dofadr[j]): j for j in range(own.njnt)}
        kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        by_joint: dict[int, list[int]] = {}
        for actuator in range(own.nu):
            if own.actuator_trntype[actuator] in kinds:
                by_joint.setdefault(int(own.actuator_trnid[actuator][0]), []).append(actuator)
        wanted = exported_joints(model)
        for joint, at in zip(model.joints, self._at, strict=True):
            actuators = by_joint.get(joint_of[at], [])
            if len(actuators) == 1 and self._is_like(actuators[0], wanted[joint]):
                found[at] = actuators[0]
        for actuator in set(range(own.nu)).difference(found.values()):
            own.actuator_gainprm[actuator], own.actuator_biasprm[actuator] = 0.0, 0.0
        own.actuator_forcelimited[:] = False
        own.jnt_actfrclimited[:] = False
        return found

    def _is_like(self, actuator: int, wanted: ExportedJoint) -> bool:
        """Whether an actuator is told what that of the model is told: an effort, or a position."""
        own = self._model
        plain = (
            own.actuator_dyntype[actuator] == int(mujoco.mjtDyn.mjDYN_NONE)
            and own.actuator_gaintype[actuator] == int(mujoco.mjtGain.mjGAIN_FIXED)
            and own.actuator_gear[actuator][0] == 1.0
        )
        servo = own.actuator_biastype[actuator] == int(mujoco.mjtBias.mjBIAS_AFFINE)
        unlike = not wanted.is_servo and own.actuator_gainprm[actuator][0] != 1.0
        late = bool(self._delays[actuator]) == bool(wanted.delay)
        return bool(plain and servo == wanted.is_servo and not unlike and late)

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
