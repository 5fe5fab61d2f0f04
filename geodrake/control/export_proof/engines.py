"""Simulators that load exported models by themselves, those that are installed.

Packages of simulators that are optional are imported where they are needed.
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
from geodrake.control.export_proof.joints import ExportedJoint, exported_joints
from geodrake.control.export_proof.reference import Drives
from geodrake.effects import Effect
from geodrake.effects.file_terms import Damping, DryFriction, Rotor, Spring
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
    """A simulator with a robot that it read from a file.

    Joints are those of the model, one position and one velocity each; or those of its plant.
    """

    package: ClassVar[str]  # that it needs
    # Effects that may be in the file, but which the simulator does not act upon.
    ignores: tuple[type[Effect], ...] = ()
    # Whether joints are those of the plant, among them such as follow others.
    of_plant: ClassVar[bool] = False
    name: str
    drives: Drives | None = None  # actuators that efforts of rollouts pass through
    messages: tuple[str, ...] = ()  # warnings

    @abc.abstractmethod
    def __init__(self, file: Path, model: RobotModel) -> None:
        """Load a file of a model."""

    @abc.abstractmethod
    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Return the effort that a motion (N, nv) needs.

        Returns:
            (N, nv) efforts, N·m or N, and where they are meant to be those of the model.
        """

    def roll_out(self, q: Array, v: Array, effort: Array, step: float) -> Array | None:
        """Roll out from a state, without dry friction: (K + 1, nv) positions; None if it cannot.

        Actuators are told `Drives.controls` of the efforts.

        Efforts (K, nv), N·m or N, are each held for a step, s.
        """
        return None


def order_of(joints: Sequence[str], places: Mapping[str, int], file: Path, name: str) -> list[int]:
    """Return where a simulator has each of some joints, of all the places that it has."""
    if lacking := [joint for joint in joints if joint not in places]:
        raise ModelError(f"{name} has no joint {lacking[0]!r} in {file.name}.")
    return [places[joint] for joint in joints]


class DrakeEngine(Engine):
    """A plant, continuous in time; it does not act upon dry friction of its joints."""

    package = "pydrake"
    of_plant = True
    ignores: tuple[type[Effect], ...] = (DryFriction,)

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
            self.ignores = (DryFriction, Spring)  # which a URDF has for Gazebo alone
        said = (message.partition("\n")[0].rpartition("warning: ")[2] for message in messages)
        self.messages = tuple(dict.fromkeys(said))
        plant, names = self._plant, joint_names(self._plant)
        places = {name: k for k, name in enumerate(names)}
        self._at = order_of(joint_names(model.plant), places, file, self.name)
        joints = (plant.get_joint(index) for index in plant.GetJointIndices())
        starts = {j.velocity_start(): j.position_start() for j in joints if j.num_velocities() == 1}
        self._positions = [starts[at] for at in self._at]
        held = ((starts[k], model.held[n]) for k, n in enumerate(names) if n in model.held)
        self._held = dict(held)

    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Inverse dynamics with damping, rotors, springs and gravity; see `Engine.effort`."""
        plant = self._plant
        context = plant.CreateDefaultContext()
        forces = MultibodyForces(plant)
        found = np.empty_like(v)
        for k in range(len(v)):
            self._set(context, q[k], v[k])
            plant.CalcForceElementsContribution(context, forces)
            found[k] = plant.CalcInverseDynamics(context, self._spread(vd[k]), forces)[self._at]
        return found, np.full(v.shape, True)

    def roll_out(self, q: Array, v: Array, effort: Array, step: float) -> Array | None:
        """Return positions by a fifth-order integrator, a step at a time; see `Engine.roll_out`."""
        if self._held:
            return None  # nothing holds these joints
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
        held = port.FixValue(context, self._spread(effort[0]))
        simulator.Initialize()
        found = [q]
        for k, own in enumerate(effort):
            held.GetMutableData().set_value(self._spread(own))
            simulator.AdvanceTo((k + 1) * step)
            found.append(self._plant.GetPositions(context)[self._positions])
        return np.array(found)

    def _set(self, context: object, q: Array, v: Array) -> None:
        positions = np.zeros(self._plant.num_positions())
        positions[self._positions] = q
        positions[[*self._held]] = [*self._held.values()]
        self._plant.SetPositions(context, positions)
        self._plant.SetVelocities(context, self._spread(v))

    def _spread(self, values: Array) -> Array:
        """Return values of the model's joints as Drake has them."""
        found = np.zeros(self._plant.num_velocities())
        found[self._at] = values
        return found


_FULL = 1.0 - 1e-9  # share of dry friction from which on it counts as being there in full


class MujocoEngine(Engine):
    """A model of MuJoCo, whose joints feel no limits, contacts and closed loops.

    Efforts of rollouts pass through the actuators of joints, where those are what the model has:
    motors, or servos, late or not. At other joints they are applied as they are, and other
    actuators are without force.
    """

    package = "mujoco"
    of_plant = True

    def __init__(self, file: Path, model: RobotModel) -> None:
        self._mj = mujoco = import_module("mujoco")
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
        joints = joint_names(model.plant)
        ids = order_of(joints, places, file, self.name)
        in_q = self._model.jnt_qposadr
        self._at, self._positions = self._model.jnt_dofadr[ids].tolist(), in_q[ids].tolist()
        self._held = {int(in_q[places[n]]): x for n, x in model.held.items() if n in places}
        self._friction = self._model.dof_frictionloss[self._at].copy()
        # Older versions have no delays, and one signal for each actuator.
        count = len(self._model.actuator_trntype)
        self._delays = getattr(self._model, "actuator_delay", np.zeros(count))
        self._signals = getattr(self._model, "actuator_ctrladr", np.arange(count))
        self._through = self._take_actuators(model, joints, ids)
        through = zip(joints, self._at, strict=True)
        self.drives = Drives.of(model, [joint for joint, at in through if at in self._through])

    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Inverse dynamics; where dry friction, a soft constraint, is not in full, it is masked."""
        data, found = self._mj.MjData(self._model), np.empty_like(v)
        meant = np.full(v.shape, True)
        data.qpos[[*self._held]] = [*self._held.values()]
        for k in range(len(v)):
            data.qpos[self._positions], data.qvel[self._at], data.qacc[self._at] = q[k], v[k], vd[k]
            with self._warning_here():
                self._mj.mj_inverse(self._model, data)
            found[k] = data.qfrc_inverse[self._at]
            held = -np.sign(v[k]) * data.qfrc_constraint[self._at]
            meant[k] = held >= _FULL * self._friction
        return found, meant

    def roll_out(self, q: Array, v: Array, effort: Array, step: float) -> Array | None:
        """Return positions by MuJoCo's Runge–Kutta integrator; see `Engine.roll_out`."""
        if self._held:
            return None  # nothing holds these joints
        model, off = self._model, self._mj.mjtDisableBit
        before = model.opt.timestep, model.opt.integrator, model.opt.disableflags
        model.opt.timestep, model.opt.integrator = step, int(self._mj.mjtIntegrator.mjINT_RK4)
        model.opt.disableflags |= int(off.mjDSBL_FRICTIONLOSS)
        model.opt.disableflags &= ~int(off.mjDSBL_ACTUATION)
        data = self._mj.MjData(model)
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
                self._mj.mj_step(model, data)
            found.append(data.qpos[self._positions].copy())
        model.opt.timestep, model.opt.integrator, model.opt.disableflags = before
        return np.array(found)

    @contextmanager
    def _warning_here(self) -> Iterator[None]:
        """Take MuJoCo's warnings as messages."""
        with quiet_mujoco() as said:
            yield
        words = (each.partition(" Time =")[0] for each in said)
        self.messages = tuple(dict.fromkeys((*self.messages, *words)))

    def _start_history(self, data: Any, controls: Array) -> None:
        """Have late actuators be told the first signals all the time before."""
        for at, value in zip(self._at, controls.tolist(), strict=True):
            actuator = self._through.get(at)
            if actuator is not None and self._delays[actuator]:
                count = int(self._model.actuator_history[actuator][0])
                self._mj.mj_initCtrlHistory(
                    self._model, data, actuator, None, np.full(count, value)
                )

    def _take_actuators(
        self, model: RobotModel, joints: Sequence[str], ids: Sequence[int]
    ) -> dict[int, int]:
        """Return degree of freedom -> its actuator, like the model's; others do nothing."""
        own, found = self._model, dict[int, int]()
        kinds = (int(self._mj.mjtTrn.mjTRN_JOINT), int(self._mj.mjtTrn.mjTRN_JOINTINPARENT))
        by_joint: dict[int, list[int]] = {}
        every = range(len(own.actuator_trntype))  # which may have more than one signal
        for actuator in every:
            if own.actuator_trntype[actuator] in kinds:
                by_joint.setdefault(int(own.actuator_trnid[actuator][0]), []).append(actuator)
        wanted = exported_joints(model)
        for joint, j, at in zip(joints, ids, self._at, strict=True):
            actuators = by_joint.get(j, []) if joint in wanted else []
            if len(actuators) == 1 and self._is_like(actuators[0], wanted[joint]):
                found[at] = actuators[0]
        for actuator in set(every).difference(found.values()):
            own.actuator_gainprm[actuator], own.actuator_biasprm[actuator] = 0.0, 0.0
        own.actuator_forcelimited[:] = False
        own.jnt_actfrclimited[:] = False
        return found

    def _is_like(self, actuator: int, wanted: ExportedJoint) -> bool:
        """Return whether an actuator is told what the model's is told: an effort, or a position."""
        own = self._model
        plain = (
            own.actuator_dyntype[actuator] == int(self._mj.mjtDyn.mjDYN_NONE)
            and own.actuator_gaintype[actuator] == int(self._mj.mjtGain.mjGAIN_FIXED)
            and own.actuator_gear[actuator][0] == 1.0
        )
        servo = own.actuator_biastype[actuator] == int(self._mj.mjtBias.mjBIAS_AFFINE)
        unlike = not wanted.is_servo and own.actuator_gainprm[actuator][0] != 1.0
        late = bool(self._delays[actuator]) == bool(wanted.delay)
        return bool(plain and servo == wanted.is_servo and not unlike and late)

    def _places(self) -> dict[str, int]:
        """Return joints of one degree of freedom by name, nameless ones as geodrake calls them."""
        model, found = self._model, {}
        single = (int(self._mj.mjtJoint.mjJNT_HINGE), int(self._mj.mjtJoint.mjJNT_SLIDE))
        for j in range(model.njnt):
            if model.jnt_type[j] in single:
                body = int(model.jnt_bodyid[j])
                own = model.body(body).name or f"body_{body - 1}"
                name = model.joint(j).name or f"{own}_joint_{j - int(model.body_jntadr[body])}"
                found[name] = j
        return found


class PinocchioEngine(Engine):
    """A model of Pinocchio: the rigid bodies alone, as `geodrake check` has its opinion on them."""

    package = "pinocchio"
    ignores = (DryFriction, Rotor, Damping, Spring)

    def __init__(self, file: Path, model: RobotModel) -> None:
        self._again = load_description(file, held=model.held)
        gravity = model.plant.gravity_field().gravity_vector()
        self._again.plant.mutable_gravity_field().set_gravity_vector(gravity)
        places = {joint: k for k, joint in enumerate(self._again.joints)}
        self._order = np.array(order_of(model.joints, places, file, "Pinocchio"))
        still = np.zeros((1, len(places)))
        self.name = self._efforts(still, still, still)[0]

    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Return inverse dynamics of the bodies; see `Engine.effort`."""
        back = np.argsort(self._order)
        found = self._efforts(*(x[:, back] for x in (q, v, vd)))[1]
        return found[:, self._order], np.full(v.shape, True)

    def _efforts(self, q: Array, v: Array, vd: Array) -> tuple[str, Array]:
        found = second_opinion(self._again, (q, v, vd))
        if isinstance(found, str):
            raise ModelError(found)
        return found[:2]


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
        """Return the function's efforts; see `Engine.effort`."""
        rows = zip(q.tolist(), v.tolist(), vd.tolist(), strict=True)
        found = np.array([self._effort(*row) for row in rows])
        return found[:, self._order], np.full(v.shape, True)
