"""A fitted model in a Drake diagram: plant, effects and delays, each once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, InputPort, OutputPort, System
from pydrake.systems.primitives import Adder, PassThrough

from geodrake.boundary.arguments import real_array
from geodrake.effects import Effect, FittedEffect, Role
from geodrake.effects.delays import delays_of
from geodrake.inertia import Array
from geodrake.model.simulation.delayed_effort import DelayedEffort
from geodrake.model.simulation.effect_force import EffectForce
from geodrake.robot.files import Given
from geodrake.robot.plant import joint_names, load_plant
from geodrake.robot.visuals import add_visuals

_PERIOD = 1e-3  # of sampling efforts that are delayed, s, where delays are no shorter

FORCES = (Role.FORCE, Role.SCALE, Role.EPISODE)
"""Effects that `EffectForce` carries; payloads are among the plant's inertias."""


@dataclass(frozen=True, eq=False)
class FittedRobot:
    """What a diagram needs to know of a model to simulate it.

    Attributes:
        path: The model file.
        floating: Whether free roots float instead of being welded to the world.
        total_phi: (nb, 10) inertial parameters, payloads included.
        effects: Effects with their parameters.
        held: Joint that is held -> where, rad or m.
        given: How the model file was read.
    """

    path: Path
    floating: bool
    total_phi: Array
    effects: tuple[FittedEffect, ...]
    held: Mapping[str, float]
    given: Given


@dataclass(frozen=True, eq=False)
class RobotInDiagram:
    """A model that was added to a builder: its systems and its ports.

    Attributes:
        plant: The plant, whose default inertias are the model's, payloads included.
        scene_graph: The SceneGraph that the plant is a source of, if any.
        effect_force: What acts on the plant beside rigid bodies, if anything.
        effort: Input (nv) for the efforts at the joints, N·m or N, zero if it is not connected;
            in units of the logs that the model was fitted to, wrong gains included.
        state: Output (nq + nv): positions and velocities.
        logged_effort: Output (nv): the efforts as a log has them beside the state, late by the
            model's delays.
        left_out: Effects of the model that a simulation of its links cannot have: soft joints and
            play.
        notes: What cannot be shown.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph | None
    effect_force: EffectForce | None
    effort: InputPort
    state: OutputPort
    logged_effort: OutputPort
    left_out: tuple[Effect, ...] = ()
    notes: tuple[str, ...] = ()

    def set_state(self, root: Context, q: ArrayLike, v: ArrayLike | None = None) -> None:
        """Sets where the robot starts.

        Args:
            root: Context of the whole diagram.
            q: (nq,) positions in Drake's order.
            v: (nv,) velocities; None for rest.
        """
        plant = self.plant
        q = real_array(q, "q", (plant.num_positions(),))
        v = np.zeros(plant.num_velocities()) if v is None else v
        context = plant.GetMyMutableContextFromRoot(root)
        plant.SetPositions(context, q)
        plant.SetVelocities(context, real_array(v, "v", (plant.num_velocities(),)))


@dataclass(frozen=True, eq=False)
class DiagramOptions:
    """How a model is put into a diagram; see `RobotModel.add_to_builder`."""

    time_step: float
    scene_graph: SceneGraph | bool | None
    name: str
    sign_width: Array
    log: str | None


def add_robot(
    builder: DiagramBuilder, robot: FittedRobot, options: DiagramOptions
) -> RobotInDiagram:
    """Adds a model to a builder; see `RobotModel.add_to_builder`.

    Args:
        builder: The diagram's builder.
        robot: The model.
        options: How.
    """
    name = options.name
    plant = MultibodyPlant(options.time_step)
    plant.set_name(name)
    scene_graph = _scene_graph(builder, options)
    if scene_graph is not None:
        plant.RegisterAsSourceForSceneGraph(scene_graph)
    load_plant(
        robot.path,
        floating=robot.floating,
        held=robot.held,
        given=robot.given,
        phi=robot.total_phi,
        into=plant,
    )
    builder.AddSystem(plant)
    notes: tuple[str, ...] = ()
    if scene_graph is not None:
        notes = add_visuals(plant, scene_graph, robot.path, robot.given)
        _show(builder, plant, scene_graph)

    nv = plant.num_velocities()
    effort = builder.AddNamedSystem(f"{name}_effort", PassThrough(np.zeros(nv)))
    delays = delays_of([fitted.effect for fitted in robot.effects], joint_names(plant))
    logged = _late(builder, f"{name}_logged_effort", effort.get_output_port(), delays)
    acting = _late(builder, f"{name}_acting_effort", effort.get_output_port(), -delays)
    forces = [fitted for fitted in robot.effects if fitted.effect.role in FORCES]
    force, total = None, acting
    if forces:
        force = EffectForce(plant, forces, sign_width=options.sign_width, log=options.log)
        builder.AddNamedSystem(f"{name}_effects", force)
        builder.Connect(plant.get_state_output_port(), force.GetInputPort("state"))
        builder.Connect(acting, force.GetInputPort("applied_effort"))
        both = builder.AddNamedSystem(f"{name}_total_effort", Adder(2, nv))
        builder.Connect(acting, both.get_input_port(0))
        builder.Connect(force.get_output_port(), both.get_input_port(1))
        total = both.get_output_port()
    builder.Connect(total, plant.get_applied_generalized_force_input_port())
    return RobotInDiagram(
        plant,
        scene_graph,
        force,
        effort.get_input_port(),
        plant.get_state_output_port(),
        logged,
        tuple(f.effect for f in robot.effects if f.effect.role is Role.DEFLECTION),
        notes,
    )


def _late(builder: DiagramBuilder, name: str, effort: OutputPort, delays: Array) -> OutputPort:
    """An effort, late by those of some delays (nv,), s, that are positive."""
    delays = np.maximum(delays, 0.0)
    if not delays.any():
        return effort
    period = min(_PERIOD, delays[delays > 0.0].min())
    late: System = builder.AddNamedSystem(name, DelayedEffort(delays, period=period))
    builder.Connect(effort, late.get_input_port())
    return late.get_output_port()


def _scene_graph(builder: DiagramBuilder, options: DiagramOptions) -> SceneGraph | None:
    if options.scene_graph is True:
        return builder.AddNamedSystem(f"{options.name}_scene_graph", SceneGraph())
    return options.scene_graph or None


def _show(builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Connects a plant with the SceneGraph that it is a source of."""
    source = scene_graph.get_source_pose_port(plant.get_source_id())
    builder.Connect(plant.get_geometry_pose_output_port(), source)
    builder.Connect(scene_graph.get_query_output_port(), plant.get_geometry_query_input_port())
