"""Least squares of what soft joints are, by how simulated windows depart from their motion.

Few values, positive, by their logarithms; a start knows each to a factor of e. Departures are those
of the rollout that the search begins with, and how much they change near the measured motion
(`near_motion`). Each window counts once at each joint, over what the joint departs by: how far a
robot departs within a window is hardly more than one number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from geodrake.control.rollout.near_motion import NearMotion
from geodrake.control.rollout.rollout_values import RolloutValue, giving_way, with_values
from geodrake.model.robot_model import RobotModel
from geodrake.model.simulation.force_law import ForceLaw

Array = NDArray[np.float64]

_REACH = np.log(30.0)  # of a value from where it begins
_TRIED = np.log([0.1, 0.2, 0.4, 0.7, 1.4, 2.5, 5.0, 10.0])  # of one value alone, at first
_STEP = 0.02  # of logarithms, for slopes
_ROUNDS = 3  # with what joints depart by, which falls
_MOST_EVALUATIONS = 20
_LEAST = 1e-6  # of what a joint moves, by which it departs at least


@dataclass(frozen=True, eq=False)
class MotionSearch:
    """Windows that values are fitted to.

    Attributes:
        model: The model at the start.
        values: What is free.
        laws: (W,) force laws of the model in the windows.
        near: (W,) the windows.
        departures: (W, N, nv) departures of the rollout at the start, rad or m.
        moved: (nv,) what joints move, rad or m.
    """

    model: RobotModel
    values: tuple[RolloutValue, ...]
    laws: Sequence[ForceLaw]
    near: Sequence[NearMotion]
    departures: Sequence[Array]
    moved: Array

    def fit(self) -> tuple[Array, Array]:
        """Values (k,) and their deviations as shares of them."""
        start = [self._departures(np.zeros(len(self.values)))]
        rest = [d - near for d, near in zip(self.departures, start[0], strict=True)]
        x, scale = np.zeros(len(self.values)), self._scale(self.departures)
        x = self._tried(x, rest, scale)
        for _ in range(_ROUNDS):
            fit = least_squares(
                self._residual,
                x,
                bounds=(-_REACH, _REACH),
                diff_step=_STEP,
                max_nfev=_MOST_EVALUATIONS,
                args=(rest, scale),
            )
            x = fit.x
            scale = self._scale(self._moved_on(x, rest))
        at_start = np.array([value.value for value in self.values])
        return at_start * np.exp(x), self._deviations(x, rest, scale)

    def _tried(self, x: Array, rest: list[Array], scale: Array) -> Array:
        """The best of some values, one after another."""
        for i in range(len(x)):
            tries = np.repeat(x[None], len(_TRIED) + 1, axis=0)
            tries[1:, i] += _TRIED
            costs = [np.sum(np.square(self._residual(each, rest, scale))) for each in tries]
            x = tries[int(np.argmin(costs))]
        return x

    def _departures(self, x: Array) -> list[Array]:
        """Departures of the windows near their motion, at logarithms of shares of the start."""
        values = [v.value * float(np.exp(share)) for v, share in zip(self.values, x, strict=True)]
        effects = with_values(self.model, self.values, values, values).effects
        gives = giving_way(effects)
        return [
            near.departure(effects, law.soft.held_by([gives[joint] for joint in law.soft.names]))
            for near, law in zip(self.near, self.laws, strict=True)
        ]

    def _moved_on(self, x: Array, rest: list[Array]) -> list[Array]:
        return [d + near for d, near in zip(rest, self._departures(x), strict=True)]

    def _scale(self, departures: Sequence[Array]) -> Array:
        """(nv,) RMS by which joints depart."""
        mean = np.mean([np.mean(np.square(d), axis=0) for d in departures], axis=0)
        return np.maximum(np.sqrt(mean), _LEAST * self.moved)

    def _windows(self, x: Array, rest: list[Array], scale: Array) -> list[Array]:
        """(N nv,) residuals of each window."""
        found = self._moved_on(x, rest)
        return [np.ravel(d / (scale * np.sqrt(len(d)))) for d in found]

    def _residual(self, x: Array, rest: list[Array], scale: Array) -> Array:
        return np.concatenate([*self._windows(x, rest, scale), x])

    def _deviations(self, x: Array, rest: list[Array], scale: Array) -> Array:
        """(k,) standard deviations of the logarithms.

        From the information of the windows, or from how their pulls differ, whichever is more.
        """
        at = self._windows(x, rest, scale)
        slopes = []
        for unit in _STEP * np.eye(len(x)):
            ahead, behind = (self._windows(x + way, rest, scale) for way in (unit, -unit))
            slopes.append([(a - b) / (2.0 * _STEP) for a, b in zip(ahead, behind, strict=True)])
        J = [np.column_stack(columns) for columns in zip(*slopes, strict=True)]
        information = sum((j.T @ j for j in J), np.eye(len(x)))
        pulls = np.array([j.T @ r for j, r in zip(J, at, strict=True)])
        pulls = pulls - pulls.mean(axis=0)
        covariance = np.linalg.inv(information)
        spread = covariance @ (pulls.T @ pulls) @ covariance * len(at) / max(len(at) - 1, 1)
        return np.sqrt(np.maximum(np.diag(covariance), np.diag(spread)))
