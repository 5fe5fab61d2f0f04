"""Dry friction that builds up over a small angle: bristles that bend before they slip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import (
    Array,
    JointEffect,
    JointMotion,
    Parameter,
    Proposer,
    RobotMotion,
    Shape,
    require_positive,
)


@dataclass(frozen=True)
class Hysteresis(JointEffect):
    """Dahl's friction: dry friction with a memory of where the joint turned round.

    effort = F z, with F ≥ 0 in N·m and the bristles' bend z in [−1, 1]:

        ż = (v − |v| z) / θ,

    which after a reversal goes from −sgn v to sgn v as 1 − 2 e^{−Δq/θ}. At rest the joint is held
    like by a spring of stiffness F/θ. LuGre's friction is this one, beside `viscous_friction` for
    its damping and `stribeck_friction` for its dependence on speed.

    A log says nothing of z before it begins: a joint that moves there is taken to have slipped,
    z = sgn v, and one at rest to be free, z = 0. Either is forgotten after a few θ. Where samples
    are no series in time, the joint has slipped far: z = sgn v.

    Attributes:
        breakaway_angle: θ, rad or m.
    """

    breakaway_angle: float

    name = "hysteresis"
    law = "F z with Dahl's bristles z, ż = (v − |v| z) / θ"
    list_position = 18
    proposer = Proposer.BRISTLES
    shapes = (
        Shape(
            "breakaway_angle", "rad", grid=(0.003, 0.01, 0.03, 0.1, 0.3), scale="reach", usual=0.02
        ),
    )
    parameters = (Parameter("coulomb", "N·m", lower=0.0),)
    signature = "dry friction that after a reversal comes back over an angle, not at once"
    depends_on = frozenset({"q", "v", "history"})
    state_count = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "breakaway_angle")

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[sgn v], of a joint that has slipped far."""
        return [joint.sign_v]

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[z]."""
        if self in motion.states:
            return {self.joint: motion.states[self]}
        if motion.before is None:
            return super().rows(motion)
        return {self.joint: self.states_along(motion)}

    def states_along(self, motion: RobotMotion) -> Array:
        """Return the bend z (N, 1) along the motion, and along what was before it."""
        at = motion.index(self.joint)
        before = motion.q[:0] if motion.before is None else motion.before
        q = np.concatenate([before[:, at], motion.q[:, at]])
        start = 0.0
        if motion.time is not None and len(motion.time) > 1 and len(q) > 1:
            speed = (q[1] - q[0]) / (motion.time[1] - motion.time[0])
            start = float(motion.direction(speed, motion.sign_width[at]))
        return self.bend(q, start)[len(before) :, None]

    def state_rates(self, motion: RobotMotion, state: Array) -> Array:
        """ż, (N, 1)."""
        v = motion.v[:, motion.index(self.joint), None]
        return np.asarray((v - np.abs(v) * state) / self.breakaway_angle)

    def bend(self, q: Array, start: float = 0.0) -> Array:
        """Return the bristles' bend z along positions, exact between reversals.

        Args:
            q: (N,) positions one after another, rad or m.
            start: z at the first of them.

        Returns:
            (N,) z.
        """
        step = np.diff(q, prepend=q[:1])
        kept = np.exp(-np.abs(step) / self.breakaway_angle)
        z = np.sign(step) * (1.0 - kept)
        z[:1] = start
        # z_k = kept_k z_{k−1} + z_k, for all k at once: maps are composed pairwise, log₂ N times.
        reach = 1
        while reach < len(z):
            z[reach:] = kept[reach:] * z[:-reach] + z[reach:]
            kept[reach:] = kept[reach:] * kept[:-reach]
            reach *= 2
        return z

    def course(self, along: Array) -> Array:
        """Return the bristles' bend z along positions (N,), from no bend on."""
        return self.bend(along)
