"""An offset that follows the temperature of a joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import (
    Array,
    JointEffect,
    JointMotion,
    Parameter,
    RobotMotion,
    Shape,
)
from geodrake.effects.effort_offset import EffortOffset


@dataclass(frozen=True)
class ThermalOffset(JointEffect):
    """Offset that changes with every degree that a joint is warmer, as that of a torque sensor.

    effort = o + k (T − T₀), with o in N·m and k in N·m/°C, at T °C.

    It contains the constant `effort_offset`. Where the temperature is not known it is T₀.

    Attributes:
        reference: T₀, °C; a diagnosis takes the mean of the logs.
    """

    reference: float

    name = "thermal_offset"
    law = "o + k (T − T₀), where the log has the joint's temperature T"
    list_position = 20.5
    complexity = 1
    contains = (EffortOffset,)
    shapes = (Shape("reference", "°C", grid=(1.0,), scale="temperature", usual=25.0),)
    parameters = (Parameter("offset", "N·m"), Parameter("slope", "N·m/°C"))
    signature = "an offset that goes with the logged temperature of the joint"
    depends_on = frozenset({"temperature"})

    @property
    def free_shapes(self) -> int:
        """None: another T₀ is the same law with another offset beside it."""
        return 0

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[1, 0], of a joint at T₀."""
        return [np.ones_like(joint.v), np.zeros_like(joint.v)]

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[1, T − T₀]; [1, 0] where T is not known."""
        warmer = motion.warmer(self.joint, self.reference)
        return {self.joint: np.stack([np.ones_like(warmer), warmer], -1)}
