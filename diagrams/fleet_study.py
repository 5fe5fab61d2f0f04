"""Simulated fleets: which robot, which joint, which effect, since when.

Pinocchio simulates robots of two types, a log a day. Each robot has bodies, friction and gains of
its own, and friction of all follows the season. In four of five robots one thing changes: friction
that rises from some day on, dry friction or a gain from one day to the next, a payload that is put
on or taken off. Told are how often that is found (robot, joint or body, effect, kind, and the day
within two; that of a ramp is the day on which it begins), and how often robots are named in which
nothing changed.

    python diagrams/fleet_study.py --json fleet.json
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from adaptive.options import make_parser, positive_number, show, write_json
from fleets.digesting import RobotDigests, digest_robot, type_columns, type_hypotheses
from fleets.draws import TYPES, FleetDraw
from fleets.figures import save_days, save_levels
from fleets.scoring import robot_row, summary
from resumable.draws import finished
from rich.console import Console
from rich.progress import track

from geodrake.fleet.changes import RobotSearch
from geodrake.fleet.fleet_changes import FleetChanges, find_changes
from geodrake.fleet.history import RobotHistory, weighted_history
from geodrake.fleet.levels import parameter_levels


def study_type(
    kind: str, draws: Sequence[FleetDraw], digests: Sequence[RobotDigests], figures: Path | None
) -> list[dict[str, Any]]:
    """Rows of the table, of all robots of a type."""
    columns, hypotheses = type_columns(kind), type_hypotheses(kind)
    histories = [weighted_history(d.robot, d.days, d.grams, d.weights) for d in digests]
    began = time.process_time()
    found = find_changes(histories, columns, hypotheses)
    seconds = time.process_time() - began
    rows = [
        robot_row(draw, changes) | {"seconds": seconds / len(draws)}
        for draw, changes in zip(draws, found.changes, strict=True)
    ]
    if figures is not None:
        _save_one(kind, found, histories, figures)
    return rows


def _save_one(
    kind: str, found: FleetChanges, histories: Sequence[RobotHistory], folder: Path
) -> None:
    """The first parameter that changed, over time."""
    columns, hypotheses = type_columns(kind), type_hypotheses(kind)
    for r, (places, history) in enumerate(zip(found.places, histories, strict=True)):
        for place, change in zip(places, found.changes[r], strict=True):
            at = hypotheses[place.hypothesis].factor.any(axis=1).nonzero()[0]
            if not columns.relative[at].all():
                continue
            search = RobotSearch(found.model, r, history, found.references[r], hypotheses)
            state = search.state(places)
            levels = parameter_levels(found.model, r, state.logs, state.fit, at.tolist())
            name = f"{change.effect} of {change.where}, {change.robot}"
            save_levels(levels, name, change.day, folder)
            return


def main() -> None:
    """Run from the command line."""
    parser = make_parser(__doc__ or "")
    parser.add_argument("--robots", type=positive_number, default=100, help="(%(default)s)")
    parser.add_argument("--still", action="store_true", help="nothing changes in any robot")
    options = parser.parse_args()
    kinds = TYPES[:1] if options.quick else TYPES
    each = 7 if options.quick else -(-options.robots // len(kinds))
    shorter = {"duration": 8.0, "days": 20} if options.quick else {}
    rows = []
    for kind in kinds:
        fixed = {"still": options.still, **shorter}
        draws = [FleetDraw(kind, k, options.seed, **fixed) for k in range(each)]
        workers = 1 if options.quick else options.jobs
        made = track(finished(digest_robot, draws, workers), kind, len(draws), transient=True)
        digests = {draw.number: digest for draw, digest in made}
        ordered = [digests[draw.number] for draw in draws]
        rows += study_type(kind, draws, ordered, options.figures)
    table = summary(rows)
    columns = {"figure": "", "value": ".3g", "found": ".0%", "or among rivals": ".0%", "of": ""}
    lines = [
        {"figure": name, **(value if isinstance(value, dict) else {"value": value})}
        for name, value in table.items()
    ]
    show(Console(), "A fleet whose robots change", columns, lines)
    if options.figures is not None:
        save_days(rows, options.figures)
    write_json(options.json, {"summary": table, "rows": rows})


if __name__ == "__main__":
    main()
