"""Servos that hold positions that they are told."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import (
    BasicVector,
    Context,
    ContinuousState,
    DiagramBuilder,
    LeafSystem,
    OutputPort,
)

from geodrake.boundary.arguments import instance, one_or_each, real_array
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.inertia.bodies import check_context
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import ServoError, ServoGains, command_delays, servo_gains
from geodrake.model.simulation.robot_in_diagram import RobotInDiagram, late
from geodrake.model.simulation.scalar_system import differenced


def _checked(name: str, value: ArrayLike, count: int) -> Array:
    """Return gains (count,) of one name, which are at least 0; a limit is above, or infinite."""
    found = one_or_each(value, name, count, strict=name == "limit", finite=name != "limit")
    if name == "rate_share" and (found > 1.0).any():
        raise ArgumentError(f"{name} must be at most 1; it is {found.max():g}.", name=name)
    return found


@differenced
class PositionServo(LeafSystem):
    """Servos of joints: PD or PID on the position, with limits, a dead band, and feedforward.

    .. pydrake_system::

        name: PositionServo
        input_ports:
        - commanded_position
        - commanded_velocity
        - estimated_state
        - feedforward
        output_ports:
        - actuation

    With the command c and the estimated state q, v,

        actuation = sat(kp e + kd (ρ ċ − v) + ki ∫e dt + feedforward),   e = dead(c − q)

    where dead takes the dead band off the error, and sat keeps efforts within ±limit. An integral,
    a continuous state, stays where the effort is at its limit and would go beyond.

    `commanded_velocity` is ċ, and zero if the port is not connected: kd then damps the motion
    itself, as `kv` of MuJoCo's position actuators does. So is `feedforward`, N·m or N: a joint
    with no gains passes it on, up to its limit.

    A command that acts late goes through `DelayedEffort` before it comes here, or through Drake's
    DiscreteTimeDelay where delays are alike and a whole number of its steps; `AddToBuilder` sees
    to that.

    Gains are numeric parameters of the Context (`set_gains`). The system can be cloned, and
    converted to AutoDiffXd.

    A servo alone swings at √(kp / inertia); explicit integrators need steps well below one over
    that, and below 2 · inertia / kd.

    Args:
        kp: (n,) effort per error of position, N·m/rad or N/m; its length is the number of joints.
        kd: Effort per error of velocity, N·m·s/rad or N·s/m; like all others one for all joints or
            (n,).
        ki: Effort per integral of the error of position, N·m/(rad·s) or N/(m·s).
        limit: Largest effort, N·m or N.
        dead_band: Error of position up to which nothing is done about it, rad or m.
        rate_share: ρ, how much of the command's rate the damping knows; 0 damps the motion alone.
    """

    def __init__(
        self,
        kp: ArrayLike,
        *,
        kd: ArrayLike = 0.0,
        ki: ArrayLike = 0.0,
        limit: ArrayLike = np.inf,
        dead_band: ArrayLike = 0.0,
        rate_share: ArrayLike = 1.0,
    ) -> None:
        """Construct the system."""
        LeafSystem.__init__(self, converter=self._converter)
        kp = real_array(kp, "kp")
        self._count = n = len(kp) if kp.ndim == 1 else len(real_array([kp], "kp", ("n",)))
        named = zip(ServoGains._fields, (kp, kd, ki, limit, dead_band, rate_share), strict=True)
        gains = ServoGains(*(_checked(name, value, n) for name, value in named))
        self._integral = bool(gains.ki.any())
        for values in gains:
            self.DeclareNumericParameter(BasicVector(values))
        self._command_port = self.DeclareVectorInputPort("commanded_position", BasicVector(n))
        self._rate_port = self.DeclareVectorInputPort("commanded_velocity", BasicVector(n))
        self._state_port = self.DeclareVectorInputPort("estimated_state", BasicVector(2 * n))
        self._feedforward_port = self.DeclareVectorInputPort("feedforward", BasicVector(n))
        known = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        if self._integral:
            self.DeclareContinuousState(n)
            known.add(self.xc_ticket())
        self.DeclareVectorOutputPort("actuation", BasicVector(n), self._calc_actuation, known)

    def gains(self, context: Context) -> ServoGains:
        """Return the gains in a Context."""
        groups = range(len(ServoGains._fields))
        return ServoGains(*(context.get_numeric_parameter(i).CopyToVector() for i in groups))

    def set_gains(self, context: Context, **gains: ArrayLike) -> None:
        """Change gains in a Context.

        Args:
            **gains: Those of kp, kd, ki, limit, dead_band and rate_share that change; one for all
                joints or (n,).
        """
        check_context(self, context)
        names = ServoGains._fields
        if unknown := [name for name in gains if name not in names]:
            raise ArgumentError(
                f"A servo has no {', '.join(unknown)}.", advice=f"It has {', '.join(names)}."
            )
        values = {name: _checked(name, value, self._count) for name, value in gains.items()}
        if not self._integral and values.get("ki", np.zeros(1)).any():
            raise ArgumentError(
                "This servo was constructed without integral gain.",
                advice="Pass a positive ki to its constructor.",
            )
        for name, own in values.items():
            context.get_mutable_numeric_parameter(names.index(name)).SetFromVector(own)

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Rates of the integrals, rad or m; see `LeafSystem`."""
        if derivatives.size():
            rates = self.gains(context).integral_rate(self._error(context))
            derivatives.get_mutable_vector().SetFromVector(rates)

    def _calc_actuation(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.gains(context).effort(self._error(context)))

    def _error(self, context: Context) -> ServoError:
        n, state = self._count, self._state_port.Eval(context)
        rate, feedforward = (
            port.Eval(context) if port.HasValue(context) else np.zeros(n)
            for port in (self._rate_port, self._feedforward_port)
        )
        held = context.get_continuous_state_vector().CopyToVector()
        integral = held if self._integral else np.zeros(n)
        position = self._command_port.Eval(context) - state[:n]
        known = self.gains(context).rate_share * rate
        return ServoError(position, known - state[n:], integral, feedforward)

    @staticmethod
    def of(model: RobotModel) -> PositionServo:
        """Return the servos that a model's `effort_signals` state, of all its joints.

        Joints that have none are without gains, and pass feedforward on.

        Raises:
            ModelError: It has no servos, or joints of several degrees of freedom.
        """
        return PositionServo(**servo_gains(instance(model, "model", RobotModel))._asdict())

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        model: RobotModel,
        robot: RobotInDiagram,
        command: OutputPort,
        rate: OutputPort | None = None,
    ) -> PositionServo:
        """Add a model's servos, and connect them with the robot that they drive.

        Commands are late by the servos' delays, exactly where they are straight lines between
        instants a sampling period apart: a millisecond, or the shortest delay.

        Args:
            command: Commanded positions (n,) in the order of `model.joints`, rad or m.
            rate: Their rates (n,); zero if None.

        Returns:
            The servos; `feedforward` is left to be connected.
        """
        instance(builder, "builder", DiagramBuilder)
        instance(robot, "robot", RobotInDiagram)
        servo = builder.AddNamedSystem("servos", PositionServo.of(model))
        builder.Connect(robot.state, servo.GetInputPort("estimated_state"))
        for name, port in (("commanded_position", command), ("commanded_velocity", rate)):
            if port is not None:
                acting = late(builder, f"late_{name}", port, command_delays(model))
                builder.Connect(acting, servo.GetInputPort(name))
        builder.Connect(servo.GetOutputPort("actuation"), robot.effort)
        return servo
