"""A constant in the effort."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter


@dataclass(frozen=True)
class EffortOffset(JointEffect):
    """Constant effort: a sensor's zero, a current offset, a constant-force balancer.

    effort = o, in N·m.
    """

    name = "effort_offset"
    of_motor = True
    law = "o"
    list_position = 20
    complexity = 0
    beside_gains = True
    parameters = (Parameter("offset", "N·m"),)
    signature = "the same at all times"
    depends_on = frozenset()

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[1]."""
        return [np.ones_like(joint.v)]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """None."""
        del joint
        return [{}]
