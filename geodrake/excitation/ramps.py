"""Ramps: slow ways from where a robot stands to the start of a motion, and back from its end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from geodrake.errors import ArgumentError
from geodrake.excitation.collisions import CollisionWorld
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.margins import stays_clear
from geodrake.excitation.starts import possible_postures
from geodrake.excitation.trajectory import ExcitationTrajectory, Ramp, RampedTrajectory
from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel

_SHARE = 0.5  # of the limits of speed, acceleration and jerk
_PEAKS = 1.875, 10.0 / np.sqrt(3.0), 60.0  # of 10 x³ − 15 x⁴ + 6 x⁵ and its derivatives
_LEAST = 1.0  # s, of a way
_STEP = 0.02  # rad or m, of the joint that goes farthest, between looks at collisions
_EFFORT_STEPS = 50
_SLOWER, _TIMES = 1.5, 8  # where efforts are too large
_VIA = 100  # postures by way of which a ramp may lead


@dataclass(frozen=True, eq=False)
class RampPlanner:
    """Plan ramps of half of the limits of speed, acceleration and jerk, of at least a second.

    A ramp is straight in the joints; where something is in the way, it goes by way of one more
    posture.
    """

    model: RobotModel
    limits: MotionLimits
    collisions: CollisionWorld | None

    def ramped(self, trajectory: ExcitationTrajectory, stand: Array) -> RampedTrajectory:
        """Return a motion with ramps from and to where the robot stands, (nv,) by joint."""
        q = trajectory.states([0.0, trajectory.length])[0]
        first = self._ramp(stand, q[0], trajectory)
        if np.allclose(q[0], q[1]):
            last = replace(first, postures=first.postures[::-1], durations=first.durations[::-1])
        else:
            last = self._ramp(q[1], stand, trajectory)
        parts = [part for part in (first, trajectory, last) if part.length]
        return RampedTrajectory(tuple(parts))

    def _ramp(self, begin: Array, end: Array, like: ExcitationTrajectory) -> Ramp:
        if np.array_equal(begin, end):
            return Ramp(np.array([begin, end]), np.zeros(1), like.joints, like.order)
        for postures in self._ways(begin, end):
            way = Ramp(postures, self._durations(postures), like.joints, like.order)
            if self.collisions is not None and not _is_clear(way, self.collisions):
                continue
            for _ in range(_TIMES):
                steps = _EFFORT_STEPS * len(way.durations)
                motion = way.motion(np.linspace(0.0, way.length, steps))
                if (np.abs(self.model.effort(motion)) <= self.limits.effort).all():
                    return way
                way = replace(way, durations=_SLOWER * way.durations)
        raise ArgumentError(
            "No ramp leads from where the robot stands to where the motion starts: neither the "
            f"straight one nor one by way of {_VIA} postures keeps clear and within the efforts.",
            advice="Let the motion start where the robot stands instead: --start.",
        )

    def _ways(self, begin: Array, end: Array) -> Iterator[Array]:
        """Yield the straight way, and then those by way of another posture, the shortest first."""
        yield np.array([begin, end])
        via = possible_postures(self.model, self.limits, self.collisions, most=_VIA)
        sizes = [np.abs((via - p) / self.limits.reach).max(axis=1) for p in (begin, end)]
        for k in np.argsort(sizes[0] + sizes[1]):
            if sizes[0][k] > 0 and sizes[1][k] > 0:
                yield np.array([begin, via[k], end])

    def _durations(self, postures: Array) -> Array:
        """Return the durations (k,) of ways between postures at half of the limits, s."""
        ways = np.abs(np.diff(postures, axis=0))
        bounds = self.limits.velocity, self.limits.acceleration, self.limits.jerk
        needed = [
            (peak * ways / (_SHARE * bound)) ** (1.0 / order)
            for order, (peak, bound) in enumerate(zip(_PEAKS, bounds, strict=True), 1)
        ]
        return np.maximum(np.max(needed, axis=(0, 2)), _LEAST)


def _is_clear(way: Ramp, collisions: CollisionWorld) -> bool:
    steps = [
        np.linspace(a, b, int(np.ceil(np.abs(b - a).max() / _STEP)) + 2)
        for a, b in zip(way.postures[:-1], way.postures[1:], strict=True)
    ]
    return stays_clear(collisions, np.concatenate(steps)[:, way.order])
