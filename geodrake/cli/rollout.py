"""The command `geodrake rollout`: the model simulated under logged efforts or commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from geodrake.cli.command import Command, Input, Output, run
from geodrake.cli.input_options import report_repairs
from geodrake.cli.options import RolloutOptions
from geodrake.control.rollout import Rollout, RolloutFit, fit_rollouts, roll_out
from geodrake.control.rollout.motion_search import rollout_values
from geodrake.errors import ArgumentError
from geodrake.model.holding import holding
from geodrake.model.robot_model import RobotModel
from geodrake.model.saved_model import is_saved_model, load_model
from geodrake.report.rollouts import Simulated
from geodrake.robot.files.xacro_file import is_xacro


def run_rollout(options: RolloutOptions) -> None:
    """Run `geodrake rollout`: simulate a model, or fit its elastic joints and backlash."""
    if options.save is not None and not options.fit:
        raise ArgumentError(
            f"--save {options.save} needs --fit: a rollout alone does not change the model.",
            advice="Add --fit, or omit --save.",
        )
    if options.fit and options.before is not None:
        raise ArgumentError(
            "--fit and --before exclude each other: a fit is compared with the given model.",
            advice="Fit and save the model first, then run rollout with --before.",
        )
    settings: dict[str, Any] = {
        "horizon": options.horizon,
        "most": options.windows,
        "commands": options.commands,
    }

    def fitted(given: Input) -> RolloutFit:
        return fit_rollouts(
            given.model, given.logs, **settings, **given.settings, progress=given.progress
        )

    def rolled_out(model: RobotModel, given: Input, prefix: str = "") -> Rollout:
        return roll_out(
            model,
            given.logs,
            **settings,
            **given.settings,
            progress=lambda words, share: given.progress(f"{prefix}{words}", share),
        )

    def simulated(given: Input) -> Simulated:
        before = None
        if options.before is not None:
            before = rolled_out(other_model(options.before, given), given, "before: ")
        return Simulated(rolled_out(given.model, given), before, given.model)

    def check(model: RobotModel) -> None:
        if options.fit and not options.commands:
            rollout_values(model)  # raises if there is nothing to fit

    working, work = ("Fitting", fitted) if options.fit else ("Simulating", simulated)
    words = "replay of measured and simulated motion"
    outputs = {"meshcat": Output(words, make=_replay)}
    run(Command[Any]("rollout", working, work, outputs=outputs, check=check), options)


def other_model(path: Path, given: Input) -> RobotModel:
    """Return another model of the same robot, with the same joints fixed."""
    model, reading, drives = given.model, None, None
    if not is_saved_model(path):
        reading = model.given
        if not (path.is_file() and is_xacro(path)):
            reading = replace(reading, xacro={})
        drives = model.transmission  # the logs belong to these
    other = load_model(
        path, floating=model.floating, extra=given.extra, given=reading, transmission=drives
    )
    report_repairs(other.path.name, other.repairs, given.progress)
    return holding(other, {j: q for j, q in model.held.items() if j in other.joints})


def _replay(found: RolloutFit | Simulated, path: Path) -> str:
    del path
    from geodrake.report.meshcat_scene import rollout_replay_page

    return rollout_replay_page(cast("RobotModel", found.model), found.after, found.before)
