"""The commands of `geodrake`. What they need is imported when they run, so that help is quick."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import as_file, files
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from geodrake.boundary.escaping import printable
from geodrake.boundary.version import versions
from geodrake.cli.check_options import CheckOptions
from geodrake.cli.digest_options import DigestOptions
from geodrake.cli.excitation_options import ExciteOptions, IdentifiableOptions
from geodrake.cli.export_options import ExportOptions
from geodrake.cli.fleet_options import FleetOptions
from geodrake.cli.options import (
    AddOptions,
    DemoOptions,
    ExplainOptions,
    IdentifyOptions,
    LogCommandOptions,
    Options,
    PlayOptions,
    RolloutOptions,
    taking,
)
from geodrake.cli.surroundings import settled_surroundings

if TYPE_CHECKING:
    from geodrake.cli.session import Input
    from geodrake.diagnosis.results import Explanation

DEMO_MODEL, DEMO_LOG = "demo.urdf", "demo.csv"
DEMO_TIME = "Done within about 15 seconds; the first time within a minute, as loops are compiled."
_GARBAGE = 100_000  # objects between two looks for cycles, of which a command leaves few


class _Commands(TyperGroup):
    """The commands; what was typed wrongly is quoted as a line that is safe to print."""

    def make_context(self, *args: Any, **more: Any) -> Any:
        with _printable_words():
            return super().make_context(*args, **more)

    def invoke(self, ctx: Any) -> Any:
        with _printable_words():
            return super().invoke(ctx)


@contextmanager
def _printable_words() -> Iterator[None]:
    try:
        yield
    except Exception as error:
        if isinstance(words := getattr(error, "message", None), str):  # of an error of usage
            error.message = printable(words)  # type: ignore[attr-defined]
        raise


app = typer.Typer(
    name="geodrake",
    cls=_Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Tells you what your robot's model is missing, and then fixes it.",
    epilog="Start with: geodrake demo. Then: geodrake explain robot.urdf log.csv",
)


EXAMPLES = {
    "compare": (
        "robot.urdf log.csv --report page.html",
        "robot.yaml log.mcap",
    ),
    "diagnose": (
        "robot.urdf log_1.csv log_2.csv",
        "robot.yaml new_log.csv --report page.html",
    ),
    "add": (
        "payload@flange robot.urdf log.csv --save robot.yaml",
        "viscous_friction robot.urdf log.csv",
    ),
    "explain": (
        "robot.urdf log_1.csv log_2.csv --save robot.yaml --report page.html",
        "robot.yaml log_with_something_new.csv",
    ),
    "rollout": (
        "robot.yaml log.csv --before robot.urdf",
        "robot.yaml log.csv --fit --save soft.yaml",
    ),
    "play": (
        "robot.yaml log.csv --out play.html",
        "robot.yaml log.csv --video play.mp4",
        "robot.yaml log.csv --to rerun play.rrd",
    ),
    "identify": (
        "robot.urdf log.csv --effects coulomb_friction,viscous_friction",
        "robot.urdf log.csv --export identified.urdf",
    ),
    "excite": (
        "robot.urdf --save motion.csv",
        "robot.yaml --tell-apart payload,wrong_inertia --save motion.csv",
    ),
    "identifiable": (
        "robot.urdf log.csv",
        "robot.urdf log_1.csv log_2.csv --report page.html",
    ),
    "digest": ("robot.urdf monday.csv tuesday.csv --to digests",),
    "fleet": (
        "fleet.yaml --report fleet.html",
        "fleet.yaml --watch",
    ),
    "export": (
        "robot.yaml --to mjcf exported",
        "robot.yaml --to ros2 src/robot_feedforward",
    ),
    "check": (
        "robot.urdf",
        "scene.xml --robot arm",
    ),
    "log": (
        "recording.mcap --model robot.urdf",
        "wrong.csv --model robot.urdf --write-mapping right.yaml",
    ),
}
"""Command -> what may follow it."""


def _examples(command: str) -> str:
    """Return examples of a command as the last lines of its help."""
    return "\n\n".join(["Examples:", *(f"geodrake {command} {e}" for e in EXAMPLES[command])])


def main() -> None:
    """Run the `geodrake` command."""
    gc.set_threshold(_GARBAGE, 20, 20)
    with settled_surroundings():
        app(prog_name="geodrake")


@app.command(epilog=_examples("compare"))
@taking(Options)
def compare(options: Options) -> None:
    """How far the model is from the logs, at which joints, and in which circumstances."""
    from geodrake.cli.session import Command, run
    from geodrake.cli.tables import show_comparison
    from geodrake.identification.logs.compare import compare as work
    from geodrake.identification.logs.model_errors import Comparison
    from geodrake.report.json_output import comparison_dict

    def compared(given: Input) -> Comparison:
        return work(given.model, given.logs, **given.settings)

    command = Command(
        "compare", "Comparing", compared, comparison_dict, "render_comparison", show_comparison
    )
    run(command, options)


@app.command(epilog=_examples("diagnose"))
@taking(Options)
def diagnose(options: Options) -> None:
    """Which effect the model lacks most, with the evidence."""
    from geodrake.cli.session import Command, run
    from geodrake.cli.tables import show_diagnosis
    from geodrake.diagnosis.diagnose import diagnose as work
    from geodrake.diagnosis.results import Diagnosis
    from geodrake.report.json_output import diagnosis_dict

    def diagnosed(given: Input) -> Diagnosis:
        return work(given.model, given.logs, extra=given.extra, **given.settings)

    command = Command(
        "diagnose", "Diagnosing", diagnosed, diagnosis_dict, "render_diagnosis", show_diagnosis
    )
    run(command, options)


@app.command(epilog=_examples("add"))
@taking(AddOptions)
def add(options: AddOptions) -> None:
    """Add an effect to the model, refit, and show what it changes."""
    from geodrake.cli.session import Command, run
    from geodrake.cli.tables import show_addition
    from geodrake.diagnosis.add import add as work
    from geodrake.report.json_output import explanation_dict

    effect, where = options.addition

    def added(given: Input) -> Explanation:
        return work(
            effect,
            given.model,
            given.logs,
            where=where,
            extra=given.extra,
            **given.settings,
        )

    command = Command(
        "add",
        f"Adding {effect}",
        added,
        explanation_dict,
        "render_explanation",
        show_addition,
    )
    run(command, options)


@app.command(epilog=_examples("explain"))
@taking(ExplainOptions)
def explain(options: ExplainOptions) -> None:
    """Compare, diagnose and add, until only noise is left or nothing explains the rest."""
    if options.draft_effect is not None:
        from geodrake.cli.drafting import run_drafting

        run_drafting(options, options.draft_effect)
        return
    from geodrake.cli.explaining import run_explaining

    run_explaining(options)


@app.command(epilog=_examples("rollout"))
@taking(RolloutOptions)
def rollout(options: RolloutOptions) -> None:
    """Simulate the model under logged efforts or commands; show where its motion departs."""
    from geodrake.cli.rollout import run_rollout

    run_rollout(options)


@app.command(epilog=_examples("play"))
@taking(PlayOptions)
def play(options: PlayOptions) -> None:
    """Play the logs over the robot, coloured where the model fails, as one HTML page."""
    from geodrake.cli.play import run_play

    run_play(options)


@app.command(epilog=_examples("identify"))
@taking(IdentifyOptions)
def identify(options: IdentifyOptions) -> None:
    """Fit the model's inertias, near what it says of them, and its effects; write them back."""
    from geodrake.cli.identify import run_identify

    run_identify(options)


@app.command(epilog=_examples("excite"))
@taking(ExciteOptions)
def excite(options: ExciteOptions) -> None:
    """Design the motion from which most is identifiable, within limits of the robot."""
    from geodrake.cli.excite import run_excite

    run_excite(options)


@app.command(epilog=_examples("identifiable"))
@taking(IdentifiableOptions)
def identifiable(options: IdentifiableOptions) -> None:
    """Which parameters are identifiable from the logs, to within a threshold, and which not."""
    from geodrake.cli.identifiable import run_identifiable

    run_identifiable(options)


@app.command(epilog=_examples("digest"))
@taking(DigestOptions)
def digest(options: DigestOptions) -> None:
    """Digest each log into a small file; exit code 1 if a log could not be, the others are."""
    from geodrake.cli.digest import run_digest

    run_digest(options)


@app.command(epilog=_examples("fleet"))
@taking(FleetOptions)
def fleet(options: FleetOptions) -> None:
    """Which robots of a fleet changed, at which joint, by which effect, since when."""
    from geodrake.cli.fleet import run_fleet_command

    run_fleet_command(options)


@app.command(epilog=_examples("export"))
@taking(ExportOptions)
def export(options: ExportOptions) -> None:
    """Write the model for a simulator, and prove it: loaded again, and compared with the model."""
    from geodrake.cli.export import run_export

    run_export(options)


@app.command(epilog=_examples("check"))
@taking(CheckOptions)
def check(options: CheckOptions) -> None:
    """Compare the model's dynamics with MultibodyPlant's; exit code 1 if they are not the same."""
    from geodrake.cli.check import run_check

    run_check(options)


@app.command(epilog=_examples("log"))
@taking(LogCommandOptions)
def log(options: LogCommandOptions) -> None:
    """What is understood of logs: joints, columns, units, rates, gaps, rest; no model needed."""
    from geodrake.cli.log import run_log

    run_log(options)


@app.command()
@taking(DemoOptions)
def demo(options: DemoOptions) -> None:
    """Explain a log that comes with the package, made with an effect that its model lacks."""
    from geodrake.cli.explaining import run_explaining

    folder = files("geodrake") / "demo"
    with as_file(folder / DEMO_MODEL) as model, as_file(folder / DEMO_LOG) as data:
        run_explaining(
            Options(
                model=model,
                logs=[data],
                json=options.json,
                report=options.report,
                quiet=options.quiet,
            ),
            DEMO_TIME,
        )


def _print_version(wanted: bool) -> None:
    if wanted:
        print(versions())
        raise typer.Exit


@app.callback()
def _command(
    _version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_print_version,
            is_eager=True,
            help="Print the version, and those of the packages that it is used with.",
        ),
    ] = False,
) -> None:
    pass
