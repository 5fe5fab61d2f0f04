"""Named motions of arms: positions, velocities and accelerations (N, n) within limits."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.signal import butter, sosfiltfilt

from diagrams.benchmarks.simulated.engines import Array, Engine, Generator
from diagrams.harness import sines

Motion = tuple[Array, Array, Array]

FAST, SLOW, POINTS = "fast", "slow", "point to point"
MOTIONS = (FAST, SLOW, POINTS)
FINE = 500.0  # Hz, sampling rate of the motions of `EVERYDAY`
_SLOW_SPEED = 0.3  # rad/s
_FASTEST = 4.0  # rad/s, upper bound of the limits
_REACH, _PACE = 0.6, 0.6  # of the limits
_SHORTEST = 0.8  # s, shortest move
_SMOOTHED = 0.08  # s, window over which a drive smooths its moves


def make_motion(
    kind: str, engine: Engine, time: Array, rng: Generator, *, pace: float = 1.0
) -> Motion:
    """Return a motion of a kind; those of `EVERYDAY` use a share `pace` of the speeds."""
    center, reach, speed = motion_range(engine)
    if kind in EVERYDAY:
        q = center + EVERYDAY[kind](time, reach, pace * speed, rng)
        v = np.gradient(q, 1.0 / FINE, axis=0)
        return q, v, np.gradient(v, 1.0 / FINE, axis=0)
    if kind == POINTS:
        return _point_to_point(center, reach, speed, time, rng)
    if kind == SLOW:
        speed = np.minimum(speed, _SLOW_SPEED)
    return _multisine(center, reach, speed, time, rng)


def motion_range(engine: Engine) -> tuple[Array, Array, Array]:
    """Return the centres of motions, the largest distances from them, and speeds, (n,) each."""
    half = np.minimum((engine.high - engine.low) / 2.0, np.pi / 2.0)
    center = np.clip(0.0, engine.low + half, engine.high - half)
    return center, _REACH * half, _PACE * np.minimum(engine.fastest, _FASTEST)


def _multisine(center: Array, reach: Array, speed: Array, time: Array, rng: Generator) -> Motion:
    """Return sums of sines q = centre + Σ a sin(ω t + φ), which are not periodic."""
    n = len(center)
    # Frequency of a wave with these amplitudes and speeds; others are multiples.
    base = float(np.clip(np.median(speed / reach) / 2.5, 0.25, 0.65))
    rate = base * (np.arange(1, 7)[:, None] + rng.uniform(-0.4, 0.4, (6, n)))
    phase = rng.uniform(0.0, 2.0 * np.pi, (6, n))
    amplitude = rng.uniform(0.3, 1.0, (6, n)) / np.sqrt(np.arange(1, 7))[:, None]
    q, v, a = sines(time, amplitude, rate, phase)
    scale = 1.0 / np.maximum(np.abs(q).max(0) / reach, np.abs(v).max(0) / speed)
    return center + scale * q, scale * v, scale * a


def _point_to_point(
    center: Array, reach: Array, speed: Array, time: Array, rng: Generator
) -> Motion:
    """Return minimum-jerk moves between random points, with rests of 0.2 to 0.6 s."""
    q, v, a = (np.zeros((len(time), len(center))) for _ in range(3))
    start, t = center, 0.0
    while t < time[-1]:
        goal = center + reach * rng.uniform(-1.0, 1.0, len(center))
        # The peak speed of a minimum-jerk move is 15/8 of its mean speed.
        length = 1.875 * float(np.max(np.abs(goal - start) / speed)) / rng.uniform(0.5, 1.0)
        length = max(length, _SHORTEST)
        s = np.clip((time - t) / length, 0.0, 1.0)[:, None]
        now = (time >= t)[:, None]
        step = goal - start
        q = np.where(now, start + step * s**3 * (10.0 - 15.0 * s + 6.0 * s**2), q)
        v = np.where(now, step * 30.0 * s**2 * (1.0 - s) ** 2 / length, v)
        a = np.where(now, step * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / length**2, a)
        start, t = goal, t + length + rng.uniform(0.2, 0.6)
    return q, v, a


# Everyday motions: positions (N, n) relative to their centres at instants (N,)


def _scaled(q: Array, reach: Array, speed: Array) -> Array:
    v = np.gradient(q, 1.0 / FINE, axis=0)
    return q / np.maximum(np.abs(q).max(0) / reach, np.abs(v).max(0) / speed)


def _fourier(t: Array, reach: Array, speed: Array, rng: Generator) -> Array:
    order, base = np.arange(1, 6)[:, None], rng.uniform(0.08, 0.2)
    sizes = rng.normal(size=(5, len(reach))) / order
    phases = rng.uniform(0.0, 2.0 * np.pi, sizes.shape)
    return _scaled(sines(t, sizes, 2.0 * np.pi * base * order, phases)[0], reach, speed)


def _trapezoids(t: Array, reach: Array, speed: Array, rng: Generator) -> Array:
    rows, start = [], np.zeros(len(reach))
    while sum(map(len, rows)) < len(t):
        goal = reach * rng.uniform(-1.0, 1.0, len(reach))
        seconds = max(1.25 * float(np.max(np.abs(goal - start) / speed)), 0.6)
        s = np.linspace(0.0, 1.0, int(seconds * FINE))
        ramp = np.select(
            [s < 0.2, s > 0.8], [s**2 / 0.32, 1.0 - (1.0 - s) ** 2 / 0.32], (s - 0.1) / 0.8
        )
        rows += [start + (goal - start) * ramp[:, None]]
        rows += [np.tile(goal, (int(rng.uniform(0.0, 1.0) * FINE), 1))]
        start = goal
    window = np.hanning(int(_SMOOTHED * FINE) + 2)[1:-1]
    padded = np.pad(np.concatenate(rows)[: len(t)], ((len(window),) * 2, (0, 0)), "edge")
    smooth = [np.convolve(each, window / window.sum(), "same") for each in padded.T]
    return np.stack(smooth, 1)[len(window) : -len(window)]


def _teleoperated(t: Array, reach: Array, speed: Array, rng: Generator) -> Array:
    low_pass = butter(4, rng.uniform(0.15, 0.5) * 2.0 / FINE, output="sos")
    wandering = sosfiltfilt(low_pass, rng.normal(size=(len(t) + 2000, len(reach))), axis=0)
    return _scaled(wandering[1000 : 1000 + len(t)], reach, speed)


def _in_turn(t: Array, reach: Array, speed: Array, rng: Generator) -> Array:
    q, seconds = np.zeros((len(t), len(reach))), t[-1] / len(reach)
    for joint, size in enumerate(0.8 * reach):
        since = t - joint * seconds
        moves = (since >= 0.0) & (since < seconds)
        rate = min(0.7 * speed[joint] / size, 4.0) * rng.uniform(0.5, 1.0)
        bump = np.sin(np.pi * since[moves] / seconds) ** 2
        q[moves, joint] = size * np.sin(rate * since[moves]) * bump
    return q


EVERYDAY: Mapping[str, Callable[[Array, Array, Array, Generator], Array]] = {
    "Fourier series": _fourier,
    "trapezoids": _trapezoids,
    "teleoperated": _teleoperated,
    "in turn": _in_turn,
}
