"""One run of a command: read and check the inputs, compute, write, print."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, TypeVar, cast
from urllib.parse import quote

import typer
from rich.console import Console

from geodrake.boundary.version import version
from geodrake.boundary.whole_files import Content, check_writable, write_together
from geodrake.cli.input_options import AxisOptions, listed, proposing, read_model, written_axis
from geodrake.cli.options import Options
from geodrake.cli.progress import Activity, progress
from geodrake.cli.streams import INTERRUPTED, print_whole, printing, results
from geodrake.diagnosis.columns import (
    MOST_JOINTS,
    ColumnFinding,
    check_columns,
    corrected,
    with_motor_limits,
)
from geodrake.effects import load_effect_file
from geodrake.effects.base import Effect
from geodrake.errors import ArgumentError, GeodrakeError, LogError, OutputError
from geodrake.logs.files import check_log, file_names, parts_of, read_log
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.motion import JointLog
from geodrake.model.base_motion import has_base
from geodrake.model.carried_payloads import carried_phi
from geodrake.model.logged_joints import holding_resting, model_of_logs, reading_for
from geodrake.model.robot_model import RobotModel
from geodrake.model.saved_model import saved_text
from geodrake.report.json_output import record, to_json
from geodrake.report.numbers import Units
from geodrake.report.page import About, Page, Section
from geodrake.report.terminal import ResultsConsole, show_page, show_saved
from geodrake.report.views import check_series, samples, series_content, view_of

R = TypeVar("R")

_AS_LOGGED = "The results use the columns as logged, mistakes included"
_UNCORRECTED = f"{_AS_LOGGED}; --correct-columns corrects them."
_CORRECTED = "The results use the corrected columns."
_PAYLOAD = (
    "Write LOG:BODY:MASS or LOG:BODY:MASS:X,Y,Z in kg and m, such as log_2.csv:flange:3:0,0,0.1."
)
_PAYLOAD_FORM = re.compile(r"^(.+):([^:,]+)(?::([^:,]+),([^:,]+),([^:,]+))?$")  # body, numbers
_PIPE_WIDTH = 160  # columns; tables are as wide as their content

STDOUT = Path("-")
PAGE = (".html", ".htm")


@dataclass(frozen=True)
class Output:
    """An optional output file of a command."""

    words: str  # description
    suffixes: tuple[str, ...] = PAGE  # allowed file extensions
    # Returns the content for a result and a path; None if there is nothing to write.
    make: Callable[[Any, Path], Content | None] = lambda found, path: None


@dataclass(frozen=True)
class Input:
    """The inputs of a command."""

    model: RobotModel  # None only for commands without MODEL
    logs: tuple[JointLog, ...]
    extra: tuple[type[Effect], ...]  # user-defined effects
    settings: Mapping[str, Any]  # of log preparation: bandwidth and, for validation, blocks
    progress: Activity  # called with the current activity and its completed share
    unread: tuple[str, ...] = ()  # logs that cannot be read, in sentences


def _write(result: object, contents: Mapping[Path, Content]) -> Sequence[Path]:
    del result
    write_together(contents)
    return ()


@dataclass(frozen=True)
class Command(Generic[R]):
    """The definition of a command."""

    name: str
    working: str  # description of the work, for the progress bar
    work: Callable[[Input], R]
    inputs: Sequence[Path] = ()  # files that are read in addition to those of the options
    reads_logs: bool = True  # whether logs are read before the work, not by the command itself
    takes_bad_logs: bool = False  # whether the command reports missing logs itself
    # Option -> outputs in addition to numbers, page, model and samples.
    outputs: Mapping[str, Output] = field(default_factory=dict)
    # Raises if an effect does not exist, before anything is read.
    check_effects: Callable[[Sequence[type[Effect]]], object] = lambda extra: None
    # Raises if the command cannot use the model, before the logs are checked.
    check: Callable[[RobotModel], None] = lambda model: None
    # Writes the files, and returns those that no option names.
    write: Callable[[R, Mapping[Path, Content]], Sequence[Path]] = _write
    code: Callable[[R], int] = lambda result: 0  # exit code, 0 for success
    promise: str = ""  # printed at the start
    last: str = ""  # printed at the end, such as the next command


def run(command: Command[R], options: Any) -> R:
    """Run a command, and return its result."""
    logs = getattr(options, "logs", None) or []
    axis: AbstractContextManager[None] = nullcontext()
    if isinstance(options, AxisOptions):
        axis = written_axis(options, options.model, logs[0])  # type: ignore[attr-defined]
    with proposing(logs), axis:
        return _run(command, options)


def _run(command: Command[R], options: Any) -> R:
    outputs = _checked_outputs(command, options)
    if command.promise and not options.quiet:
        print(command.promise, file=sys.stderr, flush=True)
    name = (_models(options) or options.logs)[0].name
    with progress(f"Reading {name}", quiet=options.quiet) as update:
        given = _read(command, options, outputs, update)
        given, column_numbers, messages = _with_columns(options, given, update)
        update(command.working)
        result = command.work(given)
        update("Writing")
        fitted, view = getattr(result, "model", given.model), view_of(result)
        header = {"version": version(), "command": command.name}
        numbers = to_json({**header, **view.numbers(result), **column_numbers})
        page = view.page(result, _about(command, options, fitted, given.extra))
        mistakes = Section("Check first: the columns of the logs", items=tuple(messages))
        unread = Section("Check first: logs that are left out", items=given.unread)
        page = replace(page, first=(unread, mistakes, *page.first))
        makers: dict[str, Callable[[Path], Content | None]] = {
            "json": lambda path: numbers,
            "report": lambda path: _html(page, fitted),
            "save": lambda path: saved_text(fitted, path),
            "series": lambda path: series_content(samples(result), path),
        }
        contents, saved = dict[Path, Content](), dict[Path, str]()
        for option, path in files_of(outputs, options).items():
            is_specific = option in command.outputs
            content = outputs[option].make(result, path) if is_specific else makers[option](path)
            if content is not None:
                contents[path], saved[path] = content, outputs[option].words
        others = command.write(result, contents)
    with printing():
        if options.json == STDOUT:
            print_whole(numbers)
        console = make_console(stderr=options.json == STDOUT)
        show_page(console, page, details=getattr(options, "details", True))
        show_saved(console, saved, others)
        if command.last:
            console.print()
            console.print(command.last, soft_wrap=True)
    if code := INTERRUPTED if getattr(result, "is_interrupted", False) else command.code(result):
        raise typer.Exit(code)
    return result


def _html(page: Page, model: RobotModel) -> str:
    from geodrake.report.html import render  # imports jinja2 and matplotlib, which are slow
    from geodrake.report.pictures import error_pictures

    return render(replace(page, pictures=error_pictures(model, page.compared)))


def _about(
    command: Command[R], options: Any, model: RobotModel, extra: Sequence[type[Effect]]
) -> About:
    """Return the names of a page's inputs, and links to other pages of the command."""
    save, models = getattr(options, "save", None), _models(options)
    folder = (getattr(options, "report", None) or Path()).resolve().parent
    links = {}
    for name, path in files_of(command.outputs, options).items():
        if path.suffix.lower() in PAGE:
            place = Path(os.path.relpath(path.resolve(), folder))
            links[command.outputs[name].words.capitalize()] = quote(place.as_posix())
    return About(
        models[0].name if models else "",
        tuple(file_names(path) for path in getattr(options, "logs", None) or ()),
        command.name,
        Units() if model is None else Units.of(model, extra),
        str(save or (models[0] if models else "MODEL")),
        links,
    )


def _models(options: Any) -> list[Path]:
    """Return the file of the model or of the fleet, if one is given."""
    named = (getattr(options, name, None) for name in ("model", "fleet"))
    return [path for path in named if path is not None]


def _log_files(options: Any) -> list[Path]:
    return [part for log in getattr(options, "logs", None) or () for part in parts_of(log)]


def inputs_of(options: Any) -> list[Path]:
    """Return the files that a command reads, which it must not overwrite."""
    mapping = getattr(options, "mapping", None)
    return [
        *_models(options),
        *_log_files(options),
        *getattr(options, "transmission_files", ()),
        *filter(None, [mapping]),
        *listed(getattr(options, "effects", None)),
    ]


USUAL = {
    "save": Output("model", (".yaml", ".yml")),
    "json": Output("numbers", (".json",)),
    "report": Output("report"),
    "series": Output("samples", (".csv", ".parquet")),
}
"""Option -> its file, in most commands."""


def _checked_outputs(command: Command[R], options: Any) -> dict[str, Output]:
    """Return the outputs, after checking that all can be written."""
    outputs = {**USUAL, **command.outputs}
    for log in () if command.takes_bad_logs else _log_files(options):
        check_log(log)
    check_outputs(outputs, options, command.inputs)
    if (path := getattr(options, "series", None)) is not None:
        check_series(path)
    return outputs


def _path(options: Any, name: str) -> Path | None:
    """Return the file named by an option, the last of its values."""
    value = getattr(options, name, None)
    return value[-1] if isinstance(value, tuple) else value


def files_of(outputs: Iterable[str], options: Any) -> dict[str, Path]:
    """Return option -> file of the requested outputs."""
    paths = {name: _path(options, name) for name in outputs}
    return {name: path for name, path in paths.items() if path not in (None, STDOUT)}


def check_outputs(outputs: Mapping[str, Output], options: Any, inputs: Iterable[Path]) -> None:
    """Raise if a file cannot be written or would overwrite an input or another output."""
    read = (*inputs_of(options), *inputs)
    taken = {_place(path): "is an input of this command" for path in read}
    for name, output in outputs.items():
        path, suffixes, option = _path(options, name), output.suffixes, name.replace("_", "-")
        if path is None or (path == STDOUT and name == "json"):
            continue
        reason, advice = "", "Choose another name."
        if path == STDOUT:
            reason, advice = "is standard output, which is for --json only", "Name a file."
        elif path.suffix.lower() not in suffixes:
            reason = f"does not end in {' or '.join(suffixes)}"
            advice = f"Name it {path.stem or option}{suffixes[0]}."
        elif _place(path) in taken:
            reason = taken[_place(path)]
        else:
            taken[_place(path)] = f"is already the target of --{option}"
            try:
                check_writable(path)
                if path.exists() and not os.access(path, os.W_OK):
                    reason, advice = "is read-only", "Choose another place."
            except OutputError as error:
                reason = f"cannot be written: {error.evidence['reason']}"
                advice = "Choose another place."
        if reason:
            raise OutputError(
                f"Cannot write --{option} {path}: it {reason}.", advice=advice, path=path
            )


def _place(path: Path) -> str:
    """Return the path with symbolic links resolved, even broken ones."""
    try:
        return os.path.realpath(path)
    except ValueError:  # a null character, rejected when the file is read
        return os.fspath(path)


def _read(
    command: Command[R], options: Any, outputs: Mapping[str, Output], update: Activity
) -> Input:
    """Return the inputs of a command."""
    extra = own_effects(listed(getattr(options, "effects", None)))
    command.check_effects(extra)
    settings = getattr(options, "settings", {})
    if getattr(options, "model", None) is None:
        return Input(cast("RobotModel", None), (), extra, settings, update)
    model = read_model(options.model, options, update, extra)
    check_outputs(outputs, options, [model.path])  # the base file of a saved model
    logs, unread = tuple[JointLog, ...](), list[str]()
    files = getattr(options, "logs", None)
    if command.reads_logs and files:
        update("Reading the logs")
        reading = reading_for(model, getattr(options, "reading", None))
        joints = model.known_joints
        paths, found, unread = readable(
            files, lambda path: read_log(path, joints=joints, partial=True, reading=reading)
        )
        model = model_of_logs(model, found, hold_resting=getattr(options, "hold_resting", False))
        model = replace(model, notes=(*unread, *model.notes)) if unread else model
        command.check(model)
        payloads = known_payloads(paths, getattr(options, "known_payload", None) or (), model)
        logs = tuple(
            replace(log, payloads=payloads[path]) if path in payloads else log
            for path, log in zip(paths, found, strict=True)
        )
    else:
        command.check(model)
    return Input(model, logs, extra, settings, update, tuple(unread))


def readable(
    paths: Sequence[Path], read: Callable[[Path], R]
) -> tuple[list[Path], list[R], list[str]]:
    """Return the logs that can be read, with their paths, and notes on the others."""
    found, logs, errors = list[Path](), list[R](), list[tuple[Path, LogError]]()
    for path in paths:
        try:
            logs.append(read(path))
            found.append(path)
        except LogError as error:
            errors.append((path, error))
    if not logs:
        raise errors[0][1]
    return found, logs, [f"{path.name} is not used: {error.problem}" for path, error in errors]


def _with_columns(
    options: Any, given: Input, update: Activity
) -> tuple[Input, dict[str, Any], list[str]]:
    """Return the input with corrected columns, and findings on columns for JSON and for users."""
    if not isinstance(options, Options):
        return given, {}, []
    update("Checking the columns")
    settings = {key: given.settings[key] for key in ("bandwidth", "blocks")}
    columns = found_columns(given.model, given.logs, settings)
    unchecked = unchecked_words(given.model, given.logs)
    numbers = {
        "columns": [record("ColumnFinding", finding) for finding in columns],
        "columns_are_checked": not unchecked,
    }
    messages = [*map(str, columns)]
    if any(finding.is_correctable for finding in columns):
        messages.append(_CORRECTED if options.correct_columns else _UNCORRECTED)
        if options.correct_columns:
            logs = tuple(corrected(log, columns) for log in given.logs)
            model = with_motor_limits(given.model, given.logs, columns)
            if options.hold_resting:  # only reliable with positions in rad
                model = holding_resting(model, logs)
            given = replace(given, model=model, logs=logs)
    elif columns:
        messages.append(f"{_AS_LOGGED}.")
    return given, numbers, [*messages, *unchecked]


def own_effects(paths: Iterable[Path]) -> tuple[type[Effect], ...]:
    """Return the effects of all files; names must be unique."""
    effects: dict[str, type[Effect]] = {}
    for path in paths:
        for effect in load_effect_file(path):
            if effect.name in effects:
                raise ArgumentError(
                    f"Two --effects files define {effect.name!r}; the second is {path}.",
                    advice="Rename or remove one of them.",
                )
            effects[effect.name] = effect
    return tuple(effects.values())


def make_console(*, stderr: bool = False) -> Console:
    """Return a console that prints text literally, without markup."""
    file = sys.stderr if stderr else results()
    console = ResultsConsole(file=file, markup=False, emoji=False, highlight=False)
    if not console.is_terminal:
        console.width = _PIPE_WIDTH
    return console


def found_columns(
    model: RobotModel, logs: Sequence[JointLog], settings: Mapping[str, Any]
) -> tuple[ColumnFinding, ...]:
    """Return mistakes in columns; none for logs that the command itself rejects."""
    if unchecked_words(model, logs):
        return ()
    try:
        return check_columns(model, logs, **settings)
    except GeodrakeError:
        return ()


def unchecked_words(model: RobotModel, logs: Sequence[JointLog]) -> list[str]:
    """Return why the columns were not checked: a free base, or too many joints."""
    count = len(model.joints)
    if model.base_joints:
        return ["Columns were not checked: the robot has a floating base."]
    if any(has_base(log) for log in logs):
        return ["Columns were not checked: the base is logged as free, but the model is fixed."]
    if count <= MOST_JOINTS:
        return []
    return [
        f"Columns were not checked: that takes minutes for {count} joints (limit {MOST_JOINTS}). "
        "Fix some with --lock to check the others."
    ]


def known_payloads(
    files: Sequence[Path], given: Sequence[str], model: RobotModel
) -> dict[Path, tuple[KnownPayload, ...]]:
    """Return log -> its known payloads, from options of the form `LOG:BODY:MASS[:X,Y,Z]`.

    LOG is the path or name of a log, BODY a link of the robot, MASS in kg, and X,Y,Z the centre of
    mass in the link's frame, m.
    """
    carried: dict[Path, tuple[KnownPayload, ...]] = {}
    for text in given:
        names = (name for log in files for name in (str(log), log.name, log.stem))
        name = max((n for n in names if text.startswith(f"{n}:")), key=len, default=None)
        if name is None:
            raise ArgumentError(
                f"--known-payload {text!r} does not begin with a log.",
                advice=f"Logs are: {', '.join(map(str, files))}. {_PAYLOAD}",
            )
        exact = [log for log in files if str(log) == name]
        log, *others = exact or [log for log in files if name in (log.name, log.stem)]
        if others:
            raise ArgumentError(
                f"--known-payload {text!r} is ambiguous: several logs are named {name!r}.",
                advice=f"Give the full path: {' or '.join(map(str, (log, *others)))}.",
            )
        parts = _PAYLOAD_FORM.findall(text[len(name) + 1 :]) or [("", "none")]
        try:
            mass, *com = (float(part or 0) for part in parts[0][1:])
        except ValueError:
            message = f"--known-payload {text!r} cannot be parsed."
            raise ArgumentError(message, advice=_PAYLOAD) from None
        payload = KnownPayload(parts[0][0], mass, (com[0], com[1], com[2]))
        carried[log] = (*carried.get(log, ()), payload)
    for payloads in carried.values():
        carried_phi(model, payloads)  # raises for unknown bodies, before the work
    return carried
