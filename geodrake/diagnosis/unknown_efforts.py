"""Efforts that no effect of the catalogue describes, which every explanation competes with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from geodrake.effects.base import Effect, JointEffect, JointMotion, Parameter
from geodrake.effects.declarations import Shape
from geodrake.identification.logs.reduce import peak_speeds, sign_widths
from geodrake.logs.motion import Trajectory
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_SAMPLES = 100_000  # of a segment that are looked at
_RESOLVED = 2.0  # times the speed below which the direction is not known
_SLIP = 0.02  # of a joint's peak speed, below which surfaces may give way before they slide


@dataclass(frozen=True)
class UnresolvedReversal(JointEffect):
    """What dry friction does at speeds at which a log hardly tells the direction of motion.

    effort = h₀ (sgn v − d) + h₁ (tanh(2v/w) − d) + Σ_k e_k e^{−|v|/s_k} d
             + Σ_k j_k (v/√(v² + s_k²) − d), with d = tanh(v/w):
    friction that jumps more sharply than the direction d of other effects, or less, or that
    is another one there. Speeds below w pass within a sample, or are noise; how surfaces give way
    before they slide, below the speeds s_k, no log of ordinary motions tells.
    """

    speed: float  # w, rad/s or m/s
    slip: float  # the largest s_k, rad/s or m/s

    name: ClassVar[str] = "unresolved_reversal"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *(Parameter(f"sharper_{k}", "N·m") for k in range(2)),
        *(Parameter(f"excess_{k}", "N·m") for k in range(3)),
        *(Parameter(f"softer_{k}", "N·m") for k in range(2)),
    )
    shapes: ClassVar[tuple[Shape, ...]] = (Shape("speed", "rad/s"), Shape("slip", "rad/s"))
    depends_on: ClassVar[frozenset[str]] = frozenset({"v"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """One column for each parameter, in the order of the equation."""
        v, usual = joint.v, np.tanh(joint.v / self.speed)
        speeds = self.speed, float(np.sqrt(self.speed * self.slip)), self.slip
        excess = [np.exp(-np.abs(v) / s) * usual for s in speeds]
        softer = [v / np.hypot(v, s) - usual for s in speeds[1:]]
        sharper = [np.sign(v) - usual, np.tanh(2.0 * v / self.speed) - usual]
        return [*sharper, *excess, *softer]


@dataclass(frozen=True)
class UnknownFunction(JointEffect):
    """A smooth function of a joint's own motion: something that no effect describes."""

    center: float  # middle of the joint's range of motion, rad or m
    reach: float  # half that range
    speed: float  # its peak speed, rad/s or m/s

    name: ClassVar[str] = "unknown_function"
    parameters: ClassVar[tuple[Parameter, ...]] = tuple(
        Parameter(f"coefficient_{k}", "N·m") for k in range(11)
    )
    shapes: ClassVar[tuple[Shape, ...]] = tuple(
        Shape(name) for name in ("center", "reach", "speed")
    )
    depends_on: ClassVar[frozenset[str]] = frozenset({"q", "v"})
    complexity: ClassVar[int] = 3

    @property
    def free_shapes(self) -> int:
        """None: the scales are those of the motion."""
        return 0

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """Polynomials of position and speed, and the direction of motion times the position."""
        q, v = (joint.q - self.center) / self.reach, joint.v / self.speed
        even, odd = q * q - 1.0 / 3.0, q**3 - 0.6 * q
        return [
            np.ones_like(q),
            q,
            even,
            odd,
            v,
            np.abs(v) * v,
            v**3,
            v * v - 1.0 / 3.0,
            q * v,
            even * v,
            joint.sign_v * q,
        ]


def reversals(
    model: RobotModel, trajectories: Sequence[Trajectory]
) -> tuple[UnresolvedReversal, ...]:
    """Return an unresolved reversal for every joint that moves."""
    peaks, widths = peak_speeds(trajectories), sign_widths(model, trajectories)
    steps = np.zeros(len(model.joints))
    for trajectory in trajectories:
        for segment in trajectory.segments:
            seen = segment[:_SAMPLES]
            step = np.sqrt(np.mean(np.square(seen.acceleration), axis=0)) * seen.period
            steps = np.maximum(steps, 0.5 * step)
    speeds = np.maximum(widths, steps)
    return tuple(
        UnresolvedReversal(joint, float(speeds[j]), float(max(3.0 * speeds[j], _SLIP * peaks[j])))
        for j, joint in enumerate(model.joints)
        if peaks[j] > 0.0 and joint in model.single_joints
    )


def is_resolved(effect: Effect, unsure: Sequence[UnresolvedReversal]) -> bool:
    """Return whether shapes of an effect that are speeds are some at which logs tell directions."""
    least = {each.joint: _RESOLVED * each.speed for each in unsure}
    names = [shape.name for shape in effect.shapes if shape.scale == "speed"]
    values = [getattr(effect, name) for name in names]
    return all(value >= least.get(joint, 0.0) for value in values for joint in effect.where)


def unknown_functions(
    model: RobotModel, trajectories: Sequence[Trajectory]
) -> tuple[UnknownFunction, ...]:
    """Return an unknown function of the motion for every joint that moves."""
    peaks = peak_speeds(trajectories)
    low, high = range_of_motion(trajectories)
    return tuple(
        UnknownFunction(
            joint,
            float(0.5 * (low[j] + high[j])),
            float(max(0.5 * (high[j] - low[j]), 1e-9)),
            float(peaks[j]),
        )
        for j, joint in enumerate(model.joints)
        if peaks[j] > 0.0 and joint in model.single_joints
    )


def range_of_motion(trajectories: Sequence[Trajectory]) -> tuple[Array, Array]:
    """Lowest and highest positions (nv,) of every joint, rad or m."""
    segments = [s for trajectory in trajectories for s in trajectory.segments if len(s)]
    seen = [s[:_SAMPLES].position for s in segments]
    return (
        np.min([q.min(axis=0) for q in seen], axis=0),
        np.max([q.max(axis=0) for q in seen], axis=0),
    )
