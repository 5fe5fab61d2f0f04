"""Drives that make a plant follow a motion."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuatorIndex
from pydrake.systems.controllers import InverseDynamics
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import TrajectorySource
from pydrake.trajectories import Trajectory

from geodrake.boundary.arguments import instance
from geodrake.errors import ArgumentError


def add_tracking_drives(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    motion: Trajectory,
    *,
    controller_plant: MultibodyPlant,
) -> OutputPort:
    """Add what makes a plant follow a motion: feedforward by inverse dynamics, PD at the joints.

    The PD control is that of the plant's own actuators, which a discrete plant takes implicitly:
    its gains may be as stiff as those of real drives.

    Args:
        plant: A finalized discrete plant of one robot, an actuator with controller gains at every
            joint, in the order of the joints.
        motion: (nq) positions over time, twice differentiable.
        controller_plant: What the controller knows of the robot; keep it as long as the diagram.

    Returns:
        The effort of the drives (nv), N·m or N: that of the last step, at its end.

    Raises:
        ArgumentError: A joint has no actuator, an actuator no gains, or they are in another order;
            or the plant is continuous, or the motion one of another robot.
    """
    instance(builder, "builder", DiagramBuilder)
    for name, each in (("plant", plant), ("controller_plant", controller_plant)):
        instance(each, name, MultibodyPlant)  # None in its place would end the process
    instance(motion, "motion", Trajectory)
    count = plant.num_actuators()
    actuators = [plant.get_joint_actuator(JointActuatorIndex(i)) for i in range(count)]
    without = [actuator.name() for actuator in actuators if not actuator.has_controller()]
    if count != plant.num_velocities() or without:
        raise ArgumentError(
            f"Tracking needs an actuator with gains at every joint; {count} of "
            f"{plant.num_velocities()} have one; without gains are {without}.",
            advice="Use AddJointActuator and set_controller_gains before Finalize.",
        )
    if not np.array_equal(plant.MakeActuationMatrix(), np.eye(count)):
        raise ArgumentError(
            "Tracking needs actuators in the order of the joints; their order is "
            f"{', '.join(actuator.joint().name() for actuator in actuators)}.",
            advice="Add the actuators in the order of plant.GetJointIndices().",
        )
    if plant.time_step() == 0 or motion.rows() != plant.num_positions() or motion.cols() != 1:
        raise ArgumentError(
            f"Tracking needs a discrete plant and a motion of its {plant.num_positions()} "
            f"positions; got a time step of {plant.time_step()} s and {motion.rows()} "
            "positions."
        )
    feedforward = builder.AddSystem(
        InverseDynamics(controller_plant, InverseDynamics.InverseDynamicsMode.kInverseDynamics)
    )
    state = builder.AddSystem(TrajectorySource(motion, 1))
    acceleration = builder.AddSystem(TrajectorySource(motion.MakeDerivative(2)))
    arm = actuators[0].model_instance()
    builder.Connect(state.get_output_port(), feedforward.GetInputPort("estimated_state"))
    builder.Connect(state.get_output_port(), plant.get_desired_state_input_port(arm))
    builder.Connect(
        acceleration.get_output_port(), feedforward.GetInputPort("desired_acceleration")
    )
    builder.Connect(feedforward.get_output_port(), plant.get_actuation_input_port())
    return plant.get_net_actuation_output_port()
