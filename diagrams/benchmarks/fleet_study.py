"""Simulated fleets: which robot, which joint, which effect, since when.

Pinocchio simulates robots of two types, a log a day. Each robot has its own bodies, friction and
gains, and all friction follows the season. In four of five robots one thing changes: friction that
rises from some day on, dry friction or a gain from one day to the next, a payload that is put on or
taken off. `geodrake fleet` reads the logs from files: digests by Dask's processes, then findings.
Reported is how often the change is found (robot, joint or body, effect, kind, and the day within
two; a ramp's day is its first), and how often robots are named in which nothing changed.

    python -m diagrams.benchmarks.fleet_study --json fleet.json
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from rich.progress import track

from diagrams.benchmarks.simulated.fleet import (
    GAIN,
    PAYLOAD,
    STICKIER,
    TYPES,
    WEAR,
    FleetDraw,
    day_of,
    type_file,
    write_fleet_file,
    write_logs,
)
from diagrams.benchmarks.simulated.truths import DRY, HELD, WET
from diagrams.harness import JOBS, finished, positive_number, script_parser, show_values, write
from geodrake.fleet import FleetFinding, FleetResult, FleetWork, read_fleet, run_fleet
from geodrake.fleet.changes import MONTH
from geodrake.fleet.type_columns import RAMP, STEP


def study(folder: Path, draws: Sequence[FleetDraw], jobs: int) -> tuple[FleetResult, float]:
    """Return the findings of a fleet, and the wall time, s."""
    made = finished(partial(write_logs, folder=folder), draws, jobs)
    for _ in track(made, "logs", len(draws), transient=True):
        pass
    fleet = read_fleet(write_fleet_file(folder, draws))
    began = time.monotonic()
    result, _ = run_fleet(fleet, FleetWork(workers=0 if jobs == 1 else jobs))
    return result, time.monotonic() - began


_DRY, _VISCOUS = frozenset({DRY}), frozenset({WET})

FAMILIES: Mapping[str, tuple[frozenset[str], ...]] = {
    WEAR: (_DRY | _VISCOUS, _DRY, _VISCOUS),
    STICKIER: (_DRY, _DRY | _VISCOUS),
    PAYLOAD: (frozenset({HELD}),),
    GAIN: (frozenset({"effort_scale"}),),
}
"""What each hidden change may be called: friction that rises is found as dry, viscous, or both."""

DAYS_OFF = 2.0
"""Days by which the day of a change may be off; for a ramp, the day on which it begins."""


def robot_row(draw: FleetDraw, found: Sequence[FleetFinding]) -> dict[str, Any]:
    """Return the row of a robot: the hidden change and the findings.

    A finding is right if it has the effect, joint or body, kind and day of the change.
    """
    hidden, model = draw.change, type_file(draw.kind).model
    row = {
        "robot": draw.name,
        "type": draw.kind,
        "months": draw.days / MONTH,
        "named": [_named(change) for change in found],
        **dict.fromkeys(("hidden", "where", "hidden day", "hidden size", "day off", "inside")),
    }
    if hidden is None:
        return {**row, "found": False, "others named": len(found)}
    where = (model.bodies if hidden.what == PAYLOAD else model.joints)[hidden.joint]
    shape = RAMP if hidden.what == WEAR else STEP

    def is_it(one: FleetFinding) -> bool:
        family, effects = FAMILIES[hidden.what], frozenset(one.effect.split("+"))
        return effects in family and (one.where, one.kind) == (where, shape)

    near = (change for change in found if abs(day_of(change.date) - hidden.day) <= DAYS_OFF)
    right = next(filter(is_it, near), None)
    row |= {"hidden": hidden.what, "where": where, "hidden day": hidden.day}
    row |= {"hidden size": hidden.size, "found": right is not None}
    if right is not None:
        low, high = (day_of(end) for end in right.interval)
        row |= {"day off": day_of(right.date) - hidden.day, "inside": low <= hidden.day <= high}
    return {**row, "others named": len(found) - (right is not None)}


def _named(change: FleetFinding) -> dict[str, Any]:
    return {
        "effect": change.effect,
        "where": change.where,
        "kind": change.kind,
        "day": day_of(change.date),
        "interval": [day_of(end) for end in change.interval],
        "probability": change.probability,
        "false_alarm_probability": change.false_alarm_probability,
    }


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return shares over all robots."""
    changed = [row for row in rows if row["hidden"] is not None]
    still = [row for row in rows if row["hidden"] is None]
    found = [row for row in changed if row["found"]]
    table: dict[str, Any] = {
        "robots": len(rows),
        "changed": len(changed),
        "found": _share(len(found), len(changed)),
        "day inside its interval": _share(sum(row["inside"] for row in found), len(found)),
        "others named, a changed robot": _share(
            sum(row["others named"] for row in changed), len(changed)
        ),
        "robots with nothing": len(still),
        "robots with nothing that are named": sum(bool(row["named"]) for row in still),
        "alarms, a robot-month": _share(
            sum(bool(row["named"]) for row in still), sum(row["months"] for row in still)
        ),
    }
    for what in FAMILIES:
        same = [row for row in changed if row["hidden"] == what]
        share = _share(sum(row["found"] for row in same), len(same))
        table[what] = {"found": share, "of": len(same)}
    return table


def _share(count: float, total: float) -> float | None:
    return count / total if total else None


def main() -> None:
    """Run from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument("--robots", type=positive_number, default=100, help="(%(default)s)")
    parser.add_argument("--folder", type=Path, help="keep logs and digests here, and go on there")
    options = parser.parse_args()
    kinds = TYPES[:1] if options.quick else TYPES
    each = 7 if options.quick else -(-options.robots // len(kinds))
    shorter = {"duration": 8.0, "days": 20} if options.quick else {}
    draws = [FleetDraw(kind, k, options.seed, **shorter) for kind in kinds for k in range(each)]
    with ExitStack() as stack:
        folder = options.folder or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        # Logs of other draws are others.
        own = f"seed_{options.seed}_{draws[0].days}_days"
        result, seconds = study(folder / own, draws, options.jobs or (1 if options.quick else JOBS))
    found = {robot.robot: robot.findings for robot in result.robots}
    rows = [robot_row(draw, found[draw.name]) for draw in draws]
    table = summary(rows) | {"seconds until findings are there": seconds}
    show_values("A fleet whose robots change", table)
    unused = [vars(log) for log in result.unused]
    write(options, {"summary": table, "rows": rows, "unused": unused})


if __name__ == "__main__":
    main()
