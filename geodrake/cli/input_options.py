"""Options that control how MODEL and LOG are read.

Readers are imported when a command runs, so that help is quick.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

from geodrake.boundary.whole_files import write_whole
from geodrake.errors import ArgumentError, LogError, OutputError

if TYPE_CHECKING:
    from geodrake.cli.progress import Activity
    from geodrake.effects import Effect
    from geodrake.logs.files import Reading
    from geodrake.logs.motors import Motor
    from geodrake.model import Given, RobotModel

_MOST_REPAIRS = 5  # repairs that are printed one by one; notes have all
_KINDS = ("prismatic", "revolute")
_RADIUS = 0.1  # m, radius of gyration of a revolute axis: a guess, as is the mass
_URDF = """<?xml version="1.0"?>
<!-- One horizontal {kind} axis, written by geodrake: only its mass is known. -->
<robot name="axis">
  <link name="base"/>
  <link name="moving">
    <inertial>
      <mass value="{mass!r}"/>
      <inertia ixx="{inertia!r}" iyy="{inertia!r}" izz="{inertia!r}" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name={joint} type="{kind}">
    <parent link="base"/>
    <child link="moving"/>
    <axis xyz="1 0 0"/>
  </joint>
</robot>
"""


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """Options for logs whose column names are not enough.

    Logs:
        mapping (FILE.yaml): Mapping of columns to joints and quantities. For unknown column names,
            a draft is written into the working folder.
        columns (NAME,…): Column names of logs without a header: time,q1,q2,tau1,tau2; _ skips one.
        rate (HZ): Sampling rate of logs without time.
        units (QUANTITY=UNIT,…): Units of columns that are not SI, such as position=deg,current=mA.
        gain (JOINT=VALUE[±DEVIATION]): Gain from a joint's current, voltage or duty cycle to
            effort, such as torque constant × gear ratio. By default estimated with the model's
            inertias. Repeatable.
        kind ([JOINT=]KIND): Quantity of the effort columns: effort, current, voltage or pwm; or
            command, to use servo commands instead. Repeatable.
        motor ([JOINT=]MOTOR): Motor or servo of a joint, such as sts3215, whose data sheet gives a
            prior for its gains. Repeatable.
        motors (FILE.yaml): Further motors, in the format of geodrake's table.
        passive (JOINT): Joint without a motor, whose effort is zero. Repeatable.
        topic (NAME): Topic of a bag, or channel of an LCM log; an unknown name, such as x, lists
            all. Several are joined by time. In a table with several robots, the word that
            names one in its columns, such as left; all if it is one robot. Repeatable.
        dbc (FILE): DBC of the robot's CAN bus, for traces of it (candump, .asc, .blf, .trc).
        episode (N): Episode of a LeRobot dataset or of a file of demonstrations; default all.
        skip_bad_rows: Skip corrupt rows, up to 1 %, and report their number.
    """

    mapping: Path | None = None
    columns: str | None = None
    rate: float | None = None
    units: str | None = None
    gain: list[str] | None = None
    kind: list[str] | None = None
    motor: list[str] | None = None
    motors: Path | None = None
    passive: list[str] | None = None
    topic: list[str] | None = None
    dbc: Path | None = None
    episode: int | None = None
    skip_bad_rows: bool = False

    @property
    def reading(self) -> Reading:
        """The reading options of logs."""
        from geodrake.logs.files import Reading, read_mapping

        if self.columns is not None and self.mapping is not None:
            raise ArgumentError(
                "--columns and --mapping exclude each other.",
                advice="In a mapping, give column numbers instead of names.",
            )
        gains, usual = self._gains, getattr(self, "effort_uncertainty", None)
        return Reading(
            mapping=None if self.mapping is None else read_mapping(self.mapping),
            columns=tuple(part.strip() for part in (self.columns or "").split(",") if part.strip()),
            rate=self.rate,
            units=pairs("--units", [self.units or ""], "position=deg,time=ms"),
            gains={joint: gain for joint, (gain, _) in gains.items()},
            gain_deviations={j: spread for j, (_, spread) in gains.items() if spread is not None},
            **({} if usual is None else {"usual_deviation": usual}),
            kinds=self._kinds,
            motors=self._motors,
            skip_bad_rows=self.skip_bad_rows,
            topic=tuple(self.topic or ()),
            dbc=self.dbc,
            episode=self.episode,
        )

    @property
    def _gains(self) -> dict[str, tuple[float, float | None]]:
        """Joint -> gain, and its deviation if known."""
        from geodrake.logs.files.reading import parsed_gain

        texts = pairs("--gain", self.gain or (), "elbow_joint=13.2")
        return {joint: parsed_gain(text, f"--gain of {joint!r}") for joint, text in texts.items()}

    @property
    def _motors(self) -> dict[str, Motor]:
        """Joint -> motor, "" for all joints."""
        from geodrake.logs.motors import known_motors, motor_named

        names = of_all_and_named("--motor", self.motor or (), "elbow_flex=sts3215")
        if not (names or self.motors):
            return {}
        table = known_motors(self.motors)
        return {joint: motor_named(name, table) for joint, name in names.items()}

    @property
    def _kinds(self) -> dict[str, str]:
        """Joint -> kind, "" for all joints."""
        kinds = of_all_and_named("--kind", self.kind or (), "elbow_joint=current")
        names = (part.strip() for part in ",".join(self.passive or ()).split(","))
        passive = dict.fromkeys(filter(None, names), "passive")
        if conflicts := sorted(kinds.keys() & passive.keys()):
            raise ArgumentError(
                f"--passive says that {conflicts[0]!r} has no motor, but --kind says that it is "
                f"{kinds[conflicts[0]]}.",
                advice="Omit one of them.",
            )
        return kinds | passive


def of_all_and_named(option: str, given: Sequence[str], example: str) -> dict[str, str]:
    """Return joint -> value of an option, "" for all joints."""
    parts = [part.strip() for part in ",".join(given).split(",")]
    common = [part for part in parts if part and "=" not in part]
    if len(common) > 1:
        form = f"JOINT={example.rpartition('=')[2].upper()}"
        raise ArgumentError(
            f"{option} has several values for all joints: {' and '.join(common)}.",
            advice=f"Write {form}.",
        )
    named = pairs(option, [part for part in parts if "=" in part], example)
    return {"": common[0], **named} if common else named


def pairs(option: str, given: Sequence[str], example: str) -> dict[str, str]:
    """Return name -> value of an option; each name occurs once."""
    values: dict[str, str] = {}
    for part in filter(None, ",".join(given).split(",")):
        name, sign, value = (word.strip() for word in part.rpartition("="))
        if not (name and sign and value):
            raise ArgumentError(
                f"{option} got {part!r}; expected NAME=VALUE.", advice=f"Write {option} {example}."
            )
        if name in values:
            raise ArgumentError(f"{option} has {name!r} twice.", advice="Give it once.")
        values[name] = value
    return values


def number_in(text: str, option: str, advice: str) -> float:
    """Return the number in a part of an option's value."""
    try:
        return float(text)
    except ValueError:
        message = f"{option} got {text.strip()!r}, which is not a number."
        raise ArgumentError(message, advice=advice) from None


_RENAMED = {"modes": "harmonics", "most": "windows", "residual_ratio": "residual_bound"}
"""Argument of the library -> option with a different name."""


@contextmanager
def naming_options(options: Collection[str]) -> Iterator[None]:
    """Replace the names of arguments in errors by the corresponding options."""
    try:
        yield
    except ArgumentError as error:
        name = str(error.evidence.get("name", ""))
        option = _RENAMED.get(name, name)
        if option not in options or not error.problem.startswith(f"{name} "):
            raise
        problem = f"--{option.replace('_', '-')}{error.problem.removeprefix(name)}"
        raise ArgumentError(problem, advice=error.advice, **error.evidence) from error


def listed(given: Sequence[Path] | None) -> list[Path]:
    """Return the comma-separated parts of an option's values; file names may contain commas."""
    paths = []
    for value in given or ():
        parts = [value] if value.is_file() else map(str.strip, str(value).split(","))
        paths += [Path(part) for part in parts if part]
    return paths


def split_effects(given: Sequence[Path] | None) -> tuple[list[Path], list[str]]:
    """Return the files and names among the values of --effects."""
    parts = listed(given)
    names = [str(part) for part in parts if part.suffix != ".py"]
    return [part for part in parts if part.suffix == ".py"], names


@contextmanager
def proposing(logs: Sequence[Path]) -> Iterator[None]:
    """Write a draft mapping for a log whose columns are unknown, and add its path to the error.

    The draft goes to the working folder, unless it exists there. Joined files share one draft.
    """
    try:
        yield
    except LogError as error:
        proposal, path = error.evidence.get("proposal"), error.evidence.get("path")
        if proposal is None or path is None:
            raise
        from geodrake.logs.files.packed_files import log_name

        log = next((log for log in logs if log.name == Path(path).name), path)
        target = Path(f"{log_name(Path(str(log).split('+')[0]))}.mapping.yaml")
        hint = f"A draft mapping is in {target}: edit it, and pass it with --mapping."
        if target.exists() or target.is_symlink():
            hint = f"Edit the existing {target}, and pass it with --mapping."
        else:
            try:
                write_whole(target, proposal)
            except OutputError:
                hint = "Or map the columns with --mapping."
        raise LogError(error.problem, advice=f"{error.advice} {hint}", **error.evidence) from error


@dataclass(frozen=True, kw_only=True)
class ModelOptions:
    """Options for reading a model file.

    Models:
        lock (JOINT=VALUE): Fix a joint at a position, rad or m. Joints that no log has are fixed
            automatically. Repeatable.
        robot (NAME): Robot of a file that has several; an unknown name, such as x, lists all.
        package (NAME=FOLDER): Folder of a ROS package that the model refers to, in addition to
            ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and parent folders. Repeatable.
        xacro_arg (NAME:=VALUE): Argument of a xacro file. Repeatable.
        trust_xacro: Evaluate all Python expressions of a xacro file, which must be trusted. By
            default only arithmetic and xacro's own functions are evaluated.
        transmission (FILE.yaml|file|none): Transmission between logged actuators and the model's
            joints, such as gears, coupled wrists or linkages; `file` reads it from MODEL. By
            default ARM.transmission.yaml beside ARM.urdf, if it exists.
        floating: Give bodies that are not fixed to the world a floating base.
    """

    lock: list[str] | None = None
    robot: str | None = None
    package: list[str] | None = None
    xacro_arg: list[str] | None = None
    trust_xacro: bool = False
    transmission: str | None = None
    floating: bool = False

    @property
    def given(self) -> Given:
        """The reading options of the model file."""
        from geodrake.model import Given

        return Given.of_words(
            self.robot, self.package or (), self.xacro_arg or (), trust_xacro=self.trust_xacro
        )

    @property
    def transmission_files(self) -> list[Path]:
        """The transmission file, if any, which no output may overwrite."""
        name = self.transmission
        return [Path(name)] if name is not None and Path(name).is_file() else []

    @property
    def held(self) -> dict[str, float]:
        """Joint -> position at which it is fixed, rad or m."""
        from geodrake.boundary.arguments import number

        texts = pairs("--lock", self.lock or (), "finger=0.04, in rad or m")
        advice = "Write --lock JOINT=VALUE, in rad or m, such as --lock finger=0.04."
        return {
            joint: number(number_in(text, option := f"--lock of {joint!r}", advice), option)
            for joint, text in texts.items()
        }


def read_model(
    path: Path, options: ModelOptions, activity: Activity, extra: Sequence[type[Effect]] = ()
) -> RobotModel:
    """Read the model of a command, and report repairs of its file."""
    from geodrake.model import load_model
    from geodrake.robot.files.named_robots import planned_download

    download = planned_download(path)
    if download:
        activity.warning(download)
    model = load_model(
        path,
        floating=options.floating,
        extra=extra,
        lock=options.held,
        given=options.given,
        transmission=options.transmission,
    )
    report_repairs(model.path.name, model.repairs, activity)
    return model


def report_repairs(file: str, repairs: Sequence[str], activity: Activity) -> None:
    """Report the first repairs of a model file, and the number of the others."""
    more = len(repairs) - _MOST_REPAIRS
    rest = [f"{more} more of its parts were replaced or omitted."] if more > 0 else []
    for repair in (*repairs[:_MOST_REPAIRS], *rest):
        activity.warning(f"Warning: {file} was repaired. {repair}")


@dataclass(frozen=True, kw_only=True)
class AxisOptions(ReadingOptions):
    """Options to write a single-axis model.

    Models:
        axis (prismatic|revolute): Write a new MODEL (.urdf): one horizontal axis with --mass.
        mass (KG): Approximate mass that --axis moves; the fit corrects it.
    """

    axis: str | None = None
    mass: float | None = None


@contextmanager
def written_axis(options: AxisOptions, model: Path, log: Path) -> Iterator[None]:
    """Write MODEL if options ask for an axis, and remove it if the command fails."""
    if options.axis is None:
        if options.mass is not None:
            raise ArgumentError("--mass needs --axis.", advice="Add --axis prismatic.")
        yield
        return
    from geodrake.logs.files import read_log

    kind, mass = options.axis, options.mass
    if kind not in _KINDS:
        raise ArgumentError(f"--axis is {kind!r}.", advice=f"Write {' or '.join(_KINDS)}.")
    if mass is None or not (math.isfinite(mass) and mass > 0):
        raise ArgumentError(
            f"--axis needs a positive --mass; got {mass}.", advice="Give the approximate mass, kg."
        )
    if model.exists() or model.is_symlink():
        raise OutputError(
            f"--axis writes MODEL, but {model} exists.",
            advice="Name a new file, or omit --axis to use this one.",
            path=model,
        )
    if model.suffix.lower() != ".urdf":
        raise OutputError(
            f"--axis writes MODEL, but {model} does not end in .urdf.",
            advice=f"Name it {model.stem or 'axis'}.urdf.",
        )
    joints = read_log(log, reading=options.reading).joints
    if len(joints) > 1:
        raise ArgumentError(
            f"--axis has one joint, but {log} has {len(joints)}: {', '.join(joints)}.",
            advice="Give a model file.",
        )
    inertia = mass * _RADIUS**2
    write_whole(
        model, _URDF.format(kind=kind, mass=mass, inertia=inertia, joint=quoteattr(joints[0]))
    )
    try:
        yield
    except BaseException:
        model.unlink(missing_ok=True)
        raise
