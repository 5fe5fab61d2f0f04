"""A base that is not level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from geodrake.effects.base import Array, Parameter, RobotMotion, Shape
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.robot_effect import RobotEffect
from geodrake.robot.driven_tree import joint_tree

_LEAST_CHANGE = 1e-4  # of the weight


@dataclass(frozen=True)
class GravityTilt(RobotEffect):
    """Base that is turned by two angles against what the model says.

    effort = ∂τ_g/∂g · (R(θ)ᵀ g − g), for the base turned by the rotation vector θ = (θx, θy, 0) rad
    about the axes of the model's world frame. The effort is linear in gravity, and gravity

        R(θ)ᵀ g − g = sin|θ|/|θ| g × θ + (1 − cos|θ|)/|θ|² (θ θᵀg − g θᵀθ)

    linear in θ with `about` in the place of one θ of each product: exact where θ is `about`. About
    zero it is wrong by |θ|²/2 of the weight. The bodies are those of the model; fits see others
    under the gravity of `about`: moments that a level base hides show only there. Gravity is taken
    to be along z, about which a turn changes nothing.

    Attributes:
        about_x: Angle about x at which the columns are exact, rad.
    """

    about_x: float = 0.0
    about_y: float = 0.0

    name = "gravity_tilt"
    law = "the base stands on a slope: two angles"
    list_position = 62
    complexity = 1
    shapes = (Shape("about_x", "rad"), Shape("about_y", "rad"))
    parameters = (
        Parameter("tilt_x", "rad", spread=1.0),
        Parameter("tilt_y", "rad", spread=1.0),
    )
    signature = "follows the robot's posture at all joints, as if it stood on a slope"
    depends_on = frozenset({"q", "bodies"})
    expandable = True

    @property
    def free_shapes(self) -> int:
        """None: the angles are parameters."""
        return 0

    @property
    def reported_shape(self) -> dict[str, float]:
        """None: where the columns are exact is no property of the robot."""
        return {}

    def expanded_about(self, parameters: Array, bodies: RobotBodies) -> GravityTilt:
        """The tilt with columns that are exact at its parameters; itself if they are so already."""
        del bodies
        step = np.linalg.norm(parameters - self._about[:2])
        if step * max(np.linalg.norm(parameters), step) < _LEAST_CHANGE:
            return self
        about_x, about_y = parameters.tolist()
        return replace(self, about_x=about_x, about_y=about_y)

    def gravity_of_bodies(self, gravity: Array) -> Array | None:
        """Gravity turned by the angles at which the columns are exact."""
        at = self.in_bodies
        return gravity + self._change(gravity) @ at if at.any() else None

    @property
    def in_bodies(self) -> Array:
        """(2,) these angles."""
        return self._about[:2]

    @property
    def _about(self) -> Array:
        return np.array([self.about_x, self.about_y, 0.0])

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """Effort of the change of gravity that each angle makes, at every joint."""
        bodies = motion.body_motions(self.name)
        columns = bodies.gravity_efforts(self._change(bodies.gravity))
        return {joint: columns[:, i] for i, joint in enumerate(motion.joints)}

    def formula_rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """The same, as the weights of all bodies along their Jacobians."""
        bodies = motion.body_motions(self.name)
        change = self._change(bodies.gravity)
        columns: Array = np.zeros((len(motion.joints), 2))
        for mobilizer in joint_tree(bodies.tree).mobilizers:
            m, *h = bodies.phi[mobilizer.body, :4].tolist() if mobilizer.body >= 0 else (0.0,)
            if m > 0.0 and mobilizer.gravity:
                body = bodies.motion(bodies.tree.bodies[mobilizer.body])
                J = body.jacobian_at(np.array(h) / m)[0]
                columns = columns - m * (J.T @ change)
        return {joint: columns[None, i] for i, joint in enumerate(motion.joints)}

    def _change(self, gravity: Array) -> Array:
        """(3, 2) change of gravity for each radian, m/s²."""
        about, axes = self._about, np.eye(3)[:2]
        angle = np.linalg.norm(about)
        first = np.sinc(angle / np.pi)
        second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
        products = axes * (about @ gravity) - np.outer(axes @ about, gravity)
        return np.asarray(first * np.cross(gravity, axes) + second * products).T
