"""A weight that something else than the joints carries."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import Array, BodyEffect, Parameter, RobotMotion, Shape


@dataclass(frozen=True)
class CarriedWeight(BodyEffect):
    """Weight of a body that needs no effort: compensated gravity, buoyancy, gravity switched off.

    effort = m J_Pᵀ g, with the mass m in kg at the point P of the body and gravity g, against the
    weight −m J_Pᵀ g that the body has in the model.

    Attributes:
        body: Name of the body.
        x: Position of P from Bo along x of the body's frame, m.
        y: The same along y.
        z: The same along z.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    name = "carried_weight"
    law = "m Jᵀ g at a point of a body, against its weight"
    list_position = 103
    complexity = 3
    shapes = tuple(Shape(axis, "m") for axis in "xyz")
    parameters = (Parameter("mass", "kg"),)
    signature = "follows the posture at all joints up to a body, as if it weighed less"
    depends_on = frozenset({"q", "bodies"})

    @property
    def free_shapes(self) -> int:
        """None: the file says where the weight is carried."""
        return 0

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[J_Pᵀ g] at the joints that move the body."""
        bodies = motion.body_motions(self.name)
        body = bodies.motion(self.body)
        J = body.jacobian_at(np.array([self.x, self.y, self.z]))
        column = np.moveaxis(J, 1, 2) @ bodies.gravity
        return {motion.joints[dof]: column[:, dof, None] for dof in body.dofs}

    @classmethod
    def candidates(cls, body: str) -> Iterable[CarriedWeight]:
        """None: a file states it."""
        return ()
