"""Dry friction that grows with the load on the gear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.effects.base import Array, JointEffect, JointMotion, Parameter


@dataclass(frozen=True)
class LoadDependentFriction(JointEffect):
    """Dry friction in proportion to the effort that the gear transmits.

    effort = k |τ_model| sgn v, with k ≥ 0 and without unit.

    τ_model is the effort that the rigid-body model needs, never the measured one, whose noise and
    whose own friction would bias k.
    """

    name = "load_dependent_friction"
    of_motor = True
    taken_out_as = "friction"
    label = "load-dependent friction"
    law = "k |τ_model| sgn v"
    list_position = 15
    complexity = 1
    jumps = True
    parameters = (Parameter("load_factor", "1", lower=0.0),)
    signature = "a step at reversals whose height grows with the load on the joint"
    depends_on = frozenset({"v", "load"})

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """[|τ_model| sgn v]."""
        return [np.abs(joint.load) * joint.sign_v]

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]]:
        """Of |τ_model| by the load, times sgn v."""
        load, s = joint.load, joint.sign_v
        return [{"load": np.sign(load) * s, "sign_v": np.abs(load)}]
