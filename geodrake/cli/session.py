"""One run of a command: read, refuse what cannot end well, work, write, print."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from rich.console import Console

from geodrake.boundary.input_files import regular_file
from geodrake.boundary.whole_files import Content
from geodrake.cli.known_payloads import with_facts, with_known_payloads
from geodrake.cli.model_options import read_model
from geodrake.cli.options import LogOptions
from geodrake.cli.progress import Update, progress
from geodrake.cli.surroundings import print_whole, printing
from geodrake.cli.tables import make_console, show_saved
from geodrake.cli.targets import STDOUT, Targets
from geodrake.cli.version import version
from geodrake.effects import load_effect_file
from geodrake.effects.base import Effect
from geodrake.errors import ArgumentError, LogError
from geodrake.logs.files import read_log
from geodrake.logs.motion import JointLog
from geodrake.model.logged_joints import model_of_logs
from geodrake.model.robot_model import RobotModel
from geodrake.report.json_output import to_json
from geodrake.report.numbers import Units

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
        progress: Called with what is going on, in words.
    """

    model: RobotModel
    logs: tuple[JointLog, ...]
    extra: tuple[type[Effect], ...]
    settings: Mapping[str, Any]
    progress: Update


@dataclass(frozen=True)
class Command(Generic[R]):
    """The parts in which commands differ.

    Attributes:
        name: What the command is called.
        working: What it does, for the progress bar.
        work: Does it.
        numbers: The result as a dictionary.
        page: Name of the function of `geodrake.report` that makes the result HTML.
        show: Prints the result.
        paged: The part of the result that the page shows.
        more: Options of files that only this command writes, with their paths.
        makers: What makes the contents of those.
        check: Refuses a model before the long work.
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
    check: Callable[[RobotModel], None] = lambda model: None


def run(command: Command[R], options: LogOptions) -> None:
    """Run a command.

    Args:
        command: The command.
        options: Options that the user gave.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """
    targets = Targets(options.model_target, options.json, options.report, command.more)
    read = [options.model, *options.logs, *(options.effects or ())]
    _check_logs(options.logs)
    targets.check(read)
    # matplotlib is slow to import and only the page needs it
    pages = importlib.import_module("geodrake.report") if options.report else None
    with progress(f"Reading {options.model.name}") as update:
        extra = own_effects(options.effects or ())
        model = read_model(options.model, options, extra)
        targets.check([*read, model.path])  # a saved model reads another one
        update("Reading the logs")
        read_logs = [read_log(log, joints=model.known_joints, partial=True) for log in options.logs]
        model = model_of_logs(model, read_logs)
        command.check(model)
        update(command.working)
        logs = with_known_payloads(options.logs, read_logs, options.known_payload or (), model)
        logs = with_facts(logs, options.log_facts)
        result = command.work(Input(model, logs, extra, options.settings, update))
        fitted = getattr(result, "model", model)
        update("Writing")
        numbers = to_json(
            {"version": version(), "command": command.name, **command.numbers(result)}
        )
        names = [path.name for path in options.logs]
        units = {}
        if pages is not None and command.name not in _WITH_UNITS:
            units["units"] = Units.of(model, extra)

        def page() -> str:
            render = getattr(pages, command.page)
            title, shown = f"{options.model.name}: {command.name}", command.paged(result)
            return str(
                render(shown, title=title, model_name=options.model.name, log_names=names, **units)
            )

        makers: dict[str, Maker] = {"json": lambda: numbers, "report": page}
        written = targets.write(fitted, {**makers, **command.makers(result)})
    with printing():
        if options.json == STDOUT:
            print_whole(numbers)
        console = make_console(stderr=options.json == STDOUT)
        console.print(f"{options.model.name} against {', '.join(names)}", soft_wrap=True)
        command.show(console, result, Units.of(fitted, extra))
        show_saved(console, written)


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


def _check_logs(logs: Sequence[Path]) -> None:
    """Refuse what is no file, and a file that is there twice, by whatever path or link."""
    seen: set[tuple[int, int]] = set()
    for log in logs:
        status = regular_file(log, "log", LogError).stat()
        if (status.st_dev, status.st_ino) in seen:
            raise ArgumentError(
                f"Log {log} is given twice, so it would be validated against itself.",
                advice="Name each log once.",
            )
        seen.add((status.st_dev, status.st_ino))
