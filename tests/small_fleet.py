"""Files of a fleet of double pendulums by Pinocchio, some of which change."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from pinocchio_logs import MODELS, perturbed, random_motion, robot

from geodrake.logs import JointLog, write_log

PENDULUM = MODELS / "double_pendulum.urdf"
LOGS, SECONDS, RATE = 8, 4.0, 200.0
DRY, WET = np.array([0.4, 0.2]), np.array([0.2, 0.1])  # N·m, N·m·s/rad
MASS, CENTER = 0.6, np.array([0.0, 0.0, -0.4])  # of the payload, kg and m
HEAVY, STICKY, FROM = "carrier", "sticky", 4  # robots that change, and from which log on
SHARE = 0.5  # by which dry friction of the elbow rises
ROBOTS = ("first", HEAVY, STICKY, "last")


@dataclass(frozen=True)
class DayOf:
    """A robot on a day."""

    name: str
    day: int

    def log(self, seconds=SECONDS):
        number = ROBOTS.index(self.name)
        own = np.random.default_rng([5, number])
        rng = np.random.default_rng([5, number, self.day])
        plain = robot("double_pendulum")
        plant = perturbed(plain, own, 0.01)
        dry, wet = DRY * np.exp(0.05 * own.normal(size=2)), WET * np.exp(0.05 * own.normal(size=2))
        if self.name == HEAVY and self.day >= FROM:
            ball = pin.Inertia(MASS, CENTER, 1e-3 * np.eye(3))
            plant.inertias[2] = plant.inertias[2] + ball
        if self.name == STICKY and self.day >= FROM:
            dry = dry * np.array([1.0, 1.0 + SHARE])
        dry, wet = dry * (1 + 0.01 * rng.normal(size=2)), wet * (1 + 0.01 * rng.normal(size=2))
        time = np.arange(0.0, seconds, 1 / RATE)
        q, v, a = random_motion(plain, rng, base=0.5)(time)
        data = plant.createData()
        effort = np.array([pin.rnea(plant, data, *each) for each in zip(q, v, a, strict=True)])
        effort += dry * np.tanh(v / 0.01) + wet * v
        effort += np.array([0.03, 0.015]) * rng.normal(size=effort.shape)
        q = q + 1e-6 * rng.normal(size=q.shape)
        return JointLog(f"log_{self.day}", ("shoulder", "elbow"), time, q, effort)


def date_of(day):
    """Return the name of a day in files."""
    return f"2026-05-{day + 1:02d}"


def write_fleet(folder, *, robots=ROBOTS, logs=LOGS):
    """Write logs and the fleet file; return its path."""
    for name in robots:
        (Path(folder) / name).mkdir()
        for day in range(logs):
            write_log(DayOf(name, day).log(), Path(folder) / name / f"{date_of(day)}.csv")
    return write_file(folder, robots)


def write_file(folder, robots=ROBOTS, *, logs="{}/*.csv", more=""):
    """Write the fleet file alone."""
    listed = "".join(
        f"  - {{name: {name}, logs: '{logs.format(name)}', dates: '%Y-%m-%d'}}\n" for name in robots
    )
    path = Path(folder) / "fleet.yaml"
    path.write_text(
        f"to: results\ntypes:\n  pendulum: {{model: '{PENDULUM}'}}\nrobots:\n{listed}{more}",
        encoding="utf-8",
    )
    return path
