"""Logs of arms: ordinary friction, tools, and sensors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from diagrams.benchmarks.simulated.engines import Array, Generator, pseudo
from diagrams.benchmarks.simulated.truths import Seen
from geodrake.logs import JointLog

TIME_CONSTANTS = (0.005, 0.05)  # s, of coloured noise
_LEAST_RANGE = 0.1  # of the motor's limit, as gears also have friction without load
_COUNTS = 2.0**17  # per turn
_STEP = 1.5  # resolution of efforts, relative to their noise


@dataclass(frozen=True, eq=False)
class Recording:
    """Logs of a robot, and the truth about it."""

    logs: tuple[JointLog, ...]
    hidden: dict[str, tuple[str, ...]]  # hidden effects of the catalogue -> places
    beside: dict[str, tuple[str, ...]]  # other correct names -> places
    mass: float  # mass of the tool, kg; 0 without one
    joints: tuple[str, ...] = ()  # of an effect outside the catalogue
    # Effect -> its sizes by joint: N·m, N·m·s, kg·m²; and "breakaway", rad/s.
    values: dict[str, list[float]] | None = None


def between(bounds: tuple[float, float], rng: Generator, n: int | None = None) -> Array:
    """Draw log-uniform numbers between bounds."""
    return np.exp(rng.uniform(*np.log(bounds), n))


def random_tool(mass: float, farthest: float, largest: float, rng: Generator) -> Array:
    """Draw the pseudo-inertia (4, 4) of a tool of given mass, kg, in the link's frame.

    Its centre is at most `farthest` along z, m, and its radii of gyration are at most `largest`, m.
    """
    center = np.array([*rng.uniform(-0.04, 0.04, 2), rng.uniform(0.03, farthest)])
    radii = rng.uniform(0.02, largest, 3)
    return pseudo(mass, center, mass * np.diag(radii @ radii - radii**2))


@dataclass(frozen=True, eq=False)
class Sizes:
    """Scales of the friction and rotors of joints, (n,) each, over all motions."""

    load: Array  # largest effort, N·m
    range: Array  # `load`, or a tenth of the motor's limit if larger
    speed: Array  # highest, rad/s
    acceleration: Array  # highest, rad/s²

    @classmethod
    def of(cls, motions: Sequence[Seen], limits: Array) -> Sizes:
        """Return the sizes for motions and limits (n,) of efforts."""
        load, speed, acceleration = (
            np.max([np.abs(getattr(seen, name)).max(0) for seen in motions], 0)
            for name in ("load", "v", "a")
        )
        return cls(load, np.maximum(load, _LEAST_RANGE * limits), speed, acceleration)

    def friction(self, rng: Generator) -> tuple[Array, Array]:
        """Draw dry and viscous friction (n,) of usual sizes."""
        n = len(self.range)
        dry = between((0.02, 0.15), rng, n) * self.range
        return dry, dry * rng.uniform(0.3, 1.5, n) / self.speed

    def rotors(self, rng: Generator) -> Array:
        """Draw inertias (n,) of rotors of usual sizes."""
        return between((0.03, 0.2), rng, len(self.range)) * self.range / self.acceleration


def coloured(noise: Array, memory: float) -> Array:
    """Colour white noise (N, …) by a correlation between samples, at constant variance."""
    signal = noise.copy()
    signal[1:] *= np.sqrt(1.0 - memory**2)
    for k in range(1, len(signal)):
        signal[k] += memory * signal[k - 1]
    return signal


@dataclass(frozen=True, eq=False)
class Sensors:
    """Sensors of a robot. All noise is white except that of efforts, which may be coloured."""

    noise: float  # deviation of the effort noise relative to `deviation`
    encoder: float  # rad
    tacho: float | None  # rad/s; None if velocities are not logged
    least: Array | float = 0.0  # N·m, lower bound of the default `deviation`
    # Draws the time constant of a log's effort noise, s; None for white noise.
    memory: Callable[[Generator], float] | None = None
    quantised: bool = False
    gains: Array | float = 1.0
    deviation: float | None = None  # N·m; by default that of the effort, at least `least`

    def log(self, name: str, seen: Seen, effort: Array, rng: Generator, **stated: Any) -> JointLog:
        """Return the log of a motion and its efforts (N, n)."""
        shape, deviation = effort.shape, np.maximum(effort.std(0), self.least)
        size = self.noise * (deviation if self.deviation is None else self.deviation)
        errors = rng.normal(size=shape)
        if self.memory is not None:
            period = seen.time[1] - seen.time[0]
            errors = coloured(errors, float(np.exp(-period / self.memory(rng))))
        u = self.gains * effort + size * errors
        q, v = seen.q + self.encoder * rng.normal(size=shape), None
        if self.tacho is not None:
            v = seen.v + self.tacho * rng.normal(size=shape)
        if self.quantised:
            q = np.round(q * _COUNTS / (2.0 * np.pi)) * 2.0 * np.pi / _COUNTS
            u = np.round(u / (_STEP * size)) * _STEP * size
        return JointLog(name, seen.engine.joints, seen.time, q, u, v, **stated)
