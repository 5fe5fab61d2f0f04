"""Pinocchio."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import numpy as np
import pinocchio

from geodrake.control.export_proof.engines.base import Array, Engine, Mask, order_of
from geodrake.effects import Effect
from geodrake.errors import ModelError
from geodrake.model.file_terms import Damping, DryFriction, Rotor
from geodrake.model.robot_model import RobotModel


class PinocchioEngine(Engine):
    """A model of Pinocchio: the rigid bodies alone.

    Raises:
        ModelError: Pinocchio cannot read the file.
    """

    ignores: ClassVar[tuple[type[Effect], ...]] = (DryFriction, Rotor, Damping)

    def __init__(self, file: Path, model: RobotModel) -> None:
        self.name = f"Pinocchio {pinocchio.__version__}"
        try:
            self._model = pinocchio.buildModelFromUrdf(str(file))
        except (ValueError, RuntimeError) as error:
            line = " ".join(str(error).split())[:300]
            raise ModelError(f"Pinocchio cannot read {file.name}: {line}") from error
        for values in ("armature", "damping", "friction"):  # whether a version reads them or not
            if hasattr(self._model, values):
                getattr(self._model, values)[:] = 0.0
        names = {name: k for k, name in enumerate(self._model.names)}
        self._joints = order_of(model, names.__getitem__, file, self.name)
        self._held = {names[n]: place for n, place in model.held.items() if n in names}

    def effort(self, q: Array, v: Array, vd: Array) -> tuple[Array, Mask]:
        """Inverse dynamics of the bodies; see `Engine.effort`."""
        model = self._model
        data, found = model.createData(), np.empty_like(v)
        positions, velocities = pinocchio.neutral(model), np.zeros(model.nv)
        accelerations = np.zeros(model.nv)
        at = [model.joints[joint].idx_v for joint in self._joints]
        for joint, place in self._held.items():
            positions[model.joints[joint].idx_q] = place
        for k in range(len(v)):
            for joint, angle in zip(self._joints, q[k], strict=True):
                start = model.joints[joint].idx_q
                if model.joints[joint].nq == 2:  # without limits
                    positions[start : start + 2] = np.cos(angle), np.sin(angle)
                else:
                    positions[start] = angle
            velocities[at], accelerations[at] = v[k], vd[k]
            found[k] = pinocchio.rnea(model, data, positions, velocities, accelerations)[at]
        return found, np.full(v.shape, True)
