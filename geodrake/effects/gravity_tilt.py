"""A base that is not level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import Array, Parameter, RobotMotion
from geodrake.effects.robot_effect import RobotEffect

_AXES = np.eye(3)[:2]


@dataclass(frozen=True)
class GravityTilt(RobotEffect):
    """Base that is turned by two small angles against what the model says.

    effort = ∂τ_g/∂g · (g × θ), for the base turned by θ = (θx, θy, 0) rad about the axes of the
    model's world frame. The effort is linear in gravity, and gravity g in small angles: of an angle
    θ it is wrong by θ²/2 of the weight. The bodies are those of the model; gravity is taken to be
    along z, about which a turn changes nothing.
    """

    name = "gravity_tilt"
    parameters = (
        Parameter("tilt_x", "rad", spread=1.0),
        Parameter("tilt_y", "rad", spread=1.0),
    )
    signature = "follows the robot's posture at all joints, as if it stood on a slope"
    sees_bodies = True
    confused_with = ("wrong_inertia", "payload", "joint_spring", "effort_offset")

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """Effort of the change of gravity that each angle makes, at every joint."""
        bodies = motion.body_motions(self.name)
        change = np.cross(bodies.gravity, _AXES).T
        columns = bodies.gravity_efforts() @ change
        return {joint: columns[:, i] for i, joint in enumerate(motion.joints)}
