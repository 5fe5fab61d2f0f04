"""The commands of `geodrake`. Modules are imported when a command runs, so that help is quick."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.resources import as_file, files
from typing import Annotated, Any

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption

from geodrake.boundary.escaping import printable
from geodrake.boundary.version import versions
from geodrake.cli import options
from geodrake.cli.options import ALL_OPTIONS, Options, is_advanced, taking
from geodrake.cli.streams import settled_surroundings

DEMO_MODEL, DEMO_LOG = "demo.urdf", "demo.csv"
DEMO_TIME = "This takes about 15 seconds; a minute the first time, as code is compiled."
_GARBAGE = 100_000  # allocations between two runs of the garbage collector


class _Command(TyperCommand):
    """A command whose help has no Python types, and advanced options only with --help-all."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        _, _, parameters = self.make_parser(ctx).parse_args(list(args))
        given = [each for each in parameters if isinstance(each, TyperOption)]
        for each in given:
            once = not each.multiple and (not each.is_flag or each.secondary_opts)
            if once and given.count(each) > 1:
                raise typer.BadParameter("it is given more than once. Give it once.", ctx, each)
        return super().parse_args(ctx, args)

    def get_params(self, ctx: Any) -> list[Any]:
        found: list[Any] = super().get_params(ctx)
        for each in found:
            if isinstance(each, TyperArgument) or each.is_flag:
                each.display_type_rich = lambda ctx: None
        return found

    def format_help(self, ctx: Any, formatter: Any) -> None:
        hidden = [
            each for each in self.params if not ctx.meta.get(ALL_OPTIONS) and is_advanced(each)
        ]
        for each in hidden:
            each.hidden = True  # type: ignore[attr-defined]
        try:
            super().format_help(ctx, formatter)
        finally:
            for each in hidden:
                each.hidden = False  # type: ignore[attr-defined]


class _Commands(TyperGroup):
    """The commands; usage errors quote the command line in printable characters."""

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
    help="Find what your robot's model is missing, and add it.",
    epilog="Start with: geodrake demo. Then: geodrake explain robot.urdf log.csv",
)

_COMMANDS: dict[str, tuple[Any, ...]] = {
    "compare": (
        "explaining.run_compare",
        Options,
        "Show the error of a model on logs, by joint, and where it is largest.",
        "robot.urdf log.csv --report page.html",
        "robot.yaml log.mcap",
    ),
    "diagnose": (
        "explaining.run_diagnose",
        Options,
        "Rank the effects that the model may lack, with the evidence.",
        "robot.urdf log_1.csv log_2.csv",
        "robot.yaml new_log.csv --report page.html",
    ),
    "add": (
        "explaining.run_add",
        options.AddOptions,
        "Add an effect to the model, refit, and show the errors before and after.",
        "payload@flange robot.urdf log.csv --save robot.yaml",
        "viscous_friction robot.urdf log.csv",
    ),
    "explain": (
        "explaining.run_explain",
        options.ExplainOptions,
        "Find and add missing effects until only noise is left, or nothing explains the rest.",
        "robot.urdf log_1.csv log_2.csv --save robot.yaml --report page.html",
        "robot.yaml log_with_something_new.csv",
    ),
    "rollout": (
        "rollout.run_rollout",
        options.RolloutOptions,
        "Simulate the model under logged efforts or commands, and compare its motion.",
        "robot.yaml log.csv --before robot.urdf",
        "robot.yaml log.csv --fit --save soft.yaml",
    ),
    "play": (
        "play.run_play",
        options.PlayOptions,
        "Replay logs on the robot, coloured by error, as a page, a video or a recording.",
        "robot.yaml log.csv --out play.html",
        "robot.yaml log.csv --video play.mp4",
        "robot.yaml log.csv --to rerun play.rrd",
    ),
    "identify": (
        "identify.run_identify",
        options.IdentifyOptions,
        "Fit inertias, regularized towards the model's, and effects that you name.",
        "robot.urdf log.csv --effects coulomb_friction,viscous_friction",
        "robot.urdf log.csv --export identified.urdf",
    ),
    "excite": (
        "excite.run_excite",
        options.ExciteOptions,
        "Design the most informative motion within the limits of the robot.",
        "robot.urdf --save motion.csv",
        "robot.yaml --tell-apart payload,wrong_inertia --save motion.csv",
        "humanoid.urdf --feet l_foot,r_foot --stand l_knee=0.8,… --save motion.csv",
    ),
    "identifiable": (
        "excite.run_identifiable",
        options.IdentifiableOptions,
        "Show which parameters the logs can identify.",
        "robot.urdf log.csv",
        "robot.urdf log_1.csv log_2.csv --report page.html",
    ),
    "digest": (
        "logs.run_digest",
        options.DigestOptions,
        "Reduce each log to a small file for fleet. Exit code 1 if any log fails.",
        "robot.urdf monday.csv tuesday.csv --to digests",
    ),
    "fleet": (
        "fleet.run_fleet_command",
        options.FleetOptions,
        "Show which robots of a fleet changed, at which joint, by which effect, and since when.",
        "fleet.yaml --report fleet.html",
        "fleet.yaml --watch",
    ),
    "export": (
        "export.run_export",
        options.ExportOptions,
        "Write the model for a simulator or controller, and verify what was written.",
        "robot.yaml --to mjcf exported",
        "robot.yaml --to ros2 src/robot_feedforward",
    ),
    "check": (
        "export.run_check",
        options.CheckOptions,
        "Compare the model's dynamics with MultibodyPlant. Exit code 1 if they differ.",
        "robot.urdf",
        "scene.xml --robot arm",
    ),
    "log": (
        "logs.run_log",
        options.LogCommandOptions,
        "Show how logs are read: joints, columns, units, rates, gaps. Needs no model.",
        "recording.mcap --model robot.urdf",
        "wrong.csv --model robot.urdf --write-mapping right.yaml",
    ),
}
"""Command -> the function that runs it, its options, its help, and example arguments."""

EXAMPLES = {name: examples for name, (_, _, _, *examples) in _COMMANDS.items()}


def main() -> None:
    """Run the `geodrake` command."""
    gc.set_threshold(_GARBAGE, 20, 20)
    with settled_surroundings():
        app(prog_name="geodrake")


def _added(name: str, place: str, kind: type[Any], help_text: str) -> Callable[..., None]:
    """Return a command that imports its function when it is called."""
    module, _, function = place.partition(".")

    def command(given: Any) -> None:
        getattr(import_module(f"geodrake.cli.{module}"), function)(given)

    command.__name__, command.__doc__ = name, help_text
    return taking(kind)(command)


for _name, (_place, _kind, _help, *_examples) in _COMMANDS.items():
    _epilog = "\n\n".join(["Examples:", *(f"geodrake {_name} {each}" for each in _examples)])
    app.command(name=_name, cls=_Command, epilog=_epilog)(_added(_name, _place, _kind, _help))


@app.command(cls=_Command)
@taking(options.DemoOptions)
def demo(given: options.DemoOptions) -> None:
    """Run explain on a log that comes with the package."""
    from geodrake.cli.explaining import run_explain

    folder = files("geodrake") / "demo"
    with as_file(folder / DEMO_MODEL) as model, as_file(folder / DEMO_LOG) as data:
        told = Options(
            model=model,
            logs=[data],
            json=given.json,
            report=given.report,
            quiet=given.quiet,
            details=given.details,
        )
        run_explain(told, DEMO_TIME)


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
            help="Print the version, and those of the packages it uses.",
        ),
    ] = False,
) -> None:
    pass
