"""The law of direct-current motors behind gears; brushless ones with commutation are alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geodrake.boundary.arguments import instance
from geodrake.control.motors.joint_scalars import JointScalars, joint_scalars
from geodrake.model.formulas.evaluation import Scalars


@dataclass(frozen=True, eq=False)
class MotorConstants(JointScalars):
    """Constants of n motors, all (n,).

    Attributes:
        torque_constant: k_t, torque of the motor per current, N·m/A.
        back_emf_constant: k_e, voltage per speed of the motor, V·s/rad.
        resistance: R, Ω.
        gear_ratio: N, turns of the motor for one of the joint; rad/m for sliding joints.
        inductance: L, H; 0 for a current that follows the voltage at once.
        voltage_limit: Largest voltage, V; infinite for none.
        current_limit: Largest current, A; infinite for none.
    """

    torque_constant: Scalars
    back_emf_constant: Scalars
    resistance: Scalars
    gear_ratio: Scalars
    inductance: Scalars
    voltage_limit: Scalars
    current_limit: Scalars


def steady_current(constants: MotorConstants, voltage: Scalars, velocity: Scalars) -> Scalars:
    """Currents (n,) of motors without inductance, i = sat((u − N k_e v) / R), A.

    Args:
        voltage: (n,) voltages u, V, of which no more than the limit acts.
        velocity: (n,) velocities v of the joints, rad/s or m/s.
    """
    voltage, velocity = _checked(constants, voltage=voltage, velocity=velocity)
    free = _driving_voltage(constants, voltage, velocity) / constants.resistance
    return _within(free, constants.current_limit)


def current_rate(
    constants: MotorConstants, voltage: Scalars, velocity: Scalars, current: Scalars
) -> Scalars:
    """Rates (n,) of currents in inductances, L di/dt = u − N k_e v − R i, A/s.

    A current at its limit does not go beyond.

    Args:
        voltage: (n,) voltages u, V, of which no more than the limit acts.
        velocity: (n,) velocities v of the joints, rad/s or m/s.
        current: (n,) currents i, A.
    """
    voltage, velocity, current = _checked(
        constants, voltage=voltage, velocity=velocity, current=current
    )
    driving = _driving_voltage(constants, voltage, velocity)
    rate = (driving - constants.resistance * current) / constants.inductance
    held = np.logical_or(
        np.logical_and(current >= constants.current_limit, rate > 0.0),
        np.logical_and(current <= -constants.current_limit, rate < 0.0),
    )
    return np.where(held, 0.0, rate)


def motor_torque(constants: MotorConstants, current: Scalars) -> Scalars:
    """Efforts (n,) at the joints, τ = N k_t i, N·m or N.

    Args:
        current: (n,) currents i, A.
    """
    (current,) = _checked(constants, current=current)
    return constants.gear_ratio * constants.torque_constant * current


def _checked(constants: MotorConstants, **values: Scalars) -> list[Scalars]:
    return joint_scalars(instance(constants, "constants", MotorConstants).shape, values)


def _driving_voltage(constants: MotorConstants, voltage: Scalars, velocity: Scalars) -> Scalars:
    """Voltage less that which the turning motor makes itself."""
    back = constants.gear_ratio * constants.back_emf_constant * velocity
    return _within(voltage, constants.voltage_limit) - back


def _within(x: Scalars, limit: Scalars) -> Scalars:
    return np.maximum(np.minimum(x, limit), -limit)
