"""Friction of an actuator that turns with two joints at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import Array, Parameter, RobotMotion, Shape
from geodrake.effects.gradient import RobotGradient, sign_slope
from geodrake.effects.shared_actuator import Direction, SharedActuatorEffect
from geodrake.errors import ArgumentError


@dataclass(frozen=True)
class CoupledFriction(SharedActuatorEffect):
    """Friction of an actuator whose speed is w = vᵢ + s vⱼ, as in a coupled wrist.

    effort of joint i = F sgn w + c w, and s times that at joint j, so that the power is
    (F sgn w + c w) w; F ≥ 0 in N·m and c ≥ 0 in N·m·s/rad.

    Attributes:
        joints: The joints i and j.
        sign: s, 1 or −1. A ratio other than one belongs in a transmission.
    """

    sign: int = 1

    name = "coupled_friction"
    of_motor = True
    taken_out_as = "friction"
    law = (
        "friction of an actuator that turns with v_i ± v_j; of joints that do not follow each "
        "other, found in the residual"
    )
    list_position = 16
    complexity = 1
    shapes = (Shape("sign", grid=(1, -1)),)
    jumps = True
    parameters = (
        Parameter("coulomb", "N·m", lower=0.0),
        Parameter("viscous", "N·m·s/rad", lower=0.0),
    )
    signature = "steps at both joints at once, where the sum or difference of their speeds reverses"
    depends_on = frozenset({"v"})

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sign not in (-1, 1):
            raise ArgumentError(f"{self.name} needs the sign 1 or −1; it got {self.sign}.")

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[sgn w, w] at joint i and s [sgn w, w] at joint j."""
        i, j = map(motion.index, self.joints)
        w = motion.v[:, i] + self.sign * motion.v[:, j]
        width = np.hypot(motion.sign_width[i], motion.sign_width[j])
        columns = np.stack([motion.direction(w, width), w], -1)
        return {self.joints[0]: columns, self.joints[1]: self.sign * columns}

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient:
        """Of both columns by w, which is how both joints' speeds enter."""
        i, j = map(motion.index, self.joints)
        w = motion.v[:, i] + self.sign * motion.v[:, j]
        width = np.hypot(motion.sign_width[i], motion.sign_width[j])
        both = weights[:, i] + self.sign * weights[:, j]
        by_w = both[:, 0] * sign_slope(motion.direction(w, width), width) + both[:, 1]
        gradient = RobotGradient.zero(motion)
        gradient.v[:, i], gradient.v[:, j] = by_w, self.sign * by_w
        return gradient

    @staticmethod
    def shared(v: Array, turned_v: Array, turned_vd: Array, direction: Direction) -> Array:
        """[sgn w, w] with w = v + s vⱼ, whatever the joint: at joint j, s is taken out."""
        del turned_vd
        w = v + turned_v
        return np.stack([direction(w), w], -1)
