"""Friction that follows the temperature of a joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import (
    Array,
    Effect,
    JointEffect,
    JointMotion,
    Parameter,
    RobotMotion,
    Shape,
)
from geodrake.effects.coulomb_friction import CoulombFriction
from geodrake.effects.viscous_friction import ViscousFriction


@dataclass(frozen=True)
class ThermalFriction(JointEffect):
    """What dry and viscous friction gain with every degree that a joint is warmer.

    effort = (T − T₀) (F sgn v + c v), with F in N·m/°C and c in N·m·s/(rad·°C), at T °C.

    It goes on top of `coulomb_friction` and `viscous_friction`, which have the values at T₀. F and
    c are negative where grease gets thinner, but need not be. Where the temperature is not known
    it is T₀. `friction_drift` goes with the time instead, for logs without temperatures.

    Attributes:
        reference: T₀, °C; a diagnosis takes the mean of the logs.
    """

    reference: float

    name = "thermal_friction"
    taken_out_as = "friction"
    law = "(T − T₀) (F sgn v + c v), where the log has the joint's temperature T"
    list_position = 17.5
    shapes = (Shape("reference", "°C", grid=(1.0,), scale="temperature", usual=25.0),)
    parameters = (
        Parameter("coulomb_slope", "N·m/°C"),
        Parameter("viscous_slope", "N·m·s/(rad·°C)"),
    )
    signature = "friction that goes with the logged temperature of the joint"
    depends_on = frozenset({"v", "temperature"})

    @property
    def free_shapes(self) -> int:
        """None: another T₀ is the same law with other friction beside it."""
        return 0

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """Nothing, of a joint at T₀."""
        return [np.zeros_like(joint.v), np.zeros_like(joint.v)]

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """(T − T₀) [sgn v, v]; nothing where T is not known."""
        if motion.temperature is None:
            return super().rows(motion)
        joint, warmer = motion.joint(self.joint), motion.warmer(self.joint, self.reference)
        return {self.joint: warmer[:, None] * np.stack([joint.sign_v, joint.v], -1)}

    @property
    def refines(self) -> tuple[tuple[type[Effect], ...], ...]:
        """Dry friction or viscous friction."""
        return ((CoulombFriction,), (ViscousFriction,))
