"""The commands of `geodrake`. Modules are imported when a command runs, so that help is quick."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption

from geodrake.boundary.escaping import printable
from geodrake.boundary.version import versions
from geodrake.cli import options
from geodrake.cli.options import ALL_OPTIONS, is_advanced
from geodrake.cli.streams import settled_surroundings

_GARBAGE = 100_000  # allocations between two runs of the garbage collector


class _Command(TyperCommand):
    """A command whose help omits Python types and, without --help-all, advanced options."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        _, _, parameters = self.make_parser(ctx).parse_args(list(args))
        given = [option for option in parameters if isinstance(option, TyperOption)]
        for option in given:
            is_single = not option.multiple and (not option.is_flag or option.secondary_opts)
            if is_single and given.count(option) > 1:
                raise typer.BadParameter("it is given more than once. Give it once.", ctx, option)
        return super().parse_args(ctx, args)

    def get_params(self, ctx: Any) -> list[Any]:
        return _without_types(super().get_params(ctx))

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        pieces: list[str] = super().collect_usage_pieces(ctx)
        return [piece.strip("{}.") + "..." * piece.endswith("...") for piece in pieces]

    def format_help(self, ctx: Any, formatter: Any) -> None:
        show_all = ctx.meta.get(ALL_OPTIONS)
        hidden = [param for param in self.params if not show_all and is_advanced(param)]
        for param in hidden:
            param.hidden = True  # type: ignore[attr-defined]
        try:
            super().format_help(ctx, formatter)
        finally:
            for param in hidden:
                param.hidden = False  # type: ignore[attr-defined]


class _Commands(TyperGroup):
    """The group of commands; usage errors quote the command line in printable characters."""

    def get_params(self, ctx: Any) -> list[Any]:
        return _without_types(super().get_params(ctx))

    def make_context(self, *args: Any, **more: Any) -> Any:
        with _printable_words():
            return super().make_context(*args, **more)

    def invoke(self, ctx: Any) -> Any:
        with _printable_words():
            return super().invoke(ctx)


def _without_types(parameters: list[Any]) -> list[Any]:
    """Return parameters whose help omits the Python types of arguments and flags."""
    for parameter in parameters:
        if isinstance(parameter, TyperArgument) or parameter.is_flag:
            parameter.display_type_rich = lambda ctx: None
    return parameters


@contextmanager
def _printable_words() -> Iterator[None]:
    try:
        yield
    except Exception as error:
        if isinstance(message := getattr(error, "message", None), str):  # a usage error
            error.message = printable(message)  # type: ignore[attr-defined]
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

_FIND, _USE = "Find what a model is missing", "Use a model"
_IDENTIFY, _WATCH = "Identify parameters", "Watch many robots"

_COMMANDS: dict[str, tuple[str, str, type[Any]]] = {
    "demo": (_FIND, "explaining.run_demo", options.DemoOptions),
    "log": (_FIND, "logs.run_log", options.LogCommandOptions),
    "compare": (_FIND, "explaining.run_compare", options.CompareOptions),
    "explain": (_FIND, "explaining.run_explain", options.ExplainOptions),
    "diagnose": (_FIND, "explaining.run_diagnose", options.DiagnoseOptions),
    "add": (_FIND, "explaining.run_add", options.AddOptions),
    "rollout": (_USE, "rollout.run_rollout", options.RolloutOptions),
    "play": (_USE, "play.run_play", options.PlayOptions),
    "export": (_USE, "export.run_export", options.ExportOptions),
    "check": (_USE, "export.run_check", options.CheckOptions),
    "excite": (_IDENTIFY, "excite.run_excite", options.ExciteOptions),
    "identifiable": (_IDENTIFY, "excite.run_identifiable", options.IdentifiableOptions),
    "identify": (_IDENTIFY, "identify.run_identify", options.IdentifyOptions),
    "digest": (_WATCH, "logs.run_digest", options.DigestOptions),
    "fleet": (_WATCH, "fleet.run_fleet_command", options.FleetOptions),
}
"""Command -> its group in the help, its function, and its options class, whose docstring is its
help."""

EXAMPLES = {name: options.examples_of(kind) for name, (*_, kind) in _COMMANDS.items()}


def main() -> None:
    """Run the `geodrake` command."""
    gc.set_threshold(_GARBAGE, 20, 20)
    with settled_surroundings():
        app(prog_name="geodrake")


for _name, (_group, _place, _kind) in _COMMANDS.items():
    _lines = [f"geodrake {_name} {example}" for example in EXAMPLES[_name]]
    _epilog = "\n\n".join(["Examples:", *_lines]) if _lines else None
    _add = app.command(name=_name, cls=_Command, epilog=_epilog, rich_help_panel=_group)
    _add(options.command_of(_place, _kind))


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
            help="Print the versions of geodrake and of its packages.",
        ),
    ] = False,
) -> None:
    pass
