"""Compiled simulation of one servo joint, while all others follow their measured motion.

Near the measured motion the effort of the bodies is linear,

    b + M (ẍ − q̈) + D (ẋ − q̇) + K (x − q),

and the joint's motion x follows from

    … + o + I ẍ + d ẋ + (F + k l²) sgn ẋ
        = kp e + kr (dc/dt(t − δ) − ẋ) + w + ki ∫e dt,    e = dead(c(t − δ) − x),

where dead subtracts a dead band b from an error, and the load l is the effort of the bodies. Gear
friction depends on the whole load, limited where the load brakes so that the gear does not lock
(`SquaredLoadFriction`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, inlined
from geodrake.effects.of_files import BRAKING_SHARE
from geodrake.model.servos import calc_beyond

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

PARAMETERS = (
    "stiffness",
    "rate",
    "damping",
    "coulomb",
    "armature",
    "delay",
    "offset",
    "load",
    "integral",
    "dead_band",
)
"""kp, kr, d, F, I, δ, o, k, ki and b; of joints that turn in N·m/rad, N·m·s/rad (twice), N·m,
kg·m², s, N·m, 1/(N·m), N·m/(rad·s) and rad.

A servo array has these, its limit (infinite for none), the share of d within the limit, and the
initial efforts w of the integral, one for each stretch.
"""

RATE, DAMPING, COULOMB, ARMATURE, DELAY, OFFSET, LOAD, INTEGRAL = 1, 2, 3, 4, 5, 6, 7, 8
DEAD_BAND, LIMIT, SHARE, BEGUN = 9, 10, 11, 12
"""Indices into a servo array; stiffness is the first."""

_STEPS, _LONGEST_STEP = 4, 5e-3  # least number of steps between two rows, longest step, s
_THETA = 0.55  # of the theta method: fraction of a step at which forces are evaluated
_FAR = 1e3  # largest distance from the measured motion, rad or m, so that squares stay finite


@compiled
def calc_servo_motions(
    rows: Array, ends: Indices, periods: Array, servo: Array, out: tuple[Array, Array]
) -> None:
    """Write the positions of a joint along several stretches; see `calc_servo_motion`.

    Args:
        rows: (N, 8) of all stretches.
        ends: (S,) end of each stretch in `rows`.
        periods: (S,) s.
        servo: (12 + S,) servo array, with an effort w for each stretch.
        out: (N,) positions, and their slopes (N, 8 or 11 + S), or (0, 0) to skip them.
    """
    positions, slopes = out
    numbers, begin = servo[: BEGUN + 1].copy(), 0
    for k in range(len(ends)):
        span = slice(begin, ends[k])
        numbers[BEGUN] = servo[BEGUN + k]
        calc_servo_motion(rows[span], periods[k], numbers, (positions[span], slopes[span]))
        if slopes.shape[1] > INTEGRAL and k > 0:
            slopes[span, BEGUN + k] = slopes[span, BEGUN]
            slopes[span, BEGUN] = 0.0
        begin = ends[k]


@compiled
def calc_servo_motion(rows: Array, period: float, servo: Array, out: tuple[Array, Array]) -> None:
    """Write the positions (N,) of a joint under its commands, by the theta method.

    The method is of second order, except for the damping of stiff joints. Dry friction depends on
    velocity and load at the end of a step, and is set-valued at rest: a joint sticks until the
    other forces exceed F + k l². Slopes are exact for the discrete steps, with sticking fixed. A
    joint that runs away under a weak servo is stopped far from the measured motion.

    Args:
        rows: (N, 8) b, M, K, D, q, q̇, q̈ and the command.
        period: Time between rows, s.
        servo: (13,) kp, kr, d, F, I, δ, o, k, ki, b, the limit, the share of d within it, and w.
        out: (N,) positions, and their slopes (N, p) with respect to the first 8 parameters or to
            all but the share; (0, p) to skip them.
    """
    positions, slopes = out
    steps = max(_STEPS, int(np.ceil(period / _LONGEST_STEP)))
    kp, kr, d, F, armature, delay, offset, load, ki, band, limit, share, w = servo
    dt, per, late = period / steps, steps / period, delay / period
    ahead, x, v, z = _THETA * dt, rows[0, 4], rows[0, 5], 0.0
    c, rise = calc_command_before(rows, -late, period)
    count = min(slopes.shape[1], BEGUN + 1) if len(slopes) > 0 else 0
    at_numbers, direct, commands = np.zeros((3, count)), np.zeros(13), np.empty((steps, 2))
    reach, least = kp + ki * ahead, -BRAKING_SHARE / load  # (minus infinity without any)
    positions[0], slopes[:1, :count] = x, 0.0
    for k in range(len(rows) - 1):
        calc_commands_after(rows, k - late, period, commands)
        for s in range(steps):
            b, M, K, D, q, qd, qdd = calc_between(rows[k], rows[k + 1], (s + _THETA) / steps)
            before, rise_before = c, rise
            c, rise = commands[s]
            target = (1.0 - _THETA) * before + _THETA * c
            inertia, free, old = (M + armature) * per, D + (1.0 - share) * d, (1.0 - _THETA) * v
            predicted = x + ahead * old
            side = np.sign(calc_beyond(target - x - ahead * v, band))
            acts = 1.0 if band == 0.0 else abs(side)
            soft = (acts * reach * ahead + kr + share * d) * _THETA
            drive = acts * reach * (target - predicted - side * band) + ki * z + w
            drive += kr * ((c - before) * per - old) - share * d * old
            load_at_rest = b + K * (predicted - q) + D * (old - qd) - M * qdd
            rest = inertia * v - load_at_rest - offset - (free - D) * old
            heavy = inertia + K * ahead * _THETA + free * _THETA
            gear = F, load, least, load_at_rest - M * per * v, M * per + D * _THETA
            v_next, direction, stiff, bound = calc_within(limit, (drive, soft), (rest, heavy), gear)
            gives, mean = 1.0 if bound == 0.0 else 0.0, old + _THETA * v_next
            error = acts * (target - x - ahead * mean - side * band)
            grows = gives > 0.0 or bound * error < 0.0
            if count > 0:
                later = (1.0 - _THETA) * rise_before + _THETA * rise
                through, rubs = calc_rubbing(gear, v_next, direction)
                direct[:] = (
                    gives * error,
                    gives * ((c - before) * per - mean),
                    -(1.0 - share + share * gives) * mean,
                    -direction,
                    (v - v_next) * per,
                    -gives * (acts * reach * later + kr * (rise - rise_before) * per),
                    -1.0,
                    -direction * through**2,
                    gives * (z + ahead * error),
                    -gives * acts * reach * side,
                    np.sign(bound),
                    (1.0 - gives) * d * mean,
                    gives,
                )
                pushes, damps = inertia + rubs * M * per, free + rubs * D + gives * (kr + share * d)
                pulls, moves = K * (1.0 + rubs) + gives * acts * reach, abs(direction) / stiff
                growing = dt * acts if grows else 0.0
                step = pushes, damps, pulls, gives * ki, moves, growing, dt
                move_slopes(at_numbers, direct, step)
                at_numbers[2, 5] -= growing * later
                if count > 9:
                    at_numbers[2, 9] -= growing * side
            v, x, z = v_next, x + dt * mean, z + (dt * error if grows else 0.0)
        if abs(x - rows[k + 1, 4]) > _FAR:
            x, v = rows[k + 1, 4] + np.copysign(_FAR, x - rows[k + 1, 4]), 0.0
            at_numbers[:2] = 0.0
        positions[k + 1] = x
        if count > 0:
            slopes[k + 1, :count] = at_numbers[0]


@inlined
def move_slopes(
    slopes: Array,
    direct: Array,
    step: tuple[float, float, float, float, float, float, float],
) -> None:
    """Advance the slopes (3, p) of position, velocity and integral by one step.

    Args:
        direct: Partial derivatives of the force with respect to the parameters.
        step: Force per previous velocity, damping, stiffness, force per integral, velocity per
            force (0 while sticking), integration time, s, and step, s.
    """
    inertia, damps, holds, gives, moves, grows, dt = step
    by_x, by_z = -moves * holds, moves * gives
    by_v = moves * (inertia - (1.0 - _THETA) * (damps + holds * _THETA * dt))
    xs, vs, zs = slopes[0], slopes[1], slopes[2]
    for i in range(len(xs)):
        x, v = xs[i], vs[i]
        v_next = moves * direct[i] + by_v * v + by_x * x + by_z * zs[i]
        mean = (1.0 - _THETA) * v + _THETA * v_next
        zs[i] -= grows * (x + _THETA * dt * mean)
        xs[i], vs[i] = x + dt * mean, v_next


@inlined
def calc_between(
    a: Array, b: Array, share: float
) -> tuple[float, float, float, float, float, float, float]:
    """Return b, M, K, D, q, q̇ and q̈ interpolated between two rows."""
    other = 1.0 - share
    return (
        other * a[0] + share * b[0],
        other * a[1] + share * b[1],
        other * a[2] + share * b[2],
        other * a[3] + share * b[3],
        other * a[4] + share * b[4],
        other * a[5] + share * b[5],
        other * a[6] + share * b[6],
    )


@inlined
def calc_within(
    limit: float,
    servo: tuple[float, float],
    joint: tuple[float, float],
    gear: tuple[float, float, float, float, float],
) -> tuple[float, float, float, float]:
    """Return `calc_velocity_after` with a servo, and the servo's effort if saturated, else 0.

    Args:
        limit: Largest effort of the servo, N·m or N.
        servo: Effort of the servo at rest, and its decrease per velocity.
        joint: Other efforts on the joint at rest, and their decrease per velocity.
        gear: See `calc_velocity_after`.
    """
    (drive, soft), (rest, heavy) = servo, joint
    velocity, direction, stiff = calc_velocity_after(drive + rest, heavy + soft, gear)
    effort, bound = drive - soft * velocity, 0.0
    if effort > limit or effort < -limit:
        bound = limit if effort > 0.0 else -limit
        velocity, direction, stiff = calc_velocity_after(bound + rest, heavy, gear)
    return velocity, direction, stiff, bound


@inlined
def calc_rubbing(
    gear: tuple[float, float, float, float, float], v: float, direction: float
) -> tuple[float, float]:
    """Return the load along the velocity that acts in friction, and the slope of that friction."""
    _, load, least, load_at_rest, grows = gear
    through = max(direction * (load_at_rest + grows * v), least)
    return through, 2.0 * load * through if through > least else 0.0


@inlined
def calc_velocity_after(
    pull: float, stiff: float, gear: tuple[float, float, float, float, float]
) -> tuple[float, float, float]:
    """Return the velocity after an implicit step, its sign, and the force per velocity.

    Velocity and sign are 0 if the joint sticks. The velocity is unique: where the load brakes,
    friction grows more slowly than the load.

    Args:
        pull: Force on the joint at rest, N·m or N.
        stiff: Its decrease per velocity.
        gear: F and k of friction F + k l²; the least load l along the velocity that increases it;
            the load at zero velocity, and its increase per velocity.
    """
    F, load, least, load_at_rest, grows = gear
    direction = 1.0 if pull > 0.0 else -1.0
    if load == 0.0:
        most = direction * pull - F
        return (direction * most / stiff, direction, stiff) if most > 0.0 else (0.0, 0.0, stiff)
    still = direction * load_at_rest
    most = direction * pull - F - load * max(still, least) ** 2
    if most <= 0.0:
        return 0.0, 0.0, stiff
    speed, resists = most / stiff, stiff
    if load * grows > 0.0 and still + grows * speed > least:
        begins = (least - still) / grows if still < least else 0.0
        remaining = most - stiff * begins
        linear = stiff + 2.0 * load * max(still, least) * grows
        resists = np.sqrt(linear**2 + 4.0 * load * grows**2 * remaining)
        speed = begins + 2.0 * remaining / (linear + resists)
    return direction * speed, direction, resists


@inlined
def calc_commands_after(rows: Array, index: float, period: float, out: Array) -> None:
    """Write the commands and their rates (S, 2) at the ends of S steps to the next row."""
    for s in range(len(out)):
        out[s, 0], out[s, 1] = calc_command_before(rows, index + (s + 1.0) / len(out), period)


@compiled
def calc_command_before(rows: Array, index: float, period: float) -> tuple[float, float]:
    """Return the command and its rate at a fractional row index.

    Between rows it is a cubic with the rates of central differences, as in rollouts. Before the
    first row it is constant.
    """
    if index <= 0.0:
        return rows[0, 7], 0.0
    last = len(rows) - 1
    low = min(int(index), last)
    high, g = min(low + 1, last), index - low
    a, b = rows[low, 7], rows[high, 7]
    rise_low, right = 0.5 * (b - rows[max(low - 1, 0), 7]), 0.5 * (rows[min(high + 1, last), 7] - a)
    bend, twist = 3.0 * (b - a) - 2.0 * rise_low - right, rise_low + right - 2.0 * (b - a)
    rise = rise_low + g * (2.0 * bend + 3.0 * g * twist)
    return a + g * (rise_low + g * (bend + g * twist)), rise / period
