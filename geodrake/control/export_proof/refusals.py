"""What formats of export have no place for."""

from __future__ import annotations

from geodrake.errors import ModelError
from geodrake.model.exporting.held import ExportFormat
from geodrake.model.robot_model import RobotModel


def check_format(model: RobotModel, form: ExportFormat) -> None:
    """Refuse a format that has no place for what the model has.

    Args:
        model: The model.
        form: The format.

    Raises:
        ModelError: It has no closed loops, or efforts and friction at joints, and the model at
            actuators.
    """
    if loops := [", ".join(drive.joints) for drive in model.transmission if drive.is_loop]:
        raise ModelError(
            f"The format {form.name} cannot have a closed loop, and the model has one of "
            f"{loops[0]}.",
            advice="Export the inertias alone into the model's file: geodrake identify --export.",
        )
    if model.transmission and not form.at_actuators:
        actuators = ", ".join(name for drive in model.transmission for name in drive.actuators)
        raise ModelError(
            f"The format {form.name} has efforts and friction at joints, and the model at "
            f"{actuators}, behind a transmission.",
            advice="Export to python or cpp, or the inertias alone: geodrake identify --export.",
        )
