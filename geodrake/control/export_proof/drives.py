"""What actuators of a simulated robot make of their control signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.model.exporting.joints import exported_joints
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Drives:
    """Servos and motors of n joints; all (n,).

    Attributes:
        stiffness: Of servos that are told positions; 0 at joints that are told efforts.
        damping: Of servos, on the velocity.
        delay: By how much what they are told acts late, s.
    """

    stiffness: Array
    damping: Array
    delay: Array

    @staticmethod
    def of(model: RobotModel, joints: Sequence[str]) -> Drives:
        """The actuators of a model's joints, where a simulator has them.

        Args:
            joints: Joints that are driven by actuators; the others are told efforts at once.
        """
        known = {name: each for name, each in exported_joints(model).items() if name in joints}
        rows = [
            (a.kp, a.kd, a.delay) if (a := known.get(joint)) else (0.0, 0.0, 0.0)
            for joint in model.joints
        ]
        return Drives(*np.array(rows, float).reshape(-1, 3).T)

    def controls(self, q: Array, effort: Array) -> Array:
        """Control signals (K, n): efforts, and positions at which servos pull with them from q.

        Args:
            q: (n,) positions, rad or m.
            effort: (K, n) efforts, N·m or N.
        """
        servo = self.stiffness > 0.0
        return np.where(servo, q + effort / np.where(servo, self.stiffness, 1.0), effort)

    def effort(self, told: Array, q: Array, v: Array) -> Array:
        """Efforts (W, n) of what is told.

        Args:
            told: (W, n) positions or efforts that have come through.
            q: (W, n) positions, rad or m.
            v: (W, n) velocities.
        """
        servo = self.stiffness > 0.0
        return np.where(servo, self.stiffness * (told - q) - self.damping * v, told)

    def told(self, controls: Array, k: int, share: float, step: float) -> Array:
        """What (W, n) has come through at an instant of a step.

        Late signals are straight lines between those at the beginnings of steps; before the first
        one, all are like it.

        Args:
            controls: (W, K, n) control signals, each held for a step.
            step: Length of a step, s.
        """
        at = np.where(self.delay > 0.0, np.clip(k + share - self.delay / step, 0.0, k), k)
        first, joints = at.astype(int), np.arange(len(at))
        after = np.minimum(first + 1, k)
        early, late = controls[:, first, joints], controls[:, after, joints]
        return np.asarray(early + (at - first) * (late - early))
