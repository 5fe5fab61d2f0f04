"""The command `geodrake rollout`: the model simulated under logged efforts or commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from geodrake.cli.model_options import tell_repairs
from geodrake.cli.options import RolloutOptions
from geodrake.cli.rollout_fit import check_fit, run_rollout_fit
from geodrake.cli.session import Command, Input, run
from geodrake.cli.tables import head, say, show_list, show_table
from geodrake.control.rollout import Rollout, command_rollout, roll_out
from geodrake.model.holding import holding
from geodrake.model.robot_model import RobotModel
from geodrake.model.saved_model import is_saved_model, load_model
from geodrake.report.json_output import rollout_dict
from geodrake.report.numbers import Units
from geodrake.report.tables import departures_table
from geodrake.report.words import departure
from geodrake.robot.files.xacro_file import is_xacro

Pair = tuple[Rollout, Rollout | None]


def run_rollout(options: RolloutOptions) -> None:
    """Run the command.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """
    check_fit(options)
    if options.fit:
        run_rollout_fit(options)
        return

    def simulated(given: Input) -> Pair:
        before = None
        if options.before is not None:
            other = other_model(options.before, given)
            before = rolled_out(other, given, "before: ")
        return rolled_out(given.model, given, ""), before

    def rolled_out(model: RobotModel, given: Input, prefix: str) -> Rollout:
        simulate = command_rollout if options.commands else roll_out
        return simulate(
            model,
            given.logs,
            horizon=options.horizon,
            most=options.windows,
            **given.settings,
            progress=lambda words, share: given.progress(f"{prefix}{words}", share),
        )

    model: list[RobotModel] = []

    def replay(found: Pair) -> str:
        from geodrake.report.replay import rollout_replay_page

        return rollout_replay_page(model[0], *found)

    run(
        Command(
            "rollout",
            "Simulating",
            simulated,
            _numbers,
            "render_rollout",
            _show,
            more={"meshcat": options.meshcat},
            makers=lambda found: {"meshcat": lambda: replay(found)},
            saved={"meshcat": "replay of measured and simulated motion"},
            check=model.append,
        ),
        options,
    )


def other_model(path: Path, given: Input) -> RobotModel:
    """Return a model of the same robot, with the same joints held."""
    model, how, drives = given.model, None, None
    if not is_saved_model(path):
        how = model.given if is_xacro(path) else replace(model.given, xacro={})
        drives = model.transmission  # whose logs these are
    other = load_model(
        path, floating=model.floating, extra=given.extra, given=how, transmission=drives
    )
    tell_repairs(other, given.progress)
    return holding(other, {j: place for j, place in model.held.items() if j in other.joints})


def _numbers(found: Pair) -> dict[str, Any]:
    after, before = found
    numbers = rollout_dict(after)
    return numbers if before is None else {**numbers, "before": rollout_dict(before)}


def _show(console: Console, found: Pair, units: Units) -> None:
    after, before = found
    count = len(after.windows)
    windows = f"{count} windows of {after.horizon:g} s"
    head(console, f"Departure from the measured motion, RMS in {windows}")
    show_table(console, departures_table(after, before, units))
    words = f"departs by {departure(after.relative)} of the motion within {after.horizon:g} s"
    if before is not None:
        words = f"{words}, where {departure(before.relative)} before"
    if after.broken:
        words = f"{words}; in {after.broken} of {count} windows the simulation breaks off"
    say(console, "Verdict", f"the simulated model {words}.")
    show_list(console, "Notes", after.notes)
