"""A sensor with noise."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem


class NoisyVelocities(LeafSystem):
    """Positions as they are, and velocities with white noise that is held for a millisecond.

    .. pydrake_system::

        name: NoisyVelocities
        input_ports:
        - state
        output_ports:
        - measured_state
    """

    def __init__(self, size: int, deviation: float, *, duration: float, seed: int) -> None:
        """Constructs the system.

        Args:
            size: Number of positions and of velocities.
            deviation: Standard deviation of the noise, rad/s.
            duration: For how long, s; then it repeats.
            seed: Of the noise.
        """
        LeafSystem.__init__(self)
        rng = np.random.default_rng([seed, 58])
        self._noise = rng.normal(0.0, deviation, (round(1e3 * duration), size))
        self._size = size
        self._state = self.DeclareVectorInputPort("state", BasicVector(2 * size))
        self.DeclareVectorOutputPort("measured_state", BasicVector(2 * size), self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        state = self._state.Eval(context).copy()
        sample = int(round(1e3 * context.get_time(), 6)) % len(self._noise)
        state[self._size :] += self._noise[sample]
        output.SetFromVector(state)
