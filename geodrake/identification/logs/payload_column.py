"""What known payloads need, as a column beside those of effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from geodrake.effects.base import Array, Parameter
from geodrake.effects.robot_effect import RobotEffect
from geodrake.effects.robot_motion import RobotMotion, log_number
from geodrake.logs.motion import JointLog
from geodrake.model.carried_payloads import carried_phi
from geodrake.model.robot_model import RobotModel


@dataclass(frozen=True, eq=False)
class CarriedBodies:
    """What the robot carries in several logs.

    Attributes:
        bodies: Names of the bodies (nb) that move.
        phi: Number of a log -> (nb, 10) inertial parameters of what is carried.
    """

    bodies: tuple[str, ...] = ()
    phi: Mapping[int, Array] = field(default_factory=dict)

    @classmethod
    def of(cls, model: RobotModel, logs: Sequence[JointLog]) -> CarriedBodies:
        """What is known to be carried in logs.

        Args:
            model: The model of the robot.
            logs: The logs, with their known payloads.
        """
        known = {log_number(log.name): carried_phi(model, log.payloads) for log in logs}
        return cls(model.bodies, known)


@dataclass(frozen=True)
class CarriedColumn(RobotEffect):
    """The effort that known payloads of a log need.

    It is no effect of the robot, but a column of logs beside those of effects: where the gains of
    efforts are not known, it cannot be taken off what was measured.
    """

    carried: CarriedBodies = field(default_factory=CarriedBodies)

    name = "carried"
    parameters = (Parameter("share", "1"),)
    depends_on = frozenset({"q", "v", "vd", "bodies"})

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """The column (N, 1) at every joint."""
        effort = np.zeros_like(motion.v)
        phi = self.carried.phi.get(motion.log)
        for body, own in zip(self.carried.bodies, () if phi is None else phi, strict=False):
            if own.any():
                effort += motion.body_columns(body) @ own
        return {joint: effort[:, j : j + 1] for j, joint in enumerate(motion.joints)}
