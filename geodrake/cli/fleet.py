"""The command `geodrake fleet`: which robots changed, at which joint, by which effect, when."""

from __future__ import annotations

import time
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

import typer

from geodrake.boundary.arguments import number
from geodrake.boundary.version import version
from geodrake.boundary.whole_files import Content, write_together
from geodrake.cli.command import STDOUT, USUAL, Command, Input, check_outputs, run
from geodrake.cli.input_options import report_repairs
from geodrake.cli.options import FleetOptions
from geodrake.cli.progress import progress
from geodrake.cli.streams import printing, results, warn
from geodrake.errors import ArgumentError, FleetError
from geodrake.fleet.fleet_file import Fleet, read_fleet
from geodrake.fleet.fleet_logs import FleetDigests
from geodrake.fleet.fleet_result import FleetResult, keep_reported, new_findings
from geodrake.fleet.fleet_run import FleetWork, look_at_fleet, run_fleet
from geodrake.report.fleets import finding_line, parquet_contents
from geodrake.report.html import render
from geodrake.report.json_output import to_json
from geodrake.report.page import About
from geodrake.report.views import numbers_of, page_of

NEW_FINDING = 3  # exit code of `--once` if there is a new finding

_RESULT, _SOME_FILE = "fleet.json", "a model file"
_SHORTEST, _LONGEST = 0.1, 1e6  # polling interval, s


def run_fleet_command(options: FleetOptions) -> None:
    """Run `geodrake fleet`: evaluate a fleet once, or repeatedly."""
    fleet = read_fleet(options.fleet)
    work = FleetWork(options.workers, options.scheduler, options.false_alarms)
    number(options.every, "--every", lower=_SHORTEST, upper=_LONGEST)
    if options.watch and options.once:
        raise ArgumentError("--watch and --once exclude each other.", advice="Omit one of them.")
    if options.watch or options.once:
        if options.json == STDOUT:
            raise ArgumentError(
                "--json - and findings would both be written to standard output.",
                advice="Name a file.",
            )
        check_outputs(USUAL, options, fleet.files)
        _watch(fleet, work, options)
        return

    def looked(given: Input) -> FleetResult:
        result, digests = run_fleet(
            fleet, work, progress=given.progress, report=given.progress.history
        )
        report_repairs(_SOME_FILE, digests.repairs, given.progress)
        return result

    def write(found: FleetResult, contents: Mapping[Path, Content]) -> tuple[Path, ...]:
        write_together({**_own_contents(fleet, found), **contents})
        return ()

    command = Command("fleet", "Evaluating the fleet", looked, inputs=fleet.files, write=write)
    run(command, options)


def _numbers(result: FleetResult) -> str:
    return to_json({"version": version(), "command": "fleet", **numbers_of(result)})


def _own_contents(fleet: Fleet, result: FleetResult) -> dict[Path, Content]:
    """Return the files in the fleet's own folder."""
    tables = parquet_contents(result, fleet.folder) if find_spec("pyarrow") else {}
    return {fleet.folder / _RESULT: _numbers(result), **tables}


def _watch(fleet: Fleet, work: FleetWork, options: FleetOptions) -> None:
    """Process new logs once, or repeatedly until the command is stopped.

    An error in the first pass is treated as a mistake in the fleet file. Later errors, such as
    folders or schedulers that do not respond, may be temporary.
    """
    seen: FleetDigests | None = None
    while True:
        try:
            seen, is_new = _look(fleet, work, options, seen)
            if options.once:
                if is_new:
                    raise typer.Exit(NEW_FINDING)
                return
        except FleetError as error:
            if seen is None:
                raise
            warn(f"{error} Retrying in {options.every:g} s.")
        time.sleep(options.every)


def _look(
    fleet: Fleet, work: FleetWork, options: FleetOptions, seen: FleetDigests | None
) -> tuple[FleetDigests, bool]:
    """Process new logs and print new findings; update statistics only if something changed."""
    with progress(f"Reading {fleet.path.name}", quiet=options.quiet) as update:
        result, digests = look_at_fleet(fleet, work, seen, progress=update, report=update.history)
        if result is None:
            return digests, False
        if seen is None:
            report_repairs(_SOME_FILE, digests.repairs, update)
    contents = _own_contents(fleet, result)
    if options.json is not None:
        contents[options.json] = _numbers(result)
    if options.report is not None:
        about = About(fleet.path.name, (), "fleet")
        contents[options.report] = render(page_of(result, about))
    write_together(contents)
    new = new_findings(fleet.folder, result.findings)
    with printing():
        for finding in new:
            print(finding_line(finding), file=results(), flush=True)
    if new:
        keep_reported(fleet.folder, new)
    return digests, bool(new)
