"""Position servos."""

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
    """Return gains (count,) of a kind, checked: ≥ 0, or > 0 and possibly infinite for a limit."""
    gains = one_or_each(value, name, count, strict=name == "limit", finite=name != "limit")
    if name == "rate_share" and (gains > 1.0).any():
        raise ArgumentError(f"{name} must be at most 1; it is {gains.max():g}.", name=name)
    return gains


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

    where dead subtracts the dead band from the error, and sat limits efforts to ±limit. The
    integral, a continuous state, does not wind up while the effort is saturated.

    `commanded_velocity` is ċ, zero if not connected: kd then damps the motion itself, like `kv` of
    MuJoCo's position actuators. `feedforward`, N·m or N, is also zero if not connected. A joint
    without gains passes it on, up to its limit.

    Delay late commands by `DelayedEffort`, or by Drake's DiscreteTimeDelay if delays are equal and
    multiples of its time step. `AddToBuilder` takes care of this.

    Gains are numeric parameters of the Context (`set_gains`). The system can be cloned, and
    converted to AutoDiffXd.

    A servo oscillates at √(kp / inertia). Explicit integrators need steps well below the inverse,
    and below 2 · inertia / kd.

    Args:
        kp: (n,) effort per position error, N·m/rad or N/m; its length is the number of joints.
        kd: Effort per velocity error, N·m·s/rad or N·s/m; scalar or (n,), like all others.
        ki: Effort per integral of the position error, N·m/(rad·s) or N/(m·s).
        limit: Effort limit, N·m or N.
        dead_band: Position error that is ignored, rad or m.
        rate_share: ρ, fraction of the command's rate in the damping term; 0 damps only the motion.
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
        pairs = zip(ServoGains._fields, (kp, kd, ki, limit, dead_band, rate_share), strict=True)
        gains = ServoGains(*(_checked(name, value, n) for name, value in pairs))
        self._integral = bool(gains.ki.any())
        for values in gains:
            self.DeclareNumericParameter(BasicVector(values))
        self._command_port = self.DeclareVectorInputPort("commanded_position", BasicVector(n))
        self._rate_port = self.DeclareVectorInputPort("commanded_velocity", BasicVector(n))
        self._state_port = self.DeclareVectorInputPort("estimated_state", BasicVector(2 * n))
        self._feedforward_port = self.DeclareVectorInputPort("feedforward", BasicVector(n))
        tickets = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        if self._integral:
            self.DeclareContinuousState(n)
            tickets.add(self.xc_ticket())
        self.DeclareVectorOutputPort("actuation", BasicVector(n), self._calc_actuation, tickets)

    def gains(self, context: Context) -> ServoGains:
        """Return the gains in a Context."""
        groups = range(len(ServoGains._fields))
        return ServoGains(*(context.get_numeric_parameter(i).CopyToVector() for i in groups))

    def set_gains(self, context: Context, **gains: ArrayLike) -> None:
        """Change gains in a Context.

        Args:
            **gains: Any of kp, kd, ki, limit, dead_band and rate_share; scalar or (n,).
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
        for name, vector in values.items():
            context.get_mutable_numeric_parameter(names.index(name)).SetFromVector(vector)

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Write the rates of the integrals, rad or m."""
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
        integral = np.zeros(n)
        if self._integral:
            integral = context.get_continuous_state_vector().CopyToVector()
        position = self._command_port.Eval(context) - state[:n]
        velocity = self.gains(context).rate_share * rate - state[n:]
        return ServoError(position, velocity, integral, feedforward)

    @staticmethod
    def of(model: RobotModel) -> PositionServo:
        """Return the servos of all joints as defined by a model's `effort_signals`.

        Joints without a servo have zero gains, and pass feedforward on.

        Raises:
            ModelError: The model has no servos, or joints with several degrees of freedom.
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
        """Add a model's servos, and connect them with their robot.

        Commands are delayed by the servos' delays. They are sampled every millisecond, or at the
        shortest delay if that is less, and interpolated linearly.

        Args:
            command: Commanded positions (n,) in the order of `model.joints`, rad or m.
            rate: Their rates (n,); zero if None.

        Returns:
            The servos, with `feedforward` not connected.
        """
        instance(builder, "builder", DiagramBuilder)
        instance(robot, "robot", RobotInDiagram)
        servo = builder.AddNamedSystem("servos", PositionServo.of(model))
        builder.Connect(robot.state, servo.GetInputPort("estimated_state"))
        for name, port in (("commanded_position", command), ("commanded_velocity", rate)):
            if port is not None:
                delayed = late(builder, f"late_{name}", port, command_delays(model))
                builder.Connect(delayed, servo.GetInputPort(name))
        builder.Connect(servo.GetOutputPort("actuation"), robot.effort)
        return servo
