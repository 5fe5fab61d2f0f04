"""`geodrake rollout --fit`: soft joints and play, by how the simulated robot moves."""

from __future__ import annotations

from rich.console import Console

from geodrake.cli.options import RolloutOptions
from geodrake.cli.session import Command, Input, run
from geodrake.cli.tables import head, say, show_list, show_table
from geodrake.control.rollout import RolloutFit, fit_rollouts
from geodrake.control.rollout.rollout_values import rollout_values
from geodrake.errors import ArgumentError
from geodrake.model.robot_model import RobotModel
from geodrake.report.json_output import rollout_fit_dict
from geodrake.report.numbers import Units
from geodrake.report.tables import rollout_fit_table, rollout_values_table
from geodrake.report.words import rollout_fit_words


def check_fit(options: RolloutOptions) -> None:
    """Refuses options that do not go together.

    Raises:
        ArgumentError: They do not.
    """
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


def run_rollout_fit(options: RolloutOptions) -> None:
    """Run the command.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """

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

    def check(model: RobotModel) -> None:
        rollout_values(model)

    def replay(found: RolloutFit) -> str:
        from geodrake.report.replay import rollout_replay_page

        return rollout_replay_page(found.model, found.after, found.before)

    run(
        Command(
            "rollout",
            "Fitting",
            fitted,
            rollout_fit_dict,
            "render_rollout_fit",
            _show,
            more={"meshcat": options.meshcat},
            makers=lambda found: {"meshcat": lambda: replay(found)},
            saved={"meshcat": "replay of measured and simulated motion"},
            check=check,
        ),
        options,
    )


def _show(console: Console, found: RolloutFit, units: Units) -> None:
    count, tested, after = len(found.tested), sum(found.tested), found.after
    windows = f"{count - tested} windows of {after.horizon:g} s"
    head(console, f"Fitted to {windows} under the logged {after.under}")
    show_table(console, rollout_values_table(found, units))
    head(console, f"Departure from the measured motion, RMS; {tested} windows are held out")
    show_table(console, rollout_fit_table(found, units))
    say(console, "Verdict", rollout_fit_words(found))
    show_list(console, "Notes", found.notes)
