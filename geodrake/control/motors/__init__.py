"""What servos and motors make of their inputs: functions of arrays, joint by joint."""

from __future__ import annotations

from geodrake.control.motors.dc_motor_law import (
    MotorConstants,
    current_rate,
    motor_torque,
    steady_current,
)
from geodrake.control.motors.servo_law import (
    ServoError,
    ServoGains,
    integral_rate,
    servo_effort,
)

__all__ = [
    "MotorConstants",
    "ServoError",
    "ServoGains",
    "current_rate",
    "integral_rate",
    "motor_torque",
    "servo_effort",
    "steady_current",
]
