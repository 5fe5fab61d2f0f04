"""Effects of position and velocity alone, at one state of a simulation after another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.control_regressor import EffectColumns
from geodrake.control_regressor.effect_columns import OnlineMotion
from geodrake.effects import Effect
from geodrake.inertia import PARAMETERS_PER_BODY, Array


@dataclass(frozen=True, eq=False)
class DirectEffects:
    """Effects whose effort depends on q and v only, evaluated together where they are alike.

    Attributes:
        columns: Their columns.
        parameters: (k,) their parameters μ.
        positions: (nv,) position of each velocity, −1 for joints of several degrees of freedom.
        several: Velocities of joints of several degrees of freedom; None for none.
    """

    columns: EffectColumns
    parameters: Array
    positions: NDArray[np.intp]
    several: NDArray[np.intp] | None

    @classmethod
    def of(
        cls,
        effects: Sequence[tuple[Effect, Array]],
        joints: tuple[str, ...],
        positions: NDArray[np.intp],
        sign_width: Array,
    ) -> DirectEffects:
        """Sorts effects and their parameters by what is alike."""
        some = np.random.default_rng(0).normal(size=(1, len(joints), PARAMETERS_PER_BODY))
        columns = EffectColumns.of(
            joints,
            [effect for effect, _ in effects],
            sign_width=sign_width,
            single=positions >= 0,
            body_columns=lambda _: some,
        )
        parameters = np.concatenate([np.zeros(0), *(mu for _, mu in effects)])
        several = np.flatnonzero(positions < 0)
        return cls(columns, parameters, positions, several if len(several) else None)

    def effort(self, q: Array, v: Array, body_columns: Callable[[str], Array]) -> Array:
        """Effort (nv,) at positions q (nq,) and velocities v (nv,).

        Args:
            q: (nq,) positions.
            v: (nv,) velocities.
            body_columns: Regressor (1, nv, 10) of a body at rest in v̇, by its name.
        """
        rest = np.zeros(len(v))
        if not len(self.parameters):
            return rest
        q_joint = q.take(self.positions)
        if self.several is not None:
            q_joint[self.several] = np.nan
        motion = OnlineMotion(q_joint, v, rest, rest, self.columns.direction(v))
        return np.asarray(self.columns.columns(motion, body_columns) @ self.parameters)
