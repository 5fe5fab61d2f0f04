"""Motions of `geodrake excite` for six popular arms, checked by Pinocchio.

Each command runs as a user types it, from the arm's present pose, with its default limits. Another
engine then checks the saved motion at 200 Hz: distances of all links from each other and from the
floor (convex hulls of the file's collision geometry), the file's joint limits, efforts of inverse
dynamics, and saved speeds against slopes of saved positions. Links that always overlap are left
out, as the command reports. Models come with the package `example-robot-data`.

    python -m diagrams.benchmarks.excite_arms --json arms.json
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from diagrams.harness import cpu_time, script_parser, show, write
from diagrams.public_data import installed_model
from geodrake import load_model
from geodrake.excitation import CollisionWorld, motion_limits
from geodrake.excitation.collisions import floor_of
from geodrake.excitation.starts import possible_postures
from geodrake.inertia import Array
from geodrake.robot import joint_names

ARMS = {
    "UR5": "ur_description/urdf/ur5_robot.urdf",
    "Panda": "panda_description/urdf/panda.urdf",
    "xArm7": "xarm_description/urdf/xarm7.urdf",
    "Z1": "z1_description/urdf/z1.urdf",
    "SO-101": "so_arm_description/urdf/so101.urdf",
    "UR10": "ur_description/urdf/ur10_joint_limited_robot.urdf",
}
MARGIN, CLEARANCE, RATE = 0.9, 0.01, 200.0
_FAR = 0.2  # m, beyond which distances do not matter here


@dataclass(frozen=True)
class Checked:
    """Pinocchio's check of a motion, and geodrake's numbers of its search."""

    arm: str
    joints: int
    cpu: float
    statuses: tuple[str, ...]
    gain: float  # by what factor the worst variance is better than by the best random motion
    length: float
    distance: float  # least distance of links from each other, m; at most 0.2
    height: float  # least distance of a moving link from the floor, m; at most 0.2
    # position, velocity, effort: Largest shares of the file's limits.
    position: float
    velocity: float
    acceleration: float  # largest, rad/s²
    effort: float
    slope: float  # largest difference of saved speeds and slopes of saved positions, rad/s

    @property
    def is_safe(self) -> bool:
        """Whether nothing collides and all margins are kept, up to errors of sampling."""
        clear = min(self.distance, self.height) >= CLEARANCE - 1e-3
        shares = self.position <= 1.0 and self.velocity <= MARGIN + 1e-3 and self.effort <= 1.0
        return clear and shares and self.slope < 1e-2


def excited(path: Path, folder: Path, options: Sequence[str]) -> tuple[dict[str, Any], Any, float]:
    """Run the command, and return its numbers, its table, and its CPU time, s."""
    numbers, motion = folder / "numbers.json", folder / "motion.csv"
    files = ["--json", str(numbers), "--save", str(motion), "--rate", f"{RATE:g}"]
    command = [sys.executable, "-m", "geodrake", "excite", str(path), *files, *options]
    seconds = cpu_time(lambda: subprocess.run(command, check=True, stdout=subprocess.DEVNULL))
    table = np.genfromtxt(motion, delimiter=",", names=True, deletechars="")
    return json.loads(numbers.read_text()), table, seconds


def checked(name: str, options: Sequence[str]) -> Checked:
    """Design a motion for an arm with the command, and check it with Pinocchio."""
    path = installed_model(ARMS[name])
    model = load_model(path)
    lower, upper = model.position_limits
    world = CollisionWorld(model, obstacles=(floor_of(model),), clearance=CLEARANCE)
    held = possible_postures(model, motion_limits(model, bounded=True), world, most=1)[0]
    stand = ",".join(f"{j}={q:.6g}" for j, q in zip(model.joints, held, strict=True))
    with TemporaryDirectory() as folder:
        numbers, table, cpu = excited(path, Path(folder), ("--stand", stand, *options))
    columns = [
        np.column_stack([table[f"{joint}.{kind}"] for joint in model.joints])
        for kind in ("position", "velocity", "acceleration")
    ]
    q, v, vd = columns
    robot = pin.buildModelFromUrdf(str(path))
    order = [joint_names(model.plant).index(joint) for joint in robot.names[1:]]
    whole = model.plant_positions(q)[:, order]
    distance, height = distances(robot, path, whole, numbers["notes"])
    own = [robot.idx_vs[robot.getJointId(joint)] for joint in model.joints]
    data, efforts = robot.createData(), np.zeros_like(v)
    for k in range(len(q)):
        rates = np.zeros((2, robot.nv))
        rates[:, own] = v[k], vd[k]
        efforts[k] = pin.rnea(robot, data, whole[k], *rates)[own]
    slopes = (q[2:] - q[:-2]) * RATE / 2.0
    return Checked(
        arm=name,
        joints=len(model.joints),
        cpu=cpu,
        statuses=tuple(start["status"] for start in numbers["starts"]),
        gain=numbers["improvement_over_random"],
        length=numbers["seconds"]["with_ramps"],
        distance=distance,
        height=height,
        position=float(np.abs((q - (lower + upper) / 2) / ((upper - lower) / 2)).max()),
        velocity=float((np.abs(v) / robot.velocityLimit[own]).max()),
        acceleration=float(np.abs(vd).max()),
        effort=float((np.abs(efforts) / robot.effortLimit[own]).max()),
        slope=float(np.abs(slopes - v[1:-1])[:-1].max()),
    )


def distances(robot: pin.Model, path: Path, q: Array, notes: Sequence[str]) -> tuple[float, float]:
    """Return the least distances of links from each other and from the floor, m."""
    shapes = pin.buildGeomFromUrdf(
        robot, str(path), pin.GeometryType.COLLISION, package_dirs=[str(path.parents[4])]
    )
    for shape in shapes.geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):
            shape.geometry.buildConvexHull(True, "Qt")
            shape.geometry = shape.geometry.convex
    links = [shape.name.rpartition("_")[0] for shape in shapes.geometryObjects]
    allowed = neighbours(path) | {
        frozenset(note.partition(" of ")[0].split(" and ")) for note in notes
    }
    floor = pin.GeometryObject(
        "floor_0", 0, pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5])), coal.Box(20.0, 20.0, 1.0)
    )
    at = shapes.addGeometryObject(floor)
    kinds = []
    for i, first in enumerate(links):
        if shapes.geometryObjects[i].parentJoint:
            shapes.addCollisionPair(pin.CollisionPair(i, at))
            kinds.append(1)
        for j, second in enumerate(links[:i]):
            if first != second and frozenset((first, second)) not in allowed:
                shapes.addCollisionPair(pin.CollisionPair(j, i))
                kinds.append(0)
    data, found, least = robot.createData(), shapes.createData(), np.full((len(q), 2), _FAR)
    for k, posture in enumerate(q):
        pin.computeDistances(robot, data, shapes, found, posture)
        for kind, result in zip(kinds, found.distanceResults, strict=True):
            least[k, kind] = min(least[k, kind], result.min_distance)
    return float(least[:, 0].min()), float(least[:, 1].min())


def neighbours(path: Path) -> set[frozenset[str]]:
    """Return pairs of links that are welded together or connected by a joint."""
    group, pairs = dict[str, str](), list[tuple[str, str]]()
    for joint in ElementTree.parse(path).getroot().iter("joint"):
        ends = [getattr(joint.find(end), "attrib", {}).get("link") for end in ("parent", "child")]
        if None in ends:
            continue
        parent, child = (group.setdefault(end, end) for end in ends)
        pairs.append(tuple(ends))
        if joint.get("type") == "fixed":
            group = {name: parent if own == child else own for name, own in group.items()}
    touching = {frozenset(group[end] for end in ends) for ends in pairs}
    touching |= {frozenset({name}) for name in group.values()}
    every = product(group, repeat=2)
    return {frozenset(two) for two in every if frozenset(group[end] for end in two) in touching}


def main() -> None:
    """Run from the command line."""
    chosen = script_parser(__doc__, "one start of each of two arms").parse_args()
    options = ["--seed", str(chosen.seed)]
    if chosen.quick:
        options += ["--seeds", "1", "--seconds", "20", "--iterations", "10", "--samples", "100"]
    found = [checked(name, options) for name in list(ARMS)[: 2 if chosen.quick else None]]
    rows = [{**asdict(one), "safe": one.is_safe} for one in found]
    lines = [{**row, "statuses": ", ".join(row["statuses"])} for row in rows]
    show("Motions of arms: s, m, shares of limits and rad/s²", lines)
    write(chosen, rows)
    if not all(one.is_safe for one in found):
        raise SystemExit("A motion does not keep its margins.")


if __name__ == "__main__":
    main()
