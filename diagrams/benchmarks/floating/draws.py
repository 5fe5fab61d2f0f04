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


_HIDDEN = (  # robot, secret, contacts, whether wrenches and efforts are logged
    ("a1", PAYLOAD, FLAGS, True, True),
    ("anymal", DRIVES, FLAGS, False, True),
    ("talos", PAYLOAD, FLAGS, False, True),
    ("a1", LIMB, FLAGS, False, True),
    ("anymal", GAIN, FLAGS, True, True),
    ("talos", DRIVES, FLAGS, True, True),
    ("a1", FOOT, FLAGS, True, True),
    ("anymal", PAYLOAD, NO_FLAGS, False, True),
    ("talos", GAIN, FLAGS, False, True),
    ("a1", DRIVES, WRONG_FLAGS, False, True),
    ("anymal", LIMB, FLAGS, True, True),
    ("talos", FOOT, FLAGS, True, True),
    ("a1", PAYLOAD, NO_FLAGS, True, False),
    ("anymal", DRIVES, NO_FLAGS, True, True),
    ("talos", LIMB, NO_FLAGS, False, True),
    ("a1", GAIN, WRONG_FLAGS, False, True),
    ("anymal", PAYLOAD, WRONG_FLAGS, False, True),
    ("talos", PAYLOAD, NO_FLAGS, True, False),
    ("a1", DRIVES, FLAGS, True, True),
    ("anymal", FOOT, NO_FLAGS, True, True),
)
_PLAIN = (
    ("a1", QUIET, FLAGS, False, True),
    ("anymal", QUIET, WRONG_FLAGS, False, True),
    ("talos", QUIET, FLAGS, True, True),
    ("a1", QUIET, NO_FLAGS, True, True),
)
_ALWAYS_STANDS = ("talos",)


def all_draws(seed: int, **fixed: object) -> list[Draw]:
    """Return twenty draws that hide something, with four between them that hide nothing."""
    rows = [*_HIDDEN]
    for k, quiet in enumerate(_PLAIN):
        rows.insert(6 * k + 5, quiet)
    return [
        Draw(
            *(robot, hidden),
            **{  # type: ignore[arg-type]
                "motions": (SWAY, SWAY if robot in _ALWAYS_STANDS else TROT),
                "contacts": contacts,
                "wrenches": wrenches,
                "efforts": efforts,
                "number": number,
                "seed": seed,
                **fixed,
            },
        )
        for number, (robot, hidden, contacts, wrenches, efforts) in enumerate(rows)
    ]
