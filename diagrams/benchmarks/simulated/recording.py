"""Logs of arms: friction and tools that ordinary ones have, and what sensors make of efforts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from diagrams.benchmarks.simulated.engines import Array, Generator, pseudo
from diagrams.benchmarks.simulated.truths import Seen
from geodrake.logs import JointLog

TIME_CONSTANTS = (0.005, 0.05)  # s, of coloured noise
_LEAST_RANGE = 0.1  # of the motor's limit: gears rub in joints without load, too
_COUNTS = 2.0**17  # of a turn
_STEP = 1.5  # of an effort's noise


@dataclass(frozen=True, eq=False)
class Recording:
    """Logs of a robot, and what is true of it."""

    logs: tuple[JointLog, ...]
    hidden: dict[str, tuple[str, ...]]  # effects of the catalogue that are hidden -> where
    beside: dict[str, tuple[str, ...]]  # further names that are right -> where
    mass: float  # mass of the tool, kg; 0 without one
    joints: tuple[str, ...] = ()  # of an effect of no catalogue
    # Effect -> what it is sized by, by joint: N·m, N·m·s, kg·m²; and "breakaway", rad/s.
    values: dict[str, list[float]] | None = None


def between(bounds: tuple[float, float], rng: Generator, n: int | None = None) -> Array:
    """Return numbers between bounds, alike for all magnitudes."""
    return np.exp(rng.uniform(*np.log(bounds), n))


def random_tool(mass: float, farthest: float, largest: float, rng: Generator) -> Array:
    """Return the pseudo-inertia (4, 4) of a random tool of a mass, kg, in the link's frame.

    Its centre is at most `farthest` along z, m, and its radii of gyration are at most `largest`, m.
    """
    center = np.array([*rng.uniform(-0.04, 0.04, 2), rng.uniform(0.03, farthest)])
    radii = rng.uniform(0.02, largest, 3)
    return pseudo(mass, center, mass * np.diag(radii @ radii - radii**2))


@dataclass(frozen=True, eq=False)
class Sizes:
    """By what friction and rotors of a robot's joints are sized, (n,) each, over all motions."""

    load: Array  # largest effort, N·m
    range: Array  # the same, or a tenth of the motor's limit if that is more
    speed: Array  # highest, rad/s
    acceleration: Array  # highest, rad/s²

    @classmethod
    def of(cls, motions: Sequence[Seen], limits: Array) -> Sizes:
        """Return those of motions, and of limits (n,) of efforts."""
        load, speed, acceleration = (
            np.max([np.abs(getattr(seen, name)).max(0) for seen in motions], 0)
            for name in ("load", "v", "a")
        )
        return cls(load, np.maximum(load, _LEAST_RANGE * limits), speed, acceleration)

    def friction(self, rng: Generator) -> tuple[Array, Array]:
        """Return dry and viscous friction (n,) of usual sizes."""
        n = len(self.range)
        dry = between((0.02, 0.15), rng, n) * self.range
        return dry, dry * rng.uniform(0.3, 1.5, n) / self.speed

    def rotors(self, rng: Generator) -> Array:
        """Return inertias (n,) of rotors of usual sizes."""
        return between((0.03, 0.2), rng, len(self.range)) * self.range / self.acceleration


def coloured(noise: Array, memory: float) -> Array:
    """Return white noise (N, …) with a memory from one sample to the next, as large as before."""
    found = noise.copy()
    found[1:] *= np.sqrt(1.0 - memory**2)
    for k in range(1, len(found)):
        found[k] += memory * found[k - 1]
    return found


@dataclass(frozen=True, eq=False)
class Sensors:
    """Sensors of a robot; all noise is white but that of efforts, which may be coloured."""

    noise: float  # deviation of that of an effort, as a share of `deviation`
    encoder: float  # rad
    tacho: float | None  # rad/s; None where no velocities are logged
    least: Array | float = 0.0  # N·m, of the deviations of efforts of which noise is a share
    # Time constant of the noise of efforts, s, as it is drawn for a log; None for white noise.
    memory: Callable[[Generator], float] | None = None
    quantised: bool = False
    gains: Array | float = 1.0
    deviation: float | None = None  # N·m; that of the effort, and at least `least`, if None

    def log(self, name: str, seen: Seen, effort: Array, rng: Generator, **stated: Any) -> JointLog:
        """Return what they make of a motion and its efforts (N, n)."""
        shape, own = effort.shape, np.maximum(effort.std(0), self.least)
        size = self.noise * (own if self.deviation is None else self.deviation)
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
