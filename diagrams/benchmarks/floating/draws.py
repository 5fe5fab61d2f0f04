"""What a robot hides, how it moves, and what of it is logged."""

from __future__ import annotations

from dataclasses import dataclass
from zlib import crc32

import numpy as np

SWAY, TROT = "sway", "trot"
PAYLOAD, LIMB, DRIVES, GAIN, FOOT, QUIET = (
    "payload",
    "limb",
    "friction and rotors",
    "gain",
    "foot sensor",
    "quiet",
)
FLAGS, WRONG_FLAGS, NO_FLAGS = "logged", "a tenth wrong", "not logged"


@dataclass(frozen=True)
class Draw:
    """A robot, its secret, and its two logs.

    Attributes:
        robot: Name of the robot.
        hidden: What it hides.
        motions: Motion of each log.
        contacts: "logged", "a tenth wrong" or "not logged".
        wrenches: Whether wrenches of the feet are logged.
        efforts: Whether efforts of the joints are logged.
        noise: Noise of all sensors, as a share of what is usual; 0 for exact logs.
        rate: Samples a second.
        duration: Length of each log, s.
        number: Of the draw.
        seed: Of the study.
    """

    robot: str
    hidden: str = QUIET
    motions: tuple[str, ...] = (SWAY, TROT)
    contacts: str = FLAGS
    wrenches: bool = False
    efforts: bool = True
    noise: float = 1.0
    rate: float = 200.0
    duration: float = 40.0
    number: int = 0
    seed: int = 0

    def rng(self, purpose: str) -> np.random.Generator:
        """Return a generator of random numbers for a purpose of this draw."""
        words = f"{self.robot} {self.hidden} {purpose}"
        return np.random.default_rng([self.seed, self.number, crc32(words.encode())])
