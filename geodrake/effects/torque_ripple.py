"""Ripple of a motor or a gear over its angle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.effects.base import (
    Array,
    JointEffect,
    JointMotion,
    Parameter,
    Proposer,
    Shape,
    require_positive,
)


@dataclass(frozen=True)
class TorqueRipple(JointEffect):
    """Effort that repeats over the joint's position: cogging, commutation, gear teeth.

    effort = a cos nq + b sin nq, with a and b in N·m.

    Attributes:
        order: n, waves in a turn (at a prismatic joint 2π waves in 1/n m); no integer where a gear
            is between. A diagnosis finds it in the residual's spectrum over position.
    """

    order: float

    name = "torque_ripple"
    of_motor = True
    law = "a cos n q + b sin n q, n from the residual's spectrum over position"
    list_position = 32
    proposer = Proposer.WAVES
    shapes = (Shape("order", usual=6.0),)
    parameters = (Parameter("cosine", "N·m"), Parameter("sine", "N·m"))
    signature = "waves over the joint's position, at any speed at the same places"
    depends_on = frozenset({"q"})

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "order")

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[cos nq, sin nq]."""
        angle = self.order * joint.q
        return [np.cos(angle), np.sin(angle)]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """Both by q."""
        angle = self.order * joint.q
        return [{"q": -self.order * np.sin(angle)}, {"q": self.order * np.cos(angle)}]
