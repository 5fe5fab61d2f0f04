"""The commands `log` and `digest`: what is understood of logs, and small files of what they do."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence

from geodrake.cli.option_values import known_payloads
from geodrake.cli.options import DigestOptions, LogCommandOptions
from geodrake.cli.session import Command, Input, Maker, found_columns, run
from geodrake.diagnosis.columns import ColumnFinding, corrected_columns
from geodrake.errors import ArgumentError, GeodrakeError
from geodrake.fleet.digest_folder import FAILED, DigestRun, digest_logs
from geodrake.fleet.digest_log import Wanted
from geodrake.fleet.log_places import date_seconds
from geodrake.logs.files import file_names, log_content
from geodrake.logs.inspection import inspect_log, mapping_text
from geodrake.logs.motion import JointLog
from geodrake.logs.unit_hints import position_limit_hint
from geodrake.model.logged_joints import log_of_model, model_of_logs, reading_for
from geodrake.model.robot_model import RobotModel
from geodrake.report.exports import InspectedLogs, log_chart

SOME_FAILED = 1
"""Exit code where logs have no digest; those of the others are there."""

_SUFFIXES = {
    "convert": (".csv", ".npz", ".txt"),
    "figure": (".png",),
    "write-mapping": (".yaml", ".yml"),
}


def run_log(options: LogCommandOptions) -> None:
    """Say what is understood of logs."""
    more = {name: getattr(options, name.replace("-", "_")) for name in _SUFFIXES}
    asked = [name for name, path in more.items() if path is not None]
    if asked and len(options.logs) > 1:
        raise ArgumentError(
            f"--{asked[0]} is for one log; {len(options.logs)} are given.",
            advice="Give them one by one.",
        )
    command = Command(
        "log",
        "Looking at the logs",
        lambda given: _inspected(options, given),
        reads_logs=False,
        more=more,
        suffixes=_SUFFIXES,
        makers=lambda found: _makers(found, options),
        saved={"convert": "log", "figure": "preview", "write-mapping": "mapping"},
        last=_explain_command(options),
    )
    run(command, options)


def _explain_command(options: LogCommandOptions) -> str:
    """Return the command that uses the mapping that is written; "" without one."""
    if not (options.write_mapping and options.model):
        return ""
    words = ["geodrake", "explain", options.model, *options.logs]
    return shlex.join(map(str, [*words, "--mapping", options.write_mapping]))


def _inspected(options: LogCommandOptions, given: Input) -> InspectedLogs:
    model: RobotModel | None = given.model
    joints = None
    if model is not None:  # a free base has no columns by the names of its joints
        joints = tuple(j for j in model.known_joints if j not in model.base_joints)
    reading = options.reading if model is None else reading_for(model, options.reading)
    found = [inspect_log(log, joints=joints, partial=True, reading=reading) for log in options.logs]
    named = tuple(zip(map(file_names, options.logs), found, strict=True))
    if model is None:
        return InspectedLogs(named)
    columns, unchecked = _columns(model, [each.log for each in found])
    beyond = _beyond_limits(model, [each.log for each in found])
    return InspectedLogs(named, columns, unchecked, model.repairs, beyond)


def _beyond_limits(model: RobotModel, logs: Sequence[JointLog]) -> list[str]:
    """Return what is said of positions beyond the model's limits; nothing of other robots' logs."""
    try:
        own = model_of_logs(model, logs)
        matched = [log_of_model(log, own) for log in logs]
    except GeodrakeError:
        return []  # `_columns` says why
    if len(own.position_limits[0]) != len(own.joints):
        return []
    hints = [position_limit_hint(log, *own.position_limits) for log in matched]
    return [hint for hint in hints if hint]


def _columns(model: RobotModel, logs: Sequence[JointLog]) -> tuple[tuple[ColumnFinding, ...], str]:
    """Return mistakes in columns; for logs that do not fit the model, none and the reason."""
    try:
        return found_columns(model_of_logs(model, logs), logs, {}), ""
    except GeodrakeError as error:
        return (), error.problem


def _makers(found: InspectedLogs, options: LogCommandOptions) -> Mapping[str, Maker]:
    """Return the writers of the files: the log, its preview, and a mapping that reads it so."""
    (_, first), *_ = found.logs

    def mapping() -> str:
        columns = corrected_columns(first.columns, found.columns)
        return mapping_text(options.logs[0], first, columns, options.reading.gain_deviations)

    def preview() -> bytes:
        from geodrake.report.figures import chart_figure
        from geodrake.report.style import png

        return png(chart_figure(log_chart(first), most=len(first.log.joints)))

    return {
        "convert": lambda: log_content(first.log, options.convert or "log.csv"),
        "figure": preview,
        "write-mapping": mapping,
    }


def run_digest(options: DigestOptions) -> None:
    """Digest logs; the exit code is 1 if a log has no digest, which the others then have."""
    date = None if options.date is None else date_seconds(options.date)

    def digested(given: Input) -> DigestRun:
        return digest_logs(
            given.model,
            options.logs,
            options.to,
            wanted=Wanted(options.bandwidth, options.blocks, options.reading, given.extra),
            date=date,
            payloads=known_payloads(options.logs, options.known_payload or (), given.model),
            told=given.progress,
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
