"""Losses of a gear that differ between driving and braking."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.effects.base import Array, Effect, JointEffect, JointMotion, Parameter
from geodrake.effects.load_dependent_friction import LoadDependentFriction


@dataclass(frozen=True)
class GearEfficiency(JointEffect):
    """Losses of a gear in proportion to its load, one where it drives and one where it brakes.

    effort = k_d |τ_model| sgn v where τ_model v > 0, and k_b |τ_model| sgn v elsewhere; both ≥ 0
    and without unit. The efficiency of a driving gear is 1 / (1 + k_d), that of one that the load
    drives is 1 − k_b.

    It contains load-dependent friction (k_d = k_b). Of a joint that moves, the difference of both
    is ½ (k_d − k_b) τ_model, which is the effort of bodies that are heavier by that share. It can
    be told only by inertias that are known from elsewhere, as a gain of the effort can
    (`effort_scale`). A diagnosis tries it only then.
    """

    name = "gear_efficiency"
    of_motor = True
    taken_out_as = "friction"
    label = "efficiency of a gear"
    law = (
        "k |τ_model| sgn v, with a k for driving and one for braking; where the inertia is trusted "
        "or a known payload is carried in one log"
    )
    list_position = 15.5
    contains = (LoadDependentFriction,)
    jumps = True
    parameters = (
        Parameter("driving_loss", "1", lower=0.0),
        Parameter("braking_loss", "1", lower=0.0),
    )
    signature = "a step at reversals that grows with the load, more where the joint drives"
    depends_on = frozenset({"v", "load"})
    needs_known_inertia = True

    @property
    def refines(self) -> tuple[tuple[type[Effect], ...], ...]:
        """Load-dependent friction, which it replaces where the difference is worth it."""
        return ((LoadDependentFriction,),)

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[|τ_model| sgn v where τ_model v > 0, and where it is not]."""
        forth, back = np.maximum(joint.sign_v, 0.0), np.minimum(joint.sign_v, 0.0)
        up, down = np.maximum(joint.load, 0.0), np.maximum(-joint.load, 0.0)
        return [up * forth + down * back, up * back + down * forth]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """Of |τ_model| by the load, times sgn v, in either case."""
        load, s = joint.load, joint.sign_v
        drives = load * s > 0.0
        by_load, by_sign = np.sign(load) * s, np.abs(load)
        return [
            {"load": np.where(here, by_load, 0.0), "sign_v": np.where(here, by_sign, 0.0)}
            for here in (drives, ~drives)
        ]
