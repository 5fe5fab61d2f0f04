"""A simulator that loads an exported model by itself."""

from __future__ import annotations

import abc
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from geodrake.control.export_proof.drives import Drives
from geodrake.effects import Effect
from geodrake.errors import ModelError
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Engine(abc.ABC):
    """A simulator with a robot that it read from a file.

    Joints are those of the model, one position and one velocity each.

    Attributes:
        name: Name of the simulator and its version.
        ignores: Effects that may be in the file, but which the simulator does not act upon.
        messages: What it said about the file.
        drives: Actuators of the file that efforts of rollouts pass through; None for none.
    """

    name: str
    drives: Drives | None = None
    messages: tuple[str, ...] = ()
    ignores: ClassVar[tuple[type[Effect], ...]] = ()

    @abc.abstractmethod
    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Effort that a motion needs.

        Args:
            q: (N, nv) positions, rad or m.
            v: (N, nv) velocities.
            vd: (N, nv) accelerations.

        Returns:
            (N, nv) efforts, N·m or N, and where they are meant to be those of the model.
        """

    def roll_out(self, q: Array, v: Array, effort: Array, step: float) -> Array | None:
        """Positions (K + 1, nv) from a state on, without dry friction; None if it cannot simulate.

        Actuators are told `Drives.controls` of the efforts.

        Args:
            q: (nv,) first positions, rad or m.
            v: (nv,) first velocities.
            effort: (K, nv) efforts, each held for a step, N·m or N.
            step: Length of a step, s.
        """
        del q, v, effort, step
        return None


def order_of(model: RobotModel, place: Callable[[str], int], file: Path, name: str) -> list[int]:
    """Where a simulator has each joint of a model.

    Args:
        place: Joint -> its place, below 0 or a KeyError if there is none.

    Raises:
        ModelError: A joint is not there.
    """
    found = []
    for joint in model.joints:
        try:
            index = place(joint)
        except KeyError:
            index = -1
        if index < 0:
            raise ModelError(f"{name} finds no joint {joint!r} in {file.name}.")
        found.append(index)
    return found
