"""Drag of the air on a body."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, contiguous
from geodrake.effects.base import Array, BodyEffect, Parameter, RobotMotion, Shape
from geodrake.effects.body_motion import RobotBodies
from geodrake.robot.vectors import add, column, cross, dot, scale, times, vector

_LEVER = "N·s²/m"
_LEAST_SPEED = 1e-150  # m/s, whose inverse is a number
_LEAST_STEP, _LARGEST_STEP = 1e-3, 2.0  # m, of the centre of pressure


@dataclass(frozen=True)
class AerodynamicDrag(BodyEffect):
    """Drag on a body that moves fast, or through water: force −d |v| v at its centre of pressure.

    effort = d Jᵀ |v| v, with v = J v_joints the velocity of the centre of pressure P, and d ≥ 0 in
    N·s²/m². How the effort changes with a step p of P is linear in d p as long as p is small, and
    d p, in N·s²/m, are parameters of their own.

    Attributes:
        x: Position of P from Bo along x of the body's frame, m, from which p is a step; None for
            that of the mass centre.
    """

    x: float | None = None
    y: float | None = None
    z: float | None = None

    name = "aerodynamic_drag"
    law = "d |v_B| v_B on a body, and its lever"
    list_position = 64
    shapes = tuple(Shape(axis, "m") for axis in "xyz")
    parameters = (
        Parameter("drag", "N·s²/m²", lower=0.0),
        *(Parameter(f"drag_lever_{axis}", _LEVER, spread=1e3) for axis in "xyz"),
    )
    signature = "grows with the square of a body's speed, at all joints up to it"
    depends_on = frozenset({"q", "v", "bodies"})
    expandable = True
    complexity = 3

    @classmethod
    def candidates(cls, body: str) -> tuple[AerodynamicDrag, ...]:
        """About the mass centre, and about the joint, too far away for slopes from there."""
        return cls(body), cls(body, 0.0, 0.0, 0.0)

    @property
    def free_shapes(self) -> int:
        """None: the position is a matter of the parameters."""
        return 0

    def center(self, p_BoBcm_B: Array) -> Array:
        """(3,) position of P from Bo, m.

        Args:
            p_BoBcm_B: (3,) that of the mass centre.
        """
        given = zip((self.x, self.y, self.z), p_BoBcm_B.tolist(), strict=True)
        return np.array([mean if value is None else value for value, mean in given])

    def expanded_about(self, parameters: Array, bodies: RobotBodies) -> AerodynamicDrag:
        """The drag about the centre of pressure that its parameters say; itself if that is here."""
        drag, lever = float(parameters[0]), parameters[1:]
        if not _LEAST_STEP * drag < np.linalg.norm(lever) < _LARGEST_STEP * drag:
            return self
        step = lever / drag
        x, y, z = (self.center(bodies.mass_center(self.body)) + step).tolist()
        return replace(self, x=x, y=y, z=z)

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[Jᵀ |v| v, and its slopes in the position of P] at the joints that move the body."""
        bodies = motion.body_motions(self.name)
        body = bodies.motion(self.body)
        center = self.center(bodies.mass_center(self.body))
        columns = np.zeros((len(motion.v), len(body.dofs), len(self.parameters)))
        parts = body.rotation, body.angular, body.linear
        calc_drag_columns(parts, contiguous(motion.v), np.array(body.dofs), center, columns)
        return {motion.joints[dof]: columns[:, k] for k, dof in enumerate(body.dofs)}

    def formula_rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """Return the same, along the Jacobian of P."""
        bodies = motion.body_motions(self.name)
        body = bodies.motion(self.body)
        J = body.jacobian_at(self.center(bodies.mass_center(self.body)))
        v = motion.v[..., None]
        u, w = (J @ v)[..., 0], (body.angular @ v)[..., 0]
        speed = np.sqrt((u * u).sum(-1))[:, None]
        along = u / np.maximum(speed, _LEAST_SPEED)
        forces, moments = [speed * u], [np.zeros_like(u)]
        for axis in range(3):
            step = body.rotation[:, :, axis]
            change = np.cross(w, step)
            forces.append(speed * change + (u * change).sum(-1)[:, None] * along)
            moments.append(np.cross(step, speed * u))
        force, moment = (np.stack(some, -1) for some in (forces, moments))
        turned = np.moveaxis(body.angular, 1, 2) @ moment
        columns = np.moveaxis(J, 1, 2) @ force + turned
        return {motion.joints[dof]: columns[:, dof] for dof in body.dofs}


@compiled
def calc_drag_columns(
    body: tuple[Array, Array, Array], v: Array, dofs: NDArray[np.int64], center: Array, out: Array
) -> None:
    """Writes [Jᵀ |v| v, and its slopes in the position of P] of the velocities that move a body.

    Args:
        body: R_WB (N, 3, 3), and the Jacobians (N, 3, nv) of ω and of the velocity of Bo, in W.
        v: (N, nv) velocities.
        dofs: (k,) those that move the body.
        center: (3,) p_BoP_B, m.
        out: (N, k, 4) the columns.
    """
    rotation, angular, linear = body
    for n in range(len(v)):
        R, arm = rotation[n], times(rotation[n], vector(center))
        w = u = (0.0, 0.0, 0.0)
        for dof in dofs:
            w = add(w, scale(v[n, dof], column(angular[n], dof)))
            u = add(u, scale(v[n, dof], column(linear[n], dof)))
        u = add(u, cross(w, arm))
        speed = np.sqrt(dot(u, u))
        force, along = scale(speed, u), scale(1.0 / max(speed, _LEAST_SPEED), u)
        moment = cross(arm, force)
        for k in range(len(dofs)):
            s, t = column(angular[n], dofs[k]), column(linear[n], dofs[k])
            out[n, k, 0] = dot(t, force) + dot(s, moment)
        for axis in range(3):
            step = column(R, axis)
            change = cross(w, step)
            slope = add(scale(speed, change), scale(dot(u, change), along))
            moment = add(cross(arm, slope), cross(step, force))
            for k in range(len(dofs)):
                s, t = column(angular[n], dofs[k]), column(linear[n], dofs[k])
                out[n, k, 1 + axis] = dot(t, slope) + dot(s, moment)
