"""Effects of a robot's environment: a tilted base, contacts, and air."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from geodrake.compiling import compiled
from geodrake.effects.base import (
    Array,
    BodyEffect,
    Effect,
    Parameter,
    RobotEffect,
    RobotMotion,
    Rows,
    Shape,
)
from geodrake.effects.body_motion import BodyMotion, RobotBodies
from geodrake.effects.episode import PointEpisode
from geodrake.robot.kinematics import actuator_rows
from geodrake.robot.vectors import add, cross, dot, put_row, row, scale, subtract

_LEAST_CHANGE = 1e-4  # of the weight
_FAR = 2.0  # rad


@dataclass(frozen=True)
class GravityTilt(RobotEffect):
    """Base that is tilted by two angles relative to the model.

    effort = ∂τ_g/∂g · (R(θ)ᵀ g − g), for the base turned by the rotation vector θ = (θx, θy, 0) rad
    about the axes of the model's world frame. The effort is linear in gravity, and

        R(θ)ᵀ g − g = sin|θ|/|θ| g × θ + (1 − cos|θ|)/|θ|² (θ θᵀg − g θᵀθ)

    becomes linear in θ if `about` replaces one θ of each product, which is exact at θ = `about`.
    About zero the error is |θ|²/2 of the weight. Near upside down, gravity hardly changes with θ in
    one direction. Fits about rotations of more than 2 rad therefore use a further rotation δ,
    R = R(δ) R(about). The columns use the model's bodies. Fits evaluate body columns under the
    gravity at `about`, which reveals moments that a level base hides. Gravity is assumed to be
    along z, so that rotations about z have no effect.

    Attributes:
        about_x: Angle about x at which the columns are exact, rad.
    """

    about_x: float = 0.0
    about_y: float = 0.0

    name = "gravity_tilt"
    law = "the base stands on a slope: two angles"
    complexity = 1
    shapes = (Shape("about_x", "rad"), Shape("about_y", "rad"))
    parameters = (
        Parameter("tilt_x", "rad", spread=1.0),
        Parameter("tilt_y", "rad", spread=1.0),
    )
    signature = "follows the robot's posture at all joints, as if it stood on a slope"
    depends_on = frozenset({"q", "bodies"})
    free_shapes = 0  # the angles are parameters

    @property
    def reported_shape(self) -> dict[str, float]:
        """Empty: the expansion point is not a property of the robot."""
        return {}

    def expanded_about(self, parameters: Array, bodies: RobotBodies) -> GravityTilt:
        """Return the tilt expanded about its parameters; itself if the change is negligible."""
        if self._is_far:
            turned, turn = self._turned(parameters, bodies.gravity), parameters - self.in_bodies
            return turned if np.linalg.norm(turn) >= _LEAST_CHANGE else self
        step = np.linalg.norm(parameters - self._about[:2])
        if step * max(np.linalg.norm(parameters), step) < _LEAST_CHANGE:
            return self
        about_x, about_y = parameters.tolist()
        return replace(self, about_x=about_x, about_y=about_y)

    def _turned(self, parameters: Array, gravity: Array) -> GravityTilt:
        """Return the tilt after a further rotation."""
        turn = np.append(parameters - self.in_bodies, 0.0)
        tilted = self._rotation.T @ Rotation.from_rotvec(turn).as_matrix().T @ gravity
        axis, cosine = np.cross(tilted, gravity), float(tilted @ gravity)
        sine = float(np.linalg.norm(axis))
        direction = self._about / np.linalg.norm(self._about) if sine == 0.0 else axis / sine
        about_x, about_y, _ = (np.arctan2(sine, cosine) * direction).tolist()
        return replace(self, about_x=about_x, about_y=about_y)

    def fit_rows(self, motion: RobotMotion) -> Rows:
        """Return `rows`, or the columns of a further rotation if far from level."""
        if not self._is_far:
            return self.rows(motion)
        gravity = motion.body_motions(self.name).gravity
        return self._rows(motion, self._rotation.T @ np.cross(gravity, np.eye(3)[:2]).T)

    def settled(self, parameters: Array, bodies: RobotBodies) -> tuple[Effect, Array]:
        """Return the tilt and its angles, including the further rotation if far from level."""
        if not self._is_far:
            return self, parameters
        turned = self._turned(parameters, bodies.gravity)
        return turned, turned.in_bodies

    @property
    def _is_far(self) -> bool:
        return bool(np.linalg.norm(self._about) > _FAR)

    @property
    def _rotation(self) -> Array:
        return np.asarray(Rotation.from_rotvec(self._about).as_matrix())

    def gravity_of_bodies(self, gravity: Array) -> Array | None:
        """Return the gravity turned by the angles at which the columns are exact."""
        angles = self.in_bodies
        return gravity + self._change(gravity) @ angles if angles.any() else None

    @property
    def in_bodies(self) -> Array:
        """(2,) angles at which the columns are exact, rad."""
        return self._about[:2]

    @property
    def _about(self) -> Array:
        return np.array([self.about_x, self.about_y, 0.0])

    def rows(self, motion: RobotMotion) -> Rows:
        """Return the derivatives of the effort with respect to both angles, at every joint."""
        return self._rows(motion, self._change(motion.body_motions(self.name).gravity))

    def _rows(self, motion: RobotMotion, change: Array) -> Rows:
        """Return the efforts of changes of gravity (3, 2), m/s²."""
        columns = motion.body_motions(self.name).gravity_efforts(change)
        return {joint: columns[:, i] for i, joint in enumerate(motion.joints)}

    def formula_rows(self, motion: RobotMotion) -> Rows:
        """Return `rows`, computed from the weights and Jacobians of all bodies."""
        bodies = motion.body_motions(self.name)
        change = self._change(bodies.gravity)
        columns: Array = np.zeros((len(motion.joints), 2))
        for mobilizer in bodies.tree.joints.mobilizers:
            m, *h = bodies.phi[mobilizer.body, :4].tolist() if mobilizer.body >= 0 else (0.0,)
            if m > 0.0 and mobilizer.gravity:
                body = bodies.motion(bodies.tree.bodies[mobilizer.body])
                J = body.jacobian_at(np.array(h) / m)[0]
                columns = columns - m * (J.T @ change)
        return {joint: columns[None, i] for i, joint in enumerate(motion.joints)}

    def _change(self, gravity: Array) -> Array:
        """Return (3, 2) change of gravity per radian, m/s²."""
        about, axes = self._about, np.eye(3)[:2]
        angle = np.linalg.norm(about)
        first = np.sinc(angle / np.pi)
        second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
        products = axes * (about @ gravity) - np.outer(axes @ about, gravity)
        return np.asarray(first * np.cross(gravity, axes) + second * products).T


@dataclass(frozen=True)
class Contact(PointEpisode):
    """Contact of a body during a time window.

    effort = w(t) (J_vᵀ f + J_ωᵀ m), with the weight w of the window (see `Episode`).

    f (N) is the force that the body applies to its environment at point P, and m (N·m) the moment
    about P. The environment applies −f. Both are constant in the world frame, as when leaning on
    something heavy, or in the body's frame, as for a tool or a jet.
    """

    name = "contact"
    law = "Jᵀ F of a wrench on a body during an episode, found in the residual"
    complexity = 3
    parameters = (
        *(Parameter(f"force_{axis}", "N") for axis in "xyz"),
        *(Parameter(f"moment_{axis}", "N·m") for axis in "xyz"),
    )
    signature = "at several joints at once, for a limited time"
    depends_on = frozenset({"q", "time", "bodies"})

    def columns(self, body: BodyMotion, time: Array) -> Array:
        """[w J_vᵀ, w J_ωᵀ] (N, nv, 6) at point P and times (N,) since the log began, s."""
        J = np.stack([body.jacobian_at(self.point), body.angular], 1)  # (N, 2, 3, nv)
        if self.turning:
            J = body.rotation[:, None].transpose(0, 1, 3, 2) @ J
        columns = J.reshape(len(J), 6, J.shape[-1]).transpose(0, 2, 1)
        return np.asarray(self.weight(time)[:, None, None] * columns)


_LEVER = "N·s²/m"
_LEAST_SPEED = 1e-150  # m/s, so that its inverse is finite
_LEAST_STEP, _LARGEST_STEP = 1e-3, 2.0  # m, of the centre of pressure


@dataclass(frozen=True)
class AerodynamicDrag(BodyEffect):
    """Drag on a body that moves fast, or through water: force −d |v| v at its centre of pressure.

    effort = d Jᵀ |v| v, with v = J v_joints the velocity of the centre of pressure P, and d ≥ 0 in
    N·s²/m². A small displacement p of P changes the effort linearly in d p, so that the products
    d p, in N·s²/m, are further parameters.

    Attributes:
        x: Position of P from Bo along x of the body's frame before the displacement, m; None for
            that of the mass centre.
    """

    x: float | None = None
    y: float | None = None
    z: float | None = None

    name = "aerodynamic_drag"
    law = "d |v_B| v_B on a body, and its lever"
    shapes = tuple(Shape(axis, "m") for axis in "xyz")
    parameters = (
        Parameter("drag", "N·s²/m²", lower=0.0),
        *(Parameter(f"drag_lever_{axis}", _LEVER, spread=1e3) for axis in "xyz"),
    )
    signature = "grows with the square of a body's speed, at all joints up to it"
    depends_on = frozenset({"q", "v", "bodies"})
    complexity = 3
    free_shapes = 0  # the parameters determine the position

    @classmethod
    def candidates(cls, body: str) -> tuple[AerodynamicDrag, ...]:
        """Return the drag at the mass centre and at the joint, too far apart to linearize."""
        return cls(body), cls(body, 0.0, 0.0, 0.0)

    def center(self, p_BoBcm_B: Array) -> Array:
        """Return (3,) position of P from Bo, m, given that of the mass centre."""
        pairs = zip((self.x, self.y, self.z), p_BoBcm_B.tolist(), strict=True)
        return np.array([default if value is None else value for value, default in pairs])

    def expanded_about(self, parameters: Array, bodies: RobotBodies) -> AerodynamicDrag:
        """Return the drag at its fitted centre of pressure; itself if that did not move."""
        drag, lever = float(parameters[0]), parameters[1:]
        if not _LEAST_STEP * drag < np.linalg.norm(lever) < _LARGEST_STEP * drag:
            return self
        step = lever / drag
        x, y, z = (self.center(bodies.mass_center(self.body)) + step).tolist()
        return replace(self, x=x, y=y, z=z)

    def rows(self, motion: RobotMotion) -> Rows:
        """Return [Jᵀ |v| v, its derivatives by the position of P] at the joints of the body."""
        bodies = motion.body_motions(self.name)
        center, tree = self.center(bodies.mass_center(self.body)), bodies.tree
        key = AerodynamicDrag, ""
        samples = motion.once(key, lambda: tree.joint_samples(bodies.q, motion.v, motion.v))
        (joints, (_, v, _, _), J), body = samples, bodies.index(self.body)
        i = [mobilizer.body for mobilizer in joints.mobilizers].index(body)
        efforts, dofs = np.zeros((v.shape[1], 4, len(v))), joints.mobilizers[i].dofs
        calc_drag_columns(bodies.places, (i, np.array(dofs), center), v, efforts)
        columns = actuator_rows(J, np.moveaxis(efforts, -1, 0))
        return {motion.joints[dof]: columns[:, dof] for dof in tree.moving_velocities(dofs)}

    def formula_rows(self, motion: RobotMotion) -> Rows:
        """Return `rows`, computed from the Jacobian of P."""
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
        force, moment = np.stack(forces, -1), np.stack(moments, -1)
        turned = np.moveaxis(body.angular, 1, 2) @ moment
        columns = np.moveaxis(J, 1, 2) @ force + turned
        return {motion.joints[dof]: columns[:, dof] for dof in body.dofs}


@compiled
def calc_drag_columns(
    places: tuple[Array, Array],
    body: tuple[int, NDArray[np.int64], Array],
    v: Array,
    out: Array,
) -> None:
    """Write [Jᵀ |v| v, its derivatives by the position of P] for the velocities that move a body.

    Args:
        places: `RobotBodies.places`.
        body: Index of its mobilizer, velocities that move it, the mobilizer's last, and (3,)
            p_BoP_B, m.
        v: (N, nv) velocities of the joints.
        out: (nv, 4, N) columns.
    """
    (rotations, lines), (i, dofs, center) = places, body
    R, origins = rotations[i], lines[dofs[-1]]
    moving = np.empty((2, len(out), 3))  # ω of B and velocity of P at unit speeds
    for n in range(len(v)):
        p, w, u = row(origins, n, 2), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for axis in range(3):
            p = add(p, scale(center[axis], row(R, n, axis)))
        for k in dofs:
            s = row(lines[k], n, 0)
            t = add(row(lines[k], n, 1), cross(s, subtract(p, row(lines[k], n, 2))))
            w, u = add(w, scale(v[n, k], s)), add(u, scale(v[n, k], t))
            put_row(moving, 0, k, s)
            put_row(moving, 1, k, t)
        speed = np.sqrt(dot(u, u))
        force, along = scale(speed, u), scale(1.0 / max(speed, _LEAST_SPEED), u)
        for k in dofs:
            out[k, 0, n] = dot(row(moving, 1, k), force)
        for axis in range(3):
            arm = row(R, n, axis)
            change, moment = cross(w, arm), cross(arm, force)
            slope = add(scale(speed, change), scale(dot(u, change), along))
            for k in dofs:
                out[k, 1 + axis, n] = dot(row(moving, 1, k), slope) + dot(row(moving, 0, k), moment)
