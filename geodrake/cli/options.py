"""Options of commands as dataclasses, and typer commands from them."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from geodrake.cli.input_options import (
    AxisOptions,
    ModelOptions,
    ReadingOptions,
    naming_options,
    split_effects,
)
from geodrake.cli.streams import guarded
from geodrake.errors import ArgumentError


@dataclass(frozen=True, kw_only=True)
class CommonOptions:
    """Options of all commands, and the help of those that many commands have.

    Attributes:
        model (MODEL): URDF, SDF, MJCF or Drake directives file, a model written by --save, or a
            name in robot_descriptions, such as ur5e.
        logs (LOG...): Logs of positions and efforts: CSV, NPZ, ROS bag, MCAP, Parquet, LeRobot,
            JSON, HDF5, LCM or MAT; a.csv+b.csv joins two files by time.
        json (FILE): Write the results as JSON; - is standard output.
        report (FILE.html): Write an HTML page with figures.
        series (FILE.csv|.parquet): Write measured and predicted efforts and residuals, by joint and
            time.
        details: Print all tables and notes, as --report does.
        quiet: Hide progress.
        debug: Show tracebacks, as GEODRAKE_DEBUG=1 does.
        effects (FILE.py): Load effects of your own. Repeatable.
        known_payload (LOG:BODY:MASS[:X,Y,Z]): Known payload carried throughout a log: body, mass in
            kg and centre of mass in the body frame in m. With a log without it, effort gains become
            identifiable. Repeatable.
    """

    json: Path | None = None
    quiet: bool = False
    debug: bool = False


@dataclass(frozen=True, kw_only=True)
class LogOptions(AxisOptions, ModelOptions, CommonOptions):
    """Options of all commands on a model and logs.

    Attributes:
        bandwidth (HZ): Bandwidth of the filter. By default that of the model's fit to the same
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
        """Settings of log preparation, as keyword arguments."""
        names = ("bandwidth", "blocks", "hold_resting")
        return {name: getattr(self, name) for name in names if hasattr(self, name)}


@dataclass(frozen=True, kw_only=True)
class ValidationOptions(LogOptions):
    """Options of commands that validate a model on blocks of logs.

    Attributes:
        blocks (N): Number of validation blocks of each log.
    """

    blocks: int | None = None
    details: bool = False


@dataclass(frozen=True, kw_only=True)
class Options(ValidationOptions):
    """Options of commands that can also save the model.

    Attributes:
        save (FILE.yaml): Save the model, for use as MODEL.
        correct_columns: Correct mistakes found in columns (signs, units, gains, zeros, time,
            swapped joints), which are otherwise only reported.
        no_auto_lock: Do not lock joints that are at rest in all logs.
    """

    save: Path | None = None
    series: Path | None = None
    correct_columns: bool = False
    no_auto_lock: bool = False

    @property
    def hold_resting(self) -> bool:
        """Whether joints that hardly move are held."""
        return not self.no_auto_lock


@dataclass(frozen=True, kw_only=True)
class CompareOptions(Options):
    """Show the error of a model, by joint, and where it is largest.

    Examples:
        robot.urdf log.csv --report page.html
        robot.yaml log.mcap
    """


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions(Options):
    """Rank the effects that the model may lack, with the evidence.

    Examples:
        robot.urdf log_1.csv log_2.csv
        robot.yaml new_log.csv --report page.html
    """


@dataclass(frozen=True, kw_only=True)
class _Steps(Options):
    """Options of commands that fit effects.

    Attributes:
        effort_uncertainty (SHARE): Relative standard deviation of the effort gains, which causes
            the second ± of parameters. Default 0.05, as for torque constants; 0 for calibrated
            torque sensors.
    """

    effort_uncertainty: float | None = None


@dataclass(frozen=True, kw_only=True)
class ExplainOptions(_Steps):
    """Find and add the effects that the model lacks.

    It ends when only noise is left, or when no effect explains the rest.

    Attributes:
        draft_effect (FILE.py): Search for a formula of the remaining error, and write it as an
            effect for --effects.

    Examples:
        robot.urdf log_1.csv log_2.csv --save robot.yaml --report page.html
        robot.yaml log_with_something_new.csv
    """

    draft_effect: Path | None = None


@dataclass(frozen=True, kw_only=True)
class RolloutOptions(LogOptions):
    """Simulate the model along a log, and compare the motion.

    It is driven by the logged efforts, or by servos that follow the logged commands.

    Attributes:
        before (MODEL): A model to compare with, such as the original file.
        horizon (SECONDS): Length of a simulated window.
        windows (N): Maximum number of windows, spread evenly over the logs.
        commands: Simulate servos that follow the logged commands, instead of applying the logged
            efforts.
        fit: Fit elastic joints, backlash and, with --commands, uncertain servo gains to the motion.
            Every other block of windows, or every other log, is held out.
        save (FILE.yaml): Save the model that --fit found; the given model if the fit is rejected.
        meshcat (FILE.html): Write a page that replays the measured and the simulated robot.

    Examples:
        robot.yaml log.csv --before robot.urdf
        robot.yaml log.csv --fit --save soft.yaml
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
    """Replay logs on the robot, coloured by error.

    It writes a page, a video or a recording.

    Attributes:
        before (MODEL): A model to show beside it. By default the file that a saved MODEL is based
            on.
        out (FILE.html): Write the page here. By default play.html, if no other output is named.
        video (FILE.mp4|.gif): Write a video.
        to (VIEWER FILE): Write a recording: rerun FILE.rrd, or mcap FILE.mcap for Foxglove and
            PlotJuggler.
        live (PORT): Serve the page on a local port until Ctrl-C; 0 picks a free one.
        speed (FACTOR): Playback speed.
        seconds (SECONDS): Maximum length. Of longer logs, the windows of largest error are played.
        ghost (SECONDS): Show a simulated robot under the measured efforts, reset to the measured
            state at this interval, such as 0.2.

    Examples:
        robot.yaml log.csv --out play.html
        robot.yaml log.csv --video play.mp4
        robot.yaml log.csv --to rerun play.rrd
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
class AddOptions(_Steps):
    """Add an effect that you name, refit, and show the error.

    Attributes:
        effect (EFFECT[@PLACE]): Name of an effect, and its joint or body, as in payload@flange;
            j2+j3 is a pair of joints. An unknown name, such as x, lists all effects.
        where (NAME): Joint or body of the effect; twice for a pair of joints. By default all
            joints, or the body or pair of neighbouring joints with the largest improvement.
            Repeatable.

    Examples:
        payload@flange robot.urdf log.csv --save robot.yaml
        viscous_friction robot.urdf log.csv
    """

    effect: str
    where: list[str] | None = None

    @property
    def addition(self) -> tuple[str, list[str] | None]:
        """Name of the effect, and its places; None if not given."""
        name, at, place = self.effect.partition("@")
        if at and not all(place.split("+")):
            raise ArgumentError(
                f"{self.effect!r} has no place after @.",
                advice=f"Write {name}@JOINT, or {name} alone.",
            )
        if place and self.where:
            raise ArgumentError(
                f"The place is given twice: {self.effect} and --where {' '.join(self.where)}.",
                advice="Give it once.",
            )
        return name, place.split("+") if place else self.where or None


@dataclass(frozen=True, kw_only=True)
class _NamedEffects:
    """Effects by name.

    Attributes:
        effects (NAME[@PLACE],…|FILE.py): Effects to add, and their joint or body; FILE.py loads
            effects of your own. An unknown name, such as x, lists all. Repeatable.
    """

    effects: list[Path] | None = None


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions(_NamedEffects, Options):
    """Fit inertias, and effects that you name.

    Inertias are regularized towards those of the model.

    Attributes:
        export (FILE.urdf|.sdf|.xml): Write a copy of the model file with the identified inertias.
        ellipsoids (FILE.png): Draw the inertia ellipsoids before and after.
        meshcat (FILE.html): Write an interactive page of the inertia ellipsoids.

    Regularization:
        regularizer (NAME): Distance from the model's inertias: entropic, pullback, riemannian, …;
            an unknown name, such as x, lists all.
        gamma (GAMMA): Weight of the regularizer; 100 keeps inertias within about 1/√100 = 10 %. By
            default chosen by held-out error.
        residual_bound (RATIO): Instead of a weight, the largest RMS training residual, relative to
            the smallest possible, such as 1.01.
        total_mass (KG): Known mass of all moving bodies.
        compare: Compare all regularizers at the same training residual.

    Examples:
        robot.urdf log.csv --effects coulomb_friction,viscous_friction
        robot.urdf log.csv --export identified.urdf
    """

    regularizer: str = "entropic"
    gamma: float | None = None
    residual_bound: float | None = None
    total_mass: float | None = None
    compare: bool = False
    export: Path | None = None
    ellipsoids: Path | None = None
    meshcat: Path | None = None

    @property
    def hold_resting(self) -> bool:
        """Whether joints that hardly move are held; never with a known total mass."""
        return super().hold_resting and self.total_mass is None


@dataclass(frozen=True, kw_only=True)
class LogCommandOptions(ReadingOptions, ModelOptions, CommonOptions):
    """Show how logs are read: joints, columns, units, rates, gaps.

    Attributes:
        model (MODEL): A model, to match its joints and check the columns.
        convert (FILE.csv|.npz): Write the log in SI units and geodrake's column names, with sensor
            faults removed.
        figure (FILE.png): Plot positions and efforts over time.
        write_mapping (FILE.yaml): Write the mapping of the columns, with corrections that a mapping
            can express.

    Examples:
        recording.mcap --model robot.urdf
        wrong.csv --model robot.urdf --write-mapping right.yaml
    """

    logs: list[Path]
    model: Path | None = None
    convert: Path | None = None
    figure: Path | None = None
    write_mapping: Path | None = None


@dataclass(frozen=True, kw_only=True)
class DemoOptions(CommonOptions):
    """Run explain on a log that comes with the package.

    Attributes:
        report (FILE.html): Write the HTML page here.
    """

    report: Path = Path("geodrake_demo.html")
    details: bool = False


@dataclass(frozen=True, kw_only=True)
class IdentifiableOptions(_NamedEffects, ValidationOptions):
    """Show which parameters the logs can identify.

    Attributes:
        threshold (VARIANCE): Largest relative variance of an identifiable parameter; 0.01 is a
            standard deviation of 10 %.
        noise (NOISE): Standard deviation of the filtered efforts in N·m or N: one number, or
            JOINT=NUMBER,…. By default the held-out error of the refitted model.

    Examples:
        robot.urdf log.csv
        robot.urdf log_1.csv log_2.csv --report page.html
    """

    threshold: float = 0.01
    noise: str | None = None


@dataclass(frozen=True, kw_only=True)
class ExciteOptions(_NamedEffects, ModelOptions, CommonOptions):
    """Design the most informative motion within the robot's limits.

    Attributes:
        tell_apart (EFFECT,EFFECT[@PLACE]): Find the motion that best distinguishes two effects,
            with everything else refitted.
        feet (LINK,…): Links on which a legged robot stands in balance, and which do not move. Its
            base is free. Give the size of a link without collision geometry: LINK=LENGTHxWIDTH
            in m, or LINK=point.
        save (FILE): Save the motion as a log with predicted efforts (.csv, .npz), a ROS
            JointTrajectory (.yaml), or a Drake BsplineTrajectory (.drake.yaml).
        rate (HZ): Sampling rate of the saved motion.
        meshcat (FILE.html): Write a page that replays the motion.

    Motion:
        trajectory (FAMILY): fourier, spline, or free: unconnected samples, a bound for any motion.
        duration (SECONDS): Length of the motion.
        harmonics (N): Harmonics of a Fourier motion; default 5.
        frequency (HZ): Base frequency of a Fourier motion. By default one period, and three with
            --tell-apart, so that every block of the log shows the difference.
        points (N): Control points of a spline motion; default 16.
        samples (N): Samples at which information is evaluated; default 300, or 50 for free.

    Robot and environment:
        friction (NUMBER): With --feet, the coefficient of friction between ground and feet.
        force_plate: With --feet, measure the ground's wrench instead of the joints' efforts.
        limits (LIMIT,…): Limits that override the model file's: 0.5 for half of all,
            velocity=1.5 or velocity=50% for all joints, JOINT.position=-1:0.5 for one. Also
            acceleration, jerk, effort, and current, voltage and pwm of models fitted to such logs.
            Repeatable.
        start (POSITION): Position at the start of the motion: one number, or JOINT=NUMBER,…
            With --feet, the feet stay where --start or --stand puts them, or else the file.
        stand (POSITION): Rest position of the robot, with ramps from there to the motion and back:
            one number, or JOINT=NUMBER,…
        obstacle (SHAPE|FILE): box:X,Y,Z@x,y,z, sphere:R@…, cylinder:R,L@…, floor:Z, a mesh, or a
            scene (URDF, SDF, MJCF). Repeatable.
        clearance (METRES): Minimum distance from obstacles and between links.
        collisions: Use the collision geometry of the model file.
        floor: Keep the robot above its base. Off for a robot that starts below it.

    Search:
        criterion (NAME): e_optimality, a_optimality, d_optimality or condition_number.
        normalization (NAME): geometric, diagonal or none.
        noise (NOISE): Standard deviation of the measured efforts in N·m or N: one number, or
            JOINT=NUMBER,…. By default the residuals of the model's last fit, or 1 % of the effort
            limits. With --force-plate nx=…,ny=…,nz=…,fx=…,fy=…,fz=…; 1 % of the weight by default.
        seeds (N): Number of random initial motions.
        seed (N): Seed of the first one.
        seconds (SECONDS): Time limit of the search.
        iterations (N): Maximum iterations of the solver in each stage.
        solver (NAME): snopt or ipopt.

    Examples:
        robot.urdf --save motion.csv
        robot.yaml --tell-apart payload,wrong_inertia --save motion.csv
        humanoid.urdf --feet l_foot,r_foot --stand l_knee=0.8,… --save motion.csv
    """

    model: Path
    tell_apart: str | None = None
    feet: str | None = None
    save: Path | None = None
    rate: float = 100.0
    report: Path | None = None
    meshcat: Path | None = None
    details: bool = False
    trajectory: str = "fourier"
    duration: float = 10.0
    harmonics: int | None = None
    frequency: float | None = None
    points: int | None = None
    samples: int | None = None
    friction: float = 0.5
    force_plate: bool = False
    limits: list[str] | None = None
    start: str | None = None
    stand: str | None = None
    obstacle: list[str] | None = None
    clearance: float = 0.01
    collisions: bool = True
    floor: bool = True
    criterion: str = "e_optimality"
    normalization: str = "geometric"
    noise: str | None = None
    seeds: int = 2
    seed: int = 0
    seconds: float = 180.0
    iterations: int = 300
    solver: str = "snopt"


@dataclass(frozen=True, kw_only=True)
class CheckOptions(ModelOptions, CommonOptions):
    """Compare the model's dynamics with MultibodyPlant.

    The exit code is 1 if they differ.

    Attributes:
        samples (N): Number of random states within the robot's limits.
        seed (N): Seed of the random numbers.

    Examples:
        robot.urdf
        scene.xml --robot arm
    """

    model: Path
    samples: int = 100
    seed: int = 0
    effects: list[Path] | None = None


@dataclass(frozen=True, kw_only=True)
class DigestOptions(ReadingOptions, ModelOptions, CommonOptions):
    """Reduce each log to a small file for fleets.

    The exit code is 1 if any log fails.

    Attributes:
        to (FOLDER): Folder of digests of robots with this model; created if missing. The first
            digest fixes the settings of all.
        date (DATE): Date of logs whose time stamps are not dates, such as 2026-05-01 or
            2026-05-01T12:00:00+02:00; UTC without a zone. By default the file's modification time.
        bandwidth (HZ): Bandwidth of the filter, for a folder without settings. By default that of
            the model's fit, or chosen from the first log.
        blocks (N): Blocks of each log, for a folder without settings; default 4.

    Examples:
        robot.urdf monday.csv tuesday.csv --to digests
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
    """Write the model for a simulator or controller, and verify it.

    Attributes:
        logs (LOG): Logs on whose motion effects that the format lacks are approximated, and the
            loss of accuracy is measured. By default random motion within the robot's limits.
        folder (DIR): Output folder, the last argument; created if missing.
        to_dir (DIR): Output folder, as an option.
        to (FORMAT): urdf, sdf, mjcf, drake (with model directives), isaac (URDF and actuator
            parameters), python or cpp (a function effort(q, v, vd)), ros2 (a ros2_control
            controller).
        force: Overwrite existing files.
        bandwidth (HZ): Bandwidth of the filter. By default that of the model's fit to the same
            logs, or chosen from the data.

    Examples:
        robot.yaml --to mjcf exported
        robot.yaml --to ros2 src/robot_feedforward
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
        """The options with the folder from the last argument or --to-dir."""
        if self.to_dir is not None:
            last = [] if self.folder is None else [self.folder]  # a log in this case
            return replace(self, folder=self.to_dir, to_dir=None, logs=[*(self.logs or ()), *last])
        if self.folder is None:
            raise ArgumentError(
                "export needs an output folder.", advice="Give it last, or with --to-dir DIR."
            )
        return self


@dataclass(frozen=True, kw_only=True)
class FleetOptions(CommonOptions):
    """Show which robots of a fleet changed, where, how and when.

    Attributes:
        fleet (FLEET.yaml): Robot types and their models, robots and patterns of their logs, and the
            folder of digests and results.
        workers (N): Worker processes; 0 runs in this process, without Dask. By default one per
            core.
        scheduler (ADDRESS): Address of a Dask scheduler, such as tcp://10.0.0.5:8786, whose workers
            see the same folders.
        false_alarms (RATE): Maximum rate of false alarms per robot and month.
        watch: Keep running and process new logs; each new finding is a line of JSON on standard
            output.
        every (SECONDS): Polling interval of --watch.
        once: Process new logs once, as a cron job does; exit code 3 if there is a new finding.

    Examples:
        fleet.yaml --report fleet.html
        fleet.yaml --watch
    """

    fleet: Path
    report: Path | None = None
    workers: int | None = None
    scheduler: str | None = None
    false_alarms: float = 0.01
    watch: bool = False
    every: float = 60.0
    once: bool = False


ALL_OPTIONS = "geodrake.all_options"  # key in a context's `meta` to show advanced options
_ADVANCED, _HELP_ALL = "Advanced: ", "help_all"
_HELP_WORDS = "Show all options, including advanced ones, and exit."
_ARGUMENTS = ("effect", "model", "logs", "folder", "fleet")
_FIRST = (*_ARGUMENTS, "save", "report", "json")
_RARE = {"bandwidth", "blocks", "debug", "effort_uncertainty", "known_payload"}
_RARE |= {"no_auto_lock", "series", "horizon", "windows", "live", "speed", "seconds", "quiet"}
_RARE |= {"ellipsoids", "rate", "scheduler", "workers"}
_ENTRY = re.compile(r"(?P<name>\w+)(?: \((?P<metavar>[^)]*)\))?: (?P<help>.*)")


def command_of(place: str, options: type[Any]) -> Callable[..., None]:
    """Return a command whose parameters are the fields of an options class.

    The help of the command and of each option is read from the docstring of the class. Errors of
    the command become messages and exit codes.

    Args:
        place: Module and name of the function to run, imported when the command is called.
    """
    hints, texts = get_type_hints(options), _documented(options)
    kinds = {field.name: field for field in fields(options)}
    names = sorted(kinds, key=lambda name: _FIRST.index(name) if name in _FIRST else len(_FIRST))
    parameters = [
        _parameter(kinds[name], hints[name], *texts.get(name, (None, "", None))) for name in names
    ]
    parameters.append(_help_all())
    module, _, function = place.partition(".")

    def command(**values: Any) -> None:
        del values[_HELP_ALL]  # handled by its callback
        files, _ = split_effects(values.get("effects"))
        with guarded(debug=values["debug"], effect_files=files), naming_options(kinds):
            getattr(import_module(f"geodrake.cli.{module}"), function)(options(**values))

    command.__doc__, *_ = _sections(options)
    command.__annotations__ = {p.name: p.annotation for p in parameters}
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return command


def examples_of(options: type[Any]) -> list[str]:
    """Return example arguments of a command."""
    _, *sections = _sections(options)
    text = dict(zip(sections[::2], sections[1::2], strict=True)).get("Examples", "")
    return [line.strip() for line in text.strip().splitlines()]


def _sections(options: type[Any]) -> list[str]:
    """Return the summary of a docstring, then the title and text of each section."""
    return re.split(r"^(\w[\w ]*):\n", inspect.cleandoc(options.__doc__ or ""), flags=re.M)


def is_advanced(parameter: Any) -> bool:
    """Return whether a parameter of a command is only shown by --help-all."""
    return (getattr(parameter, "rich_help_panel", None) or "").startswith(_ADVANCED)


def path(text: str) -> Path:
    """Return the path of a model; ./ur5e stays a path, which `Path` would turn into a name."""
    normalized = Path(text)
    if str(normalized) == text:
        return normalized
    from geodrake.robot.files.named_robots import whole_if_folder

    return whole_if_folder(text, normalized)


def _documented(options: type[Any]) -> dict[str, tuple[str | None, str, str | None]]:
    """Return option -> metavariable, help and panel, from the docstrings of a class and its bases.

    The panel of an option is the title of its section, unless that is "Attributes".
    """
    found: dict[str, tuple[str | None, str, str | None]] = {}
    for base in reversed(options.__mro__):
        _, *sections = _sections(base)
        for title, text in zip(sections[::2], sections[1::2], strict=True):
            for entry in re.split(r"\n(?=    \w)", text):
                if match := _ENTRY.match(" ".join(entry.split())):
                    name, metavar, help_text = match.group("name", "metavar", "help")
                    is_rare = name in _RARE or metavar == "FILE.py"  # user code
                    panel = "rarely needed" if is_rare else None
                    panel = panel if title == "Attributes" else title.lower()
                    found[name] = metavar, help_text, panel
    return found


def _parameter(
    field: Field[Any], kind: Any, metavar: str | None, help_text: str, panel: str | None
) -> inspect.Parameter:
    """Return a parameter of a command. Flags that are off by default have no negation."""
    name, default = field.name, field.default
    common: Any = {"metavar": metavar, "help": help_text}
    common["rich_help_panel"] = panel and f"{_ADVANCED}{panel}"
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


def _help_all() -> inspect.Parameter:
    """Return the option --help-all, which prints the help with advanced options."""

    def show(ctx: typer.Context, wanted: bool) -> None:
        if wanted:
            ctx.meta[ALL_OPTIONS] = True
            typer.echo(ctx.get_help())
            raise typer.Exit

    option = typer.Option("--help-all", callback=show, is_eager=True, help=_HELP_WORDS)
    return inspect.Parameter(
        _HELP_ALL,
        inspect.Parameter.KEYWORD_ONLY,
        default=False,
        annotation=Annotated[bool, option],
    )
