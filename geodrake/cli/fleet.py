"""The command `geodrake fleet`: which robot changed, at which joint, by what, since when."""

from __future__ import annotations

import time
from importlib.util import find_spec
from pathlib import Path

import typer

from geodrake.boundary.arguments import number
from geodrake.boundary.version import version
from geodrake.boundary.whole_files import Content, write_together
from geodrake.cli.fleet_options import FleetOptions
from geodrake.cli.model_options import repairs_in_short
from geodrake.cli.progress import progress
from geodrake.cli.surroundings import print_whole, printing, results, warn
from geodrake.cli.tables import head, make_console, say, show_list, show_saved, show_table
from geodrake.cli.targets import STDOUT, Targets
from geodrake.errors import ArgumentError, FleetError
from geodrake.fleet.fleet_file import Fleet, read_fleet
from geodrake.fleet.fleet_logs import FleetDigests
from geodrake.fleet.fleet_result import FleetFinding, FleetResult, keep_told, new_findings
from geodrake.fleet.fleet_run import FleetWork, fleet_result, run_fleet, take_in_logs
from geodrake.report.fleet_json import finding_line, fleet_dict, parquet_contents
from geodrake.report.fleet_tables import (
    MOST_ROBOTS,
    findings_table,
    fleet_verdict,
    robots_table,
    unused_list,
)
from geodrake.report.json_output import to_json

NEW_FINDING = 3
"""Exit code of `--once` where there is a finding that was not told before."""

_RESULT = "fleet.json"
_MOST_UNUSED = 20  # logs that a terminal lists
_SHORTEST, _LONGEST = 0.1, 1e6  # s between two looks


def run_fleet_command(options: FleetOptions) -> None:
    """Run the command.

    Raises:
        GeodrakeError: The fleet file, a model, a log's place or the scheduler does not do.
    """
    targets = Targets(json=options.json, report=options.report)
    fleet = read_fleet(options.fleet)
    targets.check(fleet.files)
    work = FleetWork(options.workers, options.scheduler, options.false_alarms)
    number(options.every, "--every", lower=_SHORTEST, upper=_LONGEST)
    if options.watch and options.once:
        raise ArgumentError("--watch goes on and --once does not.", advice="Leave one of them out.")
    if options.json == STDOUT and (options.watch or options.once):
        raise ArgumentError(
            "--json - and the lines of findings would both go to standard output.",
            advice="Name a file.",
        )
    if options.watch:
        _watch(fleet, work, options, targets)
        return
    result, digests = _looked(fleet, work, options)
    numbers, written = _written(fleet, result, options, targets)
    if options.once:
        if _tell_new(fleet, result):
            raise typer.Exit(NEW_FINDING)
        return
    with printing():
        if options.json == STDOUT:
            print_whole(numbers)
        _show(result, digests, written, fleet, to_stderr=options.json == STDOUT)


def _looked(
    fleet: Fleet, work: FleetWork, options: FleetOptions
) -> tuple[FleetResult, FleetDigests]:
    with progress(f"Reading {fleet.path.name}", quiet=options.quiet) as update:
        found = run_fleet(fleet, work, told=update, said=update.history)
    _warn(found[1])
    return found


def _warn(digests: FleetDigests) -> None:
    """Say what of the model files is not believed."""
    for repair in repairs_in_short(digests.repairs):
        warn(f"Warning: a model file is not used as it stands. {repair}")


def _written(
    fleet: Fleet, result: FleetResult, options: FleetOptions, targets: Targets
) -> tuple[str, dict[str, Path]]:
    """Write the results into the fleet's folder, and what was asked for; all files or none."""
    said = {"version": version(), "command": "fleet", **fleet_dict(result)}
    numbers = to_json(said)
    contents: dict[Path, Content] = {
        fleet.folder / _RESULT: numbers,
        **(parquet_contents(result, fleet.folder) if find_spec("pyarrow") else {}),
    }
    if "json" in targets.files:
        contents[targets.files["json"]] = numbers
    if "report" in targets.files:
        from geodrake.report.fleet_page import render_fleet  # as the page alone needs it

        title = f"{options.fleet.name}: fleet"
        contents[targets.files["report"]] = render_fleet(result, title=title)
    write_together(contents)
    return numbers, targets.files


def _show(
    result: FleetResult,
    digests: FleetDigests,
    written: dict[str, Path],
    fleet: Fleet,
    *,
    to_stderr: bool,
) -> None:
    console = make_console(stderr=to_stderr)
    known = sum(map(len, digests.records.values()))
    console.print(
        f"{fleet.path.name}: {len(fleet.robots)} robots, {known} logs, {digests.made} of them new",
        soft_wrap=True,
    )
    if result.findings:
        head(console, "What changed, worst first")
        show_table(console, findings_table(result.findings))
    steady = [robot for robot in result.robots if not robot.findings]
    if steady:
        head(console, "Robots in which nothing was found, the farthest from others first")
        show_table(console, robots_table(steady[:MOST_ROBOTS]))
        if len(steady) > MOST_ROBOTS:
            console.print(f"and {len(steady) - MOST_ROBOTS} more, in {fleet.folder / _RESULT}")
    show_list(console, "Notes", result.repairs)
    unused = unused_list(result)
    more = len(unused) - _MOST_UNUSED
    rest = [f"and {more} more, in {fleet.folder / _RESULT}"] if more > 0 else []
    show_list(console, "Logs that are not used", [*unused[:_MOST_UNUSED], *rest])
    say(console, "Result", f"{fleet_verdict(result)} All of it is in {fleet.folder}.")
    show_saved(console, written)


def _watch(fleet: Fleet, work: FleetWork, options: FleetOptions, targets: Targets) -> None:
    """Look for new logs again and again, until the command is ended.

    What fails at the first look is a mistake of the fleet file. Later, places of logs and
    schedulers that do not answer may do so again.

    Raises:
        GeodrakeError: What fails is something else.
    """
    seen: FleetDigests | None = None
    while True:
        try:
            seen = _look(fleet, work, options, targets, seen)
        except FleetError as error:
            if seen is None:
                raise
            warn(f"{error} It is tried again in {options.every:g} s.")
        time.sleep(options.every)


def _look(
    fleet: Fleet,
    work: FleetWork,
    options: FleetOptions,
    targets: Targets,
    seen: FleetDigests | None,
) -> FleetDigests:
    """Take in new logs; statistics only if something is not as it was seen before."""
    with progress(f"Reading {fleet.path.name}", quiet=options.quiet) as update:
        failed = () if seen is None else seen.failed
        digests = take_in_logs(fleet, work, failed=failed, told=update, said=update.history)
        known = (digests.records, digests.failed)
        if seen is not None and not digests.made and known == (seen.records, seen.failed):
            return digests
        result = fleet_result(fleet, digests, work, update)
    if seen is None:
        _warn(digests)
    _written(fleet, result, options, targets)
    _tell_new(fleet, result)
    return digests


def _tell_new(fleet: Fleet, result: FleetResult) -> list[FleetFinding]:
    """Print a line for each finding that was not told before, and remember it."""
    new = new_findings(fleet.folder, result.findings)
    with printing():
        for finding in new:
            print(finding_line(finding), file=results(), flush=True)
    if new:
        keep_told(fleet.folder, new)
    return new
