"""Robots of a fleet: of which type, how they differ, and what changes in them on which day."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from diagrams.benchmarks.hidden.engines import PinocchioEngine, congruent, pseudo
from diagrams.benchmarks.hidden.robots import RobotFile, robot_file
from geodrake import load_model
from geodrake.model import RobotModel

Array = NDArray[np.float64]

TYPES = ("arm3", "arm6")
WEAR, STICKIER, PAYLOAD, GAIN = "wear", "friction step", "payload", "gain"
CHANGES = (WEAR, STICKIER, PAYLOAD, GAIN)
DAYS = 30
_UNCHANGED = 5  # every fifth robot
_HELD = ("wrist_roll", "wrist_pitch", "wrist_spin")
_FIRST, _LAST, _RAMP_LAST = 5, 25, 16  # days on which changes begin
_LEAST_EFFORT = 0.03  # of the strongest
_PAYLOAD = {"arm3": 4.0, "arm6": 4.0}  # kg, the heaviest


@dataclass(frozen=True)
class FleetDraw:
    """One robot.

    Attributes:
        kind: Its type.
        number: Its number in the type.
        seed: Of the study.
        days: Days of logs.
        duration: Length of a log, s.
        still: Whether nothing changes in any robot.
    """

    kind: str
    number: int
    seed: int
    days: int = DAYS
    duration: float = 12.0
    still: bool = False

    @property
    def name(self) -> str:
        """The robot's name."""
        return f"{self.kind}_{self.number:03d}"

    def random(self, purpose: str) -> np.random.Generator:
        """A generator for one purpose, which no other changes."""
        words = f"{self.kind} {self.number} {purpose}"
        return np.random.default_rng([self.seed, crc32(words.encode())])

    @property
    def change(self) -> HiddenChange | None:
        """What changes; None for every fifth robot."""
        if self.still or self.number % _UNCHANGED == _UNCHANGED - 1:
            return None
        rng = self.random("change")
        what = CHANGES[(self.number - self.number // _UNCHANGED) % len(CHANGES)]
        n = len(type_engine(self.kind).joints)
        late = _RAMP_LAST if what == WEAR else _LAST
        day = int(rng.integers(_FIRST, late + 1)) * self.days // DAYS
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
    """What changes in a robot.

    Attributes:
        what: One of `CHANGES`.
        joint: Number of the joint, or of the joint that moves the body.
        day: First day with it, or on which it begins to rise.
        size: Share of friction (for wear, at the last day), mass in kg, or share of the gain.
        taken_off: Whether the payload was there before, and is not from that day on.
    """

    what: str
    joint: int
    day: int
    size: float
    taken_off: bool

    def at(self, day: float, last: float) -> float:
        """How much of it there is on a day."""
        if self.what == WEAR:
            return self.size * float(np.clip((day - self.day) / (last - self.day), 0.0, 1.0))
        here = (day >= self.day) != (self.what == PAYLOAD and self.taken_off)
        return self.size if here else 0.0


@dataclass(frozen=True, eq=False)
class OwnRobot:
    """What a robot is by itself, the same on all days.

    Attributes:
        bodies: (n, 4, 4) pseudo-inertias.
        payload: (4, 4) pseudo-inertia of a payload of 1 kg in the frame of the last body.
        dry, viscous: (n,) friction at 20 °C, N·m and N·m·s/rad.
        gain: (n,) logged over true effort.
        offset: (n,) of the logged effort, N·m.
        warmth: How much its friction follows the temperature, over the usual.
    """

    bodies: Array
    payload: Array
    dry: Array
    viscous: Array
    gain: Array
    offset: Array
    warmth: float


def own_robot(draw: FleetDraw) -> OwnRobot:
    """The robot of a draw: its type with deviations of its own."""
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
    """(n,) efforts by which friction is sized, N·m: the same for all robots of a type."""
    rng, engine = np.random.default_rng(1), type_engine(kind)
    q = rng.uniform(
        np.maximum(engine.low, -1.5), np.minimum(engine.high, 1.5), (200, len(engine.low))
    )
    v, a = rng.normal(size=(2, *q.shape))
    strongest = {
        joint.get("name"): float(joint.find("limit").get("effort"))  # type: ignore[union-attr,arg-type]
        for joint in ET.fromstring(type_file(kind).text).iter("joint")
        if joint.find("limit") is not None
    }
    least = [_LEAST_EFFORT * strongest[joint] for joint in engine.joints]
    return np.maximum(engine.efforts(q, v, 2.0 * a).std(axis=0), least)


@cache
def type_file(kind: str) -> RobotFile:
    """The model file of a type; arm3 is arm6 whose wrist is held."""
    if kind != "arm3":
        return robot_file(kind)
    root = ET.fromstring(robot_file("arm6").text)
    for joint in root.iter("joint"):
        if joint.get("name") in _HELD:
            joint.set("type", "fixed")
    return RobotFile(kind, ET.tostring(root, encoding="unicode"))


def type_engine(kind: str) -> PinocchioEngine:
    """Pinocchio's robot of a type, anew."""
    return PinocchioEngine(type_file(kind))


@cache
def type_model(kind: str) -> RobotModel:
    """What geodrake knows of a type: its model file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{kind}.urdf"
        path.write_text(type_file(kind).text, encoding="utf-8")
        return load_model(path)
