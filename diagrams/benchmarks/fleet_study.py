"""Simulated fleets: which robot, which joint, which effect, since when.

Pinocchio simulates robots of two types, a log a day. Each robot has bodies, friction and gains of
its own, and friction of all follows the season. In four of five robots one thing changes: friction
that rises from some day on, dry friction or a gain from one day to the next, a payload that is put
on or taken off. Logs are files, and what `geodrake fleet` does with them is done: digests on
processes of Dask, then the findings. Told are how often the change is found (robot, joint or body,
effect, kind, and the day within two; that of a ramp is the day on which it begins), and how often
robots are named in which nothing changed.

    python -m diagrams.benchmarks.fleet_study --json fleet.json
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from rich.progress import track

from diagrams.benchmarks.fleets.logs import TYPES, FleetDraw, write_fleet_file, write_logs
from diagrams.benchmarks.fleets.scoring import robot_row, summary
from diagrams.harness import JOBS, finished, positive_number, script_parser, show_values, write
from geodrake.fleet import FleetResult, FleetWork, read_fleet, run_fleet


def study(folder: Path, draws: Sequence[FleetDraw], jobs: int) -> tuple[FleetResult, float]:
    """Return what is found in a fleet, and how long that took on the clock, s."""
    made = finished(partial(write_logs, folder=folder), draws, jobs)
    for _ in track(made, "logs", len(draws), transient=True):
        pass
    fleet = read_fleet(write_fleet_file(folder, draws))
    began = time.monotonic()
    result, _ = run_fleet(fleet, FleetWork(workers=0 if jobs == 1 else jobs))
    return result, time.monotonic() - began


def rows_of(result: FleetResult, draws: Sequence[FleetDraw]) -> list[dict[str, Any]]:
    """Return a row of the table for each robot, in the order of the draws."""
    robots = {robot.robot: robot for robot in result.robots}
    return [robot_row(draw, robots[draw.name].findings) for draw in draws]


def main() -> None:
    """Run from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument("--robots", type=positive_number, default=100, help="(%(default)s)")
    parser.add_argument("--still", action="store_true", help="nothing changes in any robot")
    parser.add_argument("--folder", type=Path, help="keep logs and digests here, and go on there")
    options = parser.parse_args()
    kinds = TYPES[:1] if options.quick else TYPES
    each = 7 if options.quick else -(-options.robots // len(kinds))
    shorter = {"duration": 8.0, "days": 20} if options.quick else {}
    fixed = {"still": options.still, **shorter}
    draws = [FleetDraw(kind, k, options.seed, **fixed) for kind in kinds for k in range(each)]
    with ExitStack() as stack:
        folder = options.folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        # Logs of other draws are others.
        own = f"seed_{options.seed}_{draws[0].days}_days" + "_still" * options.still
        result, seconds = study(folder / own, draws, options.jobs or (1 if options.quick else JOBS))
    rows = rows_of(result, draws)
    table = summary(rows) | {"seconds until findings are there": seconds}
    show_values("A fleet whose robots change", table)
    unused = [vars(log) for log in result.unused]
    write(options, {"summary": table, "rows": rows, "unused": unused})


if __name__ == "__main__":
    main()
