"""The formats that a model is exported to, by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from geodrake.effects import Effect
from geodrake.errors import ArgumentError
from geodrake.model.exporting.directives import KINDS, drake_files, stands_free
from geodrake.model.exporting.export_format import Exported, ExportFormat, Holding, Write
from geodrake.model.exporting.held import HeldModel
from geodrake.model.exporting.isaac import isaac_files
from geodrake.model.exporting.model_text import model_file, written_kind
from geodrake.model.file_terms import Damping, Delay, DryFriction, Rotor, Spring, Tilt
from geodrake.model.robot_model import RobotModel
from geodrake.model.source import effort_source, is_written

_JOINT_TERMS = (Damping, DryFriction, Rotor)
_WITH_SPRINGS = frozenset({"sdf", "xml"})  # formats of files that have springs


def _joints(*kinds: str) -> Holding:
    """What files of some formats hold of joints: friction, rotors, and springs, if they have some.

    The usual format comes first.
    """

    def holding(model: RobotModel) -> Callable[[Effect], bool]:
        springs = written_kind(model, kinds) in _WITH_SPRINGS

        def holds(effect: Effect) -> bool:
            if isinstance(effect, Spring):
                return springs and effect.exponent == 1
            return isinstance(effect, _JOINT_TERMS)

        return holds

    return holding


def _and(
    joints: Holding, kind: type[Effect], able: Callable[[RobotModel], bool] = lambda model: True
) -> Holding:
    """Beside what files hold of joints, effects of a kind where a model makes them possible."""

    def holding(model: RobotModel) -> Callable[[Effect], bool]:
        of_joints, possible = joints(model), able(model)
        return lambda effect: of_joints(effect) or (possible and isinstance(effect, kind))

    return holding


def _file(kind: str) -> Write:
    """Writes one file of a format."""

    def write(model: RobotModel, held: HeldModel, folder: Path) -> Exported:
        name, data, notes = model_file(held.model, kind, folder)
        return Exported({name: data}, notes)

    return write


def _source(language: str) -> Write:
    """Writes the effort as a function in a language."""

    def write(model: RobotModel, held: HeldModel, folder: Path) -> Exported:
        source = effort_source(held.model, language)
        notes = tuple(f"not included: {effect}" for effect in source.left_out)
        return Exported({source.file_name: source.text.encode()}, notes)

    return write


def _written(model: RobotModel) -> Callable[[Effect], bool]:
    return is_written


_MJCF, _ISAAC = _and(_and(_joints("xml"), Tilt), Delay), _and(_joints("urdf"), Delay)
_URDF_ENGINES = ("drake", "pinocchio")

FORMATS = {
    each.name: each
    for each in (
        ExportFormat("urdf", _joints("urdf"), _file("urdf"), _URDF_ENGINES),
        ExportFormat("sdf", _joints("sdf"), _file("sdf"), ("drake",)),
        ExportFormat("mjcf", _MJCF, _file("xml"), ("mujoco",), servos=True),
        ExportFormat("drake", _and(_joints(*KINDS), Tilt, stands_free), drake_files, ("drake",)),
        ExportFormat(
            "isaac", _and(_joints("urdf"), Delay), isaac_files, _URDF_ENGINES, servos=True
        ),
        ExportFormat("python", _written, _source("python"), ("python",), True),
        ExportFormat("cpp", _written, _source("cpp"), at_actuators=True),
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
