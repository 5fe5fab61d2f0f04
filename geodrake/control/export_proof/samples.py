"""Motion that exports are fitted and compared on: that of logs, or random within limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geodrake.control.export_proof.reference import STEP, Start, position_order
from geodrake.inertia import Array
from geodrake.logs.motion import MEMORY, Motion, Trajectory
from geodrake.logs.smoothing import Segment, Stretch
from geodrake.model.file_terms import DryFriction
from geodrake.model.robot_model import RobotModel

HORIZON = 0.2
"""Length of a rollout, s."""

_CHUNK, _CHUNKS = 1000, 12  # samples that follow each other, and how many such passages of all logs
_COMPARED = 400  # samples at which efforts are compared
_STARTS = 4
_RANDOM, _PERIOD = 3000, 0.01  # samples where there is no log, and their distance, s
_WAVES, _FREQUENCIES = 4, (0.1, 1.0)  # Hz
_SWING, _SWING_FREQUENCY = 0.3, 7.0  # share of the efforts of random starts, Hz
_LARGEST, _FASTEST = np.pi, 2.0  # rad or m, and per s


def logged_motions(model: RobotModel, trajectories: Sequence[Trajectory]) -> list[Motion]:
    """Choose passages of logs, spread evenly."""
    stretches = [s for trajectory in trajectories for s in trajectory.segments]
    began = [t.began for t in trajectories for _ in t.segments]
    passages = [
        (k, start)
        for k, stretch in enumerate(stretches)
        for start in range(0, max(1, len(stretch) - _CHUNK // 2), _CHUNK)
    ]
    spread = np.linspace(0, len(passages) - 1, min(_CHUNKS, len(passages))).round().astype(int)
    return [
        _motion(model, stretches[k], start, began[k])
        for k, start in (passages[i] for i in dict.fromkeys(spread.tolist()))
    ]


def _motion(model: RobotModel, stretch: Stretch, start: int, began: float) -> Motion:
    part = stretch[start : start + _CHUNK]
    before = stretch[max(0, start - MEMORY) : start].position
    return Motion(
        model.positions(part.position),
        part.velocity,
        part.acceleration,
        part.time - began,
        model.positions(before),
    )


def random_motion(model: RobotModel, seed: int = 0) -> Motion:
    """Return a smooth motion at random, within the limits of the robot."""
    rng, nv = np.random.default_rng(seed), len(model.joints)
    order = position_order(model)
    low, high = (limits[order] for limits in model.position_limits)
    low, high = np.maximum(low, -_LARGEST), np.minimum(high, _LARGEST)
    fastest = np.minimum(model.velocity_limits, _FASTEST)
    time: Array = np.arange(_RANDOM, dtype=float) * _PERIOD
    rates = 2 * np.pi * rng.uniform(*_FREQUENCIES, (nv, _WAVES))
    phases = rng.uniform(0.0, 2 * np.pi, (nv, _WAVES))
    angle = time[:, None, None] * rates + phases
    waves = np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle)
    q, v, vd = (wave.sum(-1) for wave in waves)
    size = np.minimum((high - low) / 2 / np.abs(q).max(0), fastest / np.abs(v).max(0))
    q = model.positions((low + high) / 2 + size * q)
    return Motion(q, size * v, size * vd, time, q[:0])


def compared(motions: Sequence[Motion]) -> Motion:
    """Choose samples of motions, spread evenly, at which efforts are compared."""
    q, v, vd = (np.concatenate([getattr(m, name) for m in motions]) for name in ("q", "v", "vd"))
    every = max(1, len(v) // _COMPARED)
    return Motion(q[::every], v[::every], vd[::every])


def logged_starts(held: RobotModel, trajectories: Sequence[Trajectory]) -> list[Start]:
    """Return starts of rollouts in logs, under the logged efforts less dry friction."""
    stretches = [s for trajectory in trajectories for s in trajectory.segments]
    longest = sorted(stretches, key=len, reverse=True)[:_STARTS]
    shares = (np.arange(_STARTS) + 0.5) / _STARTS
    found = []
    for stretch, share in zip(longest * _STARTS, shares.tolist(), strict=False):
        count = int(np.ceil(HORIZON / stretch.period)) + 2
        if len(stretch) < count:
            continue
        start = int(share * (len(stretch) - count))
        found.append(_logged_start(held, stretch[start : start + count]))
    return found


def _logged_start(held: RobotModel, part: Segment) -> Start:
    effort = part.effort.copy()
    for fitted in held.effects:
        if isinstance(fitted.effect, DryFriction):
            at = held.joints.index(fitted.effect.joint)
            effort[:, at] -= fitted.parameters[0] * np.sign(part.velocity[:, at])
    time = np.arange(round(HORIZON / STEP)) * STEP
    acted = [np.interp(time, part.time - part.time[0], column) for column in effort.T]
    return Start(part.position[0], part.velocity[0], np.array(acted).T)


def random_starts(held: RobotModel, motion: Motion) -> list[Start]:
    """Return starts of rollouts along a motion, under efforts about those of its postures."""
    every, order = len(motion.v) // _STARTS, position_order(held)
    q, v = motion.q[::every], motion.v[::every]
    effort = held.effort(Motion(q, np.zeros_like(v), np.zeros_like(v)))
    time = np.arange(round(HORIZON / STEP)) * STEP
    share = 1.0 + _SWING * np.sin(2 * np.pi * _SWING_FREQUENCY * time)  # so that delays are felt
    return [Start(q[k][order], v[k], np.outer(share, effort[k])) for k in range(len(v))]
