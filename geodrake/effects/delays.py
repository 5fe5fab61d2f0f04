"""Delays of the joints of a robot, and the effects that make them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from geodrake.effects.base import Array, Effect
from geodrake.effects.effort_delay import EffortDelay
from geodrake.effects.role import Role


def delays_of(effects: Sequence[Effect], joints: Sequence[str]) -> Array:
    """(n,) delays, s, that some effects make together at n joints."""
    delays = np.zeros(len(joints))
    for effect in effects:
        if effect.role is Role.DELAY:
            at = [not effect.where or joint in effect.where for joint in joints]
            delays[at] += effect.shape["delay"]
    return delays


def effort_delays(delays: ArrayLike, joints: Sequence[str]) -> list[EffortDelay]:
    """The effects that make delays (n,), s, at n joints: one of all efforts if they are alike.

    Args:
        delays: (n,) delays, s.
    """
    seconds = np.asarray(delays, float).tolist()
    if len(set(seconds)) == 1:
        return [EffortDelay(seconds[0])] if seconds[0] else []
    return [EffortDelay(own, joint) for own, joint in zip(seconds, joints, strict=True) if own]


def delayed_by(
    delays: ArrayLike, signals: Array, period: float, *, spline: BSpline | None = None
) -> Array:
    """Signals (N, n) as they were some time ago, each with a delay of its own.

    Args:
        delays: (n,) delays, s.
        signals: (N, n) samples at a uniform rate.
        period: Time between samples, s.
    """
    seconds = np.asarray(delays, float).tolist()
    if len(set(seconds)) == 1:
        return EffortDelay(seconds[0]).delayed(signals, period, spline=spline)
    both = zip(seconds, signals.T, strict=True)
    return np.stack([EffortDelay(own).delayed(signal, period) for own, signal in both], axis=1)
