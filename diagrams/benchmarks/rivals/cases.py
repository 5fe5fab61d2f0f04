"""The robots of the study: which effect they have, which one it may be taken for, a first motion.

First motions are those of a careful first try. Each leaves a pair ambiguous for a reason of its
own: a small sway hardly changes load and posture, back and forth at one speed shows no law of
speed, and a sweep in one direction does not show what happens in the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagrams.benchmarks.rivals.simulation import Hidden, Reference

Array = NDArray[np.float64]

JOINTS = ("shoulder", "elbow")
CENTER = np.array([0.3, 1.27])  # the lower link is level: there gravity's direction moves one joint


@dataclass(frozen=True)
class Case:
    """A robot and what it is taken for.

    Attributes:
        truth: Name of the effect that it has.
        rival: Name of the other one.
        joint: Where.
        hidden: Field of `Hidden`.
        size: About how large, SI units.
        parameters: The effect's parameters for a size of one.
        motion: Kind of the first motion.
    """

    truth: str
    rival: str
    joint: str
    hidden: str
    size: float
    motion: str
    parameters: tuple[float, ...] = (1.0,)

    def drawn_size(self, rng: np.random.Generator) -> float:
        """Up to a fifth more or less than usual."""
        return self.size * rng.uniform(0.8, 1.2)

    def robot(self, size: float) -> Hidden:
        """A robot with the effect."""
        if self.hidden == "tilt":
            return Hidden.of(len(JOINTS), tilt=(0.0, size))
        return Hidden.of(len(JOINTS), **{self.hidden: {JOINTS.index(self.joint): size}})

    def first_motion(self, rng: np.random.Generator) -> Reference:
        """The first motion, a little different each time."""
        return MOTIONS[self.motion](rng)


def sway(rng: np.random.Generator) -> Reference:
    """A slow sway of a degree or two."""
    center = CENTER + rng.uniform(-0.01, 0.01, 2)
    rates = 2.0 * np.pi * np.array([0.11, 0.24])[:, None] * rng.uniform(0.9, 1.1, (2, 2))
    sizes, phases = 0.02 * rng.uniform(0.5, 1.0, (2, 2)), rng.uniform(0.0, 2.0 * np.pi, (2, 2))

    def motion(t: Array) -> tuple[Array, Array, Array]:
        angle = rates * t[:, None, None] + phases
        q, v = sizes * np.sin(angle), sizes * rates * np.cos(angle)
        return center + q.sum(1), v.sum(1), -(rates**2 * q).sum(1)

    return motion


def shuttle(rng: np.random.Generator, reach: float = 0.08) -> Reference:
    """Back and forth at one speed through a few degrees: a triangle wave with rounded corners."""
    rates = 2.0 * np.pi * np.array([0.13, 0.19]) * rng.uniform(0.9, 1.1, 2)
    phases, order = rng.uniform(0.0, 2.0 * np.pi, 2), np.arange(1, 24, 2)[:, None]
    triangle = 8.0 / np.pi**2 * (-1.0) ** ((order - 1) // 2) / order**2
    weights = reach * triangle * np.sinc(order / 25.0)
    center = CENTER + rng.uniform(-0.05, 0.05, 2)

    def motion(t: Array) -> tuple[Array, Array, Array]:
        k, angle = order * rates, order * (rates * t[:, None, None] + phases)
        q, v = weights * np.sin(angle), weights * k * np.cos(angle)
        return center + q.sum(1), v.sum(1), -(k**2 * weights * np.sin(angle)).sum(1)

    return motion


def long_shuttle(rng: np.random.Generator) -> Reference:
    """The same through a larger range, and faster."""
    return shuttle(rng, 0.4)


def sweep(rng: np.random.Generator) -> Reference:
    """In one direction at one slow speed."""
    start = np.array([-0.3, 0.6]) + rng.uniform(-0.05, 0.05, 2)
    speed = 0.08 * rng.uniform(0.9, 1.1, 2)

    def motion(t: Array) -> tuple[Array, Array, Array]:
        v = np.broadcast_to(speed, (len(t), 2))
        return start + t[:, None] * speed, v, np.zeros((len(t), 2))

    return motion


MOTIONS = {"sway": sway, "shuttle": shuttle, "long shuttle": long_shuttle, "sweep": sweep}
WORDS: Mapping[str, str] = {
    "sway": "a sway of a degree or two",
    "shuttle": "back and forth, 5° at one speed",
    "long shuttle": "back and forth, 25° at one speed",
    "sweep": "one way at one speed",
}

DRY, LOAD = "coulomb_friction", "load_dependent_friction"
VISCOUS, QUADRATIC = "viscous_friction", "nonlinear_viscous_friction"
OFFSET, ASYMMETRIC = "effort_offset", "asymmetric_friction"
SPRING, TILT = "joint_spring", "gravity_tilt"

CASES = (
    Case(DRY, LOAD, "elbow", "coulomb", 0.15, "shuttle"),
    Case(LOAD, DRY, "elbow", "load_factor", 0.1, "shuttle"),
    Case(VISCOUS, QUADRATIC, "elbow", "viscous", 0.25, "long shuttle"),
    Case(QUADRATIC, VISCOUS, "elbow", "quadratic", 0.8, "long shuttle"),
    Case(OFFSET, ASYMMETRIC, "elbow", "offset", 0.1, "sweep"),
    Case(ASYMMETRIC, OFFSET, "elbow", "one_way", 1.2, "sweep", (0.0, 0.0, 1.0, 0.0)),
    Case(SPRING, TILT, "shoulder", "stiffness", 0.2, "sway", (1.0, 0.0)),
    Case(TILT, SPRING, "shoulder", "tilt", 0.03, "sway", (0.0, 1.0)),
)
