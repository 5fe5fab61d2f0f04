"""The command `geodrake export`: the model as files for simulators, with proof."""

from __future__ import annotations

import importlib
from pathlib import Path

from geodrake.boundary.version import version
from geodrake.boundary.whole_files import Content
from geodrake.cli.export_options import ExportOptions
from geodrake.cli.export_tables import show_export
from geodrake.cli.model_options import read_model
from geodrake.cli.progress import progress
from geodrake.cli.session import check_logs, own_effects
from geodrake.cli.surroundings import print_whole, printing
from geodrake.cli.tables import make_console, show_saved
from geodrake.cli.targets import STDOUT, Targets
from geodrake.control.export_proof.export import check_folder, export_with_proof, write_files
from geodrake.logs.files import parts_of, read_log
from geodrake.model.exporting.formats import export_format
from geodrake.model.logged_joints import model_of_logs, reading_for
from geodrake.report.export_json import export_dict
from geodrake.report.json_output import to_json
from geodrake.report.numbers import Units


def run_export(options: ExportOptions) -> None:
    """Run the command.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """
    form, logs, folder = export_format(options.to), options.logs or [], options.folder
    parts = [part for log in logs for part in parts_of(log)]
    check_logs(parts)
    read = [options.model, *parts, *options.transmission_files, *(options.effects or ())]
    targets = Targets(json=options.json, report=options.report)
    targets.check(read)
    pages = importlib.import_module("geodrake.report.export_page") if options.report else None
    with progress(f"Reading {options.model.name}", quiet=options.quiet) as update:
        extra = own_effects(options.effects or ())
        model = read_model(options.model, options, update, extra)
        known, reading = model.known_joints, reading_for(model, options.reading)
        read_logs = [read_log(log, joints=known, partial=True, reading=reading) for log in logs]
        model = model_of_logs(model, read_logs, hold_resting=False) if logs else model
        targets.check([*read, model.path])
        check_folder(model, form, folder, [*read, *targets.files.values()], force=options.force)
        update(f"Exporting to {form.name}")
        found = export_with_proof(
            model, form, folder, read_logs, bandwidth=options.bandwidth, progress=update
        )
        update("Writing")
        numbers = to_json({"version": version(), "command": "export", **export_dict(found)})
        beside: dict[Path, Content] = {}
        if "json" in targets.files:
            beside[targets.files["json"]] = numbers
        if pages is not None:
            beside[targets.files["report"]] = pages.render_export(
                found,
                title=f"{options.model.name}: export to {form.name}",
                model_name=options.model.name,
                log_names=[path.name for path in logs],
                units=Units.of(model, extra),
            )
        written = write_files(found, folder, beside)
    with printing():
        if options.json == STDOUT:
            print_whole(numbers)
        console = make_console(stderr=options.json == STDOUT)
        console.print(f"{options.model.name} to {form.name}", soft_wrap=True)
        show_export(console, found, Units.of(model, extra))
        console.print()
        for path in written:
            console.print(f"Saved: {path}", soft_wrap=True)
        show_saved(console, targets.files)
