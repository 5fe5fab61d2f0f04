"""Logs of floating robots: poses, IMUs, and ground forces.

Positions of the six joints of a base (`geodrake.robot.arrangement`) are the pose. Their
accelerations come from the IMU: the specific force f turned into the world, R f + g. An error of R
cancels, as bodies feel f itself.

Wrenches w that were measured at frames are efforts Σ Jᵀ w of the base and of joints. If none was
measured, the log says which frames may touch the ground and when, and the fit does without their
forces (`geodrake.identification.logs.contact_rows`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from warnings import catch_warnings
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from geodrake.compiling import compiled, contiguous
from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import LogError
from geodrake.inertia import Array
from geodrake.inertia.bodies import lumped_bodies
from geodrake.logs.floating import FLAG, FORCE, ContactFlags, frames_of, odd_flags, vectors, widened
from geodrake.logs.motion import GROUND, UNMEASURED, JointLog
from geodrake.model.contact_probability import HIGHEST, signs_of, touching_probability
from geodrake.model.robot_model import RobotModel
from geodrake.robot.joints import joints_of
from geodrake.robot.shapes import collision_balls

_NORM = 0.02  # by which the length of a quaternion may differ from one
_UPRIGHT = np.radians(80.0)  # of pitch, beyond which yaw and roll are nearly one
_TILT = 0.5  # rad, by which the mean specific force may be off the vertical
_TURNING = 0.1  # s, in which a base turns by more than the noise of its orientation
_AGREES, _DIFFERS = 0.1, 0.4  # of squared rotations, by which two of them are off
_ADVICE = "Log base.position.x … and base.orientation.w …, or imu.angular_velocity.x … and so on."


def with_base(log: JointLog, model: RobotModel) -> JointLog:
    """Return a log with the six joints of a floating base, and ground forces.

    The log of a fixed model is itself; a note says so if it has the pose of a base.
    """
    joints = model.base_joints
    if not joints and any(name.startswith("base.") for name in log.floating):
        words = "has the pose of a free base, but the model is fixed: --floating frees it"
        return log if words in log.notes else replace(log, notes=(*log.notes, words))
    if not joints or set(joints) <= set(log.joints):
        return log
    if len(joints) > 6:
        raise LogError(
            f"The model has {len(joints) // 6} free bases, but logs have one.",
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
        notes.append("accelerations of the base are derived from its pose; an IMU is more accurate")
    padded: dict[str, Any] = {
        name: np.hstack([values, np.full((count, 6), np.nan)])
        for name in ("command", "temperature")
        if (values := getattr(log, name)) is not None
    }
    uncertainty = np.append(log.gain_deviations, np.zeros(6))
    effort, kinds = log.effort.copy(), dict(log.effort_kinds)
    silent = np.asarray(np.isnan(effort).all(axis=0))
    if log.command is not None:
        silent &= np.isnan(log.command).all(axis=0)
    if unmeasured := [joint for joint, s in zip(log.joints, silent, strict=True) if s]:
        effort[:, silent] = 0.0
        kinds |= dict.fromkeys(unmeasured, UNMEASURED)
        notes.append(
            f"no efforts of {', '.join(unmeasured)}: their bodies are told by the base's rows, and "
            "their friction, rotors and gains by nothing"
        )
    found = replace(
        log,
        joints=(*log.joints, *joints),
        position=np.hstack([log.position, position]),
        effort=np.hstack([effort, np.zeros((count, 6))]),
        velocity=own_velocity,
        acceleration=None if acceleration is None else np.hstack([empty, acceleration]),
        measured=measured,
        effort_kinds={**kinds, **dict.fromkeys(joints, GROUND)},
        effort_uncertainty=uncertainty,
        notes=tuple(notes),
        **padded,
    )
    if vectors(log.floating, "base.position") is not None:
        _check_ground(found, model)
    return with_ground(found, model)


def _base_motion(log: JointLog, model: RobotModel) -> tuple[Array, Array | None, Array | None]:
    """Return positions (N, 6) of the base's joints, and rates and accelerations if measured."""
    columns, time, g = log.floating, log.time, model.tree.gravity
    place = vectors(columns, "base.position")
    gyro = vectors(columns, "imu.angular_velocity")
    force = vectors(columns, "imu.linear_acceleration")
    spin = gyro if gyro is not None else vectors(columns, "base.angular_velocity")
    turn, known = _orientation(log, spin, gyro, force, g)
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


def _orientation(
    log: JointLog, spin: Array | None, gyro: Array | None, force: Array | None, gravity: Array
) -> tuple[Rotation, NDArray[np.bool_]]:
    """Return R_WB of N rows, and in which (N,) it is known."""
    quaternion = vectors(log.floating, "base.orientation")
    if force is not None:
        _check_felt(force, gravity, log.name)
    if quaternion is not None:
        quaternion = _checked(quaternion, force, gravity, log.name)
        _check_rates(quaternion, spin, log)
        known = np.asarray(np.isfinite(quaternion).all(axis=1))
        turn = Rotation.from_quat(
            np.where(known[:, None], quaternion, [1.0, 0, 0, 0])[:, [1, 2, 3, 0]]
        )
    elif gyro is not None and force is not None:
        turn, known = _integrated(log, gyro, force, gravity), np.ones(len(log), bool)
    else:
        raise LogError(
            f"The model floats, but log {log.name!r} has no orientation of the base and no IMU"
            f"{''.join(f'; {note}' for note in log.notes if note.startswith('columns ignored'))}.",
            advice=f"{_ADVICE} For a robot that is fixed to the world omit --floating.",
        )
    if not known.any():
        raise LogError(
            f"Log {log.name!r} has no row with the orientation of the base.", advice=_ADVICE
        )
    pitch = np.abs(np.arcsin(np.clip(turn[known].as_matrix()[:, 2, 0], -1.0, 1.0)))
    if pitch.max() > _UPRIGHT:
        raise LogError(
            f"The base of log {log.name!r} pitches by up to {np.degrees(pitch.max()):.0f}°, "
            "near the singularity of roll, pitch and yaw.",
            advice="Remove that part of the log; is the quaternion w, x, y, z, body to world?",
        )
    return turn, known


def _checked(quaternion: Array, force: Array | None, gravity: Array, name: str) -> Array:
    """Return unit quaternions (N, 4), w, x, y, z; raise if gravity contradicts them."""
    length = np.linalg.norm(quaternion, axis=1)
    wrong = np.abs(length - 1.0)
    if np.nanmax(wrong, initial=0.0) > _NORM:
        row = int(np.nanargmax(wrong))
        raise LogError(
            f"The orientation of log {name!r} is not a unit quaternion in row {row + 1}: "
            f"{np.array2string(quaternion[row], precision=4)} has length {length[row]:.4g}.",
            advice="Log base.orientation.w, .x, .y and .z of the root body in the world.",
        )
    if force is None:
        return np.asarray(quaternion / length[:, None])

    known = np.isfinite(quaternion).all(axis=1) & np.isfinite(force).all(axis=1)

    def off(turn: Rotation) -> float:
        mean = turn.apply(force[known]).mean(axis=0)
        share = mean @ upwards(gravity) / max(float(np.linalg.norm(mean)), 1e-12)
        return float(np.arccos(np.clip(share, -1.0, 1.0)))

    if not known.any():
        return np.asarray(quaternion / length[:, None])
    given, others = _readings(quaternion[known], off)
    others["its z axis or its accelerations have the other sign"] = np.pi - given
    best, least = min(others.items(), key=lambda each: each[1])
    if given > _TILT:
        hint = f" It would be upright if {best}." if least < _TILT else ""
        raise LogError(
            f"With the orientation of log {name!r}, the IMU measures gravity "
            f"{np.degrees(given):.0f}° off the vertical on average.{hint}",
            advice="The orientation is w, x, y, z of the root body in the world; the IMU is in "
            "that body's axes.",
        )
    return np.asarray(quaternion / length[:, None])


def _readings(
    quaternion: Array, off: Callable[[Rotation], float]
) -> tuple[float, dict[str, float]]:
    """Return how far `off` an orientation (N, 4) is, and it is if it is read another way."""
    turn = Rotation.from_quat(quaternion[:, [1, 2, 3, 0]])
    return off(turn), {
        "its columns are x, y, z, w": off(Rotation.from_quat(quaternion)),
        "it rotates the world into the body": off(turn.inv()),
    }


def _check_rates(quaternion: Array, spin: Array | None, log: JointLog) -> None:
    """Refuse an orientation that a gyroscope contradicts, if another reading of either agrees.

    Of a robot that stands upright, gravity does not tell the order of the columns.
    """
    if spin is None:
        return
    known = np.isfinite(quaternion).all(axis=1) & np.isfinite(spin).all(axis=1)
    time, spin, quaternion = log.time[known], spin[known], quaternion[known]
    lag = max(1, round(_TURNING / float(np.median(np.diff(time))))) if len(time) > 1 else 1
    if len(time) <= lag:
        return

    def turned(spin: Array) -> Array:
        steps = np.diff(time)[:, None] * 0.5 * (spin[1:] + spin[:-1])
        sums = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
        return np.asarray(sums[lag:] - sums[:-lag])

    def seen(turn: Rotation) -> Array:
        return np.asarray((turn[:-lag].inv() * turn[lag:]).as_rotvec())

    def off(first: Array, second: Array) -> float:
        size = np.square(first).sum() + np.square(second).sum()
        return float(np.square(first - second).sum() / max(size, 1e-12))

    own, turn = turned(spin), Rotation.from_quat(quaternion[:, [1, 2, 3, 0]])
    given, others = _readings(quaternion, lambda turn: off(seen(turn), own))
    rotated = seen(turn)
    others["these are in degrees"] = off(rotated, np.radians(own))
    others["these are in the axes of the world"] = off(rotated, turned(turn.inv().apply(spin)))
    if own.any() and rotated.any():
        with catch_warnings(action="ignore"):  # of a turn about one axis
            axes, _ = Rotation.align_vectors(rotated, own)
        others[_axes_words(axes, "the root")] = off(rotated, axes.apply(own))
    best, least = min(others.items(), key=lambda each: each[1])
    if given > _DIFFERS and least < _AGREES:
        raise LogError(
            f"The orientation of log {log.name!r} does not turn as its angular velocities say. It "
            f"would if {best}.",
            advice="The orientation is w, x, y, z of the root body in the world; angular "
            "velocities are in rad/s in that body's axes.",
        )


def _axes_words(turn: Rotation, what: str) -> str:
    """Return how axes are those of the log turned, in words."""
    right = Rotation.create_group("O")
    off = (right.inv() * turn).magnitude()
    if off.min() < _RIGHT:
        signs = right[int(off.argmin())].as_matrix().round().astype(int).tolist()
        named = [f"{'-' * (-1 in row)}{'xyz'[[*map(abs, row)].index(1)]}" for row in signs]
        return f"x, y, z of {what} are, for example, {', '.join(named)} of the log"
    angles = ", ".join(f"{x:.0f}°" for x in turn.as_euler("ZYX", degrees=True))
    return f"axes of {what} are those of the log turned by {angles} (yaw, pitch, roll)"


def _check_felt(force: Array, gravity: Array, name: str) -> None:
    """Refuse specific forces (N, 3) that do not have the size of gravity on average."""
    felt = np.linalg.norm(force[np.isfinite(force).all(axis=1)], axis=1)
    g = float(np.linalg.norm(gravity))
    if felt.size == 0 or not 0.5 * g < np.mean(felt) < 2.0 * g:
        found = f"{np.mean(felt):.3g} m/s² on average" if felt.size else "no value"
        raise LogError(
            f"The IMU of log {name!r} has {found} of specific force, but at rest it must be "
            f"{g:.3g}.",
            advice="Log imu.linear_acceleration.x … including gravity, in m/s², or omit them and "
            "log base.orientation.w ….",
        )


def _integrated(log: JointLog, gyro: Array, force: Array, gravity: Array) -> Rotation:
    """Return the orientation by the gyroscope, with the mean specific force upwards."""
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


_POINTS = 3  # feet that a robot can stand on if they are points
_NEAR = 0.02  # m over the ground, within which a frame may touch it
_LOWEST = 5.0  # per cent of the lowest heights, which are taken for the ground's
_DOUBT = 0.01  # probability of a contact, or of none, from which it counts
_ODD = 0.01  # of contact flags, that most of those around them contradict
_UNLIKE = 0.2  # of the weight, by which forces at feet may differ from it
_NOTHING, _HALF = 0.02, 0.5  # of the weight that feet carry, and of the samples in which they touch
_HELD = (
    "If the robot is held or fixed to the world, omit --floating; otherwise log contacts or forces "
    "of everything that touches it."
)
_FEW_POSES, _UNEVEN, _LEVEL = 200, 0.001, 0.3  # of heights, m, and as a share of others
_OFTEN = 0.05  # of the samples, in which a foot must be low
_FEW = 5000  # samples whose forces are compared with the weight
_RIGHT = np.radians(3.0)  # by which a rotation by right angles may be off


@dataclass(frozen=True)
class ContactFrame:
    """A link that may touch the ground, by a ball or a point."""

    name: str
    body: str  # name of the body that the link L is welded to
    origin: Array  # (3,) p_BoLo_B, m
    rotation: Array  # (3, 3) R_BL
    center: Array  # (3,) p_BoCo_B of the center of the ball, m
    radius: float  # radius of the ball, m

    def height(self, bodies: RobotBodies) -> Array:
        """Return heights (N,) of the lowest point of the ball over the world's origin, m."""
        motion = bodies.motion(self.body)
        center = motion.position + motion.rotation @ self.center
        return center @ upwards(bodies.gravity) - self.radius


def contact_jacobians(
    frames: Sequence[ContactFrame], bodies: RobotBodies, *, soles: bool = False
) -> Array:
    """Return Jacobians (N, c, 3, nv), in W, of the lowest points of frames' balls.

    Of soles, which moments act on too, they have the links' turning below, (N, c, 6, nv).
    """
    count, axes = len(bodies.q), 6 if soles else 3
    found = np.zeros((count, len(frames), axes, bodies.tree.num_velocities))
    for k, frame in enumerate(frames):
        motion = bodies.motion(frame.body)
        arm = motion.rotation @ frame.center - frame.radius * upwards(bodies.gravity)
        own, dofs = (contiguous(motion.angular), contiguous(motion.linear)), np.array(motion.dofs)
        _put_point_jacobian(own, arm, dofs, found, k)
    return found


@compiled
def _put_point_jacobian(
    own: tuple[Array, Array], arm: Array, dofs: NDArray[np.intp], out: Array, k: int
) -> None:
    """Write the k-th Jacobian of all, of points that are at (N, 3) from a body's origin, in W.

    Those of the body's turning and of its origin are its `own` (N, 3, nv). Columns of velocities
    other than `dofs`, which move it, stay.
    """
    angular, linear = own
    for n in range(len(arm)):
        x, y, z = arm[n, 0], arm[n, 1], arm[n, 2]
        for i in dofs:
            wx, wy, wz = angular[n, 0, i], angular[n, 1, i], angular[n, 2, i]
            out[n, k, 0, i] = linear[n, 0, i] + wy * z - wz * y
            out[n, k, 1, i] = linear[n, 1, i] + wz * x - wx * z
            out[n, k, 2, i] = linear[n, 2, i] + wx * y - wy * x
            if out.shape[2] > 3:
                out[n, k, 3, i], out[n, k, 4, i], out[n, k, 5, i] = wx, wy, wz


def upwards(gravity: Array) -> Array:
    """Return the unit vector (3,) against gravity, in W."""
    return -gravity / max(float(np.linalg.norm(gravity)), 1e-12)


_BALLS = WeakKeyDictionary[MultibodyPlant, Mapping[str, tuple[Array, float]]]()
"""Collision spheres of links that were read before."""


def contact_frames(model: RobotModel, names: Sequence[str]) -> tuple[ContactFrame, ...]:
    """Return links by name, with the collision spheres that the model's file gives them."""
    links = {
        member.name: (lump.name, member)
        for lump in lumped_bodies(model.plant)
        for member in lump.members
    }
    if model.plant not in _BALLS:
        is_file = model.path.is_file()
        _BALLS[model.plant] = collision_balls(model.path, model.given) if is_file else {}
    balls, found = _BALLS[model.plant], []
    for name in names:
        if name not in links:
            raise LogError(
                f"The log has a contact or a force at link {name!r}, which the model lacks.",
                advice=f"Links are {', '.join(links)}.",
            )
        body, link = links[name]
        center, radius = balls.get(link.scoped_name, (np.zeros(3), 0.0))
        X_BL = link.X_RB
        frame = X_BL.translation(), X_BL.rotation().matrix(), X_BL.multiply(center), radius
        found.append(ContactFrame(name, body, *frame))
    return tuple(found)


def _some_positions(log: JointLog, model: RobotModel) -> Array:
    """Return positions (K, n) of the model's joints in some rows, where all are known."""
    q = log.position[:, [log.joints.index(joint) for joint in model.joints]]
    q = q[np.isfinite(q).all(axis=1)]
    return q[:: max(1, len(q) // _FEW_POSES)]


def _low_links(log: JointLog, model: RobotModel, told: Sequence[str]) -> tuple[str, ...]:
    """Return ends of limbs that come near the ground, other than the frames in the log."""
    q = _some_positions(log, model)
    if vectors(log.floating, "base.position") is None or not len(q):
        return ()
    bodies = RobotBodies(model.tree, model.positions(q), model.total_phi)
    known = {frame.body for frame in contact_frames(model, told)}
    frames = [f for f in contact_frames(model, _last_links(model)) if f.body not in known]
    lowest = np.min([f.height(bodies) for f in contact_frames(model, told)], axis=0)
    ground = np.percentile(lowest, _LOWEST)
    return tuple(f.name for f in frames if np.mean(f.height(bodies) < ground + _NEAR) > _OFTEN)


def _check_ground(log: JointLog, model: RobotModel) -> None:
    """Refuse a pose with which feet leave the ground, if another reading keeps them there."""
    q = _some_positions(log, model)
    base = [model.joints.index(joint) for joint in model.base_joints]
    frames = contact_frames(model, _last_links(model))
    if not len(q) or not frames:
        return
    place, turn = q[:, base[:3]], Rotation.from_euler("ZYX", q[:, base[3:]])
    up = Rotation.from_euler("x", 90.0, degrees=True)
    others = {"y is upwards": (up.apply(place.copy()), up * turn)}
    others["the quaternion rotates the world into the body"] = place, turn.inv()
    swapped = Rotation.from_quat(turn.as_quat()[:, [3, 0, 1, 2]])
    others["the quaternion's columns are x, y, z, w"] = place, swapped
    for unit, size in {"mm": 1e-3, "cm": 1e-2, "inches": 0.0254}.items():
        others[f"positions are in {unit}"] = size * place, turn

    def spread(place: Array, turn: Rotation) -> float:
        moved = q.copy()
        moved[:, base] = np.hstack([place, turn.as_euler("ZYX")])
        bodies = RobotBodies(model.tree, model.positions(moved), model.total_phi)
        return float(np.std(np.min([frame.height(bodies) for frame in frames], axis=0)))

    given, off = spread(place, turn), {words: spread(*pose) for words, pose in others.items()}
    best = min(off, key=off.__getitem__)
    if given > _UNEVEN and off[best] < _LEVEL * given:
        raise LogError(
            f"The lowest link of log {log.name!r} rises and falls by {given:.2g} m (standard "
            f"deviation), but by {off[best]:.2g} m if {best}.",
            advice="Log base.position.x … in m, with z upwards, and base.orientation.w … of the "
            "root in the world.",
        )


def with_ground(log: JointLog, model: RobotModel) -> JointLog:
    """Return a log with the efforts of measured wrenches, or with the frames that may touch."""
    loaded, flagged = frames_of(log.floating, FORCE), frames_of(log.floating, FLAG)
    heads = dict.fromkeys(name[:-2] for name in log.floating if name[-2] == ".")
    if lost := [head for head in heads if vectors(log.floating, head) is None]:
        words = f"{', '.join(lost)}: not used, as an axis is missing"
        log = replace(log, notes=(*log.notes, words))
    whole = set(model.joints) <= set(log.joints)
    if loaded and whole:
        ground, notes = _efforts_of_wrenches(log, model, loaded)
        if low := _low_links(log, model, loaded):
            words = f"no forces at {', '.join(low)}, near the ground: what they carry is missing"
            notes = (*notes, words)
        base = np.isin(log.joints, model.base_joints)
        words = (
            f"wrenches at {', '.join(loaded)} are included in the efforts of the base and "
            "the joints"
        )
        return replace(
            log,
            effort=log.effort + ground,
            ground=np.where(base, 0.0, ground),  # of the base it is all that is measured
            notes=(*log.notes, *notes, words),
        )
    if set(model.joints) <= {*log.unmeasured, *model.base_joints}:
        raise LogError(
            f"Log {log.name!r} has neither efforts of joints nor forces at feet: nothing says how "
            "heavy the robot is.",
            advice="Log <joint>.effort …, or <frame>.force.x, .y and .z at each foot.",
        )
    low = _low_links(log, model, flagged) if flagged and whole else ()
    names = (*flagged, *low) or _last_links(model)
    frames = contact_frames(model, names)
    flags = np.zeros((len(log), len(names)), bool)
    doubts: tuple[str, ...] = ()
    if flagged:
        logged = _flags(log, names)
        doubts = _check_held(log, logged.astype(float))
        if low:
            words = f"no contact flags of {', '.join(low)}: they count as touching near the ground"
            doubts = (*doubts, words)
        wrong = dict(zip(names, odd_flags(log.time, logged).tolist(), strict=True))
        said = [f"{x:.0%} of those of {name}" for name, x in wrong.items() if x > _ODD]
        if said:
            doubts = (
                *doubts,
                f"contact flags are wrong for single samples: {', '.join(said)}; near each of "
                "them the frame counts as touching",
            )
        flags = widened(log.time, logged)
    if whole and vectors(log.floating, "base.position") is not None:
        known, bodies = _bodies(log, model)
        heights = np.full(flags.shape, np.nan)  # over level ground, m
        if known.any():
            own = np.stack([frame.height(bodies) for frame in frames], -1)
            heights[known] = own - np.percentile(own.min(axis=1), _LOWEST)
        flags |= ~(heights >= _NEAR)
        if not flagged and known.any():
            found, more = _found(log, model, frames, heights, (known, bodies))
            flags, doubts = flags | found, (*doubts, *more)
    elif not flagged:
        flags[:] = True
    told = "from the log" if flagged else "at the ends of the limbs"
    contacts = ContactFlags(names, log.time, flags)
    what = "forces and moments" if on_soles(contacts, frames) else "forces"
    words = f"unknown {what} at {', '.join(names)} ({told}) are eliminated"
    return replace(log, contacts=contacts, notes=(*log.notes, *doubts, words))


def _flags(log: JointLog, names: Sequence[str]) -> NDArray[np.bool_]:
    """Return whether frames touch (N, c) by the log, or may touch as a cell is empty."""
    none = np.zeros(len(log))
    columns = [log.floating.get(f"{name}{FLAG}", none) for name in names]
    for name, values in zip(names, columns, strict=True):
        if (most := float(np.nanmax(values, initial=0.0))) > 1.0:
            raise LogError(
                f"The contact of {name} in log {log.name!r} goes up to {most:.4g}, but it is "
                "1 while the link touches the ground and 0 in the air.",
                advice=f"Name per cent '{name}.contact [%]', and forces {name}.force.x to .z.",
            )
    return np.asarray(np.nan_to_num(np.stack(columns, -1), nan=1.0) > 0.5)


def on_soles(contacts: ContactFlags, frames: Sequence[ContactFrame]) -> bool:
    """Return whether frames are soles, as robots cannot stand on the points of two feet."""
    most = int(contacts.flags.sum(axis=1).max(initial=0))
    return most < _POINTS and not any(frame.radius for frame in frames)


def _bodies(log: JointLog, model: RobotModel) -> tuple[NDArray[np.bool_], RobotBodies]:
    """Return in which rows (N,) all positions are known, and the bodies there."""
    q = log.position[:, [log.joints.index(joint) for joint in model.joints]]
    known = np.asarray(np.isfinite(q).all(axis=1))
    return known, RobotBodies(model.tree, model.positions(q[known]), model.total_phi)


def _found(
    log: JointLog,
    model: RobotModel,
    frames: Sequence[ContactFrame],
    heights: Array,
    there: tuple[NDArray[np.bool_], RobotBodies],
) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Return where frames that may be high (N, c) touch or may touch, and a note on it.

    What is in doubt counts as touching, which holds for frames in the air as well: limbs without
    rows are all that it costs.
    """
    known, bodies = there
    near = np.flatnonzero((heights[known] < HIGHEST).any(axis=0)).tolist()
    may_be_soles = sum(frames[k].radius == 0.0 for k in near) < _POINTS
    jacobians = contact_jacobians([frames[k] for k in near], bodies, soles=may_be_soles)
    probability = np.zeros(heights.shape)
    signs = signs_of(log, model, jacobians, heights[known][:, near], known)
    probability[:, near] = touching_probability(signs)
    found = widened(log.time, probability > _DOUBT)
    doubtful = (found | ~(heights >= _NEAR)) & (probability < 1.0 - _DOUBT)
    shares = (probability > 0.5).mean(axis=0).tolist()
    told = [f"{f.name} in {x:.0%}" for f, x in zip(frames, shares, strict=True) if x > _DOUBT]
    return found, (
        *_check_held(log, probability[known]),
        f"contacts by heights, speeds and efforts: {', '.join(told) or 'none'} of the samples; in "
        f"{doubtful.any(axis=1).mean():.0%} of them one is in doubt, and its limb left out",
    )


def _check_held(log: JointLog, probability: Array) -> tuple[str, ...]:
    """Return a note if frames (N, c) hardly ever touch; raise if next to nothing ever does."""
    share = float((1.0 - probability).prod(axis=1).mean())
    words = f"nothing touches the ground in {share:.0%} of the samples"
    if share > 1.0 - _NOTHING:
        raise LogError(f"In log {log.name!r} {words}, but a robot in the air falls.", advice=_HELD)
    return (words,) if share > _HALF else ()


def _efforts_of_wrenches(
    log: JointLog, model: RobotModel, names: Sequence[str]
) -> tuple[Array, tuple[str, ...]]:
    """Return Σ Jᵀ w (N, n) of wrenches at links, in the log's order, NaN if unknown, and notes."""
    known, bodies = _bodies(log, model)
    efforts = np.full((len(log), len(model.joints)), np.nan)
    efforts[known] = 0.0
    few = slice(None, None, max(1, np.count_nonzero(known) // _FEW))
    bare = list[str]()  # soles without moments
    forces, turns = list[Array](), list[Array]()  # f in the axes of links L, and R_WL
    for frame in contact_frames(model, names):
        if (force := vectors(log.floating, f"{frame.name}.force")) is None:
            raise LogError(
                f"Log {log.name!r} lacks some of {frame.name}.force.x, .y and .z.",
                advice="Log all three, in the axes of the link.",
            )
        torque = vectors(log.floating, f"{frame.name}.torque")
        bare += [frame.name] * (torque is None and len(names) < _POINTS and not frame.radius)
        torque = np.zeros_like(force) if torque is None else torque
        motion = bodies.motion(frame.body)
        R_WL = motion.rotation @ frame.rotation
        wrench = np.stack([force[known], torque[known]], 1)  # (K, 2, 3)
        in_world = wrench @ np.swapaxes(R_WL, 1, 2)
        forces.append(wrench[few, 0])
        turns.append(R_WL[few])
        J = np.concatenate([motion.jacobian_at(frame.origin), motion.angular], axis=1)
        efforts[known] += np.einsum("nij,ni->nj", J, in_world.reshape(-1, 6))
    words = f"no moments at {', '.join(bare)}: taken as zero, although soles carry them"
    doubts: tuple[str, ...] = (words,) if bare else ()
    doubts += _check_axes(np.stack(forces, 1), np.stack(turns, 1), model, log.name)
    found = np.zeros(log.effort.shape)
    found[:, [log.joints.index(joint) for joint in model.joints]] = efforts
    return found, doubts


def _check_axes(forces: Array, turns: Array, model: RobotModel, name: str) -> tuple[str, ...]:
    """Raise for forces that carry the robot if they are read otherwise, but not in axes of links.

    Forces that carry nothing are refused, too. A note reports those that carry much less or more
    than the robot.

    Args:
        forces: (S, F, 3) forces at F links in some samples.
        turns: (S, F, 3, 3) R_WL of the links.
    """
    whole = np.isfinite(forces).all(axis=(1, 2))
    forces, turns = forces[whole], turns[whole]
    weight = -model.total_phi[:, 0].sum() * model.tree.gravity
    size = float(np.linalg.norm(weight))
    if not len(forces) or not size:
        return ()
    in_links = np.einsum("sfij,sfj->si", turns, forces)
    others = _other_readings(forces, turns, weight)
    own, *off = (
        float(np.sqrt(np.square(total - weight).sum(axis=1).mean())) / size
        for total in (in_links, *others.values())
    )
    if own > _UNLIKE and min(off) < 0.5 * own:
        raise LogError(
            f"Forces at the feet in log {name!r} differ from the robot's weight by {own:.0%} in "
            f"link axes, and by {min(off):.0%} {[*others][off.index(min(off))]}.",
            advice="Write forces of the ground on the robot, in the axes of the link after which "
            "they are named.",
        )
    carried = float(in_links.mean(axis=0) @ weight) / size**2
    words = f"forces at the feet carry {round(100.0 * carried)}% of the weight on average"
    if abs(carried) < _NOTHING:
        raise LogError(f"In log {name!r} {words}, but a robot in the air falls.", advice=_HELD)
    return (words,) if abs(carried - 1.0) > _HALF else ()


def _other_readings(forces: Array, turns: Array, weight: Array) -> dict[str, Array]:
    """Return sums (S, 3) of forces in world axes, N, by each other way to read them, in words.

    They may be forces of the robot on the ground. Their axes may be those of the world, or those of
    the links turned by one rotation, the one with which the forces carry the weight best.
    """
    rows = np.einsum("sfij,sfl->sijl", turns, forces).reshape(-1, 9)
    R = np.linalg.qr(np.column_stack([rows, np.tile(weight, len(forces))]), mode="r")

    def misses(turn: Rotation) -> Array:
        return np.asarray(R @ np.append(turn.as_matrix(), -1.0))

    right = Rotation.create_group("O")
    nearest = right[int(np.argmin([np.linalg.norm(misses(way)) for way in right]))]
    fit = least_squares(lambda x: misses(Rotation.from_rotvec(x) * nearest), np.zeros(3))
    turned = Rotation.from_rotvec(fit.x) * nearest
    words = f"if {_axes_words(turned, 'the links')}"
    in_links, in_world = np.einsum("sfij,sfj->si", turns, forces), forces.sum(axis=1)
    against = "as forces of the robot on the ground"
    return {
        "in world axes": in_world,
        f"in link axes {against}": -in_links,
        f"in world axes {against}": -in_world,
        words: np.einsum("sfij,sfj->si", turns, forces @ turned.as_matrix().T),
    }


def _last_links(model: RobotModel) -> tuple[str, ...]:
    """Return the last links of limbs, where a robot may touch the ground."""
    plant, lumps = model.plant, lumped_bodies(model.plant)
    joints = joints_of(plant)
    inner = {int(joint.parent_body().index()) for joint in joints}
    moving = {int(j.parent_body().index()) for j in joints if j.num_velocities()}
    last = [lump for lump in lumps[1:] if not moving & {int(m.index) for m in lump.members}]
    ends = [member for lump in last for member in lump.members if int(member.index) not in inner]
    return tuple(member.name for member in ends)
