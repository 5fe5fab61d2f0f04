"""Motions of the benchmark: fast, slow, and from point to point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagrams.benchmarks.hidden.engines import Engine

Array = NDArray[np.float64]
Motion = tuple[Array, Array, Array]

FAST, SLOW, POINTS = "fast", "slow", "point to point"
MOTIONS = (FAST, SLOW, POINTS)
SLOW_SPEED = 0.3  # rad/s
_FASTEST = 4.0  # rad/s, where limits are looser
_REACH, _PACE = 0.6, 0.6  # of the limits
_SHORTEST = 0.8  # s, of a move


def make_motion(kind: str, engine: Engine, time: Array, rng: np.random.Generator) -> Motion:
    """Positions, velocities and accelerations, (N, n) each, within limits of a robot."""
    half = np.minimum((engine.high - engine.low) / 2.0, np.pi / 2.0)
    center = np.clip(0.0, engine.low + half, engine.high - half)
    speed = _PACE * np.minimum(engine.fastest, _FASTEST)
    if kind == POINTS:
        return _point_to_point(center, _REACH * half, speed, time, rng)
    if kind == SLOW:
        speed = np.minimum(speed, SLOW_SPEED)
    return _multisine(center, _REACH * half, speed, time, rng)


def _multisine(
    center: Array, reach: Array, speed: Array, time: Array, rng: np.random.Generator
) -> Motion:
    """Sums of sines q = centre + Σ a sin(ω t + φ), which do not repeat; slow ones if slow."""
    n = len(center)
    # A wave that fills the reach at this speed, and its multiples.
    base = float(np.clip(np.median(speed / reach) / 2.5, 0.25, 0.65))
    rate = base * (np.arange(1, 7)[:, None] + rng.uniform(-0.4, 0.4, (6, n)))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, n))
    amplitude = rng.uniform(0.3, 1.0, (6, n)) / np.sqrt(np.arange(1, 7))[:, None]
    angle = rate * time[:, None, None] + phase
    q = (amplitude * np.sin(angle)).sum(1)
    v = (amplitude * rate * np.cos(angle)).sum(1)
    a = -(amplitude * rate**2 * np.sin(angle)).sum(1)
    scale = 1.0 / np.maximum(np.abs(q).max(0) / reach, np.abs(v).max(0) / speed)
    return center + scale * q, scale * v, scale * a


def _point_to_point(
    center: Array, reach: Array, speed: Array, time: Array, rng: np.random.Generator
) -> Motion:
    """Moves of least jerk between random points, with rests of 0.2 to 0.6 s."""
    q, v, a = (np.zeros((len(time), len(center))) for _ in range(3))
    at, t = center, 0.0
    while t < time[-1]:
        goal = center + reach * rng.uniform(-1.0, 1.0, len(center))
        # The peak speed of such a move is 15/8 of its mean speed.
        length = 1.875 * float(np.max(np.abs(goal - at) / speed)) / rng.uniform(0.5, 1.0)
        length = max(length, _SHORTEST)
        s = np.clip((time - t) / length, 0.0, 1.0)[:, None]
        now = (time >= t)[:, None]
        step = goal - at
        q = np.where(now, at + step * s**3 * (10.0 - 15.0 * s + 6.0 * s**2), q)
        v = np.where(now, step * 30.0 * s**2 * (1.0 - s) ** 2 / length, v)
        a = np.where(now, step * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / length**2, a)
        at, t = goal, t + length + rng.uniform(0.2, 0.6)
    return q, v, a
