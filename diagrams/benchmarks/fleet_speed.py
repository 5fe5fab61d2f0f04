"""How long a run of `geodrake fleet` takes with one and two workers, and once digests are there.

The arm's own model makes the logs, with friction that differs from robot to robot. Times are wall
times and include the start of the workers.

    OMP_NUM_THREADS=1 python -m diagrams.benchmarks.fleet_speed --json speed.json
"""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from diagrams.benchmarks.digest_speed import swinging
from diagrams.harness import MODELS, script_parser, tell
from geodrake.fleet import FleetWork, read_fleet, run_fleet
from geodrake.inertia import Array
from geodrake.logs.files import write_log
from geodrake.logs.motion import JointLog
from geodrake.model import load_model

RATE = 200.0  # Hz
FIRST = 1.78e9  # s since 1970
DAY = 86400.0

CASES, SHORT = [(4, 100, 12.0, 1), (4, 100, 12.0, 2)], [(3, 4, 4.0, 0)]
"""Robots, logs of each, their length in s, and workers."""


def friction(log: JointLog, robot: int, day: int) -> Array:
    """Return friction (N, nv) of a log, N·m; seeds tell robots and days apart."""
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
    """Write the logs of a fleet, and return its file."""
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


def measure(path: Path, logs: int, length: float, workers: int) -> dict[str, Any]:
    """Measure one run of a fleet without digests, s, and "again" with them."""
    fleet, work, times = read_fleet(path), FleetWork(workers=workers), [time.monotonic()]
    for _ in range(2):
        run_fleet(fleet, work)
        times.append(time.monotonic())
    seconds, again = np.diff(times).tolist()
    what = {"robots": len(fleet.robots), "logs": logs, "length": length, "workers": workers}
    return {**what, "seconds": seconds, "again": again}


def main() -> None:
    """Measure, print and write."""
    options = script_parser(__doc__, "few short logs of two joints").parse_args()
    name, cases = ("double_pendulum", SHORT) if options.quick else ("arm7", CASES)
    costs = []
    for robots, logs, length, workers in cases:
        with tempfile.TemporaryDirectory() as folder:
            much = {"robots": robots, "logs": logs, "seconds": length}
            path = write_logs(Path(folder), name, **much, seed=options.seed)
            costs.append(measure(path, logs, length, workers))
    tell(options, costs)


if __name__ == "__main__":
    main()
