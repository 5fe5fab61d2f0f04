"""What it changes in the efforts that a link is not quite where its motor is."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from geodrake.effects.base import Array, RobotMotion

_DEGREE = 5


def rate_and_acceleration(signal: Array, time: Array | None) -> tuple[Array, Array]:
    """First and second time derivatives (N,) of a signal (N,); zero where it is no series."""
    if time is None or len(signal) <= _DEGREE:
        return np.zeros_like(signal), np.zeros_like(signal)
    spline = make_interp_spline(time, signal, k=_DEGREE)
    return np.asarray(spline(time, 1)), np.asarray(spline(time, 2))


def effort_of_deflection(
    motion: RobotMotion,
    name: str,
    joint: str,
    lag: Array,
    *,
    rates: tuple[Array, Array] | None = None,
) -> Array:
    """Change of the needed effort (N, nv), to first order, where a link lags behind its motor.

    −(∂τ/∂q_j s + ∂τ/∂v_j ṡ + M_{·j} s̈), with the bodies' effort τ(q, v, v̇) and the lag s(t).

    Args:
        motion: The motion of the motors.
        name: The effect that needs it, for messages.
        joint: The joint.
        lag: (N,) position of the motor less that of the link, rad or m; of any size, as the change
            is that of an infinitely small lag, scaled.
        rates: (N,) its first and second time derivative; by default those of its spline.
    """
    slopes, at = motion.effort_slopes(name), motion.index(joint)
    rate, acceleration = rate_and_acceleration(lag, motion.time) if rates is None else rates
    change = slopes.position[:, :, at] * lag[:, None]
    change += slopes.velocity[:, :, at] * rate[:, None]
    change += slopes.acceleration[:, :, at] * acceleration[:, None]
    return np.asarray(-change)
