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
    InputPort,
    OutputPort,
    System,
)
from pydrake.systems.primitives import (
    LogVectorOutput,
    MatrixGain,
    TrajectorySource,
    VectorLogSink,
)
from pydrake.trajectories import Trajectory

from geodrake.boundary.arguments import instance, positive
from geodrake.control.systems import AdaptiveController, EffectForce
from geodrake.effects import Effect
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.inertia.bodies import check_plant
from geodrake.robot.plant import joint_names


@dataclass(frozen=True, eq=False)
class AdaptiveLoop:
    """What `add_adaptive_loop` added, by name.

    Attributes:
        plant: The plant.
        controller: The controller.
        effect_force: What acts on the plant beside rigid bodies, if anything.
        state: Positions and velocities of the plant.
        measured_state: What the controller sees of them.
        desired_state: Desired positions and velocities.
        desired_acceleration: Desired accelerations.
        actuation: Efforts of the controller, by velocity.
        parameters: The estimate.
        logs: Sinks of "state", "desired_state", "actuation", "parameters" and, where the truth is
            known, "lyapunov"; none if nothing is logged.
    """

    plant: MultibodyPlant
    controller: AdaptiveController
    effect_force: EffectForce | None
    state: OutputPort
    measured_state: OutputPort
    desired_state: OutputPort
    desired_acceleration: OutputPort
    actuation: OutputPort
    parameters: OutputPort
    logs: dict[str, VectorLogSink]

    def context(self, diagram: Diagram) -> Context:
        """A default Context of the finished diagram, with the plant at the start of the motion.

        Args:
            diagram: What the builder built.
        """
        context = diagram.CreateDefaultContext()
        desired = self.desired_state.Eval(
            self.desired_state.get_system().GetMyContextFromRoot(context)
        )
        self.plant.SetPositionsAndVelocities(self.plant.GetMyContextFromRoot(context), desired)
        return context

    def simulated(self, diagram: Diagram, duration: float) -> tuple[Array, dict[str, Array]]:
        """Simulates from the start of the motion.

        Args:
            diagram: What the builder built.
            duration: For how long, s.

        Returns:
            Times (N,), and what was logged (N, ·) by name.
        """
        simulator = Simulator(diagram, self.context(diagram))
        simulator.Initialize()
        simulator.AdvanceTo(duration)
        return self.logged(simulator.get_context())

    def logged(self, context: Context) -> tuple[Array, dict[str, Array]]:
        """Times (N,) and what was logged until now (N, ·), from the Context of the diagram.

        Raises:
            ArgumentError: Nothing is logged.
        """
        if not self.logs:
            raise ArgumentError(
                "The loop has no logs.", advice="Give add_adaptive_loop a log_period."
            )
        found = {name: sink.FindLog(context) for name, sink in self.logs.items()}
        time = np.array(next(iter(found.values())).sample_times())
        return time, {name: np.array(log.data().T) for name, log in found.items()}


def add_adaptive_loop(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    controller: AdaptiveController,
    motion: Trajectory,
    *,
    effects: Sequence[tuple[Effect, ArrayLike]] = (),
    sign_width: ArrayLike = 1e-2,
    log_period: float | None = None,
    sensor: System | None = None,
) -> AdaptiveLoop:
    """Makes a plant follow a motion under an adaptive controller.

    Args:
        builder: Where the plant is and the rest goes.
        plant: A finalized plant of one robot, continuous or discrete, an actuator at every joint.
        controller: What is to control it; added to the builder.
        motion: (nq) positions over time, twice differentiable.
        effects: Effects and their linear parameters μ that act on the plant, see `EffectForce`.
        sign_width: Speed below which dry friction fades on the plant, rad/s or m/s.
        log_period: Period of the logs, s; None for none.
        sensor: What the controller sees the plant through, such as noise: a system with one input
            and one output for positions and velocities; added to the builder. Nothing if None.

    Raises:
        ArgumentError: Plant, controller and motion do not fit together, or a joint has no actuator.
    """
    _check(plant, controller, motion, log_period)
    instance(builder, "builder", DiagramBuilder).AddSystem(controller)
    desired = builder.AddSystem(TrajectorySource(motion, 1))
    acceleration = builder.AddSystem(TrajectorySource(motion.MakeDerivative(2)))
    actuation = controller.GetOutputPort("actuation")
    measured = plant.get_state_output_port()
    if sensor is not None:
        builder.AddSystem(instance(sensor, "sensor", System))
        builder.Connect(measured, sensor.get_input_port())
        measured = sensor.get_output_port()
    builder.Connect(measured, controller.GetInputPort("estimated_state"))
    builder.Connect(desired.get_output_port(), controller.GetInputPort("desired_state"))
    builder.Connect(acceleration.get_output_port(), controller.GetInputPort("desired_acceleration"))
    _measure(builder, plant, controller)
    _actuate(builder, plant, actuation)
    force = None
    if effects:
        force = EffectForce.AddToBuilder(builder, plant, effects, sign_width=sign_width)
        builder.Connect(actuation, force.GetInputPort("applied_effort"))
    ports = {
        "state": plant.get_state_output_port(),
        "desired_state": desired.get_output_port(),
        "actuation": actuation,
        "parameters": controller.GetOutputPort("parameters"),
    }
    loop_logs = {}
    if log_period is not None:
        if controller.HasOutputPort("lyapunov"):
            ports["lyapunov"] = controller.GetOutputPort("lyapunov")
        loop_logs = {
            name: LogVectorOutput(port, builder, log_period) for name, port in ports.items()
        }
    return AdaptiveLoop(
        plant,
        controller,
        force,
        ports["state"],
        measured,
        ports["desired_state"],
        acceleration.get_output_port(),
        actuation,
        ports["parameters"],
        loop_logs,
    )


def _measure(
    builder: DiagramBuilder, plant: MultibodyPlant, controller: AdaptiveController
) -> None:
    """Connects what only some controllers measure: accelerations and efforts, exactly."""
    ports = {
        "acceleration": plant.get_generalized_acceleration_output_port(),
        "effort": controller.GetOutputPort("actuation"),
    }
    for name, port in ports.items():
        if controller.HasInputPort(name):
            builder.Connect(port, controller.GetInputPort(name))


def _actuate(builder: DiagramBuilder, plant: MultibodyPlant, actuation: OutputPort) -> None:
    """Connects efforts by velocity to actuators in whatever order they are."""
    to_velocities = plant.MakeActuationMatrix()
    port: InputPort = plant.get_actuation_input_port()
    if np.array_equal(to_velocities, np.eye(len(to_velocities))):
        builder.Connect(actuation, port)
        return
    order = builder.AddSystem(MatrixGain(np.linalg.inv(to_velocities)))
    builder.Connect(actuation, order.get_input_port())
    builder.Connect(order.get_output_port(), port)


def _check(
    plant: MultibodyPlant,
    controller: AdaptiveController,
    motion: Trajectory,
    log_period: float | None,
) -> None:
    if log_period is not None:
        positive(log_period, "log_period")  # a negative one would end the process
    check_plant(plant)
    instance(controller, "controller", AdaptiveController)
    instance(motion, "motion", Trajectory)
    joints = joint_names(plant)
    if joints != controller.control.joints:
        raise ArgumentError(
            f"The plant moves {', '.join(joints)}; the controller knows "
            f"{', '.join(controller.control.joints)}.",
            advice="Make both from the same file, and weld the plant's base (WeldFrames) before "
            "Finalize; or take the plant that load_model(file).plant is, its joints held (lock=…) "
            "that others follow.",
        )
    to_velocities = plant.MakeActuationMatrix()
    if plant.num_actuators() != len(joints) or not to_velocities.any(1).all():
        without = [joint for joint, row in zip(joints, to_velocities, strict=True) if not row.any()]
        raise ArgumentError(
            f"An adaptive loop needs one actuator at every joint; {plant.num_actuators()} are at "
            f"{len(joints)} joints, none at {', '.join(without) or '-'}.",
            advice="Use AddJointActuator before Finalize.",
        )
    if motion.rows() != plant.num_positions() or motion.cols() != 1:
        raise ArgumentError(
            f"The motion has {motion.rows()} positions; the plant {plant.num_positions()}."
        )
