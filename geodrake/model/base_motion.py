"""Motion of a free base from its pose, twist and IMU, with checks of their conventions.

The six joints of a base (`geodrake.robot.arrangement`) have its pose as positions. Their
accelerations are R f + g, with the specific force f of the IMU. Errors of the orientation R cancel,
because the dynamics of the bodies depend on f alone.

Columns may have another order, unit or frame than geodrake assumes. Gravity, the gyroscope and feet
on the ground each measure the error of an interpretation. One with a large error is refused if
another one fits. If the column names are ambiguous, the better interpretation is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any
from warnings import catch_warnings

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import LogError
from geodrake.inertia import Array
from geodrake.logs.floating import (
    ANGLES,
    FLAG,
    FORCE,
    QUATERNION,
    frames_of,
    orientation,
    vectors,
    without_held,
)
from geodrake.logs.motion import GROUND, UNMEASURED, JointLog
from geodrake.model.ground_contacts import (
    axes_words,
    contact_frames,
    last_links,
    upwards,
    with_ground,
)
from geodrake.model.robot_model import RobotModel

_NORM = 0.02  # tolerance of the norm of a quaternion or of a matrix column
_UPRIGHT = np.radians(80.0)  # largest pitch; yaw and roll become indistinguishable beyond
_BETTER = 0.7  # an alternative needs less than this share of the default interpretation's error
_SWINGING = 0.2  # s, time scale of accelerations of the base
_ACCELERATES = 0.05  # m/s², smallest acceleration of the base for a comparison
_TURNING = 0.1  # s, long enough for rotations of the base to exceed the noise of its orientation
_FEW_POSES = 200  # pairs of rows
_MOVES, _LITTLE = 0.002, 0.0005  # m, smallest displacement of a foot by its leg; noise
_PARTS = (2,), (0, 1, 2), (3, 4, 5), range(6)  # yaw, rotation, offset, or all of a mounting
_MOUNTED = 0.65  # a mounting must reduce the cost of sliding feet to this share
_TILTED, _OFF_VERTICAL = 2.0, 28.6  # ° between mean specific force and vertical: doubtful, wrong
_AGREES, _DIFFERS = 0.1, 0.4  # relative squared difference of two sources of the same rotation
_RESTS, _SLIDES, _GLIDES = 0.42, 0.5, 0.7  # sliding of a foot over its displacement by the leg
_ADVICE = "Log base.position.x … and base.orientation.w …, or imu.angular_velocity.x … and so on."


def has_base(log: JointLog) -> bool:
    """Return whether a log has the pose of a free base."""
    return any(name.startswith("base.") for name in log.floating)


def with_base(log: JointLog, model: RobotModel) -> JointLog:
    """Return the log with the six joints of a floating base, and ground forces.

    The log of a fixed model is unchanged, with a note if it has the pose of a base.
    """
    joints = model.base_joints
    if not joints and has_base(log):
        words = "has the pose of a free base, but the model is fixed: --floating frees it"
        if words in log.notes:
            return log
        return replace(log, notes=(*log.notes, words), assumed=(*log.assumed, words))
    if not joints or set(joints) <= set(log.joints):
        return log
    if len(joints) > 6:
        raise LogError(
            f"The model has {len(joints) // 6} free bases, but logs have one.",
            advice="Choose one robot: --robot NAME.",
        )
    columns, kept, held = without_held(log.time, log.floating)
    log = replace(log, floating=columns, notes=(*log.notes, *held)).rows(kept)
    pose, notes = _interpreted_pose(log, model)
    count, notes = len(log), [*log.notes, *notes]
    position, velocity, acceleration = _motion_of(pose, log, model.tree.gravity)
    if velocity is None:
        velocity = np.gradient(position, log.time, axis=0)
    if acceleration is None:
        notes.append("accelerations of the base are derived from its pose; an IMU is more accurate")
    padded: dict[str, Any] = {
        name: np.hstack([values, np.full((count, 6), np.nan)])
        for name in ("command", "temperature")
        if (values := getattr(log, name)) is not None
    }
    effort, kinds = log.effort.copy(), dict(log.effort_kinds)
    is_unmeasured = np.asarray(np.isnan(effort).all(axis=0))
    if log.command is not None:
        is_unmeasured &= np.isnan(log.command).all(axis=0)
    if unmeasured := [joint for joint, s in zip(log.joints, is_unmeasured, strict=True) if s]:
        effort[:, is_unmeasured] = 0.0
        kinds |= dict.fromkeys(unmeasured, UNMEASURED)
        notes.append(
            f"no efforts of {', '.join(unmeasured)}: the rows of the base determine their bodies, "
            "and nothing determines their friction, rotors and gains"
        )
    empty = np.full((count, len(log.joints)), np.nan)
    extended = replace(
        log,
        joints=(*log.joints, *joints),
        position=np.hstack([log.position, position]),
        effort=np.hstack([effort, np.zeros((count, 6))]),
        velocity=None if log.velocity is None else np.hstack([log.velocity, velocity]),
        acceleration=None if acceleration is None else np.hstack([empty, acceleration]),
        measured=() if acceleration is None else tuple(joints),
        effort_kinds={**kinds, **dict.fromkeys(joints, GROUND)},
        effort_uncertainty=np.append(log.gain_deviations, np.zeros(6)),
        notes=tuple(notes),
        **padded,
    )
    return with_ground(extended, model)


def _motion_of(
    pose: BasePose, log: JointLog, gravity: Array
) -> tuple[Array, Array | None, Array | None]:
    """Return positions (N, 6) of the base's joints, and rates and accelerations if measured."""
    time, known, position = pose.time, pose.known, pose.position
    if position is None:
        position = vectors(log.floating, "base.position")
    R, angles = pose.R_WB.as_matrix(), np.full((len(time), 3), np.nan)
    with catch_warnings(action="ignore"):  # gimbal lock is an error below
        angles[known] = np.unwrap(pose.R_WB[known].as_euler("ZYX"), axis=0)
    if (pitch := float(np.abs(angles[known, 1]).max())) > _UPRIGHT:
        raise LogError(
            f"The base of log {log.name!r} pitches by up to {np.degrees(pitch):.0f}°, near the "
            "singularity of roll, pitch and yaw.",
            advice="Remove that part of the log, or check that the orientation is that of the body "
            "in the world.",
        )
    rates, velocity, accelerations = None, None, None
    if pose.spin is not None:
        rates = _euler_rates(angles, pose.spin)
        linear_velocity = vectors(log.floating, "base.linear_velocity")
        if linear_velocity is not None:
            velocity = np.hstack([np.einsum("nij,nj->ni", R, linear_velocity), rates])
    if pose.force is not None:
        linear = np.einsum("nij,nj->ni", R, pose.force) + gravity
        angular = _derivatives(time, rates if rates is not None else _derivatives(time, angles))
        accelerations = np.hstack([linear, angular])
    if position is None:
        position = np.zeros((len(time), 3))
        if accelerations is not None:  # drift of the position does not affect the dynamics
            position = _integral(time, _integral(time, np.nan_to_num(accelerations[:, :3])))
    return np.hstack([position, angles]), velocity, accelerations


def _euler_rates(angles: Array, spin: Array) -> Array:
    """Return rates (N, 3) of yaw, pitch and roll for angular velocities (N, 3) in body axes."""
    _, pitch, roll = angles.T
    p, q, r = spin.T
    lateral = q * np.sin(roll) + r * np.cos(roll)
    yaw_rate = lateral / np.cos(pitch)
    pitch_rate = q * np.cos(roll) - r * np.sin(roll)
    return np.stack([yaw_rate, pitch_rate, p + yaw_rate * np.sin(pitch)], -1)


def _derivatives(time: Array, values: Array) -> Array:
    """Return derivatives (N, n) of a spline through values (N, n); NaN stays NaN."""
    known = np.isfinite(values).all(axis=1)
    slopes = np.full(values.shape, np.nan)
    if np.count_nonzero(known) > 3:
        slopes[known] = CubicSpline(time[known], values[known])(time[known], 1)
    return slopes


def _integral(time: Array, values: Array) -> Array:
    """Return integrals (N, 3) from the first row of values (N, 3) less their mean."""
    return np.asarray(cumulative_trapezoid(values - values.mean(axis=0), time, axis=0, initial=0.0))


# Interpretations of the columns.

_SAME, _UP, _OVER = (Rotation.from_euler("x", x, degrees=True) for x in (0.0, 90.0, 180.0))
_INTEGRATED = "integrated from the gyroscope"
_UNITS = {"mm": 1e-3, "cm": 1e-2, "inches": 0.0254}


@dataclass(frozen=True, eq=False)
class BasePose:
    """Pose, angular velocity and specific force of a base in N rows, in one interpretation."""

    time: Array
    known: NDArray[np.bool_]  # (N,) rows with a known orientation
    R_WB: Rotation
    position: Array | None  # (N, 3) in W, m
    spin: Array | None  # (N, 3) in B, rad/s
    force: Array | None  # (N, 3) in B, m/s²

    def between(self, world: Rotation, body: Rotation) -> BasePose:
        """Return the pose with the axes of the world and of the body rotated."""
        return replace(
            self,
            R_WB=world * self.R_WB * body.inv(),
            position=None if self.position is None else world.apply(self.position),
            spin=None if self.spin is None else body.apply(self.spin),
            force=None if self.force is None else body.apply(self.force),
        )

    @cached_property
    def rotations(self) -> tuple[Array, Array]:
        """Return rotations (K, 3) in B over a short time, by orientation and angular velocity."""
        if self.spin is None:
            return np.zeros((0, 3)), np.zeros((0, 3))
        rows = np.flatnonzero(self.known & np.isfinite(self.spin).all(axis=1))
        time, R_WB = self.time[rows], self.R_WB[rows]
        lag = max(1, round(_TURNING / float(np.median(np.diff(time))))) if len(rows) > 1 else 1
        if len(rows) <= lag:
            return np.zeros((0, 3)), np.zeros((0, 3))
        sums = cumulative_trapezoid(self.spin[rows], time, axis=0, initial=0.0)
        return (R_WB[:-lag].inv() * R_WB[lag:]).as_rotvec(), sums[lag:] - sums[:-lag]

    def readings(self, form: str) -> dict[str, BasePose]:
        """Return description -> other interpretation of the columns, for a form of orientation."""
        others = dict[str, BasePose]()
        if form == "w, x, y, z":
            swapped = Rotation.from_quat(self.R_WB.as_quat()[:, [3, 0, 1, 2]])
            others["the quaternion's columns are x, y, z, w"] = replace(self, R_WB=swapped)
        others |= {
            "the orientation rotates the world into the body": replace(self, R_WB=self.R_WB.inv()),
            "y is upwards": self.between(_UP, _SAME),
            "z is downwards in the world and the body": self.between(_OVER, _OVER),
            "z is downwards in the world": self.between(_OVER, _SAME),
            "z is downwards in the body": self.between(_SAME, _OVER),
        }
        if form == _INTEGRATED:
            for axes in Rotation.create_group("O"):
                others[axes_words(axes, "the root")] = self.between(_SAME, axes)
        if self.position is not None:
            for unit, size in _UNITS.items():
                others[f"positions are in {unit}"] = replace(self, position=size * self.position)
        if self.force is not None:
            in_body = self.R_WB.inv().apply(self.force)
            others["accelerations have the other sign"] = replace(self, force=-self.force)
            others["accelerations are in the axes of the world"] = replace(self, force=in_body)
        if self.spin is not None:
            what, by_orientation, by_gyroscope = "angular velocities are in", *self.rotations
            others[f"{what} degrees per second"] = replace(self, spin=np.radians(self.spin))
            in_body = self.R_WB.inv().apply(self.spin)
            others[f"{what} the axes of the world"] = replace(self, spin=in_body)
            if by_orientation.any() and by_gyroscope.any():
                with catch_warnings(action="ignore"):  # a rotation about one axis is ambiguous
                    axes, _ = Rotation.align_vectors(by_orientation, by_gyroscope)
                spin = replace(self, spin=axes.apply(self.spin))
                others[axes_words(axes, "the root")] = spin
        return others


def _interpreted_pose(log: JointLog, model: RobotModel) -> tuple[BasePose, list[str]]:
    """Return the pose of the base and notes; raise if another interpretation fits better."""
    pose, form, others = _usual_pose(log, model)
    notes, signs = list[str](), [*_evidence(log, model, pose)]

    def off_in_all(reading: BasePose) -> float:
        return float(np.nansum([sign.off(reading) / sign.wrong for sign in signs]))

    if others:
        others = {form: pose, **others}
        off = {name: off_in_all(reading) for name, reading in others.items()}
        best = min(off, key=off.__getitem__)
        form = best if off[best] < _BETTER * off[form] else form
        pose = others[form]
        notes.append(f"the orientation of the base is read as {form}")
    for sign in signs:
        given = sign.off(pose)
        if not given > min(sign.doubt, sign.wrong):
            continue
        words, readings = sign.words.format(given), pose.readings(form)
        off = {name: sign.off(x) for name, x in readings.items()} if given > sign.wrong else {}
        right = [name for name, x in off.items() if x < min(sign.right, _BETTER * given)]
        best = min(right, key=lambda name: off_in_all(readings[name]), default="")
        if best or (sign.is_certain and off):
            hint = f", but {sign.number.format(off[best])} if {best}" if best else ""
            advice = f"The orientation is w, x, y, z of the root body in the world; {sign.advice}"
            raise LogError(f"In log {log.name!r} {words}{hint}.", advice=advice)
        if given > sign.doubt:
            notes.append(words)
    feet = _Feet.of(log, model, pose)
    if feet is not None and pose.position is not None and pose.force is None and pose.spin is None:
        pose, more = feet.without_mounting(pose)
        notes += more
    if not any(np.isfinite(sign.off(pose)) for sign in signs):
        notes.append(
            "nothing in the log confirms the orientation of the base: no IMU, no twist, and no "
            "two feet at rest while legs move"
        )
    return pose, notes


def _usual_pose(log: JointLog, model: RobotModel) -> tuple[BasePose, str, dict[str, BasePose]]:
    """Return the usual interpretation of the pose, its name, and others that names permit."""
    columns, gravity, advice = log.floating, model.tree.gravity, _ADVICE
    position, force = (vectors(columns, n) for n in ("base.position", "imu.linear_acceleration"))
    gyro = vectors(columns, "imu.angular_velocity")
    spin = gyro if gyro is not None else vectors(columns, "base.angular_velocity")
    if force is not None and gravity.any():
        _check_specific_force(force, gravity, log.name)
    known, rotations = np.ones(len(log), bool), dict[str, Rotation]()
    if (measured := orientation(columns)) is not None:
        known = np.asarray(np.isfinite(measured[1]).all(axis=1))
        if measured[0] != ANGLES:  # zeros mark missing values
            known &= measured[1].any(axis=1)
        if not known.any():
            raise LogError(
                f"Log {log.name!r} has no row with the orientation of the base.", advice=advice
            )
        rotations = _rotations(*measured, known, log.name)
    elif gyro is not None and force is not None:
        rotations = {_INTEGRATED: _integrated_orientation(log, gyro, force, gravity)}
    else:
        raise LogError(
            f"The model floats, but log {log.name!r} has no orientation of the base and no IMU"
            f"{''.join(f'; {note}' for note in log.notes if note.startswith('columns ignored'))}.",
            advice=f"{advice} For a robot that is fixed to the world omit --floating.",
        )
    if measured is None:  # the yaw of an integrated orientation differs from that of positions
        position = None
    poses = {
        name: BasePose(log.time, known, R, position, spin, force) for name, R in rotations.items()
    }
    first = next(iter(poses))
    return poses.pop(first), first, poses


def _rotations(
    axes: Sequence[str], values: Array, known: NDArray[np.bool_], name: str
) -> dict[str, Rotation]:
    """Return description -> R_WB of N rows for values (N, k), the usual one first."""
    values = np.where(known[:, None], values, np.eye(3).ravel() if len(axes) == 9 else 1.0)
    if axes == ANGLES:
        usual, other = Rotation.from_euler, partial(Rotation.from_euler, degrees=True)
        units = {"rad": usual, "degrees": other}
        if np.abs(values[:, :2]).max() > 1.1 * np.pi:
            units = {"degrees": other, "rad": usual}
        return {
            f"roll, pitch and yaw in {unit}, about {about} axes": read(order, values)
            for order, about in {"xyz": "fixed", "XYZ": "turned"}.items()
            for unit, read in units.items()
        }
    length = np.linalg.norm(values, axis=1) / (np.sqrt(3.0) if len(axes) == 9 else 1.0)
    length[~known] = 1.0
    if np.max(wrong := np.abs(length - 1.0)) > _NORM:
        row = int(np.argmax(wrong))
        what = "rotation matrix" if len(axes) == 9 else "unit quaternion"
        raise LogError(
            f"The orientation of log {name!r} is not a {what} in row {row + 1}: "
            f"{np.array2string(values[row], precision=4)} has length {length[row]:.4g}.",
            advice="Log base.orientation.w, .x, .y and .z of the root body in the world.",
        )
    if len(axes) == 9:
        R_WB = Rotation.from_matrix(values.reshape(-1, 3, 3))
        return {"a matrix row by row": R_WB, "a matrix column by column": R_WB.inv()}
    first = {"w, x, y, z": Rotation.from_quat(values, scalar_first=True)}
    return first if axes == QUATERNION else first | {"x, y, z, w": Rotation.from_quat(values)}


def _check_specific_force(force: Array, gravity: Array, name: str) -> None:
    """Refuse specific forces (N, 3) whose mean magnitude is far from gravity."""
    felt = np.linalg.norm(force[np.isfinite(force).all(axis=1)], axis=1)
    g = float(np.linalg.norm(gravity))
    if felt.size == 0 or not 0.5 * g < np.mean(felt) < 2.0 * g:
        mean_force = f"{np.mean(felt):.3g} m/s² on average" if felt.size else "no value"
        raise LogError(
            f"The IMU of log {name!r} has {mean_force} of specific force, but at rest it must be "
            f"{g:.3g}.",
            advice="Log imu.linear_acceleration.x … including gravity, in m/s², or omit them and "
            "log base.orientation.w ….",
        )


def _integrated_orientation(log: JointLog, gyro: Array, force: Array, gravity: Array) -> Rotation:
    """Return the integrated orientation, with the mean specific force upwards."""
    rotations, now = [np.array([0.0, 0.0, 0.0, 1.0])], Rotation.identity()
    steps = np.diff(log.time)[:, None] * 0.5 * (gyro[1:] + gyro[:-1])
    for step in Rotation.from_rotvec(np.nan_to_num(steps)):
        now = now * step
        rotations.append(now.as_quat())
    relative = Rotation.from_quat(np.array(rotations))
    mean = np.nanmean(relative.apply(force), axis=0)
    upright, _ = Rotation.align_vectors([-gravity], [mean])
    return upright * relative


# Evidence for an interpretation.


@dataclass(frozen=True)
class _Evidence:
    """A measure of the error of an interpretation, and its thresholds."""

    off: Callable[[BasePose], float]  # NaN if it cannot be evaluated
    doubt: float  # a larger error is noted
    wrong: float  # a larger error makes alternatives candidates
    right: float  # an alternative needs a smaller error
    words: str  # message with the error
    number: str  # format of an alternative's error
    advice: str
    is_certain: bool = False  # refuse a wrong interpretation even without a better one


def _evidence(log: JointLog, model: RobotModel, pose: BasePose) -> Iterator[_Evidence]:
    """Yield the evidence of gravity, the gyroscope, accelerations and feet."""
    up = upwards(model.tree.gravity)

    def off_vertical(pose: BasePose) -> float:
        if pose.force is None:
            return np.nan
        felt = pose.R_WB.apply(pose.force)[pose.known]
        return _angle(felt[np.isfinite(felt).all(axis=1)].sum(axis=0), up)

    def off_rates(pose: BasePose) -> float:
        by_orientation, by_gyroscope = pose.rotations
        size = np.square(by_orientation).sum() + np.square(by_gyroscope).sum()
        return float(np.square(by_orientation - by_gyroscope).sum() / size) if size else np.nan

    yield _Evidence(
        off_vertical,
        *(_TILTED, _OFF_VERTICAL, _OFF_VERTICAL),
        "the IMU measures gravity {:.1f}° off the vertical of the orientation on average",
        "{:.1f}°",
        "the IMU is in that body's axes.",
        is_certain=True,
    )
    yield _Evidence(
        off_rates,
        *(_DIFFERS, _DIFFERS, _AGREES),
        "the orientation does not turn with the angular velocities: they differ by {:.0%}",
        "{:.0%}",
        "angular velocities are in rad/s in that body's axes.",
    )
    yield _Evidence(
        partial(_off_accelerations, gravity=model.tree.gravity),
        *(_DIFFERS, _DIFFERS, 0.5 * _DIFFERS),
        "the IMU does not measure the accelerations of the position: they differ by {:.0%}",
        "{:.0%}",
        "the IMU is in that body's axes.",
    )
    if (feet := _Feet.of(log, model, pose)) is not None:
        advice, is_told = "base.position.x … is in m, with z upwards.", feet.are_told
        yield _Evidence(
            feet.sliding,
            *(_GLIDES if is_told else np.inf, _SLIDES, _RESTS),
            "no foot rests on the ground: the one that moves least still moves {:.2g} times as far "
            "as legs move feet",
            "by {:.2g} times",
            advice,
        )
        yield _Evidence(
            partial(feet.off_below, up=up),
            *(2.0 * _OFF_VERTICAL, 2.0 * _OFF_VERTICAL, _OFF_VERTICAL),
            "feet on the ground are {:.0f}° off the vertical below the base",
            "{:.0f}°",
            advice,
        )


def _off_accelerations(pose: BasePose, gravity: Array) -> float:
    """Return the relative difference of accelerations from the IMU and second differences."""
    if pose.position is None or pose.force is None:
        return np.nan
    period = float(np.median(np.diff(pose.time)))
    step = max(1, round(_SWINGING / period))
    felt = np.hstack([pose.R_WB.apply(pose.force) + gravity, pose.position])
    gaps = uniform_filter1d((~np.isfinite(felt).all(axis=1)).astype(float), 2 * step + 1)
    rows = np.flatnonzero(gaps[step:-step] < 1e-9) + step
    own = np.nan_to_num(felt[:, :3])
    for _ in range(2):  # second differences are accelerations averaged twice
        own = uniform_filter1d(own, step, axis=0)
    p = pose.position
    seen = (p[rows + step] - 2.0 * p[rows] + p[rows - step]) / (step * period) ** 2
    squares = [np.median(np.square(x).sum(axis=1)) for x in (seen - own[rows], seen, own[rows])]
    is_moving = len(rows) and max(squares[1:]) > _ACCELERATES**2
    return float(squares[0] / sum(squares[1:])) if is_moving else np.nan


def _angle(first: Array, second: Array) -> float:
    """Return the angle between two vectors (3,), degrees; NaN if one is zero."""
    size = float(np.linalg.norm(first) * np.linalg.norm(second))
    return float(np.degrees(np.arccos(np.clip(first @ second / size, -1, 1)))) if size else np.nan


@dataclass(frozen=True, eq=False)
class _Feet:
    """Positions of links that may stand on the ground, in pairs of rows a short time apart."""

    rows: NDArray[np.intp]  # (2, K) indices of the rows
    places: Array  # (2, K, F, 3) of the links in the base, m
    are_told: bool  # whether the log names the links

    @classmethod
    def of(cls, log: JointLog, model: RobotModel, pose: BasePose) -> _Feet | None:
        """Return the feet named in the log, or else the ends of limbs; None without legs."""
        names = (*frames_of(log.floating, FORCE), *frames_of(log.floating, FLAG))
        frames = contact_frames(model, [*dict.fromkeys(names)] or last_links(model))
        legs = [joint for joint in model.joints if joint not in model.base_joints]
        if not frames or not set(legs) <= set(log.joints):
            return None
        q = np.zeros((len(log), len(model.joints)))
        q[:, np.isin(model.joints, legs)] = log.position[:, [log.joints.index(j) for j in legs]]
        is_known = pose.known & np.isfinite(q).all(axis=1)
        if pose.position is not None:
            is_known &= np.isfinite(pose.position).all(axis=1)
        rows = np.flatnonzero(is_known)
        later = np.searchsorted(log.time[rows], log.time[rows] + _TURNING)
        near = later < len(rows)
        near[near] = (
            np.abs(log.time[rows[later[near]]] - log.time[rows[near]] - _TURNING) < 0.5 * _TURNING
        )
        pairs = np.stack([rows[near], rows[later[near]]])
        pairs = pairs[:, :: max(1, pairs.shape[1] // _FEW_POSES)]
        bodies = RobotBodies(model.tree, model.positions(q[pairs.ravel()]), model.total_phi)
        places = np.stack([frame.middle(bodies) for frame in frames], 1)
        places = places.reshape(2, -1, len(frames), 3)
        steps = np.linalg.norm(places[1] - places[0], axis=-1)
        moves = np.median(steps, axis=0) > _MOVES if steps.size else np.zeros(len(frames), bool)
        return cls(pairs, places[:, :, moves], bool(names)) if moves.any() else None

    def _arms(self, pose: BasePose) -> Array:
        """Return positions (2, K, F, 3) of the feet from the base, in W, m."""
        return np.asarray(pose.R_WB.as_matrix()[self.rows][:, :, None] @ self.places[..., None])[
            ..., 0
        ]

    def sliding(self, pose: BasePose) -> float:
        """Return the least displacement of a foot, over that by its joints.

        Without positions of the base, displacements are those between two feet.
        """
        before, after = self._arms(pose)
        moved, by_joints = after - before, self.places[1] - self.places[0]
        if pose.position is not None:
            first, second = pose.position[self.rows]
            moved += (second - first)[:, None]
        else:
            one, other = np.triu_indices(moved.shape[1], 1)
            moved, by_joints = (each[:, one] - each[:, other] for each in (moved, by_joints))
        if not moved.shape[1]:
            return np.nan
        ways = (np.linalg.norm(each, axis=-1) + _LITTLE for each in (moved, by_joints))
        return float(np.median(np.divide(*ways).min(axis=1)))

    def off_below(self, pose: BasePose, up: Array) -> float:
        """Return the angle of resting feet from the vertical below the base, °; NaN without."""
        if not self.sliding(pose) < _RESTS:
            return np.nan
        return _angle(self._arms(pose).sum(axis=(0, 1, 2)), -up)

    def without_mounting(self, pose: BasePose) -> tuple[BasePose, list[str]]:
        """Return the pose of the root if a body mounted on it was tracked, and notes.

        With the rotation and offset between both, feet rest.
        """
        rotations, places = pose.R_WB.as_matrix()[self.rows], np.asarray(pose.position)[self.rows]

        scale = 2.0 * _LITTLE

        def moved(x: Array) -> Array:
            arms = self.places @ Rotation.from_rotvec(x[:3]).as_matrix().T + x[3:]
            before, after = np.einsum("akij,akfj->akfi", rotations, arms) + places[:, :, None]
            return np.asarray(after - before).ravel()

        def cost(x: Array) -> float:
            return float(np.log1p(np.square(moved(x) / scale)).sum())

        def solved(which: Sequence[int]) -> Array:
            """Return the best rotation and offset, zero except for some components."""
            free = np.eye(6)[list(which)]
            start = np.zeros(len(free))
            fit = least_squares(lambda x: moved(x @ free), start, loss="cauchy", f_scale=scale)
            return np.asarray(fit.x @ free)

        candidates = [solved(which) for which in _PARTS]
        cost_before, least = cost(np.zeros(6)), cost(candidates[-1])
        if least >= _MOUNTED * cost_before:
            return pose, []
        # Prefer few components: a wrong tilt does more harm than it repairs.
        x = next(x for x in candidates if cost(x) <= least + 0.1 * (cost_before - least))
        rotation, offset = Rotation.from_rotvec(x[:3]), x[3:]
        angles = ", ".join(f"{x:.1f}°" for x in rotation.as_euler("ZYX", degrees=True))
        words = (
            f"the tracked body is not the root: feet rest if the root is rotated by {angles} (yaw, "
            f"pitch, roll) and at {np.array2string(offset, precision=3)} m in its axes: corrected"
        )
        position = np.asarray(pose.position) + pose.R_WB.apply(offset)
        return replace(pose, R_WB=pose.R_WB * rotation, position=position), [words]
