"""The command `geodrake rollout`: the model simulated under logged efforts or commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from geodrake.cli.input_options import tell_repairs
from geodrake.cli.options import RolloutOptions
from geodrake.cli.session import Command, Input, run
from geodrake.control.rollout import (
    Rollout,
    RolloutFit,
    fit_rollouts,
    roll_out,
)
from geodrake.control.rollout.rollout_values import rollout_values
from geodrake.errors import ArgumentError
from geodrake.model.holding import holding
from geodrake.model.robot_model import RobotModel
from geodrake.model.saved_model import is_saved_model, load_model
from geodrake.report.rollouts import Simulated
from geodrake.robot.files.xacro_file import is_xacro

_SAVED = {"meshcat": "replay of measured and simulated motion"}


def run_rollout(options: RolloutOptions) -> None:
    """Simulate a model under logged efforts or commands, or fit its soft joints and play."""
    if options.save is not None and not options.fit:
        raise ArgumentError(
            f"Without --fit a rollout changes nothing of the model, so --save {options.save} would "
            "write what is there.",
            advice="Add --fit, or leave --save out.",
        )
    if options.fit and options.before is not None:
        raise ArgumentError(
            "--fit and --before do not go together: a fit begins with the model as it is, and is "
            "compared with that.",
            advice="Fit and save the model first, then roll it out with --before.",
        )
    if options.fit:
        run(_fitting(options), options)
    else:
        run(_simulating(options), options)


def _fitting(options: RolloutOptions) -> Command[RolloutFit]:
    def fitted(given: Input) -> RolloutFit:
        return fit_rollouts(
            given.model,
            given.logs,
            horizon=options.horizon,
            most=options.windows,
            commands=options.commands,
            **given.settings,
            progress=given.progress,
        )

    return Command(
        "rollout",
        "Fitting",
        fitted,
        more={"meshcat": options.meshcat},
        makers=lambda found: {"meshcat": lambda: _replay(found.model, found.after, found.before)},
        saved=_SAVED,
        check=lambda model: _refuse_rigid(model, commands=options.commands),
    )


def _refuse_rigid(model: RobotModel, *, commands: bool) -> None:
    if not commands:
        rollout_values(model)


def _simulating(options: RolloutOptions) -> Command[Simulated]:
    def simulated(given: Input) -> Simulated:
        before = None
        if options.before is not None:
            before = rolled_out(other_model(options.before, given), given, "before: ")
        return Simulated(rolled_out(given.model, given, ""), before)

    def rolled_out(model: RobotModel, given: Input, prefix: str) -> Rollout:
        return roll_out(
            model,
            given.logs,
            horizon=options.horizon,
            most=options.windows,
            commands=options.commands,
            **given.settings,
            progress=lambda words, share: given.progress(f"{prefix}{words}", share),
        )

    model: list[RobotModel] = []
    return Command(
        "rollout",
        "Simulating",
        simulated,
        more={"meshcat": options.meshcat},
        makers=lambda found: {"meshcat": lambda: _replay(model[0], found.after, found.before)},
        saved=_SAVED,
        check=model.append,
    )


def other_model(path: Path, given: Input) -> RobotModel:
    """Return a model of the same robot, with the same joints held."""
    model, how, drives = given.model, None, None
    if not is_saved_model(path):
        how = model.given if path.is_file() and is_xacro(path) else replace(model.given, xacro={})
        drives = model.transmission  # whose logs these are
    other = load_model(
        path, floating=model.floating, extra=given.extra, given=how, transmission=drives
    )
    tell_repairs(other, given.progress)
    return holding(other, {j: place for j, place in model.held.items() if j in other.joints})


def _replay(model: RobotModel, after: Rollout, before: Rollout | None) -> str:
    from geodrake.report.meshcat_scene import rollout_replay_page

    return rollout_replay_page(model, after, before)
