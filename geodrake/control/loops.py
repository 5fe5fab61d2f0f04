"""Closed loops of a robot and an adaptive controller."""

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
    """Systems and ports added by `add_adaptive_loop`.

    Attributes:
        robot: The robot in its plant; None if only the robot's ports were given.
        effect_force: Forces of the effects on the plant, if any.
        state: Positions and velocities of the robot in the order of the controller's joints; those
            of the motors for soft joints.
        measured_state: The state as measured by the controller.
        logs: Sinks of "state", "desired_state", "actuation", "parameters" and, if the truth is
            known, "lyapunov"; empty without logging.
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
        """The plant that contains the robot."""
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
        """Set the robot's state to the start of the motion."""
        robot, joints = self._robot, self.controller.control.joints
        source = self.desired_state.get_system()
        desired = self.desired_state.Eval(source.GetMyContextFromRoot(root))
        robot.set_state(robot.plant.GetMyMutableContextFromRoot(root), joints, desired)
        if self.effect_force is not None:
            self.effect_force.deflect(root)

    def simulated(self, diagram: Diagram, duration: float) -> tuple[Array, dict[str, Array]]:
        """Simulate a duration, s; return times (N,) and logged signals (N, ·) by name."""
        simulator = Simulator(diagram, self.context(diagram))
        simulator.Initialize()
        simulator.AdvanceTo(duration)
        return self.logged(simulator.get_context())

    def logged(self, context: Context) -> tuple[Array, dict[str, Array]]:
        """Return times (N,) and signals (N, ·) logged so far, given the diagram's Context."""
        if not self.logs:
            raise ArgumentError(
                "The loop does not log.", advice="Pass log_period to add_adaptive_loop."
            )
        logs = {name: sink.FindLog(context) for name, sink in self.logs.items()}
        time = np.array(next(iter(logs.values())).sample_times())
        return time, {name: np.array(log.data().T) for name, log in logs.items()}


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
            if the plant contains more; or the ports of a robot elsewhere. Either every joint has an
            actuator or none has; without actuators, efforts are generalized forces.
        controller: The controller, added to the builder. Its joints may be in another order.
        motion: (n) positions over time, twice differentiable, in the order of the controller.
        effects: Effects and their linear parameters μ that act on the robot, see `EffectForce`.
        sign_width: Speed below which dry friction fades on the robot, rad/s or m/s.
        log_period: Period of the logs, s; None for no logs.
        sensor: System between the robot's state and the controller, such as noise, with one input
            and one output for positions and velocities; added to the builder. None for exact
            measurements.

    Raises:
        ArgumentError: Robot, controller and motion do not fit together, only some joints have an
            actuator, or the robot's base is oriented differently from that of the model.
    """
    instance(builder, "builder", DiagramBuilder)
    if log_period is not None:
        positive(log_period, "log_period")  # Drake aborts on a negative period
    joints = instance(controller, "controller", AdaptiveController).control.joints
    instance(motion, "motion", Trajectory)
    if motion.rows() != len(joints) or motion.cols() != 1:
        raise ArgumentError(
            f"The motion has {motion.rows()} positions, but the controller {len(joints)} joints."
        )
    instance(effects, "effects", Sequence)
    robot: RobotInstance | None = None
    if isinstance(plant, RobotPorts):
        ports = _checked_ports(plant, joints, effects)
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
    for name, source in sources.items():
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
    """Check that a robot matches a controller's model, including the orientation of its base.

    The orientation is not checked if the model has an effect of the whole robot, which may describe
    a tilted base.
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


def _checked_ports(
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
