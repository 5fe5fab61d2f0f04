"""Logs and files of a fleet of changing robots, simulated without formulas of geodrake."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np

from diagrams.benchmarks.simulated.engines import (
    Array,
    Generator,
    PinocchioEngine,
    RobotFile,
    congruent,
    number_of,
    pseudo,
    robot_file,
)
from diagrams.benchmarks.simulated.motions import FAST, POINTS
from diagrams.benchmarks.simulated.recording import Sensors
from diagrams.benchmarks.simulated.truths import Seen
from geodrake.boundary.whole_files import write_whole
from geodrake.logs.files import write_log
from geodrake.logs.motion import JointLog

TYPES = ("arm3", "arm6")
WEAR, STICKIER, PAYLOAD, GAIN = "wear", "friction step", "payload", "gain"
CHANGES = (WEAR, STICKIER, PAYLOAD, GAIN)
DAYS = 30
_UNCHANGED = 5  # every fifth robot does not change
_HELD = ("wrist_roll", "wrist_pitch", "wrist_spin")
_FIRST, _LAST, _RAMP_LAST = 5, 25, 16  # range of days on which changes begin
_LEAST_EFFORT = 0.03  # of the limit
_PAYLOAD = {"arm3": 4.0, "arm6": 4.0}  # kg, heaviest


@dataclass(frozen=True)
class FleetDraw:
    """A robot of a fleet."""

    kind: str
    number: int
    seed: int
    days: int = DAYS
    duration: float = 12.0

    @property
    def name(self) -> str:
        """Name of the robot."""
        return f"{self.kind}_{self.number:03d}"

    def random(self, purpose: str) -> Generator:
        """Return a generator for a purpose, independent of other purposes."""
        words = f"{self.kind} {self.number} {purpose}"
        return np.random.default_rng([self.seed, number_of(words)])

    @property
    def change(self) -> HiddenChange | None:
        """Change of the robot; None for every fifth one."""
        if self.number % _UNCHANGED == _UNCHANGED - 1:
            return None
        rng = self.random("change")
        what = CHANGES[(self.number - self.number // _UNCHANGED) % len(CHANGES)]
        n = len(type_engine(self.kind).joints)
        last = _RAMP_LAST if what == WEAR else _LAST
        day = int(rng.integers(_FIRST, last + 1)) * self.days // DAYS
        joint = n - 1 if what == PAYLOAD else int(rng.integers(n))
        size = {
            WEAR: rng.uniform(0.2, 0.6),
            STICKIER: rng.uniform(0.15, 0.5),
            PAYLOAD: _PAYLOAD[self.kind] * rng.uniform(0.1, 1.0),
            GAIN: rng.choice([-1.0, 1.0]) * rng.uniform(0.03, 0.1),
        }[what]
        return HiddenChange(what, joint, day, float(size), bool(rng.integers(2)))


@dataclass(frozen=True)
class HiddenChange:
    """Change of a robot."""

    what: str
    joint: int
    day: int
    size: float  # share of friction (for wear on the last day), mass in kg, or share of the gain
    taken_off: bool  # whether the payload is removed on that day, not added

    def at(self, day: float, last: float) -> float:
        """Return the size of the change on a day."""
        if self.what == WEAR:
            return self.size * float(np.clip((day - self.day) / (last - self.day), 0.0, 1.0))
        is_present = (day >= self.day) != (self.what == PAYLOAD and self.taken_off)
        return self.size if is_present else 0.0


@dataclass(frozen=True, eq=False)
class OwnRobot:
    """Parameters of a robot, the same on all days."""

    bodies: Array  # (n, 4, 4) pseudo-inertias
    payload: Array  # (4, 4) pseudo-inertia of a payload of 1 kg in the frame of the last body
    # dry, viscous: (n,) friction at 20 °C, N·m and N·m·s/rad.
    dry: Array
    viscous: Array
    gain: Array  # (n,) ratio of logged and true effort
    offset: Array  # (n,) of the logged effort, N·m
    warmth: float  # sensitivity of its friction to the temperature, relative to the usual one


def own_robot(draw: FleetDraw) -> OwnRobot:
    """Draw a robot: its type with random deviations."""
    rng, engine = draw.random("robot"), type_engine(draw.kind)
    n, typical = len(engine.joints), _typical_efforts(draw.kind)
    com = np.array([0.0, 0.0, 0.05]) + 0.03 * rng.normal(size=3)
    inertia = 0.004 * rng.uniform(0.5, 1.5) * np.eye(3)
    return OwnRobot(
        congruent(engine.bodies(), 0.03, rng),
        pseudo(1.0, com, inertia),
        0.15 * typical * np.exp(0.15 * rng.normal(size=n)),
        0.15 * typical * np.exp(0.15 * rng.normal(size=n)),
        1.0 + 0.02 * rng.normal(size=n),
        0.01 * typical * rng.normal(size=n),
        float(1.0 + 0.1 * rng.normal()),
    )


@cache
def _typical_efforts(kind: str) -> Array:
    """Return efforts (n,), N·m, to scale friction, the same for all robots of a type."""
    rng, engine = np.random.default_rng(1), type_engine(kind)
    q = rng.uniform(
        np.maximum(engine.low, -1.5), np.minimum(engine.high, 1.5), (200, len(engine.low))
    )
    v, a = rng.normal(size=(2, *q.shape))
    least = _LEAST_EFFORT * np.asarray(type_file(kind).model.effort_limits)
    return np.maximum(engine.efforts(q, v, 2.0 * a).std(axis=0), least)


@cache
def type_file(kind: str) -> RobotFile:
    """Return the model file of a type; arm3 is arm6 with a fixed wrist."""
    if kind != "arm3":
        return robot_file(kind)
    return robot_file("arm6").holding(kind, _HELD)


def type_engine(kind: str) -> PinocchioEngine:
    """Return a new engine for a type."""
    return PinocchioEngine(type_file(kind))


RATE = 100.0  # Hz
_ENCODER, _NOISE = 1e-5, 0.01  # rad, and share of the effort's deviation
_SEASON, _DAILY = 6.0, 1.0  # °C
_DRY_LOSS, _VISCOUS_LOSS = 0.008, 0.02  # relative decrease of friction per degree
_SCATTER = 0.02  # relative deviation of friction between logs
_BREAKAWAY, _SLOW, _RISE = 0.004, 0.08, 0.1  # rad/s, rad/s, share: friction at low speed


def season(days: int, seed: int) -> Array:
    """Return the temperature (days,) above 20 °C, the same for all robots of a fleet."""
    rng = np.random.default_rng([seed, 77])
    day = np.arange(days)
    wave = np.sin(2.0 * np.pi * (day / 45.0 + rng.uniform()))
    return np.asarray(_SEASON * wave + _DAILY * rng.normal(size=days))


def robot_logs(draw: FleetDraw) -> Iterator[JointLog]:
    """Yield the logs of a robot, one for each day."""
    engine, robot, change = type_engine(draw.kind), own_robot(draw), draw.change
    n, rng = len(engine.joints), draw.random("logs")
    time = np.arange(0.0, draw.duration, 1.0 / RATE)
    for day, degrees in enumerate(season(draw.days, draw.seed)):
        size = change.at(day, draw.days - 1.0) if change else 0.0
        bodies, gain = robot.bodies.copy(), robot.gain.copy()
        dry = robot.dry * (1.0 - _DRY_LOSS * robot.warmth * degrees)
        viscous = robot.viscous * (1.0 - _VISCOUS_LOSS * robot.warmth * degrees)
        dry, viscous = (each * (1.0 + _SCATTER * rng.normal(size=n)) for each in (dry, viscous))
        if change is not None:
            if change.what == PAYLOAD:
                bodies[change.joint] += size * robot.payload
            if change.what == GAIN:
                gain[change.joint] *= 1.0 + size
            if change.what in (WEAR, STICKIER):
                dry[change.joint] *= 1.0 + size
            if change.what == WEAR:
                viscous[change.joint] *= 1.0 + size
        engine.set_bodies(bodies)
        kind = POINTS if rng.uniform() < 0.3 else FAST
        seen = Seen.of(engine, kind, time, rng)
        slow = 1.0 + _RISE * np.exp(-np.square(seen.v / _SLOW))
        friction = dry * slow * np.tanh(seen.v / _BREAKAWAY) + viscous * seen.v
        effort = gain * (seen.load + friction) + robot.offset
        sensors = Sensors(_NOISE, _ENCODER, None)
        yield sensors.log(f"{_date_name(FIRST + day * DAY)}.npz", seen, effort, rng)


Times = TypeVar("Times", float, Array)

FIRST, DAY = 1.7776e9 // 86400 * 86400, 86400.0
"""Seconds since 1970 of the first day of logs, and of a day."""


def write_logs(draw: FleetDraw, folder: Path) -> None:
    """Write the logs of a robot unless they exist."""
    robot_folder = folder / draw.name
    if (robot_folder / f"{_date_name(FIRST + (draw.days - 1) * DAY)}.npz").is_file():
        return
    robot_folder.mkdir(parents=True, exist_ok=True)
    for log in robot_logs(draw):
        write_log(log, robot_folder / log.name)


def write_fleet_file(folder: Path, draws: Sequence[FleetDraw]) -> Path:
    """Write the models of all types and the fleet file, and return the path of the latter."""
    folder.mkdir(parents=True, exist_ok=True)
    kinds = sorted({draw.kind for draw in draws})
    for kind in kinds:
        write_whole(folder / f"{kind}.urdf", type_file(kind).text)
    content = {
        "to": "results",
        "types": {kind: {"model": f"{kind}.urdf"} for kind in kinds},
        "robots": [
            {
                "name": draw.name,
                "type": draw.kind,
                "logs": f"{draw.name}/*.npz",
                "dates": "%Y-%m-%d",
            }
            for draw in draws
        ],
    }
    path = folder / "fleet.yaml"
    write_whole(path, json.dumps(content, indent=1))
    return path


def _date_name(seconds: float) -> str:
    """Format a date as 2026-05-01."""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d")


def day_of(seconds: Times) -> Times:
    """Return the days since the first one for an instant or several, s since 1970."""
    return (seconds - FIRST) / DAY
