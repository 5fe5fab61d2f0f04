"""What a format to export to is: what it holds of a model, and the files that it writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from geodrake.effects import Effect
from geodrake.model.exporting.held import HeldModel
from geodrake.model.robot_model import RobotModel


@dataclass(frozen=True)
class Exported:
    """The files of an export.

    Attributes:
        files: Name in the folder -> content; what a simulator loads first.
        notes: What is worth knowing about them.
    """

    files: Mapping[str, bytes]
    notes: tuple[str, ...] = ()


Holding = Callable[[RobotModel], Callable[[Effect], bool]]
"""For a model, whether the files hold one of its effects as it is."""

Write = Callable[[RobotModel, HeldModel, Path], Exported]
"""Writes a model: the whole one, what the format holds of it, and the folder of the files."""


@dataclass(frozen=True)
class ExportFormat:
    """A format.

    Attributes:
        name: What it is called, as in `--to`.
        holding: What tells, for a model, whether the files hold an effect as it is; inertias and
            payloads they always hold.
        engines: Names of the simulators in which the files are tried.
        at_actuators: Whether the files have the efforts of actuators behind a transmission, too.
        servos: Whether the files have the gains of servos.
    """

    name: str
    holding: Holding
    write: Write
    engines: tuple[str, ...] = ()
    at_actuators: bool = False
    servos: bool = False
