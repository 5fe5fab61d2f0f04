"""The command `geodrake digest`: small files that say what logs do, which add up."""

from __future__ import annotations

import typer

from geodrake.boundary.version import version
from geodrake.cli.digest_options import DigestOptions
from geodrake.cli.known_payloads import known_payloads
from geodrake.cli.model_options import read_model
from geodrake.cli.progress import progress
from geodrake.cli.session import own_effects
from geodrake.cli.surroundings import print_whole, printing
from geodrake.cli.tables import head, make_console, say, show_list, show_saved, show_table
from geodrake.cli.targets import STDOUT, Targets
from geodrake.fleet.digest_folder import FAILED, digest_logs
from geodrake.fleet.digest_log import Wanted
from geodrake.fleet.log_places import date_seconds
from geodrake.logs.files import parts_of
from geodrake.report.digests import (
    digest_notes,
    digests_dict,
    digests_table,
    digests_verdict,
    failures,
)
from geodrake.report.json_output import to_json

SOME_FAILED = 1
"""Exit code where logs have no digest; those of the others are there."""


def run_digest(options: DigestOptions) -> None:
    """Run the command; its exit code is 1 if a log has no digest, which the others then have.

    Raises:
        GeodrakeError: Something about the options, the model or the folder does not do.
    """
    date = None if options.date is None else date_seconds(options.date)
    files, targets = options.effects or (), Targets(json=options.json)
    logs = [part for log in options.logs for part in parts_of(log)]
    more = [*options.transmission_files, *filter(None, [options.mapping])]
    inputs = [options.model, *logs, *files, *more]
    targets.check(inputs)
    with progress(f"Reading {options.model.name}", quiet=options.quiet) as update:
        extra = own_effects(files)
        model = read_model(options.model, options, update, extra)
        targets.check([*inputs, model.path])
        run = digest_logs(
            model,
            options.logs,
            options.to,
            wanted=Wanted(options.bandwidth, options.blocks, options.reading, extra),
            date=date,
            payloads=known_payloads(options.logs, options.known_payload or (), model),
            told=update,
        )
        numbers = to_json({"version": version(), "command": "digest", **digests_dict(run)})
        written = targets.write(model, {"json": lambda: numbers})
    with printing():
        if options.json == STDOUT:
            print_whole(numbers)
        console = make_console(stderr=options.json == STDOUT)
        if any(row.status != FAILED for row in run.rows):
            head(console, f"Digests in {options.to}")
            show_table(console, digests_table(run))
        show_list(console, "Logs without a digest", failures(run))
        show_list(console, "Notes", digest_notes(run))
        say(console, "Result", digests_verdict(run))
        show_saved(console, written)
    if run.count(FAILED):
        raise typer.Exit(SOME_FAILED)
