"""State read from, and efforts written to, messages of an iiwa's driver.

The messages are `lcmt_iiwa_status` and `lcmt_iiwa_command` of Drake, for any number of joints. A
controller meets `iiwa_ports`, and drives what speaks these messages: `add_simulated_iiwa` here,
Drake's hardware_sim with an `IiwaDriver` in torque_only mode, or a real iiwa.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from drake import lcmt_iiwa_command, lcmt_iiwa_status
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcmInterface
from pydrake.manipulation import IiwaCommandReceiver, IiwaControlMode, IiwaStatusSender
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    LeafSystem,
    OutputPort,
)
from pydrake.systems.lcm import LcmPublisherSystem, LcmSubscriberSystem
from pydrake.systems.primitives import Adder, Demultiplexer, Gain

from geodrake.boundary.arguments import instance, integer, number, positive, real_array
from geodrake.control.scenes.scenario import IiwaMessages
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.inertia.bodies import check_plant
from geodrake.robot.robot_instance import RobotPorts

_MICROSECONDS = 1e6  # in a second


def state_of(message: lcmt_iiwa_status, joints: int) -> Array:
    """(2 n,) measured positions and then velocities of a status; NaN before there is one.

    Args:
        message: The status; one without joints is none.

    Raises:
        ArgumentError: It is of another number of joints.
    """
    if message.num_joints == 0:
        return np.full(2 * joints, np.nan)
    if message.num_joints != joints:
        raise ArgumentError(
            f"A status of {message.num_joints} joints came; the controller knows {joints}.",
            advice="Check the channel, and the controller's model.",
        )
    return np.array([*message.joint_position_measured, *message.joint_velocity_estimated])


def command_of(time: float, efforts: ArrayLike) -> lcmt_iiwa_command:
    """A command of torques alone.

    Args:
        time: Time stamp, s.
        efforts: (n,) N·m; all zero in the command if one is not finite, as before the first status
            where gravity is taken off.
    """
    torques = real_array(efforts, "efforts", ("n",), finite=False)
    torques = torques if np.isfinite(torques).all() else np.zeros(len(torques))
    message = lcmt_iiwa_command()
    message.utime = round(number(time, "time") * _MICROSECONDS)
    message.num_torques, message.joint_torque = len(torques), torques.tolist()
    return message


class IiwaStatusReader(LeafSystem):
    """The measured state in a status.

    .. pydrake_system::

        name: IiwaStatusReader
        input_ports:
        - lcmt_iiwa_status
        output_ports:
        - state

    `state` (2 n) is NaN until a status comes, which adaptive controllers take for missing.
    """

    def __init__(self, joints: int) -> None:
        LeafSystem.__init__(self)
        self._joints = integer(joints, "joints", lower=1)
        self._status = self.DeclareAbstractInputPort(
            "lcmt_iiwa_status", AbstractValue.Make(lcmt_iiwa_status())
        )
        self.DeclareVectorOutputPort("state", BasicVector(2 * joints), self._calc_state)

    def _calc_state(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(state_of(self._status.Eval(context), self._joints))


class IiwaCommandWriter(LeafSystem):
    """Efforts as a command, stamped with the time of the Context.

    .. pydrake_system::

        name: IiwaCommandWriter
        input_ports:
        - effort
        output_ports:
        - lcmt_iiwa_command
    """

    def __init__(self, joints: int) -> None:
        LeafSystem.__init__(self)
        size = integer(joints, "joints", lower=1)
        self._effort = self.DeclareVectorInputPort("effort", BasicVector(size))
        self.DeclareAbstractOutputPort(
            "lcmt_iiwa_command",
            lambda: AbstractValue.Make(lcmt_iiwa_command()),
            self._calc_command,
        )

    def _calc_command(self, context: Context, output: AbstractValue) -> None:
        output.set_value(command_of(context.get_time(), self._effort.Eval(context)))


class GravityCompensation(LeafSystem):
    """Efforts that hold a robot against gravity, −τ_g(q).

    .. pydrake_system::

        name: GravityCompensation
        input_ports:
        - state
        output_ports:
        - effort

    Unlike Drake's `InverseDynamics`, it takes a state that is not finite, and answers NaN.

    Args:
        plant: A finalized plant of the robot alone.
    """

    def __init__(self, plant: MultibodyPlant) -> None:
        LeafSystem.__init__(self)
        check_plant(plant)
        self._plant, self._scratch = plant, plant.CreateDefaultContext()
        states = plant.num_positions() + plant.num_velocities()
        self._state = self.DeclareVectorInputPort("state", BasicVector(states))
        self.DeclareVectorOutputPort(
            "effort", BasicVector(plant.num_velocities()), self._calc_effort
        )

    def _calc_effort(self, context: Context, output: BasicVector) -> None:
        q = self._state.Eval(context)[: self._plant.num_positions()]
        if not np.isfinite(q).all():
            output.SetFromVector(np.full(output.size(), np.nan))
            return
        self._plant.SetPositions(self._scratch, q)
        output.SetFromVector(-self._plant.CalcGravityGeneralizedForces(self._scratch))


def iiwa_ports(
    builder: DiagramBuilder,
    joints: Sequence[str],
    lcm: DrakeLcmInterface,
    messages: IiwaMessages,
    *,
    gravity_plant: MultibodyPlant | None = None,
    elsewhere: bool = False,
) -> RobotPorts:
    """Where a controller meets a robot that is driven by messages.

    Args:
        builder: The controller's builder.
        joints: Names of the n joints in the order of the messages.
        lcm: Where messages go, such as one of `ApplyLcmBusConfig`, which the diagram then pumps.
        messages: Channels and periods.
        gravity_plant: Plant of the robot alone whose gravity the robot's driver compensates on its
            own; its efforts are taken off commands. Keep it as long as the diagram.
        elsewhere: Whether the robot is in another process, so that a simulation begins with its
            first status, or after `messages.patience`.

    Returns:
        State and efforts; there are no accelerations.
    """
    _check(builder, messages)
    n = len(joints)
    status = builder.AddSystem(
        LcmSubscriberSystem.Make(
            channel=messages.status_channel,
            lcm_type=lcmt_iiwa_status,
            lcm=lcm,
            wait_for_message_on_initialization_timeout=messages.patience if elsewhere else 0.0,
        )
    )
    reader, writer = builder.AddSystem(IiwaStatusReader(n)), builder.AddSystem(IiwaCommandWriter(n))
    command = builder.AddSystem(
        LcmPublisherSystem.Make(
            channel=messages.command_channel,
            lcm_type=lcmt_iiwa_command,
            lcm=lcm,
            publish_period=messages.command_period,
        )
    )
    builder.Connect(status.get_output_port(), reader.get_input_port())
    builder.Connect(writer.get_output_port(), command.get_input_port())
    state, effort = reader.get_output_port(), writer.get_input_port()
    if gravity_plant is not None:
        taken_off, beside = builder.AddSystem(Gain(-1.0, n)), builder.AddSystem(Adder(2, n))
        builder.Connect(_gravity(builder, gravity_plant, state), taken_off.get_input_port())
        builder.Connect(taken_off.get_output_port(), beside.get_input_port(1))
        builder.Connect(beside.get_output_port(), effort)
        effort = beside.get_input_port(0)
    return RobotPorts(tuple(joints), state, None, effort)


def add_simulated_iiwa(
    builder: DiagramBuilder,
    robot: RobotPorts,
    lcm: DrakeLcmInterface,
    messages: IiwaMessages,
    *,
    gravity_plant: MultibodyPlant | None = None,
) -> OutputPort:
    """Adds the driver of a simulated robot: it sends its status and obeys the torques of commands.

    Args:
        robot: Its ports, with the joints in the order of the messages.
        gravity_plant: Plant of the robot alone whose gravity the driver compensates beside what is
            commanded. Keep it as long as the diagram.

    Returns:
        The efforts (n) that act.
    """
    _check(builder, messages)
    n, mode = len(robot.joints), IiwaControlMode.kTorqueOnly
    subscriber = builder.AddSystem(
        LcmSubscriberSystem.Make(
            channel=messages.command_channel,
            lcm_type=lcmt_iiwa_command,
            lcm=lcm,
            use_cpp_serializer=True,
        )
    )
    receiver = builder.AddSystem(IiwaCommandReceiver(n, mode))
    builder.Connect(subscriber.get_output_port(), receiver.GetInputPort("lcmt_iiwa_command"))
    commanded = receiver.GetOutputPort("torque")
    effort = commanded
    if gravity_plant is not None:
        total = builder.AddSystem(Adder(2, n))
        gravity = _gravity(builder, gravity_plant, robot.state)
        builder.Connect(commanded, total.get_input_port(0))
        builder.Connect(gravity, total.get_input_port(1))
        effort = total.get_output_port()
    builder.Connect(effort, robot.effort)
    _send_status(builder, robot, (commanded, effort), lcm, messages)
    return effort


def _send_status(
    builder: DiagramBuilder,
    robot: RobotPorts,
    efforts: tuple[OutputPort, OutputPort],
    lcm: DrakeLcmInterface,
    messages: IiwaMessages,
) -> None:
    """Sends positions and velocities, and efforts as commanded and as measured."""
    n, (commanded, measured) = len(robot.joints), efforts
    sender = builder.AddSystem(IiwaStatusSender(n))
    halves = builder.AddSystem(Demultiplexer([n, n]))
    builder.Connect(robot.state, halves.get_input_port())
    ports = {
        "position_commanded": halves.get_output_port(0),  # as none is
        "position_measured": halves.get_output_port(0),
        "velocity_estimated": halves.get_output_port(1),
        "torque_commanded": commanded,
        "torque_measured": measured,
    }
    for name, port in ports.items():
        builder.Connect(port, sender.GetInputPort(name))
    publisher = builder.AddSystem(
        LcmPublisherSystem.Make(
            channel=messages.status_channel,
            lcm_type=lcmt_iiwa_status,
            lcm=lcm,
            publish_period=messages.status_period,
            use_cpp_serializer=True,
        )
    )
    builder.Connect(sender.get_output_port(), publisher.get_input_port())


def _gravity(builder: DiagramBuilder, plant: MultibodyPlant, state: OutputPort) -> OutputPort:
    """Efforts (n) that hold a robot against gravity."""
    hold = builder.AddSystem(GravityCompensation(plant))
    builder.Connect(state, hold.get_input_port())
    return hold.get_output_port()


def _check(builder: DiagramBuilder, messages: IiwaMessages) -> None:
    instance(builder, "builder", DiagramBuilder)
    instance(messages, "messages", IiwaMessages)
    positive(messages.status_period, "status_period")  # others would end the process
    positive(messages.command_period, "command_period")
