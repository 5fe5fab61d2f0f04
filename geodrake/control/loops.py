"""Whole closed loops, with the names of their ports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    OutputPort,
    System,
)
from pydrake.systems.primitives import LogVectorOutput, MatrixGain, TrajectorySource, VectorLogSink
from pydrake.trajectories import Trajectory

from geodrake.boundary.arguments import instance, positive
from geodrake.control.systems.adaptive_controller import AdaptiveController
from geodrake.effects.base import RobotEffect
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.model.simulation.effect_force import EffectForce, EffectWithValues
from geodrake.robot.robot_instance import RobotInstance, RobotPorts


@dataclass(frozen=True, eq=False)
class AdaptiveLoop:
    """Systems that `add_adaptive_loop` added, by name.

    Attributes:
        robot: The robot in its plant; None if the loop was given the ports of a robot elsewhere.
        effect_force: What acts on the plant beside rigid bodies, if anything.
        state: Positions and velocities of the robot, in the order of the controller's joints; of
            the motors where effects make joints soft.
        measured_state: What the controller sees of them.
        logs: Sinks of "state", "desired_state", "actuation", "parameters" and, where the truth is
            known, "lyapunov"; none if nothing is logged.
    """

    robot: RobotInstance | None
    controller: AdaptiveController
    effect_force: EffectForce | None
    state: OutputPort
    measured_state: OutputPort
    desired_state: OutputPort
    desired_acceleration: OutputPort
    actuation: OutputPort
    parameters: OutputPort
    logs: dict[str, VectorLogSink]

    @property
    def plant(self) -> MultibodyPlant:
        """The plant that the robot is in."""
        return self._robot.plant

    @property
    def _robot(self) -> RobotInstance:
        if self.robot is None:
            raise ArgumentError(
                "The loop knows only the ports of its robot, not its plant.",
                advice="Pass the plant to add_adaptive_loop, or a RobotInstance of it.",
            )
        return self.robot

    def context(self, diagram: Diagram) -> Context:
        """Return a default Context of the diagram, with the robot at the start of the motion."""
        context = diagram.CreateDefaultContext()
        self.set_start(context)
        return context

    def set_start(self, root: Context) -> None:
        """Put the robot where its motion starts, and nothing else."""
        robot, joints = self._robot, self.controller.control.joints
        source = self.desired_state.get_system()
        desired = self.desired_state.Eval(source.GetMyContextFromRoot(root))
        robot.set_state(robot.plant.GetMyMutableContextFromRoot(root), joints, desired)
        if self.effect_force is not None:
            self.effect_force.deflect(root)

    def simulated(self, diagram: Diagram, duration: float) -> tuple[Array, dict[str, Array]]:
        """Simulate some seconds from the start of the motion.

        Returns:
            Times (N,), and what was logged (N, ·) by name.
        """
        simulator = Simulator(diagram, self.context(diagram))
        simulator.Initialize()
        simulator.AdvanceTo(duration)
        return self.logged(simulator.get_context())

    def logged(self, context: Context) -> tuple[Array, dict[str, Array]]:
        """Return times (N,) and what was logged until now (N, ·), by the Context of the diagram."""
        if not self.logs:
            raise ArgumentError(
                "The loop does not log.", advice="Pass log_period to add_adaptive_loop."
            )
        found = {name: sink.FindLog(context) for name, sink in self.logs.items()}
        time = np.array(next(iter(found.values())).sample_times())
        return time, {name: np.array(log.data().T) for name, log in found.items()}


def add_adaptive_loop(
    builder: DiagramBuilder,
    plant: MultibodyPlant | RobotInstance | RobotPorts,
    controller: AdaptiveController,
    motion: Trajectory,
    *,
    effects: Sequence[EffectWithValues] = (),
    sign_width: ArrayLike = 1e-2,
    log_period: float | None = None,
    sensor: System | None = None,
) -> AdaptiveLoop:
    """Make a robot follow a motion under an adaptive controller.

    Args:
        plant: A finalized plant of one robot, continuous or discrete; `RobotInstance(plant, name)`
            where it holds more than the robot; or the ports of a robot that is elsewhere. There is
            an actuator at every joint, or none at all: efforts are generalized forces then.
        controller: What is to control it; added to the builder. Its joints may be in another order.
        motion: (n) positions over time, twice differentiable, in the order of the controller.
        effects: Effects and their linear parameters μ that act on the robot, see `EffectForce`.
        sign_width: Speed below which dry friction fades on the robot, rad/s or m/s.
        log_period: Period of the logs, s; None for none.
        sensor: What the controller sees the robot through, such as noise: a system with one input
            and one output for positions and velocities; added to the builder. Nothing if None.

    Raises:
        ArgumentError: Robot, controller and motion do not fit together, only some joints have an
            actuator, or the base of the robot leans otherwise than that of the controller's model.
    """
    instance(builder, "builder", DiagramBuilder)
    if log_period is not None:
        positive(log_period, "log_period")  # a negative one would end the process
    joints = instance(controller, "controller", AdaptiveController).control.joints
    instance(motion, "motion", Trajectory)
    if motion.rows() != len(joints) or motion.cols() != 1:
        raise ArgumentError(
            f"The motion has {motion.rows()} positions, but the controller {len(joints)} joints."
        )
    instance(effects, "effects", Sequence)
    robot: RobotInstance | None = None
    if isinstance(plant, RobotPorts):
        ports = _given_ports(plant, joints, effects)
    else:
        robot = plant if isinstance(plant, RobotInstance) else RobotInstance(plant)
        check_base(robot, controller)
        ports = robot.ports(builder, joints)
    builder.AddSystem(controller)
    desired, acceleration = (
        builder.AddSystem(source).get_output_port()
        for source in (TrajectorySource(motion, 1), TrajectorySource(motion.MakeDerivative(2)))
    )
    actuation, state, force = controller.GetOutputPort("actuation"), ports.state, None
    sources = {"desired_state": desired, "desired_acceleration": acceleration, "effort": actuation}
    if ports.acceleration is not None:
        sources["acceleration"] = ports.acceleration
    elif controller.HasInputPort("acceleration"):
        raise ArgumentError(
            "The controller needs accelerations, which the robot's ports do not provide.",
            advice="Adapt with PredictionError(…, alone=True), which does not need them.",
        )
    for name, source in sources.items():  # efforts are measured exactly
        if controller.HasInputPort(name):
            builder.Connect(source, controller.GetInputPort(name))
    builder.Connect(actuation, ports.effort)
    if effects and robot is not None:
        force = EffectForce.AddToBuilder(builder, robot, effects, sign_width=sign_width)
        gain = builder.AddSystem(MatrixGain(robot.to_plant(joints)))
        builder.Connect(actuation, gain.get_input_port())
        builder.Connect(gain.get_output_port(), force.GetInputPort("applied_effort"))
        state = force.state_port(builder, joints) if force.soft_joints else state
    measured = state
    if sensor is not None:
        builder.AddSystem(instance(sensor, "sensor", System))
        builder.Connect(measured, sensor.get_input_port())
        measured = sensor.get_output_port()
    builder.Connect(measured, controller.GetInputPort("estimated_state"))
    parameters = controller.GetOutputPort("parameters")
    named = {
        "state": state,
        "desired_state": desired,
        "actuation": actuation,
        "parameters": parameters,
    }
    if controller.HasOutputPort("lyapunov"):
        named["lyapunov"] = controller.GetOutputPort("lyapunov")
    period = log_period or 0.0
    logs = {n: LogVectorOutput(p, builder, period) for n, p in named.items() if log_period}
    ends = state, measured, desired, acceleration, actuation, parameters
    return AdaptiveLoop(robot, controller, force, *ends, logs)


def check_base(robot: RobotInstance, controller: AdaptiveController) -> None:
    """Check that a robot is the controller's, and that its base leans as that of its model.

    A controller whose model has an effect of the whole robot may know by it that the base leans,
    and is believed.
    """
    control = controller.control
    if control.tree.actuation is not None and control.tree.actuation.places:
        raise ArgumentError(
            "The controller's model has a transmission, or joints that follow others, but a plant "
            "has state and efforts of all joints.",
            advice="Pass the ports of the actuators to add_adaptive_loop: "
            "model.add_to_builder(builder).ports().",
        )
    robot.order(control.joints)
    if not any(isinstance(effect, RobotEffect) for effect in control.effects):
        robot.check_base(control.tree, control.joints)


def _given_ports(
    ports: RobotPorts, joints: Sequence[str], effects: Sequence[EffectWithValues]
) -> RobotPorts:
    if ports.joints != tuple(joints):
        raise ArgumentError(
            f"The ports have joints {', '.join(ports.joints)}, but the controller "
            f"{', '.join(joints)}.",
            advice="Construct the ports with the controller's joints.",
        )
    if effects:
        raise ArgumentError(
            "Effects need a plant, but only ports were given.",
            advice="Omit effects, or pass a RobotInstance of the plant.",
        )
    return ports
