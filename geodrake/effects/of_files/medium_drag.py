"""Drag of a medium on a body, as MuJoCo has it of a box."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import Array, BodyEffect, Parameter, RobotMotion, Shape
from geodrake.robot.files.values import rotation

_WIND = ("wind_x", "wind_y", "wind_z")


@dataclass(frozen=True)
class MediumDrag(BodyEffect):
    """Drag of air or water on a body that counts as the box with its inertia (MuJoCo, "Fluid").

    With v and ω of the box against the medium, along its axes, at its centre P, force and moment of
    a medium of density ρ and viscosity β are, for a box of sizes b and d = (b₁ + b₂ + b₃)/3,

        fᵢ = −½ ρ bⱼ bₖ |vᵢ| vᵢ − 3 π β d vᵢ
        gᵢ = −ρ bᵢ (bⱼ⁴ + bₖ⁴)/64 |ωᵢ| ωᵢ − π β d³ ωᵢ

    and effort = −J_Pᵀ f − J_ωᵀ g.

    Attributes:
        body: Name of the body.
        size_x: b₁, m; b₂ and b₃ follow.
        x: Position of P from Bo along x of the body's frame, m; y and z follow.
        turn_w: Real part of the quaternion of the box's axes in the body's frame; its vector
            follows.
        wind_x: Velocity of the medium along x of the world, m/s; y and z follow.
    """

    size_x: float = 1.0
    size_y: float = 1.0
    size_z: float = 1.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    turn_w: float = 1.0
    turn_x: float = 0.0
    turn_y: float = 0.0
    turn_z: float = 0.0
    wind_x: float = 0.0
    wind_y: float = 0.0
    wind_z: float = 0.0

    name = "medium_drag"
    law = "drag of a medium on a box: ρ of the squares of v and ω, β of v and ω"
    list_position = 104
    complexity = 3
    shapes = (
        *(Shape(name, "m") for name in ("size_x", "size_y", "size_z", "x", "y", "z")),
        *(Shape(f"turn_{axis}") for axis in "wxyz"),
        *(Shape(name, "m/s") for name in _WIND),
    )
    parameters = (
        Parameter("density", "kg/m³", lower=0.0),
        Parameter("viscosity", "Pa·s", lower=0.0),
    )
    signature = "grows with a body's speed and its square, at all joints up to it"
    depends_on = frozenset({"q", "v", "bodies"})

    @property
    def free_shapes(self) -> int:
        """None: the file says what the box is."""
        return 0

    @property
    def reported_shape(self) -> dict[str, float]:
        """None: the box is that of the body's inertia."""
        return {}

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """Columns of density and viscosity at the joints that move the body."""
        body = motion.body_motions(self.name).motion(self.body)
        J = body.jacobian_at(np.array([self.x, self.y, self.z]))
        turn = np.array([self.turn_w, self.turn_x, self.turn_y, self.turn_z])
        axes = np.moveaxis(body.rotation @ rotation(turn), 1, 2)
        speed = motion.v[..., None]
        wind = np.array([self.wind_x, self.wind_y, self.wind_z])
        v, w = axes @ ((J @ speed)[..., 0] - wind)[..., None], axes @ (body.angular @ speed)
        b = np.array([self.size_x, self.size_y, self.size_z])
        d, (j, k) = b.mean(), (np.roll(b, -1), np.roll(b, -2))
        force = np.concatenate([(0.5 * j * k)[:, None] * np.abs(v) * v, 3.0 * np.pi * d * v], -1)
        moment = np.concatenate(
            [(b * (j**4 + k**4) / 64.0)[:, None] * np.abs(w) * w, np.pi * d**3 * w], -1
        )
        along = np.moveaxis(axes @ J, 1, 2) @ force
        columns = along + np.moveaxis(axes @ body.angular, 1, 2) @ moment
        return {motion.joints[dof]: columns[:, dof] for dof in body.dofs}

    @classmethod
    def candidates(cls, body: str) -> Iterable[MediumDrag]:
        """None: a file states it."""
        return ()
