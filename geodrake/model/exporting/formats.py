"""The formats that a model is exported to, by name."""

from __future__ import annotations

from collections.abc import Callable
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
from geodrake.model.export import file_kind
from geodrake.model.exporting.directives import drake_files, stands_free
from geodrake.model.exporting.export_format import Exported, ExportFormat, Holding
from geodrake.model.exporting.held import HeldModel
from geodrake.model.exporting.isaac import isaac_files
from geodrake.model.exporting.model_text import model_text
from geodrake.model.robot_model import RobotModel

_JOINT_TERMS = (ViscousFriction, CoulombFriction, RotorInertia)
_WITH_SPRINGS = frozenset({"sdf", "xml"})  # formats of files that have springs


def _joints(model: RobotModel) -> Callable[[Effect], bool]:
    """Friction and rotors, and springs where the robot's own file may have some."""
    springs = file_kind(model) in _WITH_SPRINGS

    def holds(effect: Effect) -> bool:
        if isinstance(effect, JointSpring):
            return springs and effect.exponent == 1
        return isinstance(effect, _JOINT_TERMS)

    return holds


def _beside(kind: type[Effect], able: Callable[[RobotModel], bool] = lambda model: True) -> Holding:
    """What `_joints` holds, and effects of a kind where a model makes them possible."""

    def holding(model: RobotModel) -> Callable[[Effect], bool]:
        of_joints, possible = _joints(model), able(model)
        return lambda effect: of_joints(effect) or (possible and isinstance(effect, kind))

    return holding


def _own_file(model: RobotModel, held: HeldModel, folder: Path) -> Exported:
    data, notes = model_text(held.model, folder)
    return Exported({model.path.name: data}, notes)


_URDF, _SDF, _MJCF = (frozenset({kind}) for kind in ("urdf", "sdf", "xml"))

FORMATS = {
    each.name: each
    for each in (
        ExportFormat("urdf", _URDF, _joints, _own_file, ("drake", "pinocchio")),
        ExportFormat("sdf", _SDF, _joints, _own_file, ("drake",)),
        ExportFormat("mjcf", _MJCF, _beside(GravityTilt), _own_file, ("mujoco",)),
        ExportFormat(
            "drake", _URDF | _SDF, _beside(GravityTilt, stands_free), drake_files, ("drake",)
        ),
        ExportFormat("isaac", _URDF, _beside(EffortDelay), isaac_files, ("drake", "pinocchio")),
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
