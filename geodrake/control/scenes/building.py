"""The diagram of a scenario: plant, robots, controllers, messages, MeshCat."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, SceneGraph
from pydrake.lcm import DrakeLcmInterface
from pydrake.manipulation import ApplyNamedPositionsAsDefaults
from pydrake.multibody.parsing import (
    FlattenModelDirectives,
    ModelDirectives,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.lcm import ApplyLcmBusConfig, LcmBuses
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink
from pydrake.trajectories import PiecewisePolynomial

from geodrake.boundary.arguments import instance
from geodrake.control.loops import AdaptiveLoop, add_adaptive_loop, check_base
from geodrake.control.scenes.controllers import controller_of
from geodrake.control.scenes.iiwa_messages import add_simulated_iiwa, iiwa_ports
from geodrake.control.scenes.motions import motion_of
from geodrake.control.scenes.scenario import RobotSpec, Scenario, check_scenario, within
from geodrake.control.systems import AdaptiveController
from geodrake.errors import ArgumentError, ModelError
from geodrake.model.robot_model import RobotModel
from geodrake.model.saved_model import load_model
from geodrake.model.simulation.robot_in_diagram import RobotInDiagram
from geodrake.robot.files.description import drake_errors, drake_messages, model_files
from geodrake.robot.files.given import Given
from geodrake.robot.files.includes import Includes
from geodrake.robot.files.meshes import check_geometry
from geodrake.robot.mjcf_shapes import add_geoms, plain_mjcfs
from geodrake.robot.robot_instance import RobotInstance, RobotPorts, take_out_stated

_DIRECTIVES = Path("the directives")  # what messages call them


@dataclass(frozen=True, eq=False)
class RobotInScene:
    """A robot of a scene.

    Attributes:
        joints: Names of its n joints, in the order of its controller.
        instance: It in the plant; None if it is elsewhere.
        model: The model that it moves as, in the diagram; None for the robot of the directives.
        loop: Its controller's loop, if it has one here.
        motion: What it is to follow, if it is to.
        logs: Sinks of "state" and "effort" of a robot in the plant.
        kept: What must live as long as the diagram.
    """

    joints: tuple[str, ...]
    instance: RobotInstance | None
    model: RobotInDiagram | None
    loop: AdaptiveLoop | None
    motion: PiecewisePolynomial | None
    logs: Mapping[str, VectorLogSink]
    kept: tuple[object, ...] = ()


@dataclass(frozen=True, eq=False)
class Scene:
    """What `build_scene` built.

    Attributes:
        plant: The plant, with all models of the directives.
        robots: Model instance -> robot.
        lcm_buses: The buses of LCM, which the diagram pumps.
    """

    scenario: Scenario
    diagram: Diagram
    plant: MultibodyPlant
    scene_graph: SceneGraph
    robots: Mapping[str, RobotInScene]
    lcm_buses: LcmBuses = field(repr=False)

    def context(self) -> Context:
        """Return a Context at the start: robots as their models, at the start of their motions.

        Links of soft joints are where a steady load has them.
        """
        root = self.diagram.CreateDefaultContext()
        context = self.plant.GetMyMutableContextFromRoot(root)
        for name, robot in self.robots.items():
            if robot.model is not None:
                robot.model.set_inertias(root)
            placed = name in self.scenario.initial_position
            if robot.instance is not None and robot.motion is not None and not placed:
                start = robot.motion.value(0.0).ravel()
                state = np.concatenate([start, np.zeros(len(start))])
                robot.instance.set_state(context, robot.joints, state)
            if robot.model is not None and robot.model.effect_force is not None:
                robot.model.effect_force.deflect(root)
        return root


def build_scene(*, scenario: Scenario, meshcat: Meshcat | None = None) -> Scene:
    """Builds the diagram of a scenario.

    Args:
        meshcat: Where to draw it; nowhere if None.

    Raises:
        ArgumentError: The scenario names what is not there, or numbers are out of their ranges.
        ModelError: A model file cannot be read.
        LogError: A log cannot be read.
    """
    check_scenario(instance(scenario, "scenario", Scenario))
    builder = DiagramBuilder()
    plant, scene_graph = _add_plant(builder, scenario)
    for name, robot in scenario.robots.items():
        if not plant.HasModelInstanceNamed(name) and (
            robot.messages is None or robot.controller is None
        ):
            instances = [plant.GetModelInstanceName(i) for i in _instances(plant)]
            raise ArgumentError(
                f"robots.{name}: the directives have no model instance {name!r}.",
                advice=f"They have {', '.join(instances) or 'none'}; a robot elsewhere needs "
                "messages and a controller.",
            )
    with drake_errors(Path("lcm_buses"), advice="Correct the scenario."):
        buses = ApplyLcmBusConfig(scenario.lcm_buses, builder)
    robots = {}
    for number, (name, spec) in enumerate(scenario.robots.items()):
        lcm = None if spec.messages is None else buses.Find(name, spec.messages.lcm_bus)
        rng = np.random.default_rng([scenario.random_seed, number])
        with within(f"robots.{name}"):
            place = RobotInstance(plant, name) if plant.HasModelInstanceNamed(name) else None
            maker = _RobotMaker(builder, spec, place, scenario.log_period, lcm)
            robots[name] = maker.added(rng)
    if meshcat is not None:
        params = MeshcatVisualizerParams(publish_period=scenario.meshcat.publish_period)
        MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
    return Scene(scenario, builder.Build(), plant, scene_graph, robots, buses)


def _add_plant(builder: DiagramBuilder, scenario: Scenario) -> tuple[MultibodyPlant, SceneGraph]:
    """Return the finalized plant of the directives."""
    advice = "Correct the scenario."
    with drake_messages():
        with drake_errors(Path("plant_config"), advice=advice):
            plant, scene_graph = AddMultibodyPlant(scenario.plant_config, builder)
        with drake_errors(_DIRECTIVES, advice=advice):
            parser = Parser(plant)
            for name, folder in scenario.packages.items():
                if not Path(folder).is_dir():
                    raise ModelError(
                        f"The folder {folder} of package {name!r} is not there.", advice=advice
                    )
                parser.package_map().Add(name, folder)
            given = Given(packages={name: Path(each) for name, each in scenario.packages.items()})
            includes = Includes(_DIRECTIVES, given.packages)
            for file in model_files(scenario.directives, includes):
                check_geometry([file], parser.package_map(), given)
            directives = ModelDirectives(directives=scenario.directives)
            flat = FlattenModelDirectives(directives, parser.package_map())
            with TemporaryDirectory() as folder:
                mjcfs = plain_mjcfs(flat, includes, given, Path(folder))
                ProcessModelDirectives(flat, parser)
            for name, file in mjcfs.items():
                add_geoms(plant, name, file, given)
            for name, robot in scenario.robots.items():
                if robot.model and plant.HasModelInstanceNamed(name):
                    take_out_stated(plant, name)
            plant.Finalize()
    _check_positions(plant, scenario)
    with drake_errors(Path("initial_position"), advice=advice):
        ApplyNamedPositionsAsDefaults(scenario.initial_position, plant)
    return plant, scene_graph


def _check_positions(plant: MultibodyPlant, scenario: Scenario) -> None:
    for name, joints in scenario.initial_position.items():
        if not plant.HasModelInstanceNamed(name):
            raise ArgumentError(
                f"initial_position: the directives have no model instance {name!r}."
            )
        index = plant.GetModelInstanceByName(name)
        for joint, values in joints.items():
            if not plant.HasJointNamed(joint, index):
                raise ArgumentError(f"initial_position: {name} has no joint {joint!r}.")
            if not np.isfinite(values).all():
                raise ArgumentError(f"initial_position of {joint} of {name} is not finite.")


@dataclass(frozen=True, eq=False)
class _RobotMaker:
    """Adds a robot of a scenario to a diagram.

    Attributes:
        place: The robot in the plant; None if it is elsewhere.
        log_period: Period of logs, s.
        lcm: Its bus, if it has messages.
    """

    builder: DiagramBuilder
    spec: RobotSpec
    place: RobotInstance | None
    log_period: float
    lcm: DrakeLcmInterface | None

    def added(self, rng: np.random.Generator) -> RobotInScene:
        """Return the robot, with its controller if it has one."""
        spec, place, builder = self.spec, self.place, self.builder
        own = load_model(spec.model) if spec.model else None
        known, controller = self._controller(own, rng)
        model = own or known
        joints = model.joints if model else place.joints if place else ()
        gravity = self._gravity_model()
        placed = own.add_to_scene(builder, place) if own and place else None
        ports, effort = self._ports(placed, joints), None
        logs = {}
        if place is not None and ports is not None:
            logs["state"] = LogVectorOutput(ports.state, builder, self.log_period)
        if spec.messages is not None and self.lcm is not None:
            plant = gravity.plant if gravity else None
            if ports is not None:
                effort = add_simulated_iiwa(
                    builder, ports, self.lcm, spec.messages, gravity_plant=plant
                )
            if controller is not None:
                away = place is None
                ports = iiwa_ports(
                    builder, joints, self.lcm, spec.messages, gravity_plant=plant, elsewhere=away
                )
        loop = motion = None
        if controller is not None and known is not None and ports is not None:
            loop, motion = self._loop(ports, controller, known)
            effort = effort or loop.actuation
        effort = placed.logged_effort if placed else effort
        if place is not None and effort is not None:
            logs["effort"] = LogVectorOutput(effort, builder, self.log_period)
        return RobotInScene(joints, place, placed, loop, motion, logs, (gravity,))

    def _controller(
        self, own: RobotModel | None, rng: np.random.Generator
    ) -> tuple[RobotModel | None, AdaptiveController | None]:
        """Return the controller, and the model that it begins with."""
        spec = self.spec.controller
        if spec is None:
            return None, None
        with within("controller"):
            known = load_model(spec.model) if spec.model else own
            if known is None:
                raise ArgumentError("There is no model.", advice="Give model: FILE.")
            controller = controller_of(spec, known, rng)
            if self.place is not None:
                check_base(self.place, controller)
            return known, controller

    def _gravity_model(self) -> RobotModel | None:
        """Return the model whose gravity the driver compensates."""
        messages = self.spec.messages
        if messages is None or not messages.gravity_model:
            return None
        with within("messages"):
            return load_model(messages.gravity_model)

    def _ports(self, placed: RobotInDiagram | None, joints: tuple[str, ...]) -> RobotPorts | None:
        """Where efforts reach the robot in the plant; None where none do, or it is elsewhere."""
        if placed is not None:
            return placed.ports()
        if self.place is None or (self.spec.controller is None and self.spec.messages is None):
            return None
        return self.place.ports(self.builder, joints)

    def _loop(
        self, ports: RobotPorts, controller: AdaptiveController, known: RobotModel
    ) -> tuple[AdaptiveLoop, PiecewisePolynomial]:
        """Return the loop that follows the motion, and the motion."""
        if self.spec.motion is None:
            raise ArgumentError("The controller has no motion.")
        with within("motion"):
            motion = motion_of(self.spec.motion, known)
        loop = add_adaptive_loop(
            self.builder, ports, controller, motion, log_period=self.log_period
        )
        return loop, motion


def _instances(plant: MultibodyPlant) -> list[ModelInstanceIndex]:
    """Model instances beside the world's and the default one."""
    return [ModelInstanceIndex(i) for i in range(2, plant.num_model_instances())]
