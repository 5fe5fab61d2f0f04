"""A log a day of a robot, by Pinocchio."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagrams.benchmarks.fleets.draws import (
    GAIN,
    PAYLOAD,
    STICKIER,
    WEAR,
    FleetDraw,
    own_robot,
    type_engine,
)
from diagrams.benchmarks.hidden.motions import FAST, POINTS, make_motion

Array = NDArray[np.float64]

RATE = 100.0  # Hz
_ENCODER, _NOISE = 1e-5, 0.01  # rad; a share of the effort's deviation
_SEASON, _DAILY = 6.0, 1.0  # °C
_DRY_LOSS, _VISCOUS_LOSS = 0.008, 0.02  # shares that friction loses with a degree
_SCATTER = 0.02  # of friction from log to log
_BREAKAWAY, _SLOW, _RISE = 0.004, 0.08, 0.1  # rad/s, rad/s, share: friction at low speed


@dataclass(frozen=True, eq=False)
class FleetLog:
    """One log.

    Attributes:
        day: When it was recorded.
        time: (N,) instants, s.
        position: (N, n) measured positions.
        effort: (N, n) measured efforts.
    """

    day: float
    time: Array
    position: Array
    effort: Array


def season(days: int, seed: int) -> Array:
    """(days,) degrees above 20 °C in the hall of a fleet, the same for all its robots."""
    rng = np.random.default_rng([seed, 77])
    day = np.arange(days)
    wave = np.sin(2.0 * np.pi * (day / 45.0 + rng.uniform()))
    return np.asarray(_SEASON * wave + _DAILY * rng.normal(size=days))


def robot_logs(draw: FleetDraw) -> Iterator[FleetLog]:
    """The logs of a robot, a day after another."""
    engine, own, change = type_engine(draw.kind), own_robot(draw), draw.change
    n, rng = len(engine.joints), draw.random("logs")
    time = np.arange(0.0, draw.duration, 1.0 / RATE)
    for day, degrees in enumerate(season(draw.days, draw.seed)):
        much = change.at(day, draw.days - 1.0) if change else 0.0
        bodies, gain = own.bodies.copy(), own.gain.copy()
        dry = own.dry * (1.0 - _DRY_LOSS * own.warmth * degrees)
        viscous = own.viscous * (1.0 - _VISCOUS_LOSS * own.warmth * degrees)
        dry, viscous = (each * (1.0 + _SCATTER * rng.normal(size=n)) for each in (dry, viscous))
        if change is not None:
            if change.what == PAYLOAD:
                bodies[change.joint] += much * own.payload
            if change.what == GAIN:
                gain[change.joint] *= 1.0 + much
            if change.what in (WEAR, STICKIER):
                dry[change.joint] *= 1.0 + much
            if change.what == WEAR:
                viscous[change.joint] *= 1.0 + much
        engine.set_bodies(bodies)
        kind = POINTS if rng.uniform() < 0.3 else FAST
        q, v, a = make_motion(kind, engine, time, rng)
        slow = 1.0 + _RISE * np.exp(-np.square(v / _SLOW))
        friction = dry * slow * np.tanh(v / _BREAKAWAY) + viscous * v
        effort = gain * (engine.efforts(q, v, a) + friction) + own.offset
        effort += _NOISE * effort.std(axis=0) * rng.normal(size=effort.shape)
        yield FleetLog(float(day), time, q + _ENCODER * rng.normal(size=q.shape), effort)
