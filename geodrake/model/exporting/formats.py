"""The formats that a model is exported to, by name."""

from __future__ import annotations

from pathlib import Path

from geodrake.effects import (
    CoulombFriction,
    Effect,
    EffortDelay,
    GravityTilt,
    JointSpring,
    RotorInertia,
    ViscousFriction,
)
from geodrake.errors import ArgumentError
from geodrake.model.exporting.directives import drake_files
from geodrake.model.exporting.export_format import Exported, ExportFormat, Holds
from geodrake.model.exporting.held import HeldModel
from geodrake.model.exporting.isaac import isaac_files
from geodrake.model.exporting.model_text import model_text
from geodrake.model.robot_model import RobotModel

_JOINT_TERMS = (ViscousFriction, CoulombFriction, RotorInertia)
_WITH_SPRINGS = frozenset({"sdf", "xml"})  # formats of files that have springs


def _holding(*more: type[Effect]) -> Holds:
    def holds(effect: Effect, kind: str) -> bool:
        if isinstance(effect, JointSpring):
            return effect.exponent == 1 and kind in _WITH_SPRINGS
        return isinstance(effect, (*_JOINT_TERMS, *more))

    return holds


def _own_file(model: RobotModel, held: HeldModel, folder: Path) -> Exported:
    data, notes = model_text(held.model, folder)
    return Exported({model.path.name: data}, notes)


_URDF, _SDF, _MJCF = (frozenset({kind}) for kind in ("urdf", "sdf", "xml"))

FORMATS = {
    each.name: each
    for each in (
        ExportFormat("urdf", _URDF, _holding(), _own_file, ("drake", "pinocchio")),
        ExportFormat("sdf", _SDF, _holding(), _own_file, ("drake",)),
        ExportFormat("mjcf", _MJCF, _holding(GravityTilt), _own_file, ("mujoco",)),
        ExportFormat("drake", _URDF | _SDF, _holding(GravityTilt), drake_files, ("drake",)),
        ExportFormat("isaac", _URDF, _holding(EffortDelay), isaac_files, ("drake", "pinocchio")),
    )
}
"""By name; a further format is one more entry."""


def export_format(name: str) -> ExportFormat:
    """A format by name.

    Raises:
        ArgumentError: There is no such format.
    """
    if name not in FORMATS:
        raise ArgumentError(
            f"There is no format {name!r} to export to.",
            advice=f"Formats are: {', '.join(FORMATS)}.",
        )
    return FORMATS[name]
