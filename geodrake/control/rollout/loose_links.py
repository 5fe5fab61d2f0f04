"""Where links of soft joints are when a passage begins, and how they move.

Springs bend as their load has them. In dead bands links are as the motion before leaves them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.control.rollout.passages import Passage
from geodrake.effects import FittedEffect, RobotMotion
from geodrake.effects.deflection import DeflectionEffect
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

AT_START = 9
"""Samples of the rate at which soft joints bend when a passage begins."""

_BEFORE = 0.5  # s before a passage, from which on links are followed through dead bands


def first_lag(
    lags: Array, plays: Array, time: Array, loose: Callable[[], tuple[Array, Array]]
) -> tuple[Array, Array]:
    """Lags (m,) of links behind their motors, and their rates, when a passage begins.

    Args:
        lags: (K, m) those that loads make at the first samples, rad or m.
        plays: (m,) half widths of dead bands, rad or m.
        time: (K,) instants of these samples, s.
        loose: Gives lags in dead bands, and their rates; called only if there are any.
    """
    bends = lags - np.clip(lags, -plays, plays)
    degree = min(2, len(lags) - 1)
    slope = np.polyfit(time - time[0], bends, degree)
    lag, rate = lags[0], slope[-2] if degree else np.zeros(len(plays))
    if plays.any():
        inside, rates = loose()
        lag, rate = np.where(plays, bends[0] + inside, lag), np.where(plays, rates, rate)
    return lag, rate


def motion_before(model: RobotModel, passage: Passage, sign_width: Array) -> RobotMotion:
    """The measured motion before a passage, up to its second sample, as effects see it.

    Args:
        sign_width: (nv,) speeds below which dry friction fades, rad/s or m/s.
    """
    first = max(0, passage.start - round(_BEFORE / passage.stretch.period))
    known = passage.stretch[first : passage.start + 2]
    positions, time = model.positions(known.position), known.time - passage.began
    motion = Motion(positions, known.velocity, known.acceleration, time)
    return model.motion(motion, sign_width=sign_width)


def thrown(
    effects: Sequence[FittedEffect], seen: RobotMotion, joints: Sequence[str]
) -> tuple[Array, Array]:
    """Lags (m,) in dead bands, and their rates, at the last sample but one of a motion."""
    lag, rate = np.zeros((2, len(joints)))
    for fitted in effects:
        effect = fitted.effect
        if isinstance(effect, DeflectionEffect) and effect.give(fitted.parameters).play:
            found, share = effect.deflection(seen), float(fitted.parameters[0])
            lag[joints.index(effect.joint)] += share * found.lag[-2]
            rate[joints.index(effect.joint)] += share * found.rate[-2]
    return lag, rate
