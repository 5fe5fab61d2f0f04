"""The commands `log` and `digest`: how logs are read, and their reduction to small files."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from geodrake.cli.command import (
    Command,
    Input,
    Output,
    files_of,
    found_columns,
    known_payloads,
    readable,
    run,
)
from geodrake.cli.options import DigestOptions, LogCommandOptions
from geodrake.diagnosis.columns import ColumnFinding
from geodrake.diagnosis.columns.corrections import corrected_columns
from geodrake.errors import ArgumentError, GeodrakeError
from geodrake.fleet.digest_folder import FAILED, DigestRun, digest_logs
from geodrake.fleet.digest_log import Wanted
from geodrake.fleet.log_places import date_seconds
from geodrake.logs.files import file_names, log_content
from geodrake.logs.inspection import inspect_log, mapping_text
from geodrake.logs.motion import JointLog
from geodrake.logs.units_of_values import check_ticks, position_limit_hint, position_unit_hint
from geodrake.model.logged_joints import log_of_model, model_of_logs, reading_for
from geodrake.model.robot_model import RobotModel
from geodrake.report.exports import InspectedLogs, log_chart

SOME_FAILED = 1  # exit code if some logs could not be digested


def run_log(options: LogCommandOptions) -> None:
    """Run `geodrake log`: show how logs are read."""
    outputs = {
        "convert": Output(
            "log",
            (".csv", ".npz", ".txt"),
            lambda found, path: log_content(found.logs[0][1].log, path),
        ),
        "figure": Output("preview", (".png",), _preview),
        "write_mapping": Output(
            "mapping", (".yaml", ".yml"), lambda found, path: _mapping(found, options)
        ),
    }
    requested = [name.replace("_", "-") for name in files_of(outputs, options)]
    if requested and len(options.logs) > 1:
        raise ArgumentError(
            f"--{requested[0]} takes one log; {len(options.logs)} are given.",
            advice="Run the command once for each log.",
        )
    last = ""
    if options.write_mapping and options.model:
        words = ["geodrake", "explain", options.model, *options.logs]
        words += ["--floating"] * options.floating
        last = shlex.join(map(str, [*words, "--mapping", options.write_mapping]))
    command = Command(
        "log",
        "Reading the logs",
        lambda given: _inspected(options, given),
        reads_logs=False,
        outputs=outputs,
        last=last,
    )
    run(command, options)


def _inspected(options: LogCommandOptions, given: Input) -> InspectedLogs:
    model: RobotModel | None = given.model
    joints = None
    if model is not None:  # columns do not have the names of the joints of a free base
        joints = tuple(j for j in model.known_joints if j not in model.base_joints)
    reading = options.reading if model is None else reading_for(model, options.reading)
    paths, found, unread = readable(
        options.logs, lambda log: inspect_log(log, joints=joints, partial=True, reading=reading)
    )
    names, logs = [*map(file_names, paths)], [entry.log for entry in found]
    if model is None:
        return InspectedLogs([*zip(names, found, strict=True)], unread=unread)
    columns, unchecked, beyond = tuple[ColumnFinding, ...](), "", list[str]()
    try:
        matched = model_of_logs(model, logs)
        columns = found_columns(matched, logs, {})
        if not any(position_unit_hint(entry.log) in entry.first for entry in found):
            beyond = _beyond_limits(matched, logs)
    except GeodrakeError as error:
        unchecked = error.problem
    if any(f.kind in ("position_unit", "position_alone_unit") for f in columns):
        # This finding supersedes other hints on the unit of positions.
        beyond = []
        for k, entry in enumerate(found):
            hint = position_unit_hint(entry.log)
            first, notes = (tuple(w for w in ws if w != hint) for ws in (entry.first, entry.notes))
            found[k] = replace(entry, first=first, notes=notes)
    named = [*zip(names, found, strict=True)]
    return InspectedLogs(named, columns, unchecked, model.repairs, beyond, unread)


def _beyond_limits(model: RobotModel, logs: Sequence[JointLog]) -> list[str]:
    """Return hints on positions beyond the model's limits; none for positions in ticks."""
    matched = [log_of_model(log, model) for log in logs]
    try:
        for log in matched:
            check_ticks(log)
    except GeodrakeError:
        return []
    if len(model.position_limits[0]) != len(model.joints):
        return []
    hints = [position_limit_hint(log, *model.position_limits) for log in matched]
    return [hint for hint in hints if hint]


def _mapping(found: InspectedLogs, options: LogCommandOptions) -> str:
    """Return the corrected mapping of the log's columns."""
    (_, log), *_ = found.logs
    columns = corrected_columns(log.columns, found.columns)
    return mapping_text(options.logs[0], log, columns, options.reading.gain_deviations)


def _preview(found: InspectedLogs, path: Path) -> bytes:
    del path
    from geodrake.report.figures import chart_figure
    from geodrake.report.style import figure_bytes

    (_, log), *_ = found.logs
    return figure_bytes(chart_figure(log_chart(log), most=len(log.log.joints)))


def run_digest(options: DigestOptions) -> None:
    """Run `geodrake digest`; the exit code is 1 if any log fails."""
    date = None if options.date is None else date_seconds(options.date)

    def digested(given: Input) -> DigestRun:
        return digest_logs(
            given.model,
            options.logs,
            options.to,
            wanted=Wanted(options.bandwidth, options.blocks, options.reading, given.extra),
            date=date,
            payloads=known_payloads(options.logs, options.known_payload or (), given.model),
            progress=given.progress,
        )

    command = Command(
        "digest",
        "Digesting",
        digested,
        reads_logs=False,
        takes_bad_logs=True,
        code=lambda run: SOME_FAILED if run.count(FAILED) else 0,
    )
    run(command, options)
