"""What an actuator that turns with two joints makes them share."""

from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import dataclass

from geodrake.effects.base import Array, JointPairEffect, Proposer

Direction = Callable[[Array], Array]
"""Smoothed signs of speeds."""


@dataclass(frozen=True)
class SharedActuatorEffect(JointPairEffect):
    """An effect of an actuator that turns with vᵢ + s vⱼ. Subclasses define `shared` and `rows`.

    A diagnosis tries it at joints that follow each other, and at any other two whose residuals both
    go with the motion of one actuator, beyond what they have of their own.
    """

    proposer = Proposer.SHARED_ACTUATOR

    @staticmethod
    @abc.abstractmethod
    def shared(v: Array, turned_v: Array, turned_vd: Array, direction: Direction) -> Array:
        """Columns (..., k) at a joint; with the right sign s, no parameter is negative.

        Args:
            v: (...) velocity of the joint.
            turned_v: (...) velocity s vⱼ of the other one, with the sign s of its part.
            turned_vd: (...) the same of its acceleration.
        """
