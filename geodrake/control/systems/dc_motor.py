"""Direct-current motors behind gears."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, ContinuousState, LeafSystem

from geodrake.boundary.arguments import one_or_each
from geodrake.control.motors import (
    MotorConstants,
    current_rate,
    motor_torque,
    steady_current,
)
from geodrake.control.systems.joint_system import JointSystem, count_of
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.inertia.bodies import check_context
from geodrake.model.formulas.evaluation import Scalars
from geodrake.model.simulation.scalar_system import add_scalar_types

_CONSTANTS = (
    "torque_constant",
    "back_emf_constant",
    "resistance",
    "gear_ratio",
    "inductance",
    "voltage_limit",
    "current_limit",
)
_ZERO = ("back_emf_constant", "inductance")  # constants that may be zero
_INFINITE = ("voltage_limit", "current_limit")


def _checked(name: str, value: ArrayLike, count: int) -> Array:
    """Constants (count,) of one name.

    Raises:
        ArgumentError: They are negative or zero, or not as many.
    """
    strict, finite = name not in _ZERO, name not in _INFINITE
    return one_or_each(value, name, count, strict=strict, finite=finite)


class _DcMotor(JointSystem):
    """`DcMotor` of any scalar type."""

    def _declare(self, constants: dict[str, Array], converter: Any) -> None:
        self._begin(converter)
        self._initial = constants
        self._slow = np.flatnonzero(constants["inductance"])  # motors whose current is a state
        self._declare_numbers(constants)
        n = self._count
        self._voltage_port = self.DeclareVectorInputPort("voltage", self._vector(n))
        self._state_port = self.DeclareVectorInputPort("estimated_state", self._vector(2 * n))
        known = {self.all_parameters_ticket()}
        if len(self._slow):
            self.DeclareContinuousState(len(self._slow))
            known.add(self.xc_ticket())
        if len(self._slow) < n:
            known.add(self.all_input_ports_ticket())
        for name, calc in (("torque", self._calc_torque), ("current", self._calc_current)):
            self.DeclareVectorOutputPort(name, self._vector(n), calc, known)

    def constants(self, context: Context) -> MotorConstants:
        """Return the constants in a Context."""
        return MotorConstants(**self._numbers(context))

    def set_constants(self, context: Context, **constants: ArrayLike) -> None:
        """Changes constants in a Context.

        Args:
            **constants: Those of the constructor's arguments that change; one for all motors or
                (n,).

        Raises:
            ArgumentError: There is no such constant, it is not positive, or an inductance comes or
                goes.
        """
        check_context(self, context)
        if unknown := [name for name in constants if name not in _CONSTANTS]:
            raise ArgumentError(
                f"A motor has no {', '.join(unknown)}.", advice=f"It has {', '.join(_CONSTANTS)}."
            )
        values = {name: _checked(name, value, self._count) for name, value in constants.items()}
        inductance = values.get("inductance")
        if inductance is not None and not np.array_equal(np.flatnonzero(inductance), self._slow):
            raise ArgumentError(
                "Which motors have an inductance, and so a state, cannot change in a Context.",
                advice="Make another DcMotor.",
            )
        self._set_numbers(context, values)

    @property
    def no_load_speed(self) -> Array:
        """(n,) speeds of the joints at the voltage limit without load, u / (N k_e), rad/s or m/s.

        Infinite where there is no voltage limit, or no back-EMF.
        """
        own = self._initial
        with np.errstate(divide="ignore"):
            return own["voltage_limit"] / (own["gear_ratio"] * own["back_emf_constant"])

    @property
    def stall_torque(self) -> Array:
        """(n,) efforts at rest at the limits, N k_t min(u / R, i), N·m or N."""
        own = self._initial
        current = np.minimum(own["voltage_limit"] / own["resistance"], own["current_limit"])
        return own["gear_ratio"] * own["torque_constant"] * current

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Rates of currents; see `LeafSystem`."""
        if not derivatives.size():
            return
        slow = self._slow

        def rate(voltage: Scalars, v: Scalars, current: Scalars, *constants: Scalars) -> Scalars:
            return current_rate(MotorConstants(*constants), voltage, v, current)

        inputs = (x[slow] for x in (*self._inputs(context), *self._numbers(context).values()))
        voltage, v, *constants = inputs
        current = np.asarray(context.get_continuous_state_vector().CopyToVector())
        rates = self._apply(rate, voltage, v, current, *constants)
        self._set(derivatives.get_mutable_vector(), rates)

    def _inputs(self, context: Context) -> tuple[Scalars, Scalars]:
        """Voltages and velocities (n,)."""
        state = np.asarray(self._state_port.Eval(context))
        return np.asarray(self._voltage_port.Eval(context)), state[self._count :]

    def _current(self, context: Context) -> Scalars:
        n, slow = self._count, self._slow
        found = np.zeros(n) if self._of is float else np.zeros(n, object)
        found[slow] = context.get_continuous_state_vector().CopyToVector()
        if len(slow) < n:
            quick = np.setdiff1d(np.arange(n), slow)

            def steady(voltage: Scalars, v: Scalars, *constants: Scalars) -> Scalars:
                return steady_current(MotorConstants(*constants), voltage, v)

            inputs = (*self._inputs(context), *self._numbers(context).values())
            found[quick] = self._apply(steady, *(x[quick] for x in inputs))
        return found

    def _calc_current(self, context: Context, output: Any) -> None:
        self._set(output, self._current(context))

    def _calc_torque(self, context: Context, output: Any) -> None:
        def torque(current: Scalars, *constants: Scalars) -> Scalars:
            return motor_torque(MotorConstants(*constants), current)

        constants = self._numbers(context).values()
        self._set(output, self._apply(torque, self._current(context), *constants))


class DcMotor(_DcMotor, LeafSystem):
    """Direct-current motors of joints, brushless ones with commutation included.

    .. pydrake_system::

        name: DcMotor
        input_ports:
        - voltage
        - estimated_state
        output_ports:
        - torque
        - current

    With the voltage u and the velocity v of the joint, which is in the estimated state q, v,

        torque = N k_t i,   i = (u − N k_e v) / R,
        or with an inductance   L di/dt = u − N k_e v − R i

    A voltage beyond its limit acts like that at the limit, and a current keeps its own. Without a
    limit of the current, efforts at the voltage limit fall from `stall_torque` at rest to zero at
    `no_load_speed`: the torque–speed line. Torques, N·m or N, are those at the joint. The inertia
    of the rotor and the friction of the gear are effects, or numbers of the plant.

    Currents of motors with an inductance are continuous states; explicit integrators need steps
    below 2 L / R.

    Constants are numeric parameters of the Context (`set_constants`). The system can be cloned, and
    converted to AutoDiffXd and Expression.

    Args:
        torque_constant: (n,) k_t, N·m/A; its length is the number of motors.
        resistance: R, Ω; like all others one for all motors or (n,).
        gear_ratio: N, turns of the motor for one of the joint; rad/m for sliding joints.
        back_emf_constant: k_e, V·s/rad; that of torque if None, which it is in SI units.
        inductance: L, H.
        voltage_limit: Largest voltage, V.
        current_limit: Largest current, A.

    Raises:
        ArgumentError: A constant is not positive, or they are not as many.
    """

    def _construct(
        self,
        torque_constant: ArrayLike,
        resistance: ArrayLike,
        *,
        gear_ratio: ArrayLike = 1.0,
        back_emf_constant: ArrayLike | None = None,
        inductance: ArrayLike = 0.0,
        voltage_limit: ArrayLike = np.inf,
        current_limit: ArrayLike = np.inf,
        converter: Any = None,
    ) -> None:
        count = count_of(torque_constant, "torque_constant")
        given = {
            "torque_constant": torque_constant,
            "back_emf_constant": torque_constant
            if back_emf_constant is None
            else back_emf_constant,
            "resistance": resistance,
            "gear_ratio": gear_ratio,
            "inductance": inductance,
            "voltage_limit": voltage_limit,
            "current_limit": current_limit,
        }
        constants = {name: _checked(name, value, count) for name, value in given.items()}
        self._declare(constants, converter)

    def _construct_copy(self, other: _DcMotor, converter: Any = None) -> None:
        self._declare(other._initial, converter)


DcMotor_ = add_scalar_types(DcMotor, _DcMotor, symbolic=True)
