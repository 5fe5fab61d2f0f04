"""Random motions of a robot that balances on one foot, [Lee2019] §4.6.3.

Random postures get their centre of mass over the sole by the ankle. A spline leads from one to
another by way of others, as much out of the straight line as the zero-moment point allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagrams.studies.excitation.humanoid import HALF_SOLE, STANCE
from geodrake.excitation import ExcitationTrajectory, SplineMotion
from geodrake.excitation.trajectory import joint_order
from geodrake.model import RobotModel
from geodrake.robot import (
    base_wrench_regressor,
    position_limits,
    velocity_limits,
    zero_moment_point,
)

Array = NDArray[np.float64]

FAMILY = SplineMotion(3.0, 10, 5)
CHECK_RATE = 15.0  # 1/s, at which the source checks balance
_MARGIN = 0.95  # of the sole, within which the zero-moment point is to be
_AIM = 0.5  # of the sole, over which centres of mass of postures are
_REACH = 0.6  # of the joints' ranges
_SHARES = np.linspace(1.0, 0.2, 17)
_CLOSE, _STEP, _NEWTON, _BATCH, _TRIES = 1e-3, 1e-5, 8, 40, 60


@dataclass(frozen=True, eq=False)
class Balance:
    """A robot whose left sole is the world's frame.

    Attributes:
        model: The robot, with joints of one degree of freedom.
    """

    model: RobotModel

    def zmp(self, q: Array, v: Array, vd: Array) -> Array:
        """(N, 2) zero-moment points on the ground, m; NaN where the foot would lift off."""
        Y = base_wrench_regressor(self.model.tree, q, v, vd)
        return zero_moment_point(Y @ self.model.phi.ravel())

    def postures(self, rng: np.random.Generator, count: int) -> Array:
        """(count, nv) random postures by joint with the centre of mass over the sole."""
        model, order = self.model, joint_order(self.model)
        lower, upper = (np.empty(len(order)) for _ in range(2))
        lower[order], upper[order] = position_limits(model.plant)
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        ankle = [model.joints.index(name) for name in STANCE]
        found: list[Array] = []
        for _ in range(_TRIES):
            tried = middle + rng.uniform(-_REACH, _REACH, (_BATCH, len(order))) * half
            aim = rng.uniform(-_AIM, _AIM, (_BATCH, 2)) * HALF_SOLE
            error = self._correct(tried, aim, ankle)
            within = ((tried >= lower) & (tried <= upper)).all(axis=1)
            found += list(tried[within & (error < _CLOSE)])
            if len(found) >= count:
                return np.array(found[:count])
        raise RuntimeError(f"Only {len(found)} of {count} postures are in balance.")

    def _correct(self, postures: Array, aim: Array, ankle: list[int]) -> Array:
        """Turns the ankle until centres of mass are over `aim`; the distances (N,) left, m."""
        order = joint_order(self.model)
        still = np.zeros_like(postures)

        def off(x: Array) -> Array:
            return self.zmp(x[:, order], still, still) - aim

        error = off(postures)
        for _ in range(_NEWTON):
            jacobian = np.empty((len(postures), 2, 2))
            for k, joint in enumerate(ankle):
                moved = postures.copy()
                moved[:, joint] += _STEP
                jacobian[:, :, k] = (off(moved) - error) / _STEP
            jacobian += 1e-9 * np.eye(2)
            step = np.linalg.solve(jacobian, error[..., None])[..., 0]
            postures[:, ankle] -= np.clip(step, -0.3, 0.3)
            error = off(postures)
        return np.asarray(np.linalg.norm(error, axis=1))

    def motion(self, rng: np.random.Generator) -> tuple[ExcitationTrajectory, float]:
        """A random motion in balance, from rest to rest, and its share out of the straight line."""
        inner = FAMILY.points - 4  # two free ends of three equal points each, less the ends
        along = np.clip((np.arange(FAMILY.points) - 2) / (FAMILY.points - 5), 0.0, 1.0)[:, None]
        for _ in range(_TRIES):
            postures = self.postures(rng, inner)
            straight = (1 - along) * postures[0] + along * postures[-1]
            detour = np.zeros_like(straight)
            detour[3:-3] = postures[1:-1] - straight[3:-3]
            for share in _SHARES:
                trajectory = ExcitationTrajectory(
                    FAMILY, straight + share * detour, self.model.joints, joint_order(self.model)
                )
                if self.keeps(trajectory):
                    return trajectory, float(share)
        raise RuntimeError("No random motion is in balance.")

    def keeps(self, trajectory: ExcitationTrajectory) -> bool:
        """Whether a motion keeps its zero-moment point in the sole, and speeds in their limits.

        Positions of a spline are between its points, which keep their limits.
        """
        motion = trajectory.motion(FAMILY.times(round(CHECK_RATE * FAMILY.length) + 1))
        if (np.abs(motion.v) > velocity_limits(self.model.plant)).any():
            return False
        zmp = self.zmp(motion.q, motion.v, motion.vd)
        return bool((np.abs(zmp) <= _MARGIN * HALF_SOLE).all())  # NaN is not
