"""One run of a command: read, refuse what cannot end well, work, write, print."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar
from urllib.parse import quote

import typer
from rich.console import Console

from geodrake.boundary.version import version
from geodrake.boundary.whole_files import Content
from geodrake.cli.axis_model import written_axis
from geodrake.cli.columns import (
    column_words,
    columns_list,
    found_columns,
    show_columns,
    unchecked_words,
    with_first_notes,
)
from geodrake.cli.guard import INTERRUPTED
from geodrake.cli.known_payloads import with_facts, with_known_payloads
from geodrake.cli.model_options import read_model
from geodrake.cli.options import LogOptions, Options
from geodrake.cli.progress import Activity, progress
from geodrake.cli.reading_options import proposing
from geodrake.cli.surroundings import print_whole, printing
from geodrake.cli.tables import SAVED, make_console, show_saved
from geodrake.cli.targets import STDOUT, Targets
from geodrake.diagnosis.columns import ColumnFinding, corrected, with_motor_limits
from geodrake.effects import load_effect_file
from geodrake.effects.base import Effect
from geodrake.errors import ArgumentError, LogError
from geodrake.logs.files import Reading, check_log, parts_of, read_log
from geodrake.logs.motion import JointLog
from geodrake.model.logged_joints import holding_resting, model_of_logs, reading_for
from geodrake.model.robot_model import RobotModel
from geodrake.report.json_output import to_json
from geodrake.report.numbers import Units
from geodrake.report.series_table import check_series, series_content

R = TypeVar("R")

_WITH_UNITS = ("add", "explain")  # whose pages take units from the model in the result
Maker = Callable[[], Content]


@dataclass(frozen=True)
class Input:
    """What a command works on.

    Attributes:
        model: The model as it stands.
        logs: What was read of the logs.
        extra: Effects of the user's own.
        settings: How logs are prepared: bandwidth and, with folds, blocks, as keyword arguments.
        progress: Called with what is going on, in words and as a share.
    """

    model: RobotModel
    logs: tuple[JointLog, ...]
    extra: tuple[type[Effect], ...]
    settings: Mapping[str, Any]
    progress: Activity


@dataclass(frozen=True)
class Command(Generic[R]):
    """The parts in which commands differ.

    Attributes:
        name: What the command is called.
        working: What it does, for the progress bar.
        numbers: The result as a dictionary.
        page: Name of the function of `geodrake.report` that makes the result HTML.
        paged: The part of the result that the page shows.
        more: Options of files that only this command writes, with their paths.
        makers: What makes the contents of those.
        saved: Option -> what its file is, in words.
        check: Refuses a model before the long work.
        sampled: The part of the result that has samples.
        promise: How long it will take, said before it begins.
    """

    name: str
    working: str
    work: Callable[[Input], R]
    numbers: Callable[[R], Mapping[str, Any]]
    page: str
    show: Callable[[Console, R, Units], None]
    paged: Callable[[R], Any] = lambda result: result
    more: Mapping[str, Path | None] = field(default_factory=dict)
    makers: Callable[[R], Mapping[str, Maker]] = lambda result: {}
    saved: Mapping[str, str] = field(default_factory=dict)
    check: Callable[[RobotModel], None] = lambda model: None
    sampled: Callable[[R], Any] = lambda result: result
    promise: str = ""


def run(command: Command[R], options: LogOptions) -> None:
    """Run a command.

    Args:
        command: The command.
        options: Options that the user gave.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """
    with proposing(options.logs), written_axis(options, options.model, options.logs[0]):
        _run(command, options)


def _run(command: Command[R], options: LogOptions) -> None:
    targets, inputs = _checked_targets(command, options)
    if command.promise and not options.quiet:
        print(command.promise, file=sys.stderr, flush=True)
    # matplotlib is slow to import and only the page needs it
    pages = importlib.import_module("geodrake.report") if options.report else None
    with progress(f"Reading {options.model.name}", quiet=options.quiet) as update:
        given = _read(command, options, targets, inputs, update)
        given, columns, corrects = _with_columns(options, given, update)
        update(command.working)
        result = command.work(given)
        update("Writing")
        unchecked = [] if columns is None else unchecked_words(given.model)
        told: dict[str, Any] = {}
        if columns is not None:
            told = {"columns": columns_list(columns), "columns_are_checked": not unchecked}
        numbers = to_json(
            {"version": version(), "command": command.name, **command.numbers(result), **told}
        )
        about_columns = [*column_words(columns or (), corrected=corrects), *unchecked]
        noted = with_first_notes(result, about_columns)
        makers = _makers(command, options, given, noted, pages)
        fitted = getattr(result, "model", given.model)
        written = targets.write(fitted, {"json": lambda: numbers, **makers})
    with printing():
        if options.json == STDOUT:
            print_whole(numbers)
        console = make_console(stderr=options.json == STDOUT)
        names = ", ".join(path.name for path in options.logs)
        console.print(f"{options.model.name} against {names}", soft_wrap=True)
        show_columns(console, columns or (), corrected=corrects)
        for words in unchecked:
            console.print(words, soft_wrap=True)
        command.show(console, result, Units.of(fitted, given.extra))
        show_saved(console, written, command.saved)
    if getattr(result, "is_interrupted", False):
        raise typer.Exit(INTERRUPTED)


def _checked_targets(command: Command[R], options: LogOptions) -> tuple[Targets, list[Path]]:
    """Return where the results go, and the files that are read, none of which is overwritten."""
    more = {**command.more, "series": options.series_target}
    targets = Targets(options.model_target, options.json, options.report, more)
    files = [part for log in options.logs for part in parts_of(log)]
    more_files = [*options.transmission_files, *filter(None, [options.mapping])]
    inputs = [options.model, *files, *more_files, *(options.effects or ())]
    check_logs(files)
    targets.check(inputs)
    if options.series_target is not None:
        check_series(options.series_target)
    return targets, inputs


def _read(
    command: Command[R],
    options: LogOptions,
    targets: Targets,
    inputs: Sequence[Path],
    update: Activity,
) -> Input:
    """Return the model, the logs and what is known of them."""
    extra = own_effects(options.effects or ())
    model = read_model(options.model, options, update, extra)
    targets.check([*inputs, model.path])  # a saved model reads another one
    update("Reading the logs")
    known, reading = model.known_joints, reading_for(model, options.reading)
    paths, logs, unread = _readable(options.logs, known, reading)
    model = model_of_logs(model, logs, hold_resting=_holds_resting(options))
    model = replace(model, notes=(*unread, *model.notes)) if unread else model
    command.check(model)
    carrying = with_known_payloads(paths, logs, options.known_payload or (), model)
    known_logs = with_facts(carrying, options.log_facts, reading)
    return Input(model, known_logs, extra, options.settings, update)


def _readable(
    paths: Sequence[Path], joints: Sequence[str], reading: Reading
) -> tuple[list[Path], list[JointLog], list[str]]:
    """Return the logs that can be read, with their paths, and why others cannot.

    Raises:
        LogError: None can be read.
    """
    kept, logs, errors = list[Path](), list[JointLog](), list[tuple[Path, LogError]]()
    for path in paths:
        try:
            logs.append(read_log(path, joints=joints, partial=True, reading=reading))
            kept.append(path)
        except LogError as error:
            errors.append((path, error))
    if not logs:
        raise errors[0][1]
    return kept, logs, [f"{path.name} is left out: {error.problem}" for path, error in errors]


def _holds_resting(options: LogOptions) -> bool:
    """Return whether joints that hardly move are held: only where efforts are what counts."""
    return bool(options.settings.get("hold_resting", False))


def _with_columns(
    options: LogOptions, given: Input, update: Activity
) -> tuple[Input, tuple[ColumnFinding, ...] | None, bool]:
    """What to work on, mistakes in columns (None if nobody looked), if they are corrected."""
    if not isinstance(options, Options):
        return given, None, False
    update("Checking the columns")
    asked = {key: given.settings[key] for key in ("bandwidth", "blocks")}
    columns = found_columns(given.model, given.logs, asked)
    corrects = options.correct_columns and any(finding.is_correctable for finding in columns)
    if corrects:
        logs = tuple(corrected(log, columns) for log in given.logs)
        model = with_motor_limits(given.model, given.logs, columns)
        if _holds_resting(options):  # as is known of columns in rad alone
            model = holding_resting(model, logs)
        given = replace(given, model=model, logs=logs)
    return given, columns, corrects


def _makers(
    command: Command[R], options: LogOptions, given: Input, result: R, pages: ModuleType | None
) -> dict[str, Maker]:
    """What makes the contents of the files: the page, the samples, and what the command adds."""
    units = {}
    if pages is not None and command.name not in _WITH_UNITS:
        units["units"] = Units.of(given.model, given.extra)

    def page() -> str:
        return str(
            getattr(pages, command.page)(
                command.paged(result),
                title=f"{options.model.name}: {command.name}",
                model_name=options.model.name,
                log_names=[path.name for path in options.logs],
                links=_links(command, options.report),
                **units,
            )
        )

    makers: dict[str, Maker] = {"report": page, **command.makers(result)}
    if options.series_target is not None:
        target = options.series_target
        makers["series"] = lambda: _samples(command.sampled(result), target)
    return makers


def _links(command: Command[R], report: Path | None) -> dict[str, str]:
    """From a report to the other pages that the command writes: words -> relative address."""
    folder, links = (report or Path()).resolve().parent, {}
    for option, path in command.more.items():
        if path is not None and path.suffix.lower() in (".html", ".htm"):
            words = {**SAVED, **command.saved}[option].capitalize()
            links[words] = quote(Path(os.path.relpath(path.resolve(), folder)).as_posix())
    return links


def _samples(sampled: Any, target: Path) -> Content:
    from geodrake.report.views import samples  # which needs all kinds of results

    return series_content(samples(sampled), target)


def own_effects(paths: Sequence[Path]) -> tuple[type[Effect], ...]:
    """Effects of all files, each name once."""
    found: dict[str, type[Effect]] = {}
    for path in paths:
        for effect in load_effect_file(path):
            if effect.name in found:
                raise ArgumentError(
                    f"{path} defines the effect {effect.name!r}, as another --effects file does.",
                    advice="Give one of them another name, or leave it out.",
                )
            found[effect.name] = effect
    return tuple(found.values())


def check_logs(logs: Sequence[Path]) -> None:
    """Refuse what is no file, and a file that is there twice, by whatever path or link."""
    seen: set[tuple[int, int]] = set()
    for log in logs:
        status = check_log(log).stat()
        if (status.st_dev, status.st_ino) in seen:
            raise ArgumentError(
                f"Log {log} is given twice, so it would be validated against itself.",
                advice="Name each log once.",
            )
        seen.add((status.st_dev, status.st_ino))
