"""Logs of robots that nothing fixes to the world: poses, IMUs, wrenches and contacts as joints say.

A base has six joints (`geodrake.robot.base_joints`). Its pose gives their positions, an IMU their
accelerations: the specific force f turned into the world, R f + g, whatever R is off, as bodies
then feel f itself. Wrenches that were measured at frames are efforts, Σ Jᵀ w of base and joints
alike. Where none was measured, frames in contact are kept for the fit, which does without theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import LogError
from geodrake.inertia.bodies import lumped_bodies
from geodrake.logs.floating import FLAG, FORCE, ContactFlags, frames_of, vectors
from geodrake.logs.motion import GROUND, JointLog
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_NORM = 0.02  # by which a quaternion may not be of length one
_UPRIGHT = np.radians(80.0)  # of pitch, beyond which yaw and roll are nearly one
_TILT = 0.5  # rad, by which gravity may seem to be off its place on average
_NEAR = 0.02  # m over the ground, within which a frame may touch it
_LOWEST = 5.0  # per cent of the lowest heights, which are those of the ground
_UNLIKE = 0.2  # of the weight, by which mean forces at feet may be off it unasked
_ADVICE = "Log base.position.x … and base.orientation.w …, or imu.angular_velocity.x … and so on."


@dataclass(frozen=True)
class ContactFrame:
    """A frame that may touch something: a ball about its origin, or a point.

    Attributes:
        body: Name of the body that the frame is fixed to.
        place: (3,) p_BoFo_B of its center, m.
        rotation: (3, 3) R_BF.
        radius: Of the ball, m.
    """

    name: str
    body: str
    place: Array
    rotation: Array
    radius: float = 0.0

    def jacobian(self, bodies: RobotBodies) -> Array:
        """(N, 3, nv) Jacobian, in W, of the lowest point of the ball, where it touches."""
        motion = bodies.motion(self.body)
        arm = motion.rotation @ self.place - self.radius * _up(bodies.gravity)
        return motion.linear + np.cross(motion.angular, arm[:, :, None], axis=1)

    def height(self, bodies: RobotBodies) -> Array:
        """(N,) height of the lowest point of the ball over the world's origin, m."""
        motion = bodies.motion(self.body)
        return (motion.position + motion.rotation @ self.place) @ _up(bodies.gravity) - self.radius


def _up(gravity: Array) -> Array:
    return -gravity / max(float(np.linalg.norm(gravity)), 1e-12)


def contact_frames(model: RobotModel, names: Sequence[str]) -> tuple[ContactFrame, ...]:
    """Return frames of a model by the names of links, with the balls that its file has there.

    Raises:
        LogError: The model has no such link.
    """
    links = {
        member.name: (lump.name, member.X_RB)
        for lump in lumped_bodies(model.plant)
        for member in lump.members
    }
    found = []
    for name in names:
        if name not in links:
            raise LogError(
                f"The model has no link {name!r}, of which the log has a contact or a force.",
                advice=f"Links are: {', '.join(links)}.",
            )
        body, X_RB = links[name]
        center, radius = _ball(model, name)
        place = X_RB.multiply(center)
        found.append(ContactFrame(name, body, place, X_RB.rotation().matrix(), radius))
    return tuple(found)


def frame_heights(frames: Sequence[ContactFrame], bodies: RobotBodies) -> Array:
    """Return (N, c) heights of frames over the ground, which is where the lowest often are, m."""
    heights = np.stack([frame.height(bodies) for frame in frames], -1)
    return np.asarray(heights - np.percentile(heights.min(axis=1), _LOWEST))


def may_touch(heights: Array) -> NDArray[np.bool_]:
    """Return (N, c) whether frames are as low as if they touched the ground."""
    return np.asarray(heights < _NEAR)


def _ball(model: RobotModel, link: str) -> tuple[Array, float]:
    """Center, in the link, and radius of the collision sphere that a URDF gives a link."""
    center, radius = np.zeros(3), 0.0
    if model.path.suffix != ".urdf" or not model.path.is_file():
        return center, radius
    root = ElementTree.parse(model.path).getroot()
    for element in root.iterfind("link"):
        balls = [c for c in element.iterfind("collision") if c.find("geometry/sphere") is not None]
        if element.get("name") == link and len(balls) == 1:
            origin = balls[0].find("origin")
            radius = max(float(s.get("radius", "0")) for s in balls[0].iterfind("geometry/sphere"))
            if origin is not None:
                center = np.array([float(x) for x in origin.get("xyz", "0 0 0").split()])
    return center, radius


def with_base(log: JointLog, model: RobotModel) -> JointLog:
    """Return a log with the six joints of a floating model's base; itself if the model has none.

    Raises:
        LogError: The log has neither a pose of the base nor an IMU, or they cannot be.
    """
    joints = model.base_joints
    if not joints and any(name.startswith("base.") for name in log.floating):
        words = "has the pose of a free base, and the model is fixed: --floating frees it"
        return log if words in log.notes else replace(log, notes=(*log.notes, words))
    if not joints or set(joints) <= set(log.joints):
        return log
    if len(joints) > 6:
        raise LogError(
            f"The model has {len(joints) // 6} free bases; logs are of one.",
            advice="Choose one robot: --robot NAME.",
        )
    position, velocity, acceleration = _base_motion(log, model)
    count, empty = len(log), np.full((len(log), len(log.joints)), np.nan)
    notes = list(log.notes)
    own_velocity = None
    if log.velocity is not None:
        rates = velocity if velocity is not None else np.gradient(position, log.time, axis=0)
        own_velocity = np.hstack([log.velocity, rates])
    measured = tuple(joints) if acceleration is not None else ()
    if acceleration is None:
        notes.append("accelerations of the base are derived from its pose; an IMU is better")
    padded: dict[str, Any] = {
        name: np.hstack([values, np.full((count, 6), np.nan)])
        for name in ("command", "temperature")
        if (values := getattr(log, name)) is not None
    }
    uncertainty = np.append(log.gain_deviations, np.zeros(6))
    found = replace(
        log,
        joints=(*log.joints, *joints),
        position=np.hstack([log.position, position]),
        effort=np.hstack([log.effort, np.zeros((count, 6))]),
        velocity=own_velocity,
        acceleration=None if acceleration is None else np.hstack([empty, acceleration]),
        measured=measured,
        effort_kinds={**log.effort_kinds, **dict.fromkeys(joints, GROUND)},
        effort_uncertainty=uncertainty,
        notes=tuple(notes),
        **padded,
    )
    return _with_ground(found, model)


def _base_motion(log: JointLog, model: RobotModel) -> tuple[Array, Array | None, Array | None]:
    """Positions (N, 6), and velocities and accelerations (N, 6) where they are measured."""
    columns, time = log.floating, log.time
    place, quaternion = vectors(columns, "base.position"), vectors(columns, "base.orientation")
    gyro = vectors(columns, "imu.angular_velocity")
    force = vectors(columns, "imu.linear_acceleration")
    spin = gyro if gyro is not None else vectors(columns, "base.angular_velocity")
    g = model.tree.gravity
    if quaternion is not None:
        quaternion = _checked(quaternion, force, g, log.name)
        known = np.asarray(np.isfinite(quaternion).all(axis=1))
        turn = Rotation.from_quat(
            np.where(known[:, None], quaternion, [1.0, 0, 0, 0])[:, [1, 2, 3, 0]]
        )
    elif gyro is not None and force is not None:
        turn, known = _integrated(time, gyro, force, g, log.name), np.ones(len(log), bool)
    else:
        raise LogError(
            f"Log {log.name!r} has no orientation of the base and no IMU, and the model floats.",
            advice=f"{_ADVICE} Of a robot that is fixed to the world leave --floating out.",
        )
    if not known.any():
        raise LogError(
            f"No row of log {log.name!r} has the orientation of the base.",
            advice=_ADVICE,
        )
    R = turn.as_matrix()
    pitch = np.abs(np.arcsin(np.clip(R[known, 2, 0], -1.0, 1.0)))
    if pitch.max() > _UPRIGHT:
        worst = float(np.degrees(pitch.max()))
        raise LogError(
            f"The base of log {log.name!r} pitches by up to {worst:.0f}°, where yaw and roll are "
            "one: such motions are not read.",
            advice="Leave that part of the log out; is the quaternion w, x, y, z, body to world?",
        )
    angles = np.full((len(log), 3), np.nan)
    angles[known] = np.unwrap(turn[known].as_euler("ZYX"), axis=0)
    rates, accelerations = None, None
    if spin is not None:
        rates = _euler_rates(angles, spin)
    if force is not None:
        linear = np.einsum("nij,nj->ni", R, force) + g
        angular = _slope(time, rates if rates is not None else _slope(time, angles))
        accelerations = np.hstack([linear, angular])
    if place is None:
        place = np.zeros((len(log), 3))
        if accelerations is not None:  # whose drift is no matter to the dynamics
            speed = _integral(time, accelerations[:, :3] - accelerations[:, :3].mean(axis=0))
            place = _integral(time, speed - speed.mean(axis=0))
    velocity = None
    linear_velocity = vectors(columns, "base.linear_velocity")
    if rates is not None and linear_velocity is not None:
        velocity = np.hstack([np.einsum("nij,nj->ni", R, linear_velocity), rates])
    return np.hstack([place, angles]), velocity, accelerations


def _checked(quaternion: Array, force: Array | None, gravity: Array, name: str) -> Array:
    """Quaternions (N, 4) w, x, y, z of length one."""
    length = np.linalg.norm(quaternion, axis=1)
    wrong = np.abs(length - 1.0)
    if np.nanmax(wrong, initial=0.0) > _NORM:
        row = int(np.nanargmax(wrong))
        raise LogError(
            f"The orientation of log {name!r} is no quaternion of length one in row {row + 1}: "
            f"{np.array2string(quaternion[row], precision=4)} has {length[row]:.4g}.",
            advice="Log base.orientation.w, .x, .y and .z of the root body in the world.",
        )
    if force is None:
        return np.asarray(quaternion / length[:, None])

    known = np.isfinite(quaternion).all(axis=1) & np.isfinite(force).all(axis=1)

    def off(order: Sequence[int], power: int = 1) -> float:
        turn = Rotation.from_quat(quaternion[known][:, order]) ** power
        mean = turn.apply(force[known]).mean(axis=0)
        share = mean @ _up(gravity) / max(float(np.linalg.norm(mean)), 1e-12)
        return float(np.arccos(np.clip(share, -1.0, 1.0)))

    if known.any() and (given := off([1, 2, 3, 0])) > _TILT:
        others = {
            "its columns hold x, y, z, w": off([0, 1, 2, 3]),
            "it turns the world into the body": off([1, 2, 3, 0], -1),
        }
        best = min(others, key=others.__getitem__)
        hint = f" Upright it would be if {best}." if others[best] < _TILT else ""
        raise LogError(
            f"By its orientation, the IMU of log {name!r} feels gravity {np.degrees(given):.0f}° "
            f"off the vertical on average.{hint}",
            advice="The orientation is w, x, y, z of the root body in the world; the IMU is in "
            "that body's axes.",
        )
    return np.asarray(quaternion / length[:, None])


def _integrated(time: Array, gyro: Array, force: Array, gravity: Array, name: str) -> Rotation:
    """Orientation by a gyroscope from where the mean of the specific force is upwards."""
    felt = np.linalg.norm(force[np.isfinite(force).all(axis=1)], axis=1)
    g = float(np.linalg.norm(gravity))
    if felt.size == 0 or not 0.5 * g < np.mean(felt) < 2.0 * g:
        found = f"{np.mean(felt):.3g} m/s² on average" if felt.size else "no value"
        raise LogError(
            f"The IMU of log {name!r} has {found} of specific force, and a robot at rest feels "
            f"{g:.3g}: nothing says which way is up.",
            advice="Log imu.linear_acceleration.x … with gravity in it, in m/s², or "
            "base.orientation.w ….",
        )
    turns, now = [np.array([0.0, 0.0, 0.0, 1.0])], Rotation.identity()
    steps = np.diff(time)[:, None] * 0.5 * (gyro[1:] + gyro[:-1])
    for step in Rotation.from_rotvec(np.nan_to_num(steps)):
        now = now * step
        turns.append(now.as_quat())
    relative = Rotation.from_quat(np.array(turns))
    mean = np.nanmean(relative.apply(force), axis=0)
    upright, _ = Rotation.align_vectors([-gravity], [mean])
    return upright * relative


def _euler_rates(angles: Array, spin: Array) -> Array:
    """Rates (N, 3) of yaw, pitch and roll, of angular velocities (N, 3) in the body's axes."""
    _, pitch, roll = angles.T
    p, q, r = spin.T
    lateral = q * np.sin(roll) + r * np.cos(roll)
    yaw_rate = lateral / np.cos(pitch)
    pitch_rate = q * np.cos(roll) - r * np.sin(roll)
    return np.stack([yaw_rate, pitch_rate, p + yaw_rate * np.sin(pitch)], -1)


def _slope(time: Array, values: Array) -> Array:
    known = np.isfinite(values).all(axis=1)
    found = np.full(values.shape, np.nan)
    if np.count_nonzero(known) > 3:
        found[known] = CubicSpline(time[known], values[known])(time[known], 1)
    return found


def _integral(time: Array, values: Array) -> Array:
    steps = np.diff(time)[:, None] * 0.5 * (values[1:] + values[:-1])
    return np.vstack([np.zeros(3), np.cumsum(np.nan_to_num(steps), axis=0)])


def _with_ground(log: JointLog, model: RobotModel) -> JointLog:
    """Return the log with the efforts of measured wrenches, or the frames that may touch."""
    columns = log.floating
    loaded, flagged = frames_of(columns, FORCE), frames_of(columns, FLAG)
    order = [log.joints.index(joint) for joint in model.joints if joint in log.joints]
    if loaded and len(order) == len(model.joints):
        frames, q = contact_frames(model, loaded), log.position[:, order]
        known = np.isfinite(q).all(axis=1)
        bodies = RobotBodies(model.tree, model.positions(q[known]), model.total_phi)
        ground = np.full((len(log), len(order)), np.nan)
        ground[known] = 0.0
        sums = np.zeros((2, 3))  # mean forces by axes of links, and as if by the world's
        for frame in frames:
            motion = bodies.motion(frame.body)
            J = np.concatenate([motion.jacobian_at(frame.place), motion.angular], axis=1)
            if (force := vectors(columns, f"{frame.name}.force")) is None:
                raise LogError(
                    f"Log {log.name!r} has not all of {frame.name}.force.x, .y and .z.",
                    advice="Log all three, in the axes of the link.",
                )
            torque = vectors(columns, f"{frame.name}.torque")
            torque = np.zeros_like(force) if torque is None else torque
            R = motion.rotation @ frame.rotation
            both = np.stack([force[known], torque[known]], 1)
            sums += np.nan_to_num(
                [np.einsum("nij,nj->ni", R, both[:, 0]).mean(axis=0), both[:, 0].mean(axis=0)]
            )
            wrench = np.asarray(np.einsum("nij,nkj->nki", R, both), float)
            ground[known] += np.einsum("nij,ni->nj", J, wrench.reshape(len(wrench), 6))
        _check_axes(sums, model, log.name)
        effort = log.effort.copy()
        effort[:, order] += ground
        words = f"wrenches at {', '.join(loaded)} are efforts of the base and the joints"
        pushed = np.zeros(effort.shape)
        pushed[:, order] = ground
        pushed[:, np.isin(log.joints, model.base_joints)] = 0.0  # all that is measured there
        return replace(log, effort=effort, ground=pushed, notes=(*log.notes, words))
    names = flagged or _feet(model)
    frames = contact_frames(model, names)
    flags = None
    if flagged:
        flags = np.stack(
            [np.nan_to_num(columns[f"{name}.contact"], nan=1.0) > 0.5 for name in names], -1
        )
    heights = vectors(columns, "base.position") is not None
    told = "as the log says" if flagged else "the ends of the robot's limbs"
    words = f"unknown forces at {', '.join(f.name for f in frames)} ({told}) are taken out"
    contacts = ContactFlags(names, log.time, flags, heights)
    return replace(log, contacts=contacts, notes=(*log.notes, words))


def _check_axes(sums: Array, model: RobotModel, name: str) -> None:
    """Refuse forces that carry the robot by axes of the world, and not by those of links."""
    weight = -model.total_phi[:, 0].sum() * model.tree.gravity
    size = max(float(np.linalg.norm(weight)), 1e-12)
    own, world = np.linalg.norm(sums - weight, axis=1) / size
    if own > _UNLIKE and world < 0.5 * own:
        raise LogError(
            f"Mean forces at the feet of log {name!r} are off the robot's weight by {own:.0%} of "
            f"it in the axes of links, and by {world:.0%} in those of the world.",
            advice="Turn them into the axes of the link that each is named after.",
        )


def _feet(model: RobotModel) -> tuple[str, ...]:
    """Return the last links of limbs, where a robot may touch the ground."""
    plant, lumps = model.plant, lumped_bodies(model.plant)
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    inner = {int(joint.parent_body().index()) for joint in joints}
    moving = {int(j.parent_body().index()) for j in joints if j.num_velocities()}
    last = [lump for lump in lumps[1:] if not moving & {int(m.index) for m in lump.members}]
    ends = [member for lump in last for member in lump.members if int(member.index) not in inner]
    return tuple(member.name for member in ends)
