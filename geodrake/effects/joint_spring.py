"""A spring across a joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter, Shape
from geodrake.errors import ArgumentError


@dataclass(frozen=True)
class JointSpring(JointEffect):
    """Spring across a joint: a cable loom, a balancing spring, a rubber stop.

    effort = k (q − q_c)^n + p, with stiffness k ≥ 0 in N·m/radⁿ and preload p in N·m.

    The preload, which is the effort at q_c, is linear and so stands in for the rest position q₀: of
    a linear spring k (q − q₀) it is p = k (q_c − q₀). A hardening spring
    k (q − q₀) + k₃ (q − q₀)³ is a linear and a cubic one with q_c = q₀.

    Attributes:
        exponent: n, 1 or 3.
        center: q_c, rad or m. It changes nothing but p while n = 1, and keeps k and p apart when it
            is amid the motion.
    """

    exponent: int = 1
    center: float = 0.0

    name = "joint_spring"
    law = "k (q − q_c)ⁿ + preload"
    list_position = 30
    complexity = 1
    shapes = (Shape("exponent", grid=(1, 3)), Shape("center", "rad"))
    parameters = (Parameter("stiffness", "N·m/radⁿ", lower=0.0), Parameter("preload", "N·m"))
    signature = "follows the joint's position, whatever its speed"
    depends_on = frozenset({"q"})

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.exponent not in (1, 3) or not np.isfinite(self.center):
            raise ArgumentError(
                f"{self.name} needs the exponent 1 or 3 and a finite center; it got "
                f"{self.exponent} and {self.center}."
            )

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[(q − q_c)^n, 1]."""
        return [(joint.q - self.center) ** self.exponent, np.ones_like(joint.q)]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """Of (q − q_c)^n by q."""
        n = self.exponent
        return [{"q": n * (joint.q - self.center) ** (n - 1)}, {}]
