"""The command `geodrake log`: what was understood of logs, without a model."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from geodrake.boundary.version import version
from geodrake.boundary.whole_files import Content, write_together
from geodrake.cli.columns import columns_list, found_columns
from geodrake.cli.model_options import read_model
from geodrake.cli.options import LogCommandOptions
from geodrake.cli.progress import progress
from geodrake.cli.reading_options import proposing
from geodrake.cli.session import check_logs
from geodrake.cli.surroundings import print_whole, printing
from geodrake.cli.tables import head, make_console, show_list, show_saved, show_table
from geodrake.cli.targets import STDOUT, Targets
from geodrake.diagnosis.columns import ColumnFinding, corrected_columns
from geodrake.errors import ArgumentError, GeodrakeError
from geodrake.logs.files import log_content, parts_of
from geodrake.logs.inspection import LogInspection, inspect_log, mapping_text
from geodrake.logs.motion import JointLog
from geodrake.model.logged_joints import model_of_logs, reading_for
from geodrake.model.robot_model import RobotModel
from geodrake.report.json_output import to_json
from geodrake.report.log_preview import (
    columns_table,
    inspection_dict,
    inspection_words,
    preview_figure,
)
from geodrake.report.style import png

_SUFFIXES = {
    "convert": (".csv", ".npz", ".txt"),
    "figure": (".png",),
    "write-mapping": (".yaml", ".yml"),
}


def run_log(options: LogCommandOptions) -> None:
    """Run the command.

    Raises:
        GeodrakeError: A log cannot be read, or a file not be written.
    """
    with proposing(options.logs):
        _run(options)


def _run(options: LogCommandOptions) -> None:
    files = [part for log in options.logs for part in parts_of(log)]
    more = {
        "convert": options.convert,
        "figure": options.figure,
        "write-mapping": options.write_mapping,
    }
    targets = Targets(json=options.json, more=more, suffixes=_SUFFIXES)
    asked = [name for name, path in more.items() if path is not None]
    if asked and len(options.logs) > 1:
        raise ArgumentError(
            f"--{asked[0]} is for one log; {len(options.logs)} are given.",
            advice="Give them one by one.",
        )
    check_logs(files)
    more_files = [*options.transmission_files, *filter(None, [options.mapping, options.model])]
    inputs = [*files, *more_files]
    targets.check(inputs)
    with progress(f"Reading {options.logs[0].name}", quiet=options.quiet) as update:
        model = None if options.model is None else read_model(options.model, options, update)
        joints = None if model is None else model.known_joints
        reading = options.reading if model is None else reading_for(model, options.reading)
        found = [
            inspect_log(log, joints=joints, partial=True, reading=reading) for log in options.logs
        ]
        numbers: dict[str, Any] = {"logs": [inspection_dict(each) for each in found]}
        columns, unchecked = _columns(model, [each.log for each in found]) if model else ((), "")
        if model is not None:
            notes = [*model.repairs, *filter(None, [unchecked])]
            numbers |= {"columns": columns_list(columns), "notes": notes}
        text = to_json({"version": version(), "command": "log", **numbers})
        written = _written(targets, options, found[0], columns, text)
    with printing():
        if options.json == STDOUT:
            print_whole(text)
        console = make_console(stderr=options.json == STDOUT)
        show_list(console, "Columns are not what they seem", [str(each) for each in columns])
        show_list(
            console, "Columns were not compared with the model", [unchecked] if unchecked else []
        )
        for path, each in zip(options.logs, found, strict=True):
            _show(console, path.name, each)
        words = {"convert": "log", "figure": "preview", "write-mapping": "mapping"}
        show_saved(console, written, words)
        if options.write_mapping and options.model:
            explain = ["geodrake", "explain", options.model, *options.logs]
            command = shlex.join(map(str, [*explain, "--mapping", options.write_mapping]))
            console.print()
            console.print(command, soft_wrap=True, highlight=False, markup=False)


def _columns(model: RobotModel, logs: Sequence[JointLog]) -> tuple[tuple[ColumnFinding, ...], str]:
    """Mistakes in columns; of logs that say nothing of the model none, and why."""
    try:
        return found_columns(model_of_logs(model, logs), logs, {}), ""
    except GeodrakeError as error:
        return (), error.problem


def _written(
    targets: Targets,
    options: LogCommandOptions,
    found: LogInspection,
    columns: Sequence[ColumnFinding],
    text: str,
) -> dict[str, Path]:
    """Option -> file, of what was asked for."""
    made: dict[Path, Content] = {}
    for name, path in targets.files.items():
        if name == "convert":
            made[path] = log_content(found.log, path)
        elif name == "write-mapping":
            corrected = corrected_columns(found.columns, columns)
            made[path] = mapping_text(
                options.logs[0], found, corrected, options.reading.gain_deviations
            )
        else:
            made[path] = text if name == "json" else png(preview_figure(found))
    write_together(made)
    return targets.files


def _show(console: Console, name: str, found: LogInspection) -> None:
    head(console, name)
    show_table(console, columns_table(found))
    show_list(console, "Rows", inspection_words(found))
    show_list(console, "Notes", found.notes)
