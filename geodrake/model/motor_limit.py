"""What a motor can give of the efforts that it is asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MotorLimit:
    """A motor gives the less the faster it drives: −L (1 + v/w) ≤ effort ≤ L (1 − v/w).

    Attributes:
        effort: L, its largest effort, N·m or N.
        no_load_speed: w, at which it gives none, rad/s or m/s; infinite if the limit is the same
            at every speed.
    """

    effort: float
    no_load_speed: float = np.inf

    def times(self, factor: float) -> MotorLimit:
        """That of efforts multiplied by a factor above 0."""
        return replace(self, effort=factor * self.effort)

    def given(self, asked: Array, velocity: Array) -> Array:
        """Efforts (K,) that the motor gives.

        Args:
            asked: (K,) efforts that were asked for, N·m or N.
            velocity: (K,) velocities of the joint.
        """
        falling = velocity / self.no_load_speed
        return np.clip(asked, -self.effort * (1.0 + falling), self.effort * (1.0 - falling))

    def beyond(self, asked: Array, velocity: Array) -> tuple[float, float]:
        """Share of the samples that are beyond the limit, and their mean square beyond it.

        Args:
            asked: (K,) efforts that were asked for, N·m or N.
            velocity: (K,) velocities of the joint.
        """
        excess = asked - self.given(asked, velocity)
        share = float(np.mean(excess != 0.0))
        return share, float(np.mean(excess**2)) / share if share else 1.0
