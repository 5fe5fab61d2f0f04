"""The files of an export written into a folder: all of them or none, and none over another."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from geodrake.boundary.arguments import file_path, instances, positive, typed
from geodrake.boundary.whole_files import Content, made_folder, write_together
from geodrake.control.export_proof.export import ProvenExport, export_with_proof
from geodrake.control.export_proof.refusals import check_format
from geodrake.errors import OutputError
from geodrake.logs.motion import JointLog
from geodrake.model.exporting.formats import export_format
from geodrake.model.exporting.held import ExportFormat, HeldModel
from geodrake.model.robot_model import RobotModel


@typed
def export_to(
    to: str,
    model: RobotModel,
    folder: str | Path,
    logs: Sequence[JointLog | str | Path] = (),
    *,
    force: bool = False,
    bandwidth: float | None = None,
) -> ProvenExport:
    """Write a model for a simulator, and prove it: loaded again, and compared with the model.

    Args:
        to: Name of the format: urdf, sdf, mjcf, drake, isaac, python, cpp or ros2.
        model: The model.
        folder: Where the files go; made if it is not there.
        logs: Logs, or their files, on whose motion what the format lacks is fitted, and the error
            that it costs is measured; without any, random motion within the limits of the robot
            serves.
        force: Replace files that are there.
        bandwidth: Bandwidth of the filter of the logs, Hz; by default that of the model's fit.

    Returns:
        The files, what they hold and lack, and how far simulators that load them are off.

    Raises:
        ArgumentError: There is no such format.
        ModelError: The model's own file cannot take the numbers, or the robot has joints that
            the format does not have.
        LogError: A log cannot be used.
        OutputError: A file is there already, or cannot be written.
    """
    form, folder = export_format(to), file_path(folder)
    logs = instances(logs, "logs", (JointLog, str, Path))
    if bandwidth is not None:
        positive(bandwidth, "bandwidth")
    check_folder(model, form, folder, (), force=force)
    found = export_with_proof(model, form, folder, logs, bandwidth=bandwidth)
    write_files(found, folder)
    return found


def check_folder(
    model: RobotModel, form: ExportFormat, folder: Path, inputs: Iterable[Path], *, force: bool
) -> None:
    """Refuse a folder in which the files cannot be written, before the long work.

    Raises:
        OutputError: It is no folder, or has such files already.
        ModelError: The model's file cannot take what is to be written.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(
            f"Cannot export to {folder}: it is there and is no folder.",
            advice="Name a folder.",
            path=folder,
        )
    check_format(model, form)
    taken = {os.path.realpath(path) for path in (*inputs, model.path)}
    for name in form.write(model, HeldModel(model, ()), folder).files:
        path = folder / name
        if os.path.realpath(path) in taken:
            raise OutputError(
                f"Cannot write {path}: it is an input of this command.",
                advice="Choose another folder.",
                path=path,
            )
        if path.exists() and not force:
            raise OutputError(
                f"Cannot write {path}: it is there already.",
                advice="Choose another folder, or give --force to replace it.",
                path=path,
            )


def write_files(
    found: ProvenExport, folder: Path, beside: Mapping[Path, Content] | None = None
) -> list[Path]:
    """Write all files or none; a folder that is made for them stays only with them.

    Returns:
        The files of the export.

    Raises:
        OutputError: One cannot be written.
    """
    files: dict[Path, Content] = {folder / name: d for name, d in found.exported.files.items()}
    with ExitStack() as stack:
        for parent in sorted({folder, *(path.parent for path in files)}):
            stack.enter_context(made_folder(parent))
        write_together({**files, **(beside or {})})
    return [*files]
