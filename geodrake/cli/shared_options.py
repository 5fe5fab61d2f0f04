"""Options that commands share, and the way from a dataclass of options to a command."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import typer

from geodrake.cli.axis_model import AxisOptions
from geodrake.cli.guard import guarded
from geodrake.cli.model_options import ModelOptions

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_SHARED = {
    "model": (
        "MODEL",
        "URDF, SDF, MJCF or Drake directives file, a model saved with --save, or the name of a "
        "robot of robot_descriptions, such as ur5e.",
    ),
    "logs": (
        "LOG...",
        "Logs of time, positions and efforts: CSV, NPZ, ROS bag, MCAP, Parquet, LeRobot, JSON, "
        "HDF5, LCM or .mat; a.csv+b.csv are joined by time.",
    ),
    "json": ("FILE", "Write the numbers; - is standard output."),
    "report": ("FILE.html", "Write one page with the figures."),
    "series": (
        "FILE.csv|.parquet",
        "Write the samples: time, log, and of every joint measured, predicted and residual.",
    ),
    "details": (
        None,
        "Show all: parameters, what is left, where the model fails, bodies; so does --report.",
    ),
    "quiet": (None, "Show results and errors only, no progress."),
    "debug": (None, "Show tracebacks; GEODRAKE_DEBUG=1 does too."),
    "effects": ("FILE.py", "Know the effects of this file too; repeatable."),
    "known_payload": (
        "LOG:BODY:MASS[:X,Y,Z]",
        "What the robot carried throughout a log, of known mass, kg, and centre of mass in the "
        "body's frame, m. With a log without it, gains of efforts are identifiable. Repeatable.",
    ),
}
"""Options of many commands by name: their metavariable and help."""


@dataclass(frozen=True, kw_only=True)
class CommonOptions:
    """Options of all commands."""

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
        """How logs are prepared, as keyword arguments."""
        return {"bandwidth": self.bandwidth}

    @property
    def log_facts(self) -> dict[str, Any]:
        """What is known of all logs beside what is in their files, as fields of `JointLog`."""
        return {}


@dataclass(frozen=True, kw_only=True)
class ValidationOptions(LogOptions):
    """Options of commands that validate a model on blocks of logs.

    Attributes:
        blocks (N): Blocks that each log is validated on.
    """

    blocks: int | None = None

    @property
    def settings(self) -> dict[str, Any]:
        """How logs are prepared, as keyword arguments."""
        return {"bandwidth": self.bandwidth, "blocks": self.blocks}


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
    def settings(self) -> dict[str, Any]:
        """How logs are prepared, as keyword arguments."""
        return {**super().settings, "hold_resting": self.holds_resting}

    @property
    def holds_resting(self) -> bool:
        """Whether joints that hardly move are held."""
        return not self.no_auto_lock


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
    hints, told = get_type_hints(options), _SHARED | _documented(options)
    kinds = {field.name: field for field in fields(options)}
    names = sorted(kinds, key=lambda name: _FIRST.index(name) if name in _FIRST else len(_FIRST))
    rare = _RARE | ({"effects"} if told.get("effects") == _SHARED["effects"] else set())
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
    """Option -> metavariable and help, as the docstrings of the class and its bases have them."""
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
