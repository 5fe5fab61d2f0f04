"""Options of each command, as dataclasses that typer reads like function parameters."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from geodrake.cli.model_options import ModelOptions
from geodrake.cli.reading_options import ReadingOptions
from geodrake.cli.shared_options import (
    Debug,
    EffectFiles,
    EffectNames,
    JsonFile,
    KnownPayloads,
    LogFiles,
    LogOptions,
    ModelFile,
    Options,
    Quiet,
    ReportFile,
    SeriesFile,
    ValidationOptions,
)
from geodrake.errors import ArgumentError

__all__ = ["Options"]

_NOISE_HELP = "Deviation of the {what}, N·m or N: one number, or JOINT=NUMBER,…; {default}."


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


@dataclass(frozen=True, kw_only=True)
class IdentifiableOptions(ValidationOptions):
    """Options of identifiable."""

    threshold: Annotated[
        float,
        typer.Option(
            metavar="VARIANCE",
            help="Largest relative variance of what counts as identifiable; 0.01 is a deviation "
            "of 10 %.",
        ),
    ] = 1e-2
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="NOISE",
            help=_NOISE_HELP.format(
                what="filtered efforts",
                default="what the refitted model leaves on held-out data if absent",
            ),
        ),
    ] = None
    effects: EffectNames = None


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """Which motions excite chooses from."""

    trajectory: Annotated[
        str,
        typer.Option(
            metavar="FAMILY",
            help="fourier, spline, or free: samples that need not follow each other, the best that "
            "any motion could do.",
        ),
    ] = "fourier"
    duration: Annotated[float, typer.Option(metavar="SECONDS", help="Length of the motion.")] = 10.0
    harmonics: Annotated[
        int | None, typer.Option(metavar="N", help="Harmonics of a Fourier motion; 5 if absent.")
    ] = None
    frequency: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Base frequency of a Fourier motion; once in its length if absent, and three "
            "times with --tell-apart, so that every block of the log shows the difference.",
        ),
    ] = None
    points: Annotated[
        int | None,
        typer.Option(metavar="N", help="Control points of a spline motion; 16 if absent."),
    ] = None
    samples: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Samples by which information is counted; 300 if absent, or 50 free ones.",
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class _Robot:
    """What excite may do with the robot."""

    limits: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LIMIT,…",
            help="Limits in place of the model file's: 0.5 for half of all of them, "
            "velocity=1.5 or velocity=50% for all joints, JOINT.position=-1:0.5 for one; also "
            "acceleration and effort, and current, voltage and pwm of models fitted to such logs. "
            "Repeatable.",
        ),
    ] = None
    start: Annotated[
        str | None,
        typer.Option(
            metavar="POSITION", help="Where the motion starts: one number, or JOINT=NUMBER,…"
        ),
    ] = None
    clearance: Annotated[
        float,
        typer.Option(metavar="METRES", help="Least distance of the robot from itself."),
    ] = 0.01
    collisions: Annotated[
        bool,
        typer.Option(
            "--collisions/--no-collisions",
            help="Whether the collision geometry of the file counts.",
        ),
    ] = True
    floor: Annotated[
        bool,
        typer.Option(
            "--floor/--no-floor",
            help="Whether nothing may go below the base, as on a table or a floor. A robot that "
            "hangs below its base where it starts has none.",
        ),
    ] = True


@dataclass(frozen=True, kw_only=True)
class _Choosing:
    """How excite judges motions and looks for the best one."""

    criterion: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="e_optimality, a_optimality, d_optimality or condition_number.",
        ),
    ] = "e_optimality"
    normalization: Annotated[
        str, typer.Option(metavar="NAME", help="geometric, diagonal or none.")
    ] = "geometric"
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="NOISE",
            help=_NOISE_HELP.format(
                what="measured efforts",
                default="what the model's last fit left, or 1 % of the limits of effort, if absent",
            ),
        ),
    ] = None
    seeds: Annotated[int, typer.Option(metavar="N", help="Random motions to start from.")] = 3
    seed: Annotated[int, typer.Option(metavar="N", help="Number of the first of them.")] = 0
    seconds: Annotated[
        float, typer.Option(metavar="SECONDS", help="Most time for the whole search.")
    ] = 180.0
    iterations: Annotated[
        int, typer.Option(metavar="N", help="Most iterations of the solver, for each stage.")
    ] = 300
    solver: Annotated[str, typer.Option(metavar="NAME", help="snopt or ipopt.")] = "snopt"


@dataclass(frozen=True, kw_only=True)
class ExciteOptions(ModelOptions, _Motion, _Robot, _Choosing):
    """Options of excite."""

    model: ModelFile
    effects: EffectNames = None
    tell_apart: Annotated[
        str | None,
        typer.Option(
            metavar="EFFECT,EFFECT[@PLACE]",
            help="Two effects that logs so far cannot distinguish: the motion on which their "
            "predictions differ most, once everything else is refitted.",
        ),
    ] = None
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv|.npz|.yaml|.drake.yaml",
            help="Write the motion: a log with the predicted efforts, a ROS JointTrajectory, or a "
            "Drake BsplineTrajectory.",
        ),
    ] = None
    rate: Annotated[
        float, typer.Option(metavar="HZ", help="Samples a second of what --save writes.")
    ] = 100.0
    json: JsonFile = None
    report: ReportFile = None
    meshcat: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Write a page that replays the motion."),
    ] = None
    quiet: Quiet = False
    debug: Debug = False


@dataclass(frozen=True, kw_only=True)
class CheckOptions(ModelOptions):
    """Options of check."""

    model: ModelFile
    samples: Annotated[
        int, typer.Option(metavar="N", help="Random states, within the limits of the robot.")
    ] = 100
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the random numbers.")] = 0
    effects: EffectFiles = None
    json: JsonFile = None
    quiet: Quiet = False
    debug: Debug = False


@dataclass(frozen=True, kw_only=True)
class DigestOptions(ReadingOptions, ModelOptions):
    """Options of digest."""

    model: ModelFile
    logs: LogFiles
    to: Annotated[
        Path,
        typer.Option(
            metavar="FOLDER",
            help="Folder of the digests, all of logs of robots with this model; made if it is not "
            "there. The first digest writes the settings that all of them share.",
        ),
    ]
    date: Annotated[
        str | None,
        typer.Option(
            metavar="DATE",
            help="When logs were recorded whose time stamps are no dates, such as 2026-05-01 or "
            "2026-05-01T12:00:00+02:00, UTC without a zone; when the file was changed if absent.",
        ),
    ] = None
    effects: EffectFiles = None
    bandwidth: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Bandwidth of the filter of all digests, if the folder has no settings yet; if "
            "absent, that of the model's fit, or chosen from the first log.",
        ),
    ] = None
    blocks: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Blocks that each log is cut into, if the folder has no settings yet; 4 if "
            "absent.",
        ),
    ] = None
    known_payload: KnownPayloads = None
    json: JsonFile = None
    quiet: Quiet = False
    debug: Debug = False


@dataclass(frozen=True, kw_only=True)
class ExportOptions(ReadingOptions, ModelOptions):
    """Options of export."""

    model: ModelFile
    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="LOG",
            help="Logs on whose motion what the format lacks is fitted, and the error that it "
            "costs is measured; without any, random motion within the robot's limits serves.",
        ),
    ] = None
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of the files; made if it is not there.")
    ]
    to: Annotated[
        str,
        typer.Option(
            metavar="FORMAT",
            help="urdf, sdf, mjcf, drake (with model directives), isaac (a URDF, and values of "
            "actuators), python, cpp (a function effort(q, v, vd)), ros2 (a controller of "
            "ros2_control); an unknown name lists them.",
        ),
    ]
    force: Annotated[
        bool, typer.Option("--force", help="Replace files of these names that are there.")
    ] = False
    json: JsonFile = None
    report: ReportFile = None
    quiet: Quiet = False
    effects: EffectFiles = None
    bandwidth: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Bandwidth of the filter of logs; if absent, that of the model's fit to the same "
            "logs, or chosen from the data.",
        ),
    ] = None
    debug: Debug = False


@dataclass(frozen=True, kw_only=True)
class FleetOptions:
    """Options of fleet."""

    fleet: Annotated[
        Path,
        typer.Argument(
            metavar="FLEET.yaml",
            help="Types with a model each, robots with patterns of their logs, and the folder of "
            "digests and results.",
        ),
    ]
    json: JsonFile = None
    report: ReportFile = None
    workers: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Processes of this machine that work; 0 is the command's own, which also works "
            "where Dask is not installed. One on each core if absent.",
        ),
    ] = None
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="A Dask scheduler of your own, such as tcp://10.0.0.5:8786, whose workers see the "
            "same folders.",
        ),
    ] = None
    false_alarms: Annotated[
        float,
        typer.Option(
            metavar="RATE",
            help="At most how many robots in which nothing changed are named, a robot-month.",
        ),
    ] = 0.01
    watch: Annotated[
        bool,
        typer.Option(
            "--watch",
            help="Go on, and take in new logs as they come: each new finding is a line of JSON on "
            "standard output.",
        ),
    ] = False
    every: Annotated[
        float, typer.Option(metavar="SECONDS", help="Time between two looks for new logs.")
    ] = 60.0
    once: Annotated[
        bool,
        typer.Option(
            "--once",
            help="Look once and say what a watch would; exit code 3 if there is a new finding, "
            "for a cron job.",
        ),
    ] = False
    quiet: Quiet = False
    debug: Debug = False
