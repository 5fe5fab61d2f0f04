"""Python itself, which runs a function that was exported."""

from __future__ import annotations

import platform
import runpy
from pathlib import Path

import numpy as np

from geodrake.control.export_proof.engines.base import Array, Engine, Mask, order_of
from geodrake.errors import ModelError
from geodrake.model.robot_model import RobotModel


class PythonEngine(Engine):
    """A module with a function effort(q, v, vd).

    Raises:
        ModelError: Its positions are others than those of single joints.
    """

    def __init__(self, file: Path, model: RobotModel) -> None:
        self.name = f"Python {platform.python_version()}"
        if model.tree.num_positions != len(model.joints):
            raise ModelError(f"{file.name} has positions of a base or of joints of several degrees")
        names = runpy.run_path(str(file))
        self._effort = names["effort"]
        places = {joint: k for k, joint in enumerate(names["JOINTS"])}
        self._order = order_of(model, places.__getitem__, file, self.name)
        self._positions = model.single_places[1]

    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """The function's efforts; see `Engine.effort`."""
        own = np.empty_like(q)
        own[:, self._positions] = q
        rows = zip(own.tolist(), v.tolist(), vd.tolist(), strict=True)
        found = np.array([self._effort(*row) for row in rows])
        return found[:, self._order], np.full(v.shape, True)
