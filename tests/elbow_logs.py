"""Logs of a pendulum whose elbow has play or is soft, by scipy.

The motor of the elbow moves as planned, whatever the link does; the shoulder stands nearly still.
"""

from functools import cache
from math import cos, sin

import numpy as np
from pendulum_logs import PENDULUM
from scipy.integrate import solve_ivp

from geodrake import load_model
from geodrake.logs.motion import JointLog, Motion

MODEL = load_model(PENDULUM)
RATES = 2 * np.pi * np.array([0.31, 0.53, 0.83])
SIZES, PHASES = np.array([1.0, 0.6, 0.3]), np.array([0.0, 1.0, 2.0])


def motor(t):
    """Position, velocity and acceleration of the elbow's motor."""
    angle = np.multiply.outer(t, RATES) + PHASES
    return (
        np.sin(angle) @ SIZES,
        np.cos(angle) @ (SIZES * RATES),
        -np.sin(angle) @ (SIZES * RATES**2),
    )


def at_elbow(q, v, vd):
    """Effort (N, 2) with the shoulder at rest."""
    still = np.zeros_like(q)
    return MODEL.effort(Motion(*(np.stack([still, x], 1) for x in (q, v, vd))))


@cache
def constants():
    """Inertia about the elbow and the moment of the weight there, N·m."""
    one, none = np.ones(1), np.zeros(1)
    weight = at_elbow(one * np.pi / 2, none, none)[0, 1]
    return at_elbow(none, none, one)[0, 1] - at_elbow(none, none, none)[0, 1], weight


@cache
def played(half_width, seconds=16.0, rate=2000.0):
    """Time, and the link's positions, velocities and the motor's torque."""
    inertia, weight = constants()
    stiffness = 4e4 * inertia
    damping = np.sqrt(stiffness * inertia)
    waves = list(zip(SIZES.tolist(), RATES.tolist(), PHASES.tolist(), strict=True))

    def torque(t, y, link_v):
        """With plain numbers, as the solver asks for it often."""
        lag = sum(a * sin(w * t + p) for a, w, p in waves) - y
        over = lag - min(max(lag, -half_width), half_width)
        if over == 0.0:
            return 0.0
        speed = sum(a * w * cos(w * t + p) for a, w, p in waves) - link_v
        push = stiffness * over + damping * speed
        return max(push, 0.0) if over > 0.0 else min(push, 0.0)

    def rates(t, y):
        q, v = y.tolist()
        return [v, (torque(t, q, v) - weight * sin(q)) / inertia]

    time = np.arange(0.0, seconds, 1.0 / rate)
    q, v, _ = motor(0.0)
    step = 5e-4
    y = solve_ivp(rates, time[[0, -1]], [q - half_width, v], "LSODA", time, max_step=step).y
    pushes = zip(time.tolist(), *y.tolist(), strict=True)
    return time, y, np.array([torque(*each) for each in pushes])


def loose_log(half_width, *, noise=0.005, seed=1):
    """A log of the pendulum whose elbow has play, its shoulder all but at rest."""
    rng = np.random.default_rng(seed)
    time, link, torque = played(half_width, 40.0)
    every = slice(0, None, 8)
    q, v, vd = motor(time)
    slow = 0.02 * np.sin(1.1 * time)
    base = Motion(
        np.stack([slow, q], 1),
        np.stack([0.022 * np.cos(1.1 * time), v], 1),
        np.stack([-0.0242 * np.sin(1.1 * time), vd], 1),
    )
    zero = np.zeros_like(q)
    alone = MODEL.effort(Motion(*(np.stack([zero, x], 1) for x in (q, v, vd))))
    inertia, weight = constants()
    falling = (torque - weight * np.sin(link[0])) / inertia
    real = [x.copy() for x in (base.q, base.v, base.vd)]
    for order, values in enumerate((*link, falling)):
        real[order][:, 1] = values
    effort = MODEL.effort(Motion(*real))
    effort[:, 1] = MODEL.effort(base)[:, 1] + torque - alone[:, 1]
    # What a sample shows is the mean over its period.
    effort = effort[: len(effort) // 8 * 8].reshape(-1, 8, 2).mean(1)
    at = time[every] + 3.5 / 2000.0
    states = [np.stack([np.interp(at, time, x) for x in pair.T], 1) for pair in (base.q, base.v)]
    return JointLog(
        "loose",
        MODEL.joints,
        at,
        states[0],
        effort + noise * effort.std(0) * rng.normal(size=effort.shape),
        states[1],
    )


def moves(t, *, period=1.2, duration=0.7):
    """Position, velocity and acceleration of a motor that goes from point to point, and rests."""
    points = np.random.default_rng(3).uniform(-1.2, 1.2, 80)
    number = np.floor(t / period).astype(int)
    s = np.clip((t - number * period) / duration, 0.0, 1.0)
    start, way = points[number], points[number + 1] - points[number]
    return (
        start + way * s**3 * (10.0 - 15.0 * s + 6.0 * s**2),
        way / duration * 30.0 * s**2 * (1.0 - s) ** 2,
        way / duration**2 * 60.0 * s * (1.0 - 3.0 * s + 2.0 * s**2),
    )


def soft_log(more, *, frequency=8.0, damping=0.05, seconds=20.0, noise=0.005):
    """A log of the pendulum whose elbow goes from point to point behind a soft, damped gear.

    Args:
        more: Function of the time that gives efforts (N, 2) on top.
        frequency: At which the link swings, Hz.
        damping: Share of the critical one.
        seconds: Length.
        noise: Deviation of the effort's noise, as a share of that of the effort.
    """
    rng, (inertia, weight) = np.random.default_rng(1), constants()
    rate = 2 * np.pi * frequency

    def torque(t, y):
        q, v, _ = moves(t)
        return inertia * rate * (rate * (q - y[0]) + 2 * damping * (v - y[1]))

    def rates(t, y):
        return [y[1], (torque(t, y) - weight * np.sin(y[0])) / inertia]

    time = np.arange(0.0, seconds, 0.004)
    begin = [moves(0.0)[0], 0.0]
    y = solve_ivp(rates, time[[0, -1]], begin, "LSODA", time, max_step=5e-3).y
    falling = (torque(time, y) - weight * np.sin(y[0])) / inertia
    slow = (0.02 * np.sin(1.1 * time), 0.022 * np.cos(1.1 * time), -0.0242 * np.sin(1.1 * time))
    link = [np.stack(pair, 1) for pair in zip(slow, (*y, falling), strict=True)]
    effort = MODEL.effort(Motion(*link)) + more(time)
    position = np.stack([slow[0], moves(time)[0]], 1)
    return JointLog(
        "soft",
        MODEL.joints,
        time,
        position + 1e-5 * rng.normal(size=position.shape),
        effort + noise * effort.std(0) * rng.normal(size=effort.shape),
    )
