"""A balancer that pulls once a turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter


@dataclass(frozen=True)
class GravityCompensator(JointEffect):
    """Balancer of a joint: a counterweight, or a spring whose lever turns with the joint.

    effort = k sin(q − q₀) = s sin q + c cos q, with s = k cos q₀ and c = −k sin q₀ in N·m.

    It is for joints that turn. Unlike the weight of a link, it depends on its own joint alone and
    has no inertia.
    """

    name = "gravity_compensator"
    law = "k sin(q − q₀)"
    list_position = 31
    complexity = 1
    parameters = (Parameter("sine", "N·m"), Parameter("cosine", "N·m"))
    signature = "one wave a turn of the joint, whatever its speed and the other joints"
    depends_on = frozenset({"q"})
    turning_only = True

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[sin q, cos q]."""
        return [np.sin(joint.q), np.cos(joint.q)]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """Both by q."""
        return [{"q": np.cos(joint.q)}, {"q": -np.sin(joint.q)}]
