"""Simulators that load exported models with their own parsers.

Optional packages are imported on demand.
"""

from __future__ import annotations

import abc
import platform
import runpy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder

from geodrake.boundary.input_files import read_regular
from geodrake.control.export_proof.joints import POSITIVE_TERMS, ExportedJoint, exported_joints
from geodrake.control.export_proof.reference import Drives
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.model.dynamics_check import second_opinion
from geodrake.model.robot_model import RobotModel, load_description
from geodrake.robot.files.description import drake_errors, drake_messages
from geodrake.robot.files.includes import add_packages, named_packages
from geodrake.robot.files.mjcf_source import quiet_mujoco
from geodrake.robot.joints import joint_names
from geodrake.robot.plant import weld_roots

Mask = NDArray[np.bool_]


class Engine(abc.ABC):
    """A simulator with a robot loaded from a file.

    Joints are those of the model, with one position and velocity each, or those of its plant.
    """

    package: ClassVar[str]  # required package
    ignores: tuple[str, ...] = ()  # properties of joints in the file that it does not simulate
    of_plant: ClassVar[bool] = False  # whether joints are those of the plant, including followers
    name: str
    drives: Drives | None = None  # actuators through which efforts of rollouts are applied
    messages: tuple[str, ...] = ()  # warnings

    @abc.abstractmethod
    def __init__(self, file: Path, model: RobotModel) -> None:
        """Load a file of a model."""

    @abc.abstractmethod
    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Return the efforts (N, nv) of a motion, and which are comparable to the model's."""

    def roll_out(self, q: Array, v: Array, effort: Array, step: float) -> Array | None:
        """Simulate without dry friction and return positions (K + 1, nv); None if not supported.

        Args:
            effort: (K, nv) efforts, N·m or N, each held for a step; actuators get their
                `Drives.controls`.
            step: Time step, s.
        """
        return None


def order_of(joints: Sequence[str], places: Mapping[str, int], file: Path, name: str) -> list[int]:
    """Return the simulator's index of each joint; raise if one is missing."""
    if missing := [joint for joint in joints if joint not in places]:
        raise ModelError(f"{name} has no joint {missing[0]!r} in {file.name}.")
    return [places[joint] for joint in joints]


class DrakeEngine(Engine):
    """A continuous-time plant, which does not simulate dry friction of joints."""

    package = "pydrake"
    of_plant = True
    ignores: tuple[str, ...] = ("friction",)

    def __init__(self, file: Path, model: RobotModel) -> None:
        self.name = f"Drake {version('drake')}"
        builder = DiagramBuilder()
        self._plant = builder.AddSystem(MultibodyPlant(time_step=0.0))
        parser = Parser(self._plant)
        text = read_regular(file, "model file", ModelError).decode(errors="replace")
        parser.package_map().PopulateFromFolder(str(file.parent))
        with drake_messages() as messages, drake_errors(file):
            add_packages(parser.package_map(), model.path, named_packages(text))
            parser.AddModels(str(file))
            weld_roots(self._plant)
            gravity = model.plant.gravity_field().gravity_vector()
            self._plant.mutable_gravity_field().set_gravity_vector(gravity)
            self._plant.Finalize()
            self._diagram = builder.Build()
        if self._plant.num_force_elements() == 1:  # gravity
            self.ignores = ("friction", "stiffness")  # a URDF's springs may be for Gazebo only
        warnings = (message.partition("\n")[0].rpartition("warning: ")[2] for message in messages)
        self.messages = tuple(dict.fromkeys(warnings))
        plant, names = self._plant, joint_names(self._plant)
        places = {name: k for k, name in enumerate(names)}
        self._at = order_of(joint_names(model.plant), places, file, self.name)
        joints = (plant.get_joint(index) for index in plant.GetJointIndices())
        starts = {j.velocity_start(): j.position_start() for j in joints if j.num_velocities() == 1}
        self._positions = [starts[at] for at in self._at]
        held = ((starts[k], model.held[n]) for k, n in enumerate(names) if n in model.held)
        self._held = dict(held)

    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Return inverse dynamics with damping, rotors, springs and gravity."""
        plant = self._plant
        context = plant.CreateDefaultContext()
        forces = MultibodyForces(plant)
        effort = np.empty_like(v)
        for k in range(len(v)):
            self._set(context, q[k], v[k])
            plant.CalcForceElementsContribution(context, forces)
            effort[k] = plant.CalcInverseDynamics(context, self._spread(vd[k]), forces)[self._at]
        return effort, np.full(v.shape, True)

    def roll_out(self, q: Array, v: Array, effort: Array, step: float) -> Array | None:
        """Return positions by a fifth-order integrator with fixed steps."""
        if self._held:
            return None  # fixed joints would move
        simulator = Simulator(self._diagram)
        ResetIntegratorFromFlags(simulator, "runge_kutta5", step)
        integrator = simulator.get_mutable_integrator()
        integrator.set_fixed_step_mode(True)
        context = self._plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        self._set(context, q, v)
        port = self._plant.get_applied_generalized_force_input_port()
        if self._plant.num_actuators():
            self._plant.get_actuation_input_port().FixValue(
                context, np.zeros(self._plant.num_actuators())
            )
        fixed = port.FixValue(context, self._spread(effort[0]))
        simulator.Initialize()
        positions = [q]
        for k, applied in enumerate(effort):
            fixed.GetMutableData().set_value(self._spread(applied))
            simulator.AdvanceTo((k + 1) * step)
            positions.append(self._plant.GetPositions(context)[self._positions])
        return np.array(positions)

    def _set(self, context: object, q: Array, v: Array) -> None:
        positions = np.zeros(self._plant.num_positions())
        positions[self._positions] = q
        positions[[*self._held]] = [*self._held.values()]
        self._plant.SetPositions(context, positions)
        self._plant.SetVelocities(context, self._spread(v))

    def _spread(self, values: Array) -> Array:
        """Return values of the model's joints in Drake's order of velocities."""
        spread = np.zeros(self._plant.num_velocities())
        spread[self._at] = values
        return spread


_FULL = 1.0 - 1e-9  # fraction of dry friction above which it is fully developed


class MujocoEngine(Engine):
    """A MuJoCo model without joint limits, contacts and closed loops.

    In rollouts, efforts are applied through actuators that correspond to those of the model: motors
    or servos, with or without delays. At other joints they are applied directly, and other
    actuators are disabled.
    """

    package = "mujoco"
    of_plant = True

    def __init__(self, file: Path, model: RobotModel) -> None:
        self._mj = mujoco = import_module("mujoco")
        self.name = f"MuJoCo {mujoco.__version__}"
        try:
            with self._collecting_warnings():
                self._model = mujoco.MjModel.from_xml_path(str(file))
        except ValueError as error:
            line = " ".join(str(error).split())[:300]
            raise ModelError(f"MuJoCo cannot read {file.name}: {line}") from error
        bits = mujoco.mjtDisableBit
        for bit in (
            bits.mjDSBL_CONTACT,
            bits.mjDSBL_LIMIT,
            bits.mjDSBL_EQUALITY,
            bits.mjDSBL_CLAMPCTRL,
            bits.mjDSBL_ACTUATION,  # except in rollouts
        ):
            self._model.opt.disableflags |= int(bit)
        places = self._places()
        joints = joint_names(model.plant)
        ids = order_of(joints, places, file, self.name)
        addresses = self._model.jnt_qposadr
        self._at, self._positions = self._model.jnt_dofadr[ids].tolist(), addresses[ids].tolist()
        self._held = {int(addresses[places[n]]): x for n, x in model.held.items() if n in places}
        self._friction = self._model.dof_frictionloss[self._at].copy()
        # Older versions have no delays, and one signal per actuator.
        count = len(self._model.actuator_trntype)
        self._delays = getattr(self._model, "actuator_delay", np.zeros(count))
        self._signals = getattr(self._model, "actuator_ctrladr", np.arange(count))
        self._actuators = self._matching_actuators(model, joints, ids)
        pairs = zip(joints, self._at, strict=True)
        self.drives = Drives.of(model, [joint for joint, dof in pairs if dof in self._actuators])

    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Return inverse dynamics, comparable where dry friction is fully developed.

        MuJoCo's dry friction is a soft constraint.
        """
        data, effort = self._mj.MjData(self._model), np.empty_like(v)
        is_comparable = np.full(v.shape, True)
        data.qpos[[*self._held]] = [*self._held.values()]
        for k in range(len(v)):
            data.qpos[self._positions], data.qvel[self._at], data.qacc[self._at] = q[k], v[k], vd[k]
            with self._collecting_warnings():
                self._mj.mj_inverse(self._model, data)
            effort[k] = data.qfrc_inverse[self._at]
            friction = -np.sign(v[k]) * data.qfrc_constraint[self._at]
            is_comparable[k] = friction >= _FULL * self._friction
        return effort, is_comparable

    def roll_out(self, q: Array, v: Array, effort: Array, step: float) -> Array | None:
        """Return positions by MuJoCo's Runge–Kutta integrator."""
        if self._held:
            return None  # fixed joints would move
        model, bits = self._model, self._mj.mjtDisableBit
        options = model.opt.timestep, model.opt.integrator, model.opt.disableflags
        model.opt.timestep, model.opt.integrator = step, int(self._mj.mjtIntegrator.mjINT_RK4)
        model.opt.disableflags |= int(bits.mjDSBL_FRICTIONLOSS)
        model.opt.disableflags &= ~int(bits.mjDSBL_ACTUATION)
        data = self._mj.MjData(model)
        data.qpos[self._positions], data.qvel[self._at] = q, v
        controls = effort if self.drives is None else self.drives.controls(q, effort)
        self._start_history(data, controls[0])
        positions = [q]
        for signals in controls:
            for dof, value in zip(self._at, signals.tolist(), strict=True):
                if (actuator := self._actuators.get(dof)) is None:
                    data.qfrc_applied[dof] = value
                else:
                    data.ctrl[self._signals[actuator]] = value
            with self._collecting_warnings():
                self._mj.mj_step(model, data)
            positions.append(data.qpos[self._positions].copy())
        model.opt.timestep, model.opt.integrator, model.opt.disableflags = options
        return np.array(positions)

    @contextmanager
    def _collecting_warnings(self) -> Iterator[None]:
        """Collect MuJoCo's warnings in `messages`."""
        with quiet_mujoco() as warnings:
            yield
        texts = (warning.partition(" Time =")[0] for warning in warnings)
        self.messages = tuple(dict.fromkeys((*self.messages, *texts)))

    def _start_history(self, data: Any, controls: Array) -> None:
        """Fill the buffers of delayed actuators with the first signals."""
        for dof, value in zip(self._at, controls.tolist(), strict=True):
            actuator = self._actuators.get(dof)
            if actuator is not None and self._delays[actuator]:
                count = int(self._model.actuator_history[actuator][0])
                self._mj.mj_initCtrlHistory(
                    self._model, data, actuator, None, np.full(count, value)
                )

    def _matching_actuators(
        self, model: RobotModel, joints: Sequence[str], ids: Sequence[int]
    ) -> dict[int, int]:
        """Return degree of freedom -> matching actuator, and disable other actuators."""
        mj_model, matching = self._model, dict[int, int]()
        kinds = (int(self._mj.mjtTrn.mjTRN_JOINT), int(self._mj.mjtTrn.mjTRN_JOINTINPARENT))
        by_joint: dict[int, list[int]] = {}
        indices = range(len(mj_model.actuator_trntype))
        for actuator in indices:
            if mj_model.actuator_trntype[actuator] in kinds:
                by_joint.setdefault(int(mj_model.actuator_trnid[actuator][0]), []).append(actuator)
        exported = exported_joints(model)
        for joint, j, dof in zip(joints, ids, self._at, strict=True):
            actuators = by_joint.get(j, []) if joint in exported else []
            if len(actuators) == 1 and self._matches(actuators[0], exported[joint]):
                matching[dof] = actuators[0]
        for actuator in set(indices).difference(matching.values()):
            mj_model.actuator_gainprm[actuator], mj_model.actuator_biasprm[actuator] = 0.0, 0.0
        mj_model.actuator_forcelimited[:] = False
        mj_model.jnt_actfrclimited[:] = False
        return matching

    def _matches(self, actuator: int, joint: ExportedJoint) -> bool:
        """Return whether an actuator has the same kind of command as the model's."""
        model = self._model
        is_direct = (
            model.actuator_dyntype[actuator] == int(self._mj.mjtDyn.mjDYN_NONE)
            and model.actuator_gaintype[actuator] == int(self._mj.mjtGain.mjGAIN_FIXED)
            and model.actuator_gear[actuator][0] == 1.0
        )
        is_servo = model.actuator_biastype[actuator] == int(self._mj.mjtBias.mjBIAS_AFFINE)
        has_gain = not joint.is_servo and model.actuator_gainprm[actuator][0] != 1.0
        same_delay = bool(self._delays[actuator]) == bool(joint.delay)
        return bool(is_direct and is_servo == joint.is_servo and not has_gain and same_delay)

    def _places(self) -> dict[str, int]:
        """Return indices of single joints by name, with geodrake's names for unnamed ones."""
        model, places = self._model, {}
        single = (int(self._mj.mjtJoint.mjJNT_HINGE), int(self._mj.mjtJoint.mjJNT_SLIDE))
        for j in range(model.njnt):
            if model.jnt_type[j] in single:
                body = int(model.jnt_bodyid[j])
                body_name = model.body(body).name or f"body_{body - 1}"
                default = f"{body_name}_joint_{j - int(model.body_jntadr[body])}"
                places[model.joint(j).name or default] = j
        return places


class PinocchioEngine(Engine):
    """A Pinocchio model of the rigid bodies only, as used by `geodrake check`."""

    package = "pinocchio"
    ignores = (*POSITIVE_TERMS, "stiffness")

    def __init__(self, file: Path, model: RobotModel) -> None:
        self._loaded = load_description(file, held=model.held)
        gravity = model.plant.gravity_field().gravity_vector()
        self._loaded.plant.mutable_gravity_field().set_gravity_vector(gravity)
        places = {joint: k for k, joint in enumerate(self._loaded.joints)}
        self._order = np.array(order_of(model.joints, places, file, "Pinocchio"))
        zero = np.zeros((1, len(places)))
        self.name = self._efforts(zero, zero, zero)[0]

    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Return inverse dynamics of the bodies."""
        inverse = np.argsort(self._order)
        effort = self._efforts(*(x[:, inverse] for x in (q, v, vd)))[1]
        return effort[:, self._order], np.full(v.shape, True)

    def _efforts(self, q: Array, v: Array, vd: Array) -> tuple[str, Array]:
        result = second_opinion(self._loaded, (q, v, vd))
        if isinstance(result, str):
            raise ModelError(result)
        return result[:2]


class PythonEngine(Engine):
    """A module with a function effort(q, v, vd)."""

    package = "math"

    def __init__(self, file: Path, model: RobotModel) -> None:
        self.name = f"Python {platform.python_version()}"
        names = runpy.run_path(str(file))
        self._effort = names["effort"]
        places = {joint: k for k, joint in enumerate(names["JOINTS"])}
        self._order = order_of(model.joints, places, file, self.name)

    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Return the function's efforts."""
        rows = zip(q.tolist(), v.tolist(), vd.tolist(), strict=True)
        effort = np.array([self._effort(*row) for row in rows])
        return effort[:, self._order], np.full(v.shape, True)
