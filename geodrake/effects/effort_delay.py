"""Efforts that are logged later than the motion they belong to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from geodrake.boundary.arguments import positive, real_array
from geodrake.effects.base import Array, Effect, RobotMotion, Role, Shape
from geodrake.errors import ArgumentError
from geodrake.logs.filtering import spline_through


@dataclass(frozen=True)
class EffortDelay(Effect):
    """Time by which logged efforts lag behind logged motion.

    effort logged at t = effort needed at t − δ.

    It has no columns of its own but shifts those of everything else: `delayed` turns the needed
    efforts, or the regressor columns that they come from, into what the log shows. Shift before
    filtering. In a simulation it is `geodrake.control.DelayedEffort`.

    Efforts that were commanded, and not measured, are ahead of the motion if they act late: δ is
    then negative, and −δ the time after which a command acts.

    Attributes:
        delay: δ, s; negative if the efforts are ahead.
        joint: The joint whose effort lags; all joints of the log if None.
    """

    delay: float
    joint: str | None = None

    name = "effort_delay"
    law = "effort logged at t is that needed at t − δ; δ < 0 where it is a command that acts late"
    list_position = 22
    complexity = 1
    role = Role.DELAY
    shapes = (Shape("delay", "s"),)
    parameters = ()
    places: ClassVar[str] = "log"
    signature = "follows the rate of change of the effort, so it is largest in fast motion"
    depends_on = frozenset()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.isfinite(self.delay):
            raise ArgumentError(f"{self.name} needs a finite delay; it got {self.delay}.")

    @property
    def where(self) -> tuple[str, ...]:
        """Return the joint, or nothing for the whole log."""
        return () if self.joint is None else (self.joint,)

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """Nothing: a delay adds no effort."""
        del motion
        return {}

    def delayed(self, signal: ArrayLike, period: float, *, spline: BSpline | None = None) -> Array:
        """Return the signal as it was δ ago, by quintic spline interpolation.

        Args:
            signal: (N, ...) samples at a uniform rate.
            period: Time between samples, s.

        Returns:
            (N, ...) the samples at t − δ; what lies outside the signal is its first or last sample.

        Raises:
            ArgumentError: The period is not positive, or there are no samples.
        """
        signal, period = real_array(signal, "signal"), positive(period, "period")
        if signal.size == 0 or signal.ndim == 0:
            raise ArgumentError(f"A delay needs samples; its signal has the shape {signal.shape}.")
        if self.delay == 0 or len(signal) == 1:
            return signal.copy()
        samples = np.arange(len(signal), dtype=float)
        spline = spline_through(signal) if spline is None else spline
        return np.asarray(spline(np.clip(samples - self.delay / period, 0, samples[-1])))
