"""Inertia of a geared rotor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter


@dataclass(frozen=True)
class RotorInertia(JointEffect):
    """Inertia of a rotor behind a gear, as the joint feels it (the reflected inertia).

    effort = I v̇, with I = (gear ratio)² · rotor inertia ≥ 0 in kg·m² (kg at a prismatic joint).
    """

    name = "rotor_inertia"
    of_motor = True
    taken_out_as = "rotor inertia"
    law = "I v̇"
    list_position = 40
    complexity = 0
    stated_as = "reflected rotor inertia"
    beside_gains = True
    parameters = (Parameter("inertia", "kg·m²", lower=0.0),)
    signature = "follows the joint's own acceleration"
    depends_on = frozenset({"vd"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[v̇]."""
        return [joint.vd]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """One by v̇."""
        del joint
        return [{"vd": 1.0}]
