"""Controllers and simulated robots that meet by LCM messages of an iiwa's driver.

The messages are Drake's `lcmt_iiwa_status` and `lcmt_iiwa_command`, for any number of joints. A
controller uses `iiwa_ports`; the other side is `add_simulated_iiwa`, Drake's hardware_sim with an
`IiwaDriver` in torque_only mode, or a real iiwa.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from drake import lcmt_iiwa_command, lcmt_iiwa_status
from pydrake.common.value import AbstractValue
from pydrake.lcm import DrakeLcmInterface
from pydrake.manipulation import IiwaCommandReceiver, IiwaControlMode, IiwaStatusSender
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.controllers import InverseDynamics
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.lcm import LcmPublisherSystem, LcmSubscriberSystem
from pydrake.systems.primitives import Adder, Demultiplexer

from geodrake.errors import ArgumentError
from geodrake.robot import RobotPorts


@dataclass
class IiwaMessages:
    """LCM channels between a robot and its controller, as those of Drake's `IiwaDriver`."""

    lcm_bus: str = "default"  # one of the scenario's `lcm_buses`
    status_channel: str = "IIWA_STATUS"  # channel of `lcmt_iiwa_status`, which the robot sends
    # Channel of `lcmt_iiwa_command`, whose torques the controller sends.
    command_channel: str = "IIWA_COMMAND"
    status_period: float = 0.005  # time between status messages, s
    command_period: float = 0.005  # time between commands, s
    # File of the model whose gravity the robot's driver compensates on its own, so that commands
    # are what is beside it; empty for a driver that does not. Drake's `IiwaDriver`, and the
    # controller of a real iiwa, do.
    gravity_model: str = ""
    # For how long a controller waits for the first status of a robot that is not simulated here, s.
    patience: float = 10.0


class StatusReader(LeafSystem):
    """The measured state (2 n) in a status; before the first, NaN, which means missing."""

    def __init__(self, joints: int) -> None:
        LeafSystem.__init__(self)
        self._joints = joints
        self._status = self.DeclareAbstractInputPort(
            "lcmt_iiwa_status", AbstractValue.Make(lcmt_iiwa_status())
        )
        self.DeclareVectorOutputPort("state", BasicVector(2 * joints), self._calc_state)

    def _calc_state(self, context: Context, output: BasicVector) -> None:
        message, state = self._status.Eval(context), np.full(2 * self._joints, np.nan)
        if message.num_joints not in (0, self._joints):
            raise ArgumentError(
                f"A status of {message.num_joints} joints came; the controller knows "
                f"{self._joints}.",
                advice="Check the channel, and the controller's model.",
            )
        if message.num_joints:
            state[:] = [*message.joint_position_measured, *message.joint_velocity_estimated]
        output.SetFromVector(state)


class CommandWriter(LeafSystem):
    """Efforts as a command of torques, stamped with the time of the Context.

    Gravity of `gravity_plant` at the state is subtracted. Torques are zero before there is a state.
    """

    def __init__(self, joints: int, gravity_plant: MultibodyPlant | None = None) -> None:
        LeafSystem.__init__(self)
        self._plant, self._joints = gravity_plant, joints
        self._scratch = None if gravity_plant is None else gravity_plant.CreateDefaultContext()
        self._effort = self.DeclareVectorInputPort("effort", BasicVector(joints))
        self._state = self.DeclareVectorInputPort("state", BasicVector(2 * joints))
        self.DeclareAbstractOutputPort(
            "lcmt_iiwa_command", lambda: AbstractValue.Make(lcmt_iiwa_command()), self._calc_command
        )

    def _calc_command(self, context: Context, output: AbstractValue) -> None:
        torques, q = self._effort.Eval(context), self._state.Eval(context)[: self._joints]
        if self._plant is not None:
            if np.isfinite(q).all():
                self._plant.SetPositions(self._scratch, q)
                torques = torques + self._plant.CalcGravityGeneralizedForces(self._scratch)
            else:
                torques = np.zeros(self._joints)
        message = lcmt_iiwa_command()
        message.utime = round(1e6 * context.get_time())
        message.num_torques, message.joint_torque = self._joints, torques.tolist()
        output.set_value(message)


def iiwa_ports(
    builder: DiagramBuilder,
    joints: Sequence[str],
    lcm: DrakeLcmInterface,
    messages: IiwaMessages,
    *,
    gravity_plant: MultibodyPlant | None = None,
    elsewhere: bool = False,
) -> RobotPorts:
    """Return the ports of a controller for a robot that is driven by messages.

    Args:
        joints: Names of the n joints in the order of the messages.
        lcm: Interface for the messages, which the diagram must pump, as by `ApplyLcmBusConfig`.
        gravity_plant: As for `CommandWriter`, if the robot's driver compensates gravity.
        elsewhere: Whether the robot is in another process, so that a simulation begins with its
            first status, or after `messages.patience`.
    """
    n, patience = len(joints), messages.patience if elsewhere else 0.0
    subscriber = LcmSubscriberSystem.Make(
        channel=messages.status_channel,
        lcm_type=lcmt_iiwa_status,
        lcm=lcm,
        wait_for_message_on_initialization_timeout=patience,
    )
    status, reader = builder.AddSystem(subscriber), builder.AddSystem(StatusReader(n))
    writer = builder.AddSystem(CommandWriter(n, gravity_plant))
    builder.Connect(status.get_output_port(), reader.get_input_port())
    builder.Connect(reader.get_output_port(), writer.GetInputPort("state"))
    command = _publisher(messages.command_channel, lcmt_iiwa_command, messages.command_period, lcm)
    builder.Connect(writer.get_output_port(), builder.AddSystem(command).get_input_port())
    ports = tuple(joints), reader.get_output_port(), None, writer.GetInputPort("effort")
    return RobotPorts(*ports)


def add_simulated_iiwa(
    builder: DiagramBuilder,
    robot: RobotPorts,
    lcm: DrakeLcmInterface,
    messages: IiwaMessages,
    *,
    gravity_plant: MultibodyPlant | None = None,
) -> OutputPort:
    """Add the driver of a simulated robot, which sends its status; return the efforts (n).

    Args:
        robot: Its ports, with the joints in the order of the messages.
        gravity_plant: Plant of the robot alone whose gravity the driver compensates. Keep it as
            long as the diagram.
    """
    n = len(robot.joints)
    subscriber = builder.AddSystem(
        LcmSubscriberSystem.Make(
            channel=messages.command_channel,
            lcm_type=lcmt_iiwa_command,
            lcm=lcm,
            use_cpp_serializer=True,
        )
    )
    receiver = builder.AddSystem(IiwaCommandReceiver(n, IiwaControlMode.kTorqueOnly))
    builder.Connect(subscriber.get_output_port(), receiver.GetInputPort("lcmt_iiwa_command"))
    effort = commanded = receiver.GetOutputPort("torque")
    if gravity_plant is not None:
        mode = InverseDynamics.InverseDynamicsMode.kGravityCompensation
        gravity = builder.AddSystem(InverseDynamics(gravity_plant, mode))
        builder.Connect(robot.state, gravity.GetInputPort("estimated_state"))
        total = builder.AddSystem(Adder(2, n))
        builder.Connect(commanded, total.get_input_port(0))
        builder.Connect(gravity.get_output_port(), total.get_input_port(1))
        effort = total.get_output_port()
    builder.Connect(effort, robot.effort)
    halves, sender = (
        builder.AddSystem(Demultiplexer([n, n])),
        builder.AddSystem(IiwaStatusSender(n)),
    )
    builder.Connect(robot.state, halves.get_input_port())
    for name, port in {
        "position_commanded": halves.get_output_port(0),  # as none is
        "position_measured": halves.get_output_port(0),
        "velocity_estimated": halves.get_output_port(1),
        "torque_commanded": commanded,
        "torque_measured": effort,
    }.items():
        builder.Connect(port, sender.GetInputPort(name))
    status = _publisher(
        messages.status_channel, lcmt_iiwa_status, messages.status_period, lcm, of_drake=True
    )
    builder.Connect(sender.get_output_port(), builder.AddSystem(status).get_input_port())
    return effort


def _publisher(
    channel: str, kind: type, period: float, lcm: DrakeLcmInterface, *, of_drake: bool = False
) -> Any:
    return LcmPublisherSystem.Make(
        channel=channel, lcm_type=kind, lcm=lcm, publish_period=period, use_cpp_serializer=of_drake
    )
