"""From which sample on the motion decides the hidden states of effects, wherever they began."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.effects.base import Effect
from geodrake.motion import MEMORY, Stretch

LARGEST_SHARE = 0.2
"""Share of a stretch that is given up at most, to forget a state that nobody knows."""


def first_known(
    effects: Sequence[Effect], joints: Sequence[str], stretch: Stretch
) -> NDArray[np.intp]:
    """First sample of a stretch, for each joint, at which the states of all its effects are known.

    Args:
        effects: Effects that have columns.
        joints: Names of the nv velocities, in the stretch's order.
        stretch: The stretch.

    Returns:
        (nv,) samples; zero where there is nothing to know, or it would be known too late.
    """
    first = np.zeros(len(joints), np.intp)
    remembering = [effect for effect in effects if effect.state_count]
    if remembering:
        q = stretch[:MEMORY].position
        for effect in remembering:
            for place in effect.where:
                known = effect.settled_at(q[:, joints.index(place)])
                if known <= LARGEST_SHARE * len(stretch):
                    first[joints.index(place)] = max(known, first[joints.index(place)])
    return first
