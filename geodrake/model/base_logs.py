"""Logs of robots that nothing fixes to the world: their poses and IMUs as six joints of the base.

Positions of the six joints (`geodrake.robot.base_joints`) are the pose. Their accelerations come
from the IMU: the specific force f turned into the world, R f + g. An error of R cancels, as bodies
feel f itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from geodrake.errors import LogError
from geodrake.inertia import Array
from geodrake.logs.floating import vectors
from geodrake.logs.motion import GROUND, JointLog
from geodrake.model.ground_contacts import upwards, with_ground
from geodrake.model.robot_model import RobotModel

_NORM = 0.02  # by which the length of a quaternion may differ from one
_UPRIGHT = np.radians(80.0)  # of pitch, beyond which yaw and roll are nearly one
_TILT = 0.5  # rad, by which the mean specific force may be off the vertical
_ADVICE = "Log base.position.x … and base.orientation.w …, or imu.angular_velocity.x … and so on."


def with_base(log: JointLog, model: RobotModel) -> JointLog:
    """Return a log with the six joints of a floating model's base, and what the ground does.

    The log of a fixed model is itself; a note says so if it has the pose of a base.
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
    return with_ground(found, model)


def _base_motion(log: JointLog, model: RobotModel) -> tuple[Array, Array | None, Array | None]:
    """Return positions (N, 6) of the base's joints, and rates and accelerations if measured."""
    columns, time, g = log.floating, log.time, model.tree.gravity
    place = vectors(columns, "base.position")
    gyro = vectors(columns, "imu.angular_velocity")
    force = vectors(columns, "imu.linear_acceleration")
    spin = gyro if gyro is not None else vectors(columns, "base.angular_velocity")
    turn, known = _orientation(log, g)
    R, angles = turn.as_matrix(), np.full((len(log), 3), np.nan)
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


def _orientation(log: JointLog, gravity: Array) -> tuple[Rotation, NDArray[np.bool_]]:
    """Return R_WB of N rows, and in which (N,) it is known."""
    columns = log.floating
    quaternion = vectors(columns, "base.orientation")
    gyro = vectors(columns, "imu.angular_velocity")
    force = vectors(columns, "imu.linear_acceleration")
    if quaternion is not None:
        quaternion = _checked(quaternion, force, gravity, log.name)
        known = np.asarray(np.isfinite(quaternion).all(axis=1))
        turn = Rotation.from_quat(
            np.where(known[:, None], quaternion, [1.0, 0, 0, 0])[:, [1, 2, 3, 0]]
        )
    elif gyro is not None and force is not None:
        turn, known = _integrated(log, gyro, force, gravity), np.ones(len(log), bool)
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
    pitch = np.abs(np.arcsin(np.clip(turn[known].as_matrix()[:, 2, 0], -1.0, 1.0)))
    if pitch.max() > _UPRIGHT:
        raise LogError(
            f"The base of log {log.name!r} pitches by up to {np.degrees(pitch.max()):.0f}°, where "
            "yaw and roll are one: such motions are not read.",
            advice="Leave that part of the log out; is the quaternion w, x, y, z, body to world?",
        )
    return turn, known


def _checked(quaternion: Array, force: Array | None, gravity: Array, name: str) -> Array:
    """Return quaternions (N, 4), w, x, y, z, of length one; refuse what gravity contradicts."""
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
        share = mean @ upwards(gravity) / max(float(np.linalg.norm(mean)), 1e-12)
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


def _integrated(log: JointLog, gyro: Array, force: Array, gravity: Array) -> Rotation:
    """Return the orientation by the gyroscope, with the mean specific force upwards."""
    felt = np.linalg.norm(force[np.isfinite(force).all(axis=1)], axis=1)
    g = float(np.linalg.norm(gravity))
    if felt.size == 0 or not 0.5 * g < np.mean(felt) < 2.0 * g:
        found = f"{np.mean(felt):.3g} m/s² on average" if felt.size else "no value"
        raise LogError(
            f"The IMU of log {log.name!r} has {found} of specific force, and a robot at rest feels "
            f"{g:.3g}: nothing says which way is up.",
            advice="Log imu.linear_acceleration.x … with gravity in it, in m/s², or "
            "base.orientation.w ….",
        )
    turns, now = [np.array([0.0, 0.0, 0.0, 1.0])], Rotation.identity()
    steps = np.diff(log.time)[:, None] * 0.5 * (gyro[1:] + gyro[:-1])
    for step in Rotation.from_rotvec(np.nan_to_num(steps)):
        now = now * step
        turns.append(now.as_quat())
    relative = Rotation.from_quat(np.array(turns))
    mean = np.nanmean(relative.apply(force), axis=0)
    upright, _ = Rotation.align_vectors([-gravity], [mean])
    return upright * relative


def _euler_rates(angles: Array, spin: Array) -> Array:
    """Return rates (N, 3) of yaw, pitch and roll for angular velocities (N, 3) in body axes."""
    _, pitch, roll = angles.T
    p, q, r = spin.T
    lateral = q * np.sin(roll) + r * np.cos(roll)
    yaw_rate = lateral / np.cos(pitch)
    pitch_rate = q * np.cos(roll) - r * np.sin(roll)
    return np.stack([yaw_rate, pitch_rate, p + yaw_rate * np.sin(pitch)], -1)


def _slope(time: Array, values: Array) -> Array:
    """Return derivatives (N, n) of a spline through values (N, n); NaN where these are."""
    known = np.isfinite(values).all(axis=1)
    found = np.full(values.shape, np.nan)
    if np.count_nonzero(known) > 3:
        found[known] = CubicSpline(time[known], values[known])(time[known], 1)
    return found


def _integral(time: Array, values: Array) -> Array:
    """Return integrals (N, 3) of values (N, 3) from the first row, by trapezoids."""
    steps = np.diff(time)[:, None] * 0.5 * (values[1:] + values[:-1])
    return np.vstack([np.zeros(3), np.cumsum(np.nan_to_num(steps), axis=0)])
