"""Play between a motor and its link."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from geodrake.compiling import compiled, contiguous
from geodrake.effects.base import (
    Array,
    Parameter,
    Proposer,
    RobotMotion,
    Shape,
    Values,
    require_positive,
)
from geodrake.effects.deflection import Deflection, DeflectionEffect, Give
from geodrake.effects.fitted_effect import FittedEffect

_SUBSTEPS = 4


@dataclass(frozen=True)
class Backlash(DeflectionEffect):
    """Dead band between a motor, whose position is measured, and its link.

    effort = −g (∂τ/∂q s + ∂τ/∂v ṡ + M s̈), with the lag s(t) of the link; g is 1 where the gap is
    as wide as the shape says.

    The link lies at the side of the gap to which its load pushes it, s = ±h. When the load τ_j
    changes its sign the link comes loose, is carried by nothing, M_jj s̈ = τ_j, and strikes the
    other side, where it stays. The motor thus feels no load for a while, and then a blow. Where
    samples are no series in time, there is only the posture s = h sgn τ_j.

    A simulation has motor and link as two bodies, between stiff and damped sides.

    Attributes:
        half_width: h, rad or m.
    """

    half_width: float

    name = "backlash"
    of_motor = True
    law = "a dead band between the measured motor and its link"
    list_position = 51
    proposer = Proposer.PLAY
    shapes = (Shape("half_width", "rad", grid=(1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)),)
    parameters = (Parameter("gap_share", "1", lower=0.0),)
    signature = "no load for a moment where the load changes its sign, and then a blow"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "half_width")

    def deflection(self, motion: RobotMotion) -> Deflection:
        """At the side to which the load pushes the link, or loose between both sides."""
        at, time = motion.index(self.joint), motion.time
        load = motion.load[:, at]
        if time is None or len(time) < 3:
            return Deflection.along(self.half_width * np.sign(load), time)
        inertia = motion.effort_slopes.acceleration[:, at, at]
        lag = self.lag(load / np.maximum(inertia, 1e-9), time)
        bend = np.diff(lag, 2, prepend=lag[:1], append=lag[-1:])
        period = float(np.median(np.diff(time)))
        return Deflection(lag, np.gradient(lag, time), bend / period**2)

    def give(self, parameters: Array) -> Give:
        """Play of half the width h to either side, times the share g."""
        return Give(play=max(parameters[0], 0.0) * self.half_width)

    def rollout_values(self, parameters: Array) -> Values:
        """Half the width of the gap that the share makes of the shape."""
        width = float(parameters[0]) * self.half_width
        return {"half_width": width} if width > 0.0 else {}

    def with_rollout_values(self, values: Values, deviations: Values) -> FittedEffect:
        """Return a gap as wide as its shape says."""
        width = values["half_width"]
        share = np.array([deviations["half_width"] / width])
        return FittedEffect(replace(self, half_width=width), np.ones(1), share)

    def lag(self, acceleration: Array, time: Array) -> Array:
        """Return the lag s (N,) of a link.

        Args:
            acceleration: (N,) τ_j / M_jj, with which it falls behind when it is loose, rad/s².
            time: (N,) instants, s.
        """
        steps = np.diff(time, append=time[-1:]) / _SUBSTEPS
        following = np.append(acceleration[1:], acceleration[-1:])
        return np.asarray(_lag(self.half_width, contiguous(acceleration), following, steps))


@compiled
def _lag(h: float, acceleration: Array, following: Array, steps: Array) -> Array:
    """Return the lag (N,) within ±h of a link that falls behind by accelerations, rad/s²."""
    lags = np.empty(len(acceleration))
    s, speed = np.copysign(h, acceleration[0]), 0.0
    for i in range(len(acceleration)):
        a, b, dt = acceleration[i], following[i], steps[i]
        lags[i] = s
        if a * s > 0.0 and b * s > 0.0 and abs(s) == h:
            continue  # it lies at its side
        for k in range(_SUBSTEPS):
            speed += dt * (a + (b - a) * (k + 0.5) / _SUBSTEPS)
            s += dt * speed
            if abs(s) >= h:
                s, speed = np.copysign(h, s), 0.0
    return lags
