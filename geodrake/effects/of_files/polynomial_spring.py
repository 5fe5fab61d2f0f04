"""A spring whose force is a cubic polynomial."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter, Shape


@dataclass(frozen=True)
class PolynomialSpring(JointEffect):
    """Spring across a joint as MuJoCo states it: effort = p + k₁ x + k₂ x² + k₃ x³, x = q − q_c.

    No coefficient has a sign of its own, unlike those of `joint_spring`.

    Attributes:
        center: q_c, rad or m.
    """

    center: float = 0.0

    name = "polynomial_spring"
    law = "p + k₁ x + k₂ x² + k₃ x³, x = q − q_c"
    list_position = 101
    complexity = 3
    shapes = (Shape("center", "rad"),)
    parameters = (
        Parameter("preload", "N·m"),
        Parameter("stiffness", "N·m/rad"),
        Parameter("stiffness_2", "N·m/rad²"),
        Parameter("stiffness_3", "N·m/rad³"),
    )
    signature = "follows the joint's position, whatever its speed"
    depends_on = frozenset({"q"})

    @property
    def free_shapes(self) -> int:
        """None: the file says where the polynomial is written about."""
        return 0

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[1, x, x², x³]."""
        x = joint.q - self.center
        return [np.ones_like(x), x, x**2, x**3]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """Of the powers of x by q."""
        x = joint.q - self.center
        return [{}, {"q": np.ones_like(x)}, {"q": 2.0 * x}, {"q": 3.0 * x**2}]

    @classmethod
    def candidates(cls, joint: str, peak_speed: float) -> Iterable[PolynomialSpring]:
        """None: a file states it."""
        return ()
