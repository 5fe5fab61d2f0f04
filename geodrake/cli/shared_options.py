"""Options that commands share, and the way from a dataclass of options to a command."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from copy import copy
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_args, get_type_hints

import typer

from geodrake.cli.axis_model import AxisOptions
from geodrake.cli.guard import guarded
from geodrake.cli.model_options import ModelOptions

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

ModelFile = Annotated[
    Path,
    typer.Argument(
        metavar="MODEL",
        help="URDF, SDF, MJCF or Drake directives file, a model saved with --save, or the name of "
        "a robot of robot_descriptions, such as ur5e.",
    ),
]
LogFiles = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG...",
        help="Logs of time, positions and efforts: CSV, NPZ, ROS bag, MCAP, Parquet, LeRobot, "
        "JSON, HDF5, LCM or .mat; a.csv+b.csv are joined by time.",
    ),
]
JsonFile = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Write the numbers; - is standard output.")
]
ReportFile = Annotated[
    Path | None, typer.Option(metavar="FILE.html", help="Write one page with the figures.")
]
SeriesFile = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.csv|.parquet",
        help="Write the samples: time, log, and of every joint measured, predicted and residual.",
    ),
]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Show results and errors only, no progress.")
]
Debug = Annotated[bool, typer.Option("--debug", help="Show tracebacks; GEODRAKE_DEBUG=1 does too.")]
EffectFiles = Annotated[
    list[Path] | None,
    typer.Option(metavar="FILE.py", help="Know the effects of this file too; repeatable."),
]
EffectNames = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="NAME[@PLACE],…|FILE.py",
        help="Effects beside the model's, by their names (an unknown name such as x lists them), "
        "and the joint or body where they are; a FILE.py brings effects that may be named. "
        "Repeatable.",
    ),
]
KnownPayloads = Annotated[
    list[str] | None,
    typer.Option(
        metavar="LOG:BODY:MASS[:X,Y,Z]",
        help="What the robot carried throughout a log, of known mass, kg, and centre of mass "
        "in the body's frame, m. With a log without it, gains of efforts are identifiable. "
        "Repeatable.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class LogOptions(AxisOptions, ModelOptions):
    """Options of all commands on a model and logs."""

    model: ModelFile
    logs: LogFiles
    json: JsonFile = None
    report: ReportFile = None
    effects: EffectFiles = None
    bandwidth: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Bandwidth of the filter; if absent, that of the model's fit to the same logs, or "
            "chosen from the data.",
        ),
    ] = None
    known_payload: KnownPayloads = None
    quiet: Quiet = False
    debug: Debug = False

    @property
    def settings(self) -> dict[str, Any]:
        """How logs are prepared, as keyword arguments."""
        return {"bandwidth": self.bandwidth}

    @property
    def log_facts(self) -> dict[str, Any]:
        """What is known of all logs beside what is in their files, as fields of `JointLog`."""
        return {}

    @property
    def model_target(self) -> Path | None:
        """Where the model goes, if it is saved."""
        return None

    @property
    def series_target(self) -> Path | None:
        """Where the samples go, if they are wanted."""
        return getattr(self, "series", None)


@dataclass(frozen=True, kw_only=True)
class ValidationOptions(LogOptions):
    """Options of commands that validate a model on blocks of logs."""

    blocks: Annotated[
        int | None, typer.Option(metavar="N", help="Blocks that each log is validated on.")
    ] = None

    @property
    def settings(self) -> dict[str, Any]:
        """How logs are prepared, as keyword arguments."""
        return {"bandwidth": self.bandwidth, "blocks": self.blocks}


@dataclass(frozen=True, kw_only=True)
class Options(ValidationOptions):
    """Options of commands that can save the model, too."""

    save: Annotated[
        Path | None, typer.Option(metavar="FILE.yaml", help="Write the model, to be used as MODEL.")
    ] = None
    series: SeriesFile = None
    correct_columns: Annotated[
        bool,
        typer.Option(
            "--correct-columns",
            help="Go on with the columns as they are found to be: signs, units, gains, zeros, "
            "time, swapped joints. If absent, what is found is said first, and no more.",
        ),
    ] = False
    no_auto_lock: Annotated[
        bool,
        typer.Option(
            "--no-auto-lock",
            help="Keep joints that hardly move. If absent, those that rest in all logs are held "
            "where they rest, as --lock does.",
        ),
    ] = False

    @property
    def settings(self) -> dict[str, Any]:
        """How logs are prepared, as keyword arguments."""
        return {**super().settings, "hold_resting": self.holds_resting}

    @property
    def holds_resting(self) -> bool:
        """Whether joints that hardly move are held."""
        return not self.no_auto_lock

    @property
    def model_target(self) -> Path | None:
        """Where the model goes, if it is saved."""
        return self.save


T = TypeVar("T", bound="DataclassInstance")

_FIRST = ("save", "report", "json")
_OF_MODELS = ({field.name for field in fields(ModelOptions)} | {"axis", "mass"}) - {"lock"}
_RARE = {"bandwidth", "blocks", "debug", "draft_effect", "effort_uncertainty", "known_payload"}
_RARE |= {"no_auto_lock", "series"}


def taking(options: type[T]) -> Callable[[Callable[[T], None]], Callable[..., None]]:
    """Make a function of one options object a command whose parameters are its fields.

    Errors of the command become messages and exit codes. Help shows what is used most, then what
    says how models and logs are read, and what is rare.
    """
    hints = get_type_hints(options, include_extras=True)
    kinds = {field.name: field for field in fields(options)}
    names = sorted(kinds, key=lambda name: _FIRST.index(name) if name in _FIRST else len(_FIRST))
    for name in names:
        panel = "Models" if name in _OF_MODELS else "Rarely needed" if name in _RARE else None
        if panel is not None:
            kind, option = get_args(hints[name])
            option = copy(option)
            option.rich_help_panel = panel
            hints[name] = Annotated[kind, option]

    def decorate(run: Callable[[T], None]) -> Callable[..., None]:
        @functools.wraps(run)
        def command(**values: Any) -> None:
            files = values.get("effects") or ()
            with guarded(debug=values["debug"], effect_files=files):
                run(options(**values))

        command.__annotations__ = {name: hints[name] for name in names}
        command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [
                inspect.Parameter(
                    name,
                    inspect.Parameter.KEYWORD_ONLY,
                    default=inspect.Parameter.empty
                    if kinds[name].default is MISSING
                    else kinds[name].default,
                    annotation=hints[name],
                )
                for name in names
            ]
        )
        return command

    return decorate
