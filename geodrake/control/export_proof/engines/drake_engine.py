"""Drake, by its own parser."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder

from geodrake.boundary.input_files import read_regular
from geodrake.control.export_proof.engines.base import Array, Engine, Mask, order_of
from geodrake.effects import Effect
from geodrake.errors import ModelError
from geodrake.model.file_terms import DryFriction
from geodrake.model.robot_model import RobotModel
from geodrake.robot.files.description import drake_errors, drake_messages
from geodrake.robot.files.packages import add_packages, named_packages
from geodrake.robot.plant import free_roots, joint_names


class DrakeEngine(Engine):
    """A plant, continuous in time; it does not act upon dry friction of its joints.

    Args:
        file: The exported file that is loaded first.
        model: The model, for the names of its joints and the packages around its file.

    Raises:
        ModelError: Drake cannot read the file.
    """

    ignores: ClassVar[tuple[type[Effect], ...]] = (DryFriction,)

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
            for body in free_roots(self._plant):
                X_WB = self._plant.GetDefaultFloatingBaseBodyPose(body)
                self._plant.WeldFrames(self._plant.world_frame(), body.body_frame(), X_WB)
            self._plant.Finalize()
            self._diagram = builder.Build()
        said = (message.partition("\n")[0].rpartition("warning: ")[2] for message in messages)
        self.messages = tuple(dict.fromkeys(said))
        plant, names = self._plant, joint_names(self._plant)
        self._at = order_of(
            model, {name: k for k, name in enumerate(names)}.__getitem__, file, self.name
        )
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
        """Positions by a fifth-order integrator, a step at a time; see `Engine.roll_out`."""
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
        """Values of the model's joints as Drake has them."""
        found = np.zeros(self._plant.num_velocities())
        found[self._at] = values
        return found
