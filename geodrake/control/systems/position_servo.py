"""Servos that hold positions that they are told."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import (
    Context,
    ContinuousState,
    DiagramBuilder,
    LeafSystem,
    OutputPort,
)

from geodrake.boundary.arguments import instance, one_or_each
from geodrake.control.motors import ServoError, ServoGains, integral_rate, servo_effort
from geodrake.control.systems.joint_system import JointSystem, count_of
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.inertia.bodies import check_context
from geodrake.model.formulas.evaluation import Scalars
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import command_delays, servo_gains
from geodrake.model.simulation.robot_in_diagram import RobotInDiagram, late
from geodrake.model.simulation.scalar_system import add_scalar_types

_GAINS = ("kp", "kd", "ki", "limit", "dead_band")
_Law = Callable[[ServoGains, ServoError], Scalars]
_STRICT, _INFINITE = ("limit",), ("limit",)  # gains that cannot be zero, and that may be infinite


def _checked(name: str, value: ArrayLike, count: int) -> Array:
    """Gains (count,) of one name.

    Raises:
        ArgumentError: They are negative, a limit is zero, or they are not as many.
    """
    strict, finite = name in _STRICT, name not in _INFINITE
    return one_or_each(value, name, count, strict=strict, finite=finite)


class _PositionServo(JointSystem):
    """`PositionServo` of any scalar type."""

    def _declare(self, gains: dict[str, Scalars], integral: bool, converter: Any) -> None:
        self._begin(converter)
        self._initial, self._integral = gains, integral
        self._declare_numbers(gains)
        n = self._count
        self._command_port = self.DeclareVectorInputPort("commanded_position", self._vector(n))
        self._rate_port = self.DeclareVectorInputPort("commanded_velocity", self._vector(n))
        self._state_port = self.DeclareVectorInputPort("estimated_state", self._vector(2 * n))
        self._feedforward_port = self.DeclareVectorInputPort("feedforward", self._vector(n))
        known = {self.all_input_ports_ticket(), self.all_parameters_ticket()}
        if integral:
            self.DeclareContinuousState(n)
            known.add(self.xc_ticket())
        self.DeclareVectorOutputPort("actuation", self._vector(n), self._calc_actuation, known)

    def gains(self, context: Context) -> ServoGains:
        """Return the gains in a Context."""
        return ServoGains(**self._numbers(context))

    def set_gains(self, context: Context, **gains: ArrayLike) -> None:
        """Changes gains in a Context.

        Args:
            **gains: Those of kp, kd, ki, limit and dead_band that change; one for all joints or
                (n,).

        Raises:
            ArgumentError: There is no such gain, a gain is negative, or ki is given to a servo that
                was made without an integral.
        """
        check_context(self, context)
        if unknown := [name for name in gains if name not in _GAINS]:
            raise ArgumentError(
                f"A servo has no {', '.join(unknown)}.", advice=f"It has {', '.join(_GAINS)}."
            )
        values = {name: _checked(name, value, self._count) for name, value in gains.items()}
        if not self._integral and values.get("ki", np.zeros(1)).any():
            raise ArgumentError(
                "This servo was made without an integral.",
                advice="Give its constructor a ki above zero.",
            )
        self._set_numbers(context, values)

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Rates of the integrals; see `LeafSystem`.

        Args:
            derivatives: Receives the rates, rad or m.
        """
        if derivatives.size():
            rates = self._law(integral_rate, context)
            self._set(derivatives.get_mutable_vector(), rates)

    def _calc_actuation(self, context: Context, output: Any) -> None:
        self._set(output, self._law(servo_effort, context))

    def _law(self, law: _Law, context: Context) -> Scalars:
        n = self._count
        state, none = np.asarray(self._state_port.Eval(context)), np.zeros(n)
        rate, feedforward = (
            np.asarray(port.Eval(context)) if port.HasValue(context) else none
            for port in (self._rate_port, self._feedforward_port)
        )
        integral = context.get_continuous_state_vector().CopyToVector() if self._integral else none
        command = np.asarray(self._command_port.Eval(context))
        told = command, state[:n], rate, state[n:], np.asarray(integral), feedforward

        def of_inputs(*values: Scalars) -> Scalars:
            c, q, c_rate, v, *more = values[len(_GAINS) :]
            return law(ServoGains(*values[: len(_GAINS)]), ServoError(c - q, c_rate - v, *more))

        return self._apply(of_inputs, *self._numbers(context).values(), *told)


class PositionServo(_PositionServo, LeafSystem):
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

        actuation = sat(kp e + kd (ċ − v) + ki ∫e dt + feedforward),   e = dead(c − q)

    where dead takes the dead band off the error, and sat keeps efforts within ±limit. An integral,
    a continuous state, stays where the effort is at its limit and would go beyond.

    `commanded_velocity` is ċ, and zero if the port is not connected: kd then damps the motion
    itself, as `kv` of MuJoCo's position actuators does. So is `feedforward`, N·m or N: a joint
    with no gains passes it on, up to its limit.

    A command that acts late goes through `DelayedEffort` before it comes here, or through Drake's
    DiscreteTimeDelay where delays are alike and a whole number of its steps; `AddToBuilder` sees
    to that.

    Gains are numeric parameters of the Context (`set_gains`). The system can be cloned, and
    converted to AutoDiffXd and Expression.

    A servo alone swings at √(kp / inertia); explicit integrators need steps well below one over
    that, and below 2 · inertia / kd.

    Args:
        kp: (n,) effort per error of position, N·m/rad or N/m; its length is the number of joints.
        kd: Effort per error of velocity; like all others one for all joints or (n,).
        ki: Effort per integral of the error of position.
        limit: Largest effort, N·m or N.
        dead_band: Error of position up to which nothing is done about it, rad or m.

    Raises:
        ArgumentError: A gain is negative, a limit is not positive, or they are not as many.
    """

    def _construct(
        self,
        kp: ArrayLike,
        *,
        kd: ArrayLike = 0.0,
        ki: ArrayLike = 0.0,
        limit: ArrayLike = np.inf,
        dead_band: ArrayLike = 0.0,
        converter: Any = None,
    ) -> None:
        count = count_of(kp, "kp")
        given = dict(zip(_GAINS, (kp, kd, ki, limit, dead_band), strict=True))
        gains = {name: _checked(name, value, count) for name, value in given.items()}
        self._declare(gains, bool(gains["ki"].any()), converter)

    def _construct_copy(self, other: _PositionServo, converter: Any = None) -> None:
        self._declare(other._initial, other._integral, converter)

    @staticmethod
    def of(model: RobotModel) -> PositionServo:
        """Return the servos that a model's `effort_signals` state, of all its joints.

        Joints that have none are without gains, and pass feedforward on.

        Raises:
            ModelError: It has no servos, or joints of several degrees of freedom.
        """
        kp, kd, ki, limit = servo_gains(instance(model, "model", RobotModel))
        return PositionServo(kp, kd=kd, ki=ki, limit=limit)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        model: RobotModel,
        robot: RobotInDiagram,
        command: OutputPort,
        rate: OutputPort | None = None,
    ) -> PositionServo:
        """Adds a model's servos, and connects them with the robot that they drive.

        Commands are late by the servos' delays, exactly where they are straight lines between
        instants a sampling period apart: a millisecond, or the shortest delay.

        Args:
            command: Commanded positions (n,) in the order of `model.joints`, rad or m.
            rate: Their rates (n,); zero if None.

        Returns:
            The servos; `feedforward` is left to be connected.

        Raises:
            ModelError: The model has no servos, or joints of several degrees of freedom.
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


PositionServo_ = add_scalar_types(PositionServo, _PositionServo, symbolic=True)
