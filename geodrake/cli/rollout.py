"""The command `geodrake rollout`: the model simulated under the logged efforts."""

from __future__ import annotations

from math import isfinite
from typing import Any

from rich.console import Console

from geodrake.cli.options import RolloutOptions
from geodrake.cli.session import Command, Input, run
from geodrake.cli.tables import head, number_columns, say, show_list, table_of
from geodrake.cli.wording import Wording, number, percent
from geodrake.json_output import rollout_dict
from geodrake.model import RobotModel
from geodrake.rollout import Rollout, roll_out
from geodrake.saved_model import load_model

Pair = tuple[Rollout, Rollout | None]

_NO_FORCES = "as they are no forces on the links"


def run_rollout(options: RolloutOptions) -> None:
    """Run the command.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """

    def simulated(given: Input) -> Pair:
        before = None
        if options.before is not None:
            other = load_model(options.before, floating=options.floating, extra=given.extra)
            before = rolled_out(other, given, "before: ")
        return rolled_out(given.model, given, ""), before

    def rolled_out(model: RobotModel, given: Input, prefix: str) -> Rollout:
        return roll_out(
            model,
            given.logs,
            horizon=options.horizon,
            most=options.windows,
            **given.settings,
            progress=lambda words, share: given.tell(f"{prefix}{words}: {percent(share)}"),
        )

    run(Command("rollout", "Simulating", simulated, _numbers, "render_rollout", _show), options)


def _numbers(found: Pair) -> dict[str, Any]:
    after, before = found
    numbers = rollout_dict(after)
    return numbers if before is None else {**numbers, "before": rollout_dict(before)}


def _show(console: Console, found: Pair, wording: Wording) -> None:
    after, before = found
    count = len(after.windows)
    head(
        console,
        f"Departure from the measured motion, RMS in {count} windows of {after.horizon:g} s; "
        "rad (m at sliding joints)",
    )
    table = table_of(console, "joint")
    ends = ("before", "after") if before else ("departure",)
    number_columns(table, "moved", *ends, "share of motion", "worst at")
    for j, joint in enumerate(after.joints):
        start = [number(before.joints[j].rms)] if before else []
        log, instant = joint.worst
        table.add_row(
            joint.joint,
            number(joint.moved),
            *start,
            number(joint.rms),
            _share(joint.relative),
            f"{log} {instant:.1f} s",
        )
    console.print(table)
    words = f"departs by {_share(after.relative)} of the motion within {after.horizon:g} s"
    if before is not None:
        words = f"{words}, where {_share(before.relative)} before"
    if after.broken:
        words = f"{words}; in {after.broken} of {count} windows the simulation breaks off"
    say(console, "Verdict", f"the simulated model {words}.")
    show_list(console, f"Not simulated, {_NO_FORCES}", after.left_out_words)
    if before is not None:
        show_list(
            console, f"Not simulated of the model before, {_NO_FORCES}", before.left_out_words
        )
    show_list(console, "Notes", after.notes)


def _share(value: float) -> str:
    if not isfinite(value):
        return "more than can be simulated"
    return percent(value) if value < 10 else f"{value:.3g} times the whole"
