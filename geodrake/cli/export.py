"""The command `geodrake export`: the model as files for simulators, with proof."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from geodrake.boundary.whole_files import Content, write_together
from geodrake.cli.export_options import ExportOptions
from geodrake.cli.export_tables import show_export
from geodrake.cli.progress import progress
from geodrake.cli.session import check_logs, own_effects
from geodrake.cli.surroundings import print_whole, printing
from geodrake.cli.tables import make_console
from geodrake.cli.targets import STDOUT, Targets
from geodrake.cli.version import version
from geodrake.control.export_proof.export import check_base, export_with_proof
from geodrake.errors import OutputError
from geodrake.model.exporting.export_format import ExportFormat
from geodrake.model.exporting.formats import export_format
from geodrake.model.exporting.held import HeldModel
from geodrake.model.robot_model import RobotModel
from geodrake.model.saved_model import load_model
from geodrake.report.export_json import export_dict
from geodrake.report.json_output import to_json
from geodrake.report.numbers import Units


def run_export(options: ExportOptions) -> None:
    """Run the command.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """
    form, logs = export_format(options.to), options.logs or []
    check_logs(logs)
    read = [options.model, *logs, *(options.effects or ())]
    targets = Targets(json=options.json)
    targets.check(read)
    with progress(f"Reading {options.model.name}") as update:
        extra = own_effects(options.effects or ())
        model = load_model(options.model, floating=options.floating, extra=extra)
        targets.check([*read, model.path])
        _check_folder(model, form, options, [*read, model.path])
        update(f"Exporting to {form.name}")
        found = export_with_proof(
            model, form, options.folder, logs, bandwidth=options.bandwidth, progress=update
        )
        update("Writing")
        numbers = to_json({"version": version(), "command": "export", **export_dict(found)})
        files = {options.folder / name: data for name, data in found.exported.files.items()}
        json_files = dict.fromkeys(targets.files.values(), numbers)
        _write(options.folder, {**files, **json_files})
    with printing():
        if options.json == STDOUT:
            print_whole(numbers)
        console = make_console(stderr=options.json == STDOUT)
        console.print(f"{options.model.name} to {form.name}", soft_wrap=True)
        show_export(console, found, Units.of(model, extra))
        console.print()
        for path in files:
            console.print(f"Saved: {path}", soft_wrap=True)
        for path in json_files:
            console.print(f"Saved the numbers: {path}", soft_wrap=True)


def _check_folder(
    model: RobotModel, form: ExportFormat, options: ExportOptions, inputs: Iterable[Path]
) -> None:
    """Refuse a folder in which the files cannot be written, before the long work.

    Raises:
        OutputError: It is no folder, or has such files already.
        ModelError: The model's file cannot take what is to be written.
    """
    check_base(model, form)
    folder = options.folder
    if folder.exists() and not folder.is_dir():
        raise OutputError(
            f"Cannot export to {folder}: it is there and is no folder.",
            advice="Name a folder.",
            path=folder,
        )
    taken = {os.path.realpath(path) for path in inputs}
    for name in form.write(model, HeldModel(model, ()), folder).files:
        path = folder / name
        if os.path.realpath(path) in taken:
            raise OutputError(
                f"Cannot write {path}: it is an input of this command.",
                advice="Choose another folder.",
                path=path,
            )
        if path.exists() and not options.force:
            raise OutputError(
                f"Cannot write {path}: it is there already.",
                advice="Choose another folder, or give --force to replace it.",
                path=path,
            )


def _write(folder: Path, contents: dict[Path, Content]) -> None:
    """Write all files or none; a folder that is made for them stays only with them."""
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_together(contents)
    except BaseException as error:
        for path in made:
            with suppress(OSError):
                path.rmdir()
        if isinstance(error, OSError):
            raise OutputError(
                f"Cannot make the folder {folder}: {error.strerror}.",
                advice="Choose another place.",
                path=folder,
            ) from error
        raise
