"""Random draws: ordinary robots, effects of no catalogue, and logs that hide nothing."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest
from zlib import crc32

import numpy as np

from diagrams.benchmarks.ordinary.uncatalogued import KINDS

ORDINARY, OUTSIDE, QUIET = "ordinary", "outside", "quiet"
ARMS = ("ur5", "xarm7", "z1", "kinova")
ENGINES = ("pinocchio", "mujoco")
WHITE, COLOURED = "white", "coloured"
COLOURS = (WHITE, COLOURED)
_OFF = (0.0, 0.15, 0.3)
_RATES = (50.0, 100.0, 200.0, 500.0)
_QUIET = 2  # logs a colour and seed


@dataclass(frozen=True)
class Draw:
    """A robot and its two logs.

    Attributes:
        case: "ordinary", "outside" or "quiet".
        robot: Name of the robot.
        engine: Who makes the logs.
        kind: Name of the effect of no catalogue, if there is one.
        friction: Whether there is dry and viscous friction at all joints.
        rotors: Whether there are rotors at all joints.
        tool: Mass of the tool at the last link, as a share of the robot's; 0 without one.
        off: How far bodies of the model file are off, as a share of their mass.
        rate: Samples a second.
        velocities: Whether velocities are logged.
        noise: Deviation of an effort's noise, as a share of that of the effort.
        colour: "white" or "coloured" noise.
        quantised: Whether positions and efforts are multiples of a resolution.
        calibrated: Whether logs state that gains of efforts are exact, as they are in all.
        number: Of the draw within its case.
        seed: Of the study.
        duration: Length of each log, s.
    """

    case: str
    robot: str
    engine: str
    kind: str
    friction: bool
    rotors: bool
    tool: float
    off: float
    rate: float
    velocities: bool
    noise: float
    colour: str
    quantised: bool
    calibrated: bool
    number: int
    seed: int
    duration: float = 40.0

    def rng(self, purpose: str) -> np.random.Generator:
        """A generator of random numbers for a purpose of this draw."""
        words = f"{self.case} {self.robot} {self.kind} {purpose}"
        return np.random.default_rng([self.seed, self.number, crc32(words.encode())])


def draw(case: str, robot: str, number: int, seed: int, **fixed: object) -> Draw:
    """A random draw of a case; `fixed` has the fields that are not left to chance."""
    rng = np.random.default_rng([seed, number, crc32(f"{case} {robot}".encode())])
    ordinary = case == ORDINARY
    has_tool = rng.random() < 2.0 / 3.0
    tool = round(float(rng.uniform(0.05, 0.15)), 4) if has_tool else 0.0
    chosen = {
        "engine": ENGINES[(number + seed) % 2],
        "kind": "",
        "friction": ordinary,
        "rotors": bool(rng.random() < 0.5) and ordinary,
        "tool": tool if ordinary else 0.0,
        "off": float(rng.choice(_OFF)) if ordinary else 0.0,
        "rate": float(rng.choice(_RATES)),
        "velocities": bool(rng.random() < 0.5),
        "noise": round(float(np.exp(rng.uniform(*np.log((0.005, 0.02))))), 4),
        "colour": WHITE,
        "quantised": bool(rng.random() < 1.0 / 3.0),
        "calibrated": bool(rng.random() < 0.5),
    }
    values = {**chosen, **fixed}
    return Draw(case, robot, number=number, seed=seed, **values)  # type: ignore[arg-type]


def all_draws(seed: int, **fixed: object) -> list[Draw]:
    """A seed's draws, the cases in turn, so that the first few show some of all of them."""
    ordinary = [draw(ORDINARY, arm, k, seed, **fixed) for k, arm in enumerate(ARMS)]
    outside = [
        draw(
            OUTSIDE,
            ARMS[(k + seed) % len(ARMS)],
            k,
            seed,
            **{"kind": kind, "engine": "mujoco", "friction": (k + seed) % 2 == 0, **fixed},
        )
        for k, kind in enumerate(KINDS)
    ]
    quiet = [
        draw(QUIET, ARMS[(k + seed) % len(ARMS)], k, seed, **{"colour": COLOURS[k % 2], **fixed})
        for k in range(_QUIET * len(COLOURS))
    ]
    # As many of the many between two of the few.
    groups = zip_longest(ordinary, outside[0::3], outside[1::3], quiet, outside[2::3])
    return [each for group in groups for each in group if each is not None]
