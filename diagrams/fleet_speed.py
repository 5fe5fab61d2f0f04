"""What a run of `geodrake fleet` costs: time with one and two workers, memory with ever more logs.

Logs are made by the arm's own model, with friction that differs from robot to robot. Times are
those of a clock, with the start of the workers; memory is the most that a process takes that makes
findings of digests, with its libraries.

    OMP_NUM_THREADS=1 python diagrams/fleet_speed.py --json fleet_speed.json --figures figures
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from digest_speed import MODELS, swinging
from matplotlib.figure import Figure
from numpy.typing import NDArray

from geodrake.fleet import FleetWork, read_fleet, run_fleet
from geodrake.logs.files import write_log
from geodrake.logs.motion import JointLog
from geodrake.model import load_model
from geodrake.report import style

RATE = 200.0  # Hz
FIRST = 1.78e9  # s since 1970
DAY = 86400.0

CASES = [
    (4, 100, 12.0, 1),
    (4, 100, 12.0, 2),
    (4, 40, 60.0, 1),
    (4, 40, 60.0, 2),
    (2, 10, 4.0, 2),
    (2, 1000, 4.0, 2),
]
"""Robots, logs of each, their length in s, and workers: four for times, and two for memory."""
SHORT = [(3, 4, 4.0, 0), (3, 16, 4.0, 0)]

_PEAK = """
import resource, sys
from pathlib import Path
from geodrake.fleet import FleetWork, read_fleet, run_fleet

run_fleet(read_fleet(sys.argv[1]), FleetWork(workers=0))
peak, status = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, Path("/proc/self/status")
if status.is_file():  # where the other number may be that of the process which started this one
    peak = next(int(line.split()[1]) for line in status.open() if line.startswith("VmHWM"))
print(peak * (1.0 if sys.platform == "darwin" else 1024.0) / 1e6)
"""


@dataclass(frozen=True)
class RunCost:
    """What a run took.

    Attributes:
        robots: Robots of one type.
        logs: Logs of each.
        length: Length of a log, s.
        workers: Processes that digest.
        seconds: Time of a clock until findings are there, s.
        again: The same when digests and histories are there, s.
        memory: Most memory of a process that makes findings of digests, MB.
    """

    robots: int
    logs: int
    length: float
    workers: int
    seconds: float
    again: float
    memory: float


def friction(log: JointLog, robot: int, day: int) -> NDArray[np.float64]:
    """(N, nv) friction of a log, N·m: robots differ, and the days of each.

    Args:
        log: The log.
        robot: Seed of the robot.
        day: Seed of the day.
    """
    n, v = len(log.joints), np.gradient(log.position, 1.0 / RATE, axis=0)
    own, of_day = (
        np.exp(share * np.random.default_rng([seed, 7]).normal(size=(2, n)))
        for share, seed in ((0.1, robot), (0.02, day))
    )
    dry, viscous = own * of_day
    return np.asarray(dry * np.tanh(v / 0.01) + viscous * v)


def write_logs(
    folder: Path, name: str, *, robots: int, logs: int, seconds: float, seed: int
) -> Path:
    """The logs and the file of a fleet.

    Args:
        folder: Where they go.
        name: Name of the model.
        robots: How many robots there are.
        logs: Logs of each.
        seconds: Length of a log, s.
        seed: Of motions and noise.
    """
    path = MODELS / f"{name}.urdf"
    model, names = load_model(path), [f"robot_{k}" for k in range(robots)]
    for k, robot in enumerate(names):
        (folder / robot).mkdir(parents=True)
        for day in range(logs):
            log = swinging(model, RATE, seconds, 1.0, seed + 1000 * k + day)
            log = replace(log, effort=log.effort + friction(log, seed + k, seed + 1000 * k + day))
            write_log(
                log, folder / robot / f"{time.strftime('%F', time.gmtime(FIRST + day * DAY))}.csv"
            )
    listed = [{"name": each, "logs": f"{each}/*.csv", "dates": "%Y-%m-%d"} for each in names]
    said = {"to": "results", "types": {"arm": {"model": str(path)}}, "robots": listed}
    (folder / "fleet.yaml").write_text(json.dumps(said), encoding="utf-8")
    return folder / "fleet.yaml"


def measure(path: Path, logs: int, length: float, workers: int) -> RunCost:
    """One run, and one more of what it left.

    Args:
        path: File of the fleet, whose digests are not made.
        logs: Logs of each robot.
        length: Length of a log, s.
        workers: Processes that digest.
    """
    fleet, work = read_fleet(path), FleetWork(workers=workers)
    begin = time.monotonic()
    run_fleet(fleet, work)
    middle = time.monotonic()
    run_fleet(fleet, work)
    end = time.monotonic()
    times = middle - begin, end - middle
    return RunCost(len(fleet.robots), logs, length, workers, *times, most_memory(path))


def most_memory(path: Path) -> float:
    """Most memory of a process that makes findings of digests alone, MB.

    Args:
        path: File of the fleet, whose digests are there.
    """
    for kept in path.parent.glob("results/*/logs/*/history.npz"):
        kept.unlink()
    run = subprocess.run(
        [sys.executable, "-c", _PEAK, str(path)], check=True, capture_output=True, text=True
    )
    return float(run.stdout)


def cost_figure(costs: Sequence[RunCost]) -> Figure:
    """Time and memory of each run."""
    figure = style.new_figure(1.2 + 0.4 * len(costs))
    labels = [
        f"{cost.robots} × {cost.logs} × {cost.length:g} s, {cost.workers} workers" for cost in costs
    ]
    for ax, name, unit in zip(
        figure.subplots(1, 2), ("seconds", "memory"), ("s", "MB"), strict=True
    ):
        style.polish(ax, grid="x")
        values = [getattr(cost, name) for cost in costs]
        bars = ax.barh(labels, values, color=style.AFTER, height=0.6)
        ax.bar_label(bars, [f"{value:.3g} {unit}" for value in values], padding=4, **style.plain())
        ax.invert_yaxis()
        ax.margins(x=0.3)
        ax.set_title(f"{name}, {unit}", loc="left", **style.plain(fontweight="bold"))
    return figure


def main() -> None:
    """Measures, prints, and writes what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few short logs of two joints")
    parser.add_argument("--seed", type=int, default=0, help="of the motions and the noise")
    parser.add_argument("--json", type=Path, help="file for the numbers")
    parser.add_argument("--figures", type=Path, help="folder for the figure")
    options = parser.parse_args()
    name, cases = ("double_pendulum", SHORT) if options.quick else ("arm7", CASES)
    costs = []
    for robots, logs, length, workers in cases:
        with tempfile.TemporaryDirectory() as folder:
            much = {"robots": robots, "logs": logs, "seconds": length}
            path = write_logs(Path(folder), name, **much, seed=options.seed)
            costs.append(measure(path, logs, length, workers))
            print(costs[-1], flush=True)
    table = [asdict(cost) for cost in costs]
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(table, indent=2) + "\n")
    if options.figures:
        options.figures.mkdir(parents=True, exist_ok=True)
        cost_figure(costs).savefig(options.figures / "fleet_speed.png")


if __name__ == "__main__":
    main()
