"""Options of commands, as dataclasses, and the way from one to a command of typer."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar, get_type_hints

import typer

from geodrake.cli.input_options import AxisOptions, ModelOptions, ReadingOptions
from geodrake.cli.streams import guarded
from geodrake.errors import ArgumentError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


@dataclass(frozen=True, kw_only=True)
class CommonOptions:
    """Options of all commands, and the words for those that many commands have.

    Attributes:
        model (MODEL): URDF, SDF, MJCF or Drake directives file, a model saved with --save, or the
            name of a robot of robot_descriptions, such as ur5e.
        logs (LOG...): Logs of time, positions and efforts: CSV, NPZ, ROS bag, MCAP, Parquet,
            LeRobot, JSON, HDF5, LCM or .mat; a.csv+b.csv are joined by time.
        json (FILE): Write the numbers; - is standard output.
        report (FILE.html): Write one page with the figures.
        series (FILE.csv|.parquet): Write the samples: time, log, and of every joint measured,
            predicted and residual.
        details: Show all: parameters, what is left, where the model fails, bodies; so does
            --report.
        quiet: Show results and errors only, no progress.
        debug: Show tracebacks; GEODRAKE_DEBUG=1 does too.
        effects (FILE.py): Know the effects of this file too; repeatable.
        known_payload (LOG:BODY:MASS[:X,Y,Z]): What the robot carried throughout a log, of known
            mass, kg, and centre of mass in the body's frame, m. With a log without it, gains of
            efforts are identifiable. Repeatable.
    """

    json: Path | None = None
    quiet: bool = False
    debug: bool = False


@dataclass(frozen=True, kw_only=True)
class LogOptions(AxisOptions, ModelOptions, CommonOptions):
    """Options of all commands on a model and logs.

    Attributes:
        bandwidth (HZ): Bandwidth of the filter; if absent, that of the model's fit to the same
            logs, or chosen from the data.
    """

    model: Path
    logs: list[Path]
    report: Path | None = None
    effects: list[Path] | None = None
    bandwidth: float | None = None
    known_payload: list[str] | None = None

    @property
    def settings(self) -> dict[str, Any]:
        """How logs are prepared, as keyword arguments: what options there are of these."""
        names = ("bandwidth", "blocks", "hold_resting")
        return {name: getattr(self, name) for name in names if hasattr(self, name)}


@dataclass(frozen=True, kw_only=True)
class ValidationOptions(LogOptions):
    """Options of commands that validate a model on blocks of logs.

    Attributes:
        blocks (N): Blocks that each log is validated on.
    """

    blocks: int | None = None


@dataclass(frozen=True, kw_only=True)
class Options(ValidationOptions):
    """Options of commands that can save the model, too.

    Attributes:
        save (FILE.yaml): Write the model, to be used as MODEL.
        correct_columns: Go on with the columns as they are found to be: signs, units, gains, zeros,
            time, swapped joints. If absent, what is found is said first, and no more.
        no_auto_lock: Keep joints that hardly move. If absent, those that rest in all logs are held
            where they rest, as --lock does.
    """

    save: Path | None = None
    series: Path | None = None
    correct_columns: bool = False
    no_auto_lock: bool = False
    details: bool = False

    @property
    def hold_resting(self) -> bool:
        """Whether joints that hardly move are held."""
        return not self.no_auto_lock


@dataclass(frozen=True, kw_only=True)
class _Steps(Options):
    """Options of commands that find values of effects.

    Attributes:
        effort_uncertainty (SHARE): How well the gains of the efforts are known, as a share: what
            that makes of parameters is a second ±. 0.05 if absent, as for torque constants; 0 for
            calibrated torque sensors.
    """

    effort_uncertainty: float | None = None

    @property
    def log_facts(self) -> dict[str, Any]:
        """How well the gains are known, if that is said, as fields of `JointLog`."""
        share = self.effort_uncertainty
        return {} if share is None else {"effort_uncertainty": share}


@dataclass(frozen=True, kw_only=True)
class ExplainOptions(_Steps):
    """Options of explain.

    Attributes:
        draft_effect (FILE.py): Search a formula for what stays unexplained, and write it as an
            effect of your own, to be used with --effects.
    """

    draft_effect: Path | None = None


@dataclass(frozen=True, kw_only=True)
class RolloutOptions(LogOptions):
    """Options of rollout.

    Attributes:
        before (MODEL): A model to compare with, such as the file it was.
        horizon (SECONDS): Length of a window of the simulation.
        windows (N): Most windows, spread evenly over the logs.
        commands: Servos of the simulated robot follow the logged commands, instead of the logged
            efforts at their joints.
        fit: Fit the model's soft joints and play to how the simulated robot moves, under efforts,
            or under --commands with servos that are not known exactly; every other block of
            windows, or every other log, is held out.
        save (FILE.yaml): Write the model with what --fit found, or as it was if that was not taken.
        meshcat (FILE.html): Write a page that replays the windows: the measured and the simulated
            robot.
    """

    before: Path | None = None
    horizon: float = 0.5
    windows: int = 12
    commands: bool = False
    fit: bool = False
    save: Path | None = None
    series: Path | None = None
    meshcat: Path | None = None


@dataclass(frozen=True, kw_only=True)
class PlayOptions(LogOptions):
    """Options of play.

    Attributes:
        before (MODEL): A model to play beside it; if absent and MODEL was saved with --save, the
            file that it is based on.
        out (FILE.html): Where the page goes; play.html if nothing else is asked for.
        video (FILE.mp4|.gif): Write a video of the robot and its errors.
        to (VIEWER FILE): Write a recording for another viewer: rerun FILE.rrd, or mcap FILE.mcap,
            which Foxglove and PlotJuggler open.
        live (PORT): Show the page on a port of this machine instead, until Ctrl-C; 0 is any free.
        speed (FACTOR): Seconds of the log played in a second.
        seconds (SECONDS): Most to play: of longer logs, the passages of largest error.
        ghost (SECONDS): Show the model's robot under the measured efforts as a ghost, which begins
            at the measured state anew every so often, such as 0.2.
    """

    before: Path | None = None
    out: Path | None = None
    video: Path | None = None
    to: tuple[str, Path] | None = None
    live: int | None = None
    speed: float = 1.0
    seconds: float = 30.0
    ghost: float | None = None


@dataclass(frozen=True, kw_only=True)
class _Addition:
    """Options.

    Attributes:
        effect (EFFECT[@PLACE]): Its name (an unknown one such as x lists them), and the joint or
            body where it is, as in payload@flange; j2+j3 is a pair of joints.
        where (NAME): Joint or body to add it at; repeatable, twice for a pair of joints. If absent,
            all joints, or the body or pair of neighbouring joints that it helps most at.
    """

    effect: str
    where: list[str] | None = None


@dataclass(frozen=True, kw_only=True)
class AddOptions(_Steps, _Addition):
    """Options of add."""

    @property
    def addition(self) -> tuple[str, list[str] | None]:
        """Name of the effect, and where it is to be; None if nobody said."""
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
class _NamedEffects:
    """Effects that are named.

    Attributes:
        effects (NAME[@PLACE],…|FILE.py): Effects beside the model's, by their names (an unknown
            name such as x lists them), and the joint or body where they are; a FILE.py brings
            effects that may be named. Repeatable.
    """

    effects: list[Path] | None = None


@dataclass(frozen=True, kw_only=True)
class _Regularization:
    """What keeps identified inertias near the model's.

    Attributes:
        regularizer (NAME): What keeps inertias near the model's: entropic, pullback, riemannian, …;
            an unknown name lists them.
        gamma (GAMMA): Weight of the regularizer: 100 keeps inertias to about 1/√100 = 10 %. Chosen
            by held-out error if absent.
        residual_bound (RATIO): Instead of a weight: the RMS training residual allowed, relative to
            the least possible, such as 1.01.
        total_mass (KG): Mass of all that moves, if it is known from a scale.
        compare: All regularizers at the same training residual.
    """

    PANEL: ClassVar = "near the model"

    regularizer: str = "entropic"
    gamma: float | None = None
    residual_bound: float | None = None
    total_mass: float | None = None
    compare: bool = False


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(_NamedEffects, Options, _Regularization):
    """Options of identify.

    Attributes:
        export (FILE.urdf|.sdf|.xml): Write the identified inertias into a copy of the model file;
            all else in it stays as it is.
        ellipsoids (FILE.png): Draw the bodies as ellipsoids before and after.
        meshcat (FILE.html): The same as a page to turn around in a browser.
    """

    export: Path | None = None
    ellipsoids: Path | None = None
    meshcat: Path | None = None

    @property
    def hold_resting(self) -> bool:
        """Whether joints that hardly move are held: not beside a mass, which is of all bodies."""
        return super().hold_resting and self.total_mass is None


@dataclass(frozen=True, kw_only=True)
class LogCommandOptions(ReadingOptions, ModelOptions, CommonOptions):
    """Options of log.

    Attributes:
        model (MODEL): A model, whose joints the columns are matched with.
        convert (FILE.csv|.npz): Write the log in SI units under geodrake's own names, without what
            sensors did wrong.
        figure (FILE.png): Draw positions and efforts over time.
        write_mapping (FILE.yaml): Write a mapping that reads the log so, with what is wrong in its
            columns corrected where a mapping can say it.
    """

    logs: list[Path]
    model: Path | None = None
    convert: Path | None = None
    figure: Path | None = None
    write_mapping: Path | None = None


@dataclass(frozen=True, kw_only=True)
class DemoOptions(CommonOptions):
    """Options of demo.

    Attributes:
        report (FILE.html): Where the page with the figures goes.
    """

    report: Path = Path("geodrake_demo.html")
    details: bool = False


@dataclass(frozen=True, kw_only=True)
class IdentifiableOptions(_NamedEffects, ValidationOptions):
    """Options of identifiable.

    Attributes:
        threshold (VARIANCE): Largest relative variance of what counts as identifiable; 0.01 is a
            deviation of 10 %.
        noise (NOISE): Deviation of the filtered efforts, N·m or N: one number, or JOINT=NUMBER,…;
            what the refitted model leaves on held-out data if absent.
    """

    threshold: float = 0.01
    noise: str | None = None


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """Which motions excite chooses from.

    Attributes:
        trajectory (FAMILY): fourier, spline, or free: samples that need not follow each other, the
            best that any motion could do.
        duration (SECONDS): Length of the motion.
        harmonics (N): Harmonics of a Fourier motion; 5 if absent.
        frequency (HZ): Base frequency of a Fourier motion; once in its length if absent, and three
            times with --tell-apart, so that every block of the log shows the difference.
        points (N): Control points of a spline motion; 16 if absent.
        samples (N): Samples by which information is counted; 300 if absent, or 50 free ones.
    """

    PANEL: ClassVar = "motion"

    trajectory: str = "fourier"
    duration: float = 10.0
    harmonics: int | None = None
    frequency: float | None = None
    points: int | None = None
    samples: int | None = None


@dataclass(frozen=True, kw_only=True)
class _Robot:
    """What excite may do with the robot.

    Attributes:
        limits (LIMIT,…): Limits in place of the model file's: 0.5 for half of all of them,
            velocity=1.5 or velocity=50% for all joints, JOINT.position=-1:0.5 for one; also
            acceleration, jerk and effort, and current, voltage and pwm of models fitted to such
            logs. Repeatable.
        start (POSITION): Where the motion starts: one number, or JOINT=NUMBER,…
        stand (POSITION): Where the robot stands: ramps lead from there to the motion, and back at
            its end; one number, or JOINT=NUMBER,…
        obstacle (SHAPE|FILE): What stands in the way: box:X,Y,Z@x,y,z, sphere:R@…,
            cylinder:R,L@…, floor:Z, a mesh, or a scene (URDF, SDF, MJCF). Repeatable.
        clearance (METRES): Least distance of the robot from itself and from obstacles.
        collisions: Whether the collision geometry of the file counts.
        floor: Whether nothing may go below the base, as on a table or a floor. A robot that hangs
            below its base where it starts has none.
    """

    PANEL: ClassVar = "robot and surroundings"

    limits: list[str] | None = None
    start: str | None = None
    stand: str | None = None
    obstacle: list[str] | None = None
    clearance: float = 0.01
    collisions: bool = True
    floor: bool = True


@dataclass(frozen=True, kw_only=True)
class _Choosing:
    """How excite judges motions and looks for the best one.

    Attributes:
        criterion (NAME): e_optimality, a_optimality, d_optimality or condition_number.
        normalization (NAME): geometric, diagonal or none.
        noise (NOISE): Deviation of the measured efforts, N·m or N: one number, or JOINT=NUMBER,…;
            what the model's last fit left, or 1 % of the limits of effort, if absent.
        seeds (N): Random motions to start from.
        seed (N): Number of the first of them.
        seconds (SECONDS): Most time for the whole search.
        iterations (N): Most iterations of the solver, for each stage.
        solver (NAME): snopt or ipopt.
    """

    PANEL: ClassVar = "search"

    criterion: str = "e_optimality"
    normalization: str = "geometric"
    noise: str | None = None
    seeds: int = 2
    seed: int = 0
    seconds: float = 180.0
    iterations: int = 300
    solver: str = "snopt"


@dataclass(frozen=True, kw_only=True)
class ExciteOptions(_NamedEffects, ModelOptions, _Motion, _Robot, _Choosing, CommonOptions):
    """Options of excite.

    Attributes:
        tell_apart (EFFECT,EFFECT[@PLACE]): Two effects that logs so far cannot distinguish: the
            motion on which their predictions differ most, once everything else is refitted.
        save (FILE): Write the motion: as a log with the predicted efforts (.csv, .npz), a ROS
            JointTrajectory (.yaml), or a Drake BsplineTrajectory (.drake.yaml).
        rate (HZ): Samples a second of what --save writes.
        meshcat (FILE.html): Write a page that replays the motion.
    """

    model: Path
    tell_apart: str | None = None
    save: Path | None = None
    rate: float = 100.0
    report: Path | None = None
    meshcat: Path | None = None


@dataclass(frozen=True, kw_only=True)
class CheckOptions(ModelOptions, CommonOptions):
    """Options of check.

    Attributes:
        samples (N): Random states, within the limits of the robot.
        seed (N): Seed of the random numbers.
    """

    model: Path
    samples: int = 100
    seed: int = 0
    effects: list[Path] | None = None


@dataclass(frozen=True, kw_only=True)
class DigestOptions(ReadingOptions, ModelOptions, CommonOptions):
    """Options of digest.

    Attributes:
        to (FOLDER): Folder of the digests, all of logs of robots with this model; made if it is not
            there. The first digest writes the settings that all of them share.
        date (DATE): When logs were recorded whose time stamps are no dates, such as 2026-05-01 or
            2026-05-01T12:00:00+02:00, UTC without a zone; when the file was changed if absent.
        bandwidth (HZ): Bandwidth of the filter of all digests, if the folder has no settings yet;
            if absent, that of the model's fit, or chosen from the first log.
        blocks (N): Blocks that each log is cut into, if the folder has no settings yet; 4 if
            absent.
    """

    model: Path
    logs: list[Path]
    to: Path
    date: str | None = None
    effects: list[Path] | None = None
    bandwidth: float | None = None
    blocks: int | None = None
    known_payload: list[str] | None = None


@dataclass(frozen=True, kw_only=True)
class ExportOptions(ReadingOptions, ModelOptions, CommonOptions):
    """Options of export.

    Attributes:
        logs (LOG): Logs on whose motion what the format lacks is fitted, and the error that it
            costs is measured; without any, random motion within the robot's limits serves.
        folder (DIR): Folder of the files, the last of all; made if it is not there.
        to_dir (DIR): The same as an option, for those who do not name it last.
        to (FORMAT): urdf, sdf, mjcf, drake (with model directives), isaac (a URDF, and values of
            actuators), python, cpp (a function effort(q, v, vd)), ros2 (a controller of
            ros2_control); an unknown name lists them.
        force: Replace files of these names that are there.
        bandwidth (HZ): Bandwidth of the filter of logs; if absent, that of the model's fit to the
            same logs, or chosen from the data.
    """

    model: Path
    logs: list[Path] | None = None
    folder: Path | None = None
    to: str
    to_dir: Path | None = None
    force: bool = False
    report: Path | None = None
    effects: list[Path] | None = None
    bandwidth: float | None = None

    @property
    def with_folder(self) -> ExportOptions:
        """The options with their folder, whichever way it was named."""
        if self.to_dir is not None:
            last = [] if self.folder is None else [self.folder]  # which is a log then
            return replace(self, folder=self.to_dir, to_dir=None, logs=[*(self.logs or ()), *last])
        if self.folder is None:
            raise ArgumentError(
                "export has no folder to write to.", advice="Name it last, or by --to-dir DIR."
            )
        return self


@dataclass(frozen=True, kw_only=True)
class FleetOptions(CommonOptions):
    """Options of fleet.

    Attributes:
        fleet (FLEET.yaml): Types with a model each, robots with patterns of their logs, and the
            folder of digests and results.
        workers (N): Processes of this machine that work; 0 is the command's own, which also works
            where Dask is not installed. One on each core if absent.
        scheduler (ADDRESS): A Dask scheduler of your own, such as tcp://10.0.0.5:8786, whose
            workers see the same folders.
        false_alarms (RATE): At most how many robots in which nothing changed are named, a
            robot-month.
        watch: Go on, and take in new logs as they come: each new finding is a line of JSON on
            standard output.
        every (SECONDS): Time between two looks for new logs.
        once: Look once and say what a watch would; exit code 3 if there is a new finding, for a
            cron job.
    """

    fleet: Path
    report: Path | None = None
    workers: int | None = None
    scheduler: str | None = None
    false_alarms: float = 0.01
    watch: bool = False
    every: float = 60.0
    once: bool = False


T = TypeVar("T", bound="DataclassInstance")

_FIRST = ("save", "report", "json")
_RARE = {"bandwidth", "blocks", "debug", "draft_effect", "effort_uncertainty", "known_payload"}
_RARE |= {"no_auto_lock", "series", "horizon", "windows", "live", "speed", "seconds", "quiet"}
_RARE |= {"ellipsoids", "scheduler", "workers", "details"}
_ARGUMENTS = {"model", "logs", "folder", "fleet", "effect"}
_ENTRY = re.compile(r"(?P<name>\w+)(?: \((?P<metavar>[^)]*)\))?: (?P<help>.*)")


def taking(options: type[T]) -> Callable[[Callable[[T], None]], Callable[..., None]]:
    """Make a function of one options object a command whose parameters are its fields.

    The help of an option is what the attributes of the class say of it, behind its metavariable in
    brackets. Errors of the command become messages and exit codes. Help shows what is used most,
    then what says how models and logs are read, and what is rare.
    """
    hints, told = get_type_hints(options), _documented(options)
    kinds = {field.name: field for field in fields(options)}
    names = sorted(kinds, key=lambda name: _FIRST.index(name) if name in _FIRST else len(_FIRST))
    rare = _RARE | (
        {"effects"} if told["effects"] == _documented(CommonOptions)["effects"] else set()
    )
    panels = dict.fromkeys(rare, "Advanced: rarely needed")
    for each in options.__mro__:
        if "PANEL" in vars(each):
            panels |= dict.fromkeys(
                inspect.get_annotations(each), f"Advanced: {vars(each)['PANEL']}"
            )
    parameters = [
        _parameter(kinds[name], hints[name], panels.get(name), told.get(name, (None, "")))
        for name in names
    ]

    def decorate(run: Callable[[T], None]) -> Callable[..., None]:
        @functools.wraps(run)
        def command(**values: Any) -> None:
            files = values.get("effects") or ()
            with guarded(debug=values["debug"], effect_files=files):
                run(options(**values))

        command.__annotations__ = {each.name: each.annotation for each in parameters}
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        return command

    return decorate


def path(text: str) -> Path:
    """Return the path of a model; ./ur5e is one, though `Path` makes the name ur5e of it."""
    found = Path(text)
    if str(found) == text:
        return found
    from geodrake.robot.files.named_robots import whole_if_folder

    return whole_if_folder(text, found)


def _documented(options: type[Any]) -> dict[str, tuple[str | None, str]]:
    """Return option -> metavariable and help, as docstrings of a class and its bases have them."""
    found: dict[str, tuple[str | None, str]] = {}
    for each in reversed(options.__mro__):
        text = inspect.cleandoc(each.__doc__ or "").partition("Attributes:\n")[2]
        for entry in re.split(r"\n(?=    \w)", text):
            if match := _ENTRY.match(" ".join(entry.split())):
                found[match["name"]] = match["metavar"], match["help"]
    return found


def _parameter(
    field: Field[Any], kind: Any, panel: str | None, told: tuple[str | None, str]
) -> inspect.Parameter:
    """Return a parameter of a command; flags that are off by themselves have no opposite."""
    name, default = field.name, field.default
    common: Any = {"metavar": told[0], "help": told[1], "rich_help_panel": panel}
    common |= {"parser": path} if name == "model" else {}
    if name in _ARGUMENTS and (default is MISSING or name in ("logs", "folder")):
        option = typer.Argument(**common)
    else:
        option_name = f"--{name.replace('_', '-')}"
        flags = (option_name,) if kind is bool and not default else ()
        flags = (*flags, "-q") if name == "quiet" else flags
        option = typer.Option(*flags, **common)
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=inspect.Parameter.empty if default is MISSING else default,
        annotation=Annotated[kind, option],
    )
