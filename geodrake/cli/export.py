"""The commands `export` and `check`: write and verify models for other programs."""

from __future__ import annotations

from pathlib import Path

from geodrake.cli.command import STDOUT, Command, Input, inputs_of, run
from geodrake.cli.options import CheckOptions, ExportOptions
from geodrake.cli.streams import INTERNAL_ERROR
from geodrake.control.export_proof.export import (
    ProvenExport,
    check_folder,
    export_with_proof,
    write_files,
)
from geodrake.control.export_proof.formats import export_format
from geodrake.model.dynamics_check import check_dynamics
from geodrake.model.robot_model import RobotModel


def run_export(options: ExportOptions) -> None:
    """Run `geodrake export`: write a model for another program."""
    options = options.with_folder
    form, folder = export_format(options.to), Path(options.folder or "")

    def check(model: RobotModel) -> None:
        beside = [p for p in (options.json, options.report) if p not in (None, STDOUT)]
        taken = [*inputs_of(options), *filter(None, beside)]
        check_folder(model, form, folder, taken, force=options.force)

    def exported(given: Input) -> ProvenExport:
        return export_with_proof(
            given.model,
            form,
            folder,
            given.logs,
            bandwidth=options.bandwidth,
            progress=given.progress,
        )

    command = Command(
        "export",
        f"Exporting to {form.name}",
        exported,
        check=check,
        write=lambda found, contents: write_files(found, folder, contents),
    )
    run(command, options)


def run_check(options: CheckOptions) -> None:
    """Run `geodrake check`: compare a model's dynamics with MultibodyPlant's."""
    command = Command(
        "check",
        "Comparing with MultibodyPlant and an independent reader of the file",
        lambda given: check_dynamics(given.model, samples=options.samples, seed=options.seed),
        code=lambda found: 0 if found.holds else INTERNAL_ERROR,
    )
    run(command, options)
