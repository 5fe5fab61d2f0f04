"""A spring and a damper between two points."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from geodrake.effects.base import Array, Effect, Parameter, RobotMotion, Shape
from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import ArgumentError

_WORLD = "world"
_LEAST_LENGTH = 1e-150  # m, whose inverse is a number


@dataclass(frozen=True)
class Strut(Effect):
    """Spring and damper between a point P of a body and a point Q of another one, or of the world.

    With L the distance of the two, effort = (k L + p + d L̇) ∂L/∂q: a counterbalance or a gas spring
    of stiffness k in N/m, preload p = −k L₀ in N and damping d in N·s/m.

    Attributes:
        bodies: Names of the two bodies; "world" for what stands still.
        x: Position of P from Bo along x of the first body's frame, m; y and z follow.
        other_x: The same of Q in the frame of the second body.
    """

    bodies: tuple[str, str]
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    other_x: float = 0.0
    other_y: float = 0.0
    other_z: float = 0.0

    name = "strut"
    law = "(k L + p + d L̇) ∂L/∂q, L the distance of two points"
    places: ClassVar[str] = "body_pair"
    list_position = 105
    complexity = 3
    shapes = tuple(Shape(name, "m") for name in ("x", "y", "z", "other_x", "other_y", "other_z"))
    parameters = (
        Parameter("stiffness", "N/m", lower=0.0),
        Parameter("preload", "N"),
        Parameter("damping", "N·s/m", lower=0.0),
    )
    signature = "follows the posture at all joints between two bodies"
    depends_on = frozenset({"q", "v", "bodies"})

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.bodies) != 2 or self.bodies[0] == self.bodies[1]:
            raise ArgumentError(f"{self.name} needs two different bodies; it got {self.bodies}.")

    @property
    def where(self) -> tuple[str, ...]:
        """Return the two bodies."""
        return self.bodies

    @property
    def free_shapes(self) -> int:
        """None: the file says where the points are."""
        return 0

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """Columns of stiffness, preload and damping at the joints that move either body."""
        bodies = motion.body_motions(self.name)
        points = ([self.x, self.y, self.z], [self.other_x, self.other_y, self.other_z])
        (p, J, first), (other_p, other_J, second) = (
            _point(bodies, body, np.array(point))
            for body, point in zip(self.bodies, points, strict=True)
        )
        apart, moving = other_p - p, other_J - J
        length = np.sqrt((apart * apart).sum(-1))[:, None]
        along = (apart / np.maximum(length, _LEAST_LENGTH))[:, None, :]
        slope = (along @ moving)[:, 0]
        rate = (slope * motion.v).sum(-1)[:, None]
        dofs = sorted({*first, *second})
        return {
            motion.joints[dof]: np.stack(
                [slope[:, dof] * length[:, 0], slope[:, dof], slope[:, dof] * rate[:, 0]], -1
            )
            for dof in dofs
        }

    @classmethod
    def candidates(cls, bodies: tuple[str, str]) -> Iterable[Strut]:
        """None: a file states it."""
        return ()


def _point(bodies: RobotBodies, body: str, p_BoP_B: Array) -> tuple[Array, Array, tuple[int, ...]]:
    """Return the position (N, 3) of a point of a body, its Jacobian, and what moves it."""
    if body == _WORLD:
        return p_BoP_B[None], np.zeros((1, 3, bodies.tree.num_velocities)), ()
    motion = bodies.motion(body)
    return motion.position + motion.rotation @ p_BoP_B, motion.jacobian_at(p_BoP_B), motion.dofs
