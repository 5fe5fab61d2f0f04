"""Options that commands share, as dataclasses that typer reads like function parameters."""

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
from geodrake.cli.reading_options import ReadingOptions
from geodrake.errors import ArgumentError

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


@dataclass(frozen=True, kw_only=True)
class _Steps(Options):
    """Options of commands that find values of effects."""

    effort_uncertainty: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE",
            help="How well the gains of the efforts are known, as a share: what that makes of "
            "parameters is a second ±. 0.05 if absent, as for torque constants; 0 for calibrated "
            "torque sensors.",
        ),
    ] = None

    @property
    def log_facts(self) -> dict[str, Any]:
        """How well the gains are known, if that is said."""
        share = self.effort_uncertainty
        return {} if share is None else {"effort_uncertainty": share}


@dataclass(frozen=True, kw_only=True)
class ExplainOptions(_Steps):
    """Options of explain."""

    draft_effect: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.py",
            help="Search a formula for what stays unexplained, and write it as an effect of your "
            "own, to be used with --effects.",
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class RolloutOptions(LogOptions):
    """Options of rollout."""

    before: Annotated[
        Path | None,
        typer.Option(metavar="MODEL", help="A model to compare with, such as the file it was."),
    ] = None
    horizon: Annotated[
        float, typer.Option(metavar="SECONDS", help="Length of a window of the simulation.")
    ] = 0.5
    windows: Annotated[
        int, typer.Option(metavar="N", help="Most windows, spread evenly over the logs.")
    ] = 12
    commands: Annotated[
        bool,
        typer.Option(
            "--commands",
            help="Servos of the simulated robot follow the logged commands, instead of the logged "
            "efforts at their joints.",
        ),
    ] = False
    fit: Annotated[
        bool,
        typer.Option(
            "--fit",
            help="Fit the model's soft joints and play to how the simulated robot moves, under "
            "efforts, or under --commands with servos that are not known exactly; every other "
            "block of windows, or every other log, is held out.",
        ),
    ] = False
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.yaml",
            help="Write the model with what --fit found, or as it was if that was not taken.",
        ),
    ] = None
    series: SeriesFile = None
    meshcat: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.html",
            help="Write a page that replays the windows: the measured and the simulated robot.",
        ),
    ] = None

    @property
    def model_target(self) -> Path | None:
        """Where the model goes, if it is saved."""
        return self.save


@dataclass(frozen=True, kw_only=True)
class PlayOptions(LogOptions):
    """Options of play."""

    before: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL",
            help="A model to play beside it; if absent and MODEL was saved with --save, the file "
            "that it is based on.",
        ),
    ] = None
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.html",
            help="Where the page goes; play.html if nothing else is asked for.",
        ),
    ] = None
    video: Annotated[
        Path | None,
        typer.Option(metavar="FILE.mp4|.gif", help="Write a video of the robot and its errors."),
    ] = None
    to: Annotated[
        tuple[str, Path] | None,
        typer.Option(
            metavar="VIEWER FILE",
            help="Write a recording for another viewer: rerun FILE.rrd, or mcap FILE.mcap, which "
            "Foxglove and PlotJuggler open.",
        ),
    ] = None
    live: Annotated[
        int | None,
        typer.Option(
            metavar="PORT",
            help="Show the page on a port of this machine instead, until Ctrl-C; 0 is any free.",
        ),
    ] = None
    speed: Annotated[
        float, typer.Option(metavar="FACTOR", help="Seconds of the log played in a second.")
    ] = 1.0
    seconds: Annotated[
        float,
        typer.Option(
            metavar="SECONDS", help="Most to play: of longer logs, the passages of largest error."
        ),
    ] = 30.0


@dataclass(frozen=True, kw_only=True)
class _Addition:
    effect: Annotated[
        str,
        typer.Argument(
            metavar="EFFECT[@PLACE]",
            help="Its name (an unknown one such as x lists them), and the joint or body where it "
            "is, as in payload@flange; j2+j3 is a pair of joints.",
        ),
    ]
    where: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Joint or body to add it at; repeatable, twice for a pair of joints. If absent, "
            "all joints, or the body or pair of neighbouring joints that it helps most at.",
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class AddOptions(_Steps, _Addition):
    """Options of add."""

    @property
    def addition(self) -> tuple[str, list[str] | None]:
        """Name of the effect, and where it is to be; None if nobody said.

        Raises:
            ArgumentError: The place is said twice, or empty.
        """
        name, at, place = self.effect.partition("@")
        if at and not all(place.split("+")):
            raise ArgumentError(
                f"{self.effect!r} names no place.", advice=f"Write {name}@JOINT, or {name} alone."
            )
        if place and self.where:
            raise ArgumentError(
                f"{self.effect} names a place, and --where {' '.join(self.where)} another one.",
                advice="Say it once.",
            )
        return name, place.split("+") if place else self.where or None


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(Options):
    """Options of identify."""

    regularizer: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="What keeps inertias near the model's: entropic, pullback, riemannian, …; an "
            "unknown name lists them.",
        ),
    ] = "entropic"
    gamma: Annotated[
        float | None,
        typer.Option(
            metavar="GAMMA",
            help="Weight of the regularizer: 100 keeps inertias to about 1/√100 = 10 %. Chosen by "
            "held-out error if absent.",
        ),
    ] = None
    residual_bound: Annotated[
        float | None,
        typer.Option(
            metavar="RATIO",
            help="Instead of a weight: the RMS training residual allowed, relative to the least "
            "possible, such as 1.01.",
        ),
    ] = None
    total_mass: Annotated[
        float | None,
        typer.Option(metavar="KG", help="Mass of all that moves, if it is known from a scale."),
    ] = None
    effects: EffectNames = None
    compare: Annotated[
        bool,
        typer.Option("--compare", help="All regularizers at the same training residual."),
    ] = False
    export: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.urdf|.sdf|.xml",
            help="Write the identified inertias into a copy of the model file; all else in it "
            "stays as it is.",
        ),
    ] = None
    ellipsoids: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="Draw the bodies as ellipsoids before and after."),
    ] = None
    meshcat: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="The same as a page to turn around in a browser."),
    ] = None

    @property
    def holds_resting(self) -> bool:
        """Whether joints that hardly move are held: not beside a mass, which is of all bodies."""
        return super().holds_resting and self.total_mass is None


@dataclass(frozen=True, kw_only=True)
class LogCommandOptions(ReadingOptions, ModelOptions):
    """Options of log."""

    logs: LogFiles
    model: Annotated[
        Path | None,
        typer.Option(metavar="MODEL", help="A model, whose joints the columns are matched with."),
    ] = None
    convert: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv|.npz",
            help="Write the log in SI units under geodrake's own names, without what sensors did "
            "wrong.",
        ),
    ] = None
    figure: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="Draw positions and efforts over time."),
    ] = None
    write_mapping: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.yaml",
            help="Write a mapping that reads the log so, with what is wrong in its columns "
            "corrected where a mapping can say it.",
        ),
    ] = None
    json: JsonFile = None
    quiet: Quiet = False
    debug: Debug = False


@dataclass(frozen=True, kw_only=True)
class DemoOptions:
    """Options of demo."""

    report: Annotated[
        Path, typer.Option(metavar="FILE.html", help="Where the page with the figures goes.")
    ] = Path("geodrake_demo.html")
    json: JsonFile = None
    quiet: Quiet = False
    debug: Debug = False


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
