"""What it changes in the efforts that a link is not quite where its motor is."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from geodrake.effects.base import Array, RobotMotion
from geodrake.regressor import inverse_dynamics

_DEGREE = 5
_STEP = 1e-4  # rad or m, of differences


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
    bodies, at = motion.body_motions(name), motion.index(joint)
    mobilizer = next(m for m in bodies.tree.mobilizers if m.velocities.start == at)
    rate, acceleration = rate_and_acceleration(lag, motion.time) if rates is None else rates
    scale = _STEP / max(float(np.abs(lag).max(initial=0.0)), np.finfo(float).tiny)

    def effort(sign: float) -> Array:
        q, v, vd = bodies.q.copy(), motion.v.copy(), motion.vd.copy()
        q[:, mobilizer.positions.start] -= sign * scale * lag
        v[:, at] -= sign * scale * rate
        vd[:, at] -= sign * scale * acceleration
        return inverse_dynamics(bodies.tree, q, v, vd, bodies.phi)

    return np.asarray((effort(1.0) - effort(-1.0)) / (2.0 * scale))
