"""Motion of a free base, from its pose, twist and IMU, and other ways to read these.

Positions of the six joints of a base (`geodrake.robot.arrangement`) are the pose. Their
accelerations come from the IMU: the specific force f turned into the world, R f + g. An error of R
cancels, as bodies feel f itself.

Columns may be meant otherwise than geodrake reads them: in another order, unit or frame. Gravity,
the gyroscope and feet on the ground each tell how far off a reading is. One that is far off is
refused if another one fits; where names leave it open, the other one is used.
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

_NORM = 0.02  # by which the length of a quaternion, or of a column of a matrix, may be off one
_UPRIGHT = np.radians(80.0)  # of pitch, beyond which yaw and roll are nearly one
_BETTER = 0.7  # times as far off as the most usual reading, another one that names allow is right
_SWINGING = 0.2  # s, in which a base accelerates
_ACCELERATES = 0.05  # m/s², by which it does at least
_TURNING = 0.1  # s, in which a base turns by more than the noise of its orientation
_FEW_POSES = 200  # pairs of rows
_MOVES, _LITTLE = 0.002, 0.0005  # m, by which legs move feet between them, and noise may
_PARTS = (2,), (0, 1, 2), (3, 4, 5), range(6)  # yaw, rotation, offset, or all of a mounting
_MOUNTED = 0.65  # of how far feet slide, what is left where a tracked body is mounted otherwise
_TILTED, _OFF_VERTICAL = 2.0, 28.6  # °, by which the mean specific force may be: doubtful, wrong
_AGREES, _DIFFERS = 0.1, 0.4  # of squared turns, by which two ways to tell them are off
_RESTS, _SLIDES, _GLIDES = 0.42, 0.5, 0.7  # of what legs move feet by, which they do on the ground
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
    columns, kept, held = without_held(log.time, log.floating)
    log = replace(log, floating=columns, notes=(*log.notes, *held)).rows(kept)
    pose, notes = _settled(log, model)
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
    empty = np.full((count, len(log.joints)), np.nan)
    found = replace(
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
    return with_ground(found, model)


def _motion_of(
    pose: BasePose, log: JointLog, gravity: Array
) -> tuple[Array, Array | None, Array | None]:
    """Return positions (N, 6) of the base's joints, and rates and accelerations if measured."""
    time, known, place = pose.time, pose.known, pose.place
    if place is None:
        place = vectors(log.floating, "base.position")
    R, angles = pose.turn.as_matrix(), np.full((len(time), 3), np.nan)
    with catch_warnings(action="ignore"):  # of a base that pitches by a right angle, see below
        angles[known] = np.unwrap(pose.turn[known].as_euler("ZYX"), axis=0)
    if (pitch := float(np.abs(angles[known, 1]).max())) > _UPRIGHT:
        raise LogError(
            f"The base of log {log.name!r} pitches by up to {np.degrees(pitch):.0f}°, near the "
            "singularity of roll, pitch and yaw.",
            advice="Remove that part of the log; is the orientation that of the body in the world?",
        )
    rates, velocity, accelerations = None, None, None
    if pose.spin is not None:
        rates = _euler_rates(angles, pose.spin)
        linear_velocity = vectors(log.floating, "base.linear_velocity")
        if linear_velocity is not None:
            velocity = np.hstack([np.einsum("nij,nj->ni", R, linear_velocity), rates])
    if pose.force is not None:
        linear = np.einsum("nij,nj->ni", R, pose.force) + gravity
        angular = _slope(time, rates if rates is not None else _slope(time, angles))
        accelerations = np.hstack([linear, angular])
    if place is None:
        place = np.zeros((len(time), 3))
        if accelerations is not None:  # whose drift does not matter for the dynamics
            place = _integral(time, _integral(time, np.nan_to_num(accelerations[:, :3])))
    return np.hstack([place, angles]), velocity, accelerations


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
    """Return integrals (N, 3) of values (N, 3) without their mean, from the first row."""
    return np.asarray(cumulative_trapezoid(values - values.mean(axis=0), time, axis=0, initial=0.0))


# How columns may be meant.

_SAME, _UP, _OVER = (Rotation.from_euler("x", x, degrees=True) for x in (0.0, 90.0, 180.0))
_INTEGRATED = "integrated from the gyroscope"
_UNITS = {"mm": 1e-3, "cm": 1e-2, "inches": 0.0254}


@dataclass(frozen=True, eq=False)
class BasePose:
    """Pose, angular velocity and specific force of a base in N rows, by one reading."""

    time: Array
    known: NDArray[np.bool_]  # (N,) whether the orientation is known
    turn: Rotation  # R_WB
    place: Array | None  # (N, 3) in W, m
    spin: Array | None  # (N, 3) in B, rad/s
    force: Array | None  # (N, 3) in B, m/s²

    def between(self, world: Rotation, body: Rotation) -> BasePose:
        """Return the same in axes of the world and the body from which these turn it."""
        return replace(
            self,
            turn=world * self.turn * body.inv(),
            place=None if self.place is None else world.apply(self.place),
            spin=None if self.spin is None else body.apply(self.spin),
            force=None if self.force is None else body.apply(self.force),
        )

    @cached_property
    def turns(self) -> tuple[Array, Array]:
        """(K, 3) turns in B in a short time, by the orientation and by the angular velocity."""
        if self.spin is None:
            return np.zeros((0, 3)), np.zeros((0, 3))
        rows = np.flatnonzero(self.known & np.isfinite(self.spin).all(axis=1))
        time, turn = self.time[rows], self.turn[rows]
        lag = max(1, round(_TURNING / float(np.median(np.diff(time))))) if len(rows) > 1 else 1
        if len(rows) <= lag:
            return np.zeros((0, 3)), np.zeros((0, 3))
        sums = cumulative_trapezoid(self.spin[rows], time, axis=0, initial=0.0)
        return (turn[:-lag].inv() * turn[lag:]).as_rotvec(), sums[lag:] - sums[:-lag]

    def readings(self, form: str) -> dict[str, BasePose]:
        """Return other ways to read the columns, by words for each, given a form of orientation."""
        found = dict[str, BasePose]()
        if form == "w, x, y, z":
            swapped = Rotation.from_quat(self.turn.as_quat()[:, [3, 0, 1, 2]])
            found["the quaternion's columns are x, y, z, w"] = replace(self, turn=swapped)
        found |= {
            "the orientation rotates the world into the body": replace(self, turn=self.turn.inv()),
            "y is upwards": self.between(_UP, _SAME),
            "z is downwards in the world and the body": self.between(_OVER, _OVER),
            "z is downwards in the world": self.between(_OVER, _SAME),
            "z is downwards in the body": self.between(_SAME, _OVER),
        }
        if form == _INTEGRATED:
            for axes in Rotation.create_group("O"):
                found[axes_words(axes, "the root")] = self.between(_SAME, axes)
        if self.place is not None:
            for unit, size in _UNITS.items():
                found[f"positions are in {unit}"] = replace(self, place=size * self.place)
        if self.force is not None:
            in_body = self.turn.inv().apply(self.force)
            found["accelerations have the other sign"] = replace(self, force=-self.force)
            found["accelerations are in the axes of the world"] = replace(self, force=in_body)
        if self.spin is not None:
            what, seen, own = "angular velocities are in", *self.turns
            found[f"{what} degrees per second"] = replace(self, spin=np.radians(self.spin))
            in_body = self.turn.inv().apply(self.spin)
            found[f"{what} the axes of the world"] = replace(self, spin=in_body)
            if seen.any() and own.any():
                with catch_warnings(action="ignore"):  # of a turn about one axis
                    axes, _ = Rotation.align_vectors(seen, own)
                spin = replace(self, spin=axes.apply(self.spin))
                found[axes_words(axes, "the root")] = spin
        return found


def _settled(log: JointLog, model: RobotModel) -> tuple[BasePose, list[str]]:
    """Return how the base moves, and notes; raise if columns are meant otherwise."""
    pose, form, others = _given(log, model)
    notes, signs = list[str](), [*_signs(log, model, pose)]

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
    if feet is not None and pose.place is not None and pose.force is None and pose.spin is None:
        pose, more = feet.without_mounting(pose)
        notes += more
    if not any(np.isfinite(sign.off(pose)) for sign in signs):
        notes.append(
            "nothing in the log confirms the orientation of the base: no IMU, no twist, and no "
            "two feet that rest while legs move"
        )
    return pose, notes


def _given(log: JointLog, model: RobotModel) -> tuple[BasePose, str, dict[str, BasePose]]:
    """Return the pose as it is usually meant, in words, and as its names let it be meant, too."""
    columns, gravity, advice = log.floating, model.tree.gravity, _ADVICE
    place, force = (vectors(columns, n) for n in ("base.position", "imu.linear_acceleration"))
    gyro = vectors(columns, "imu.angular_velocity")
    spin = gyro if gyro is not None else vectors(columns, "base.angular_velocity")
    if force is not None and gravity.any():
        _check_felt(force, gravity, log.name)
    known, turns = np.ones(len(log), bool), dict[str, Rotation]()
    if (found := orientation(columns)) is not None:
        known = np.asarray(np.isfinite(found[1]).all(axis=1))
        if found[0] != ANGLES:  # zeros stand for nothing
            known &= found[1].any(axis=1)
        if not known.any():
            raise LogError(
                f"Log {log.name!r} has no row with the orientation of the base.", advice=advice
            )
        turns = _turns(*found, known, log.name)
    elif gyro is not None and force is not None:
        turns = {_INTEGRATED: _integrated(log, gyro, force, gravity)}
    else:
        raise LogError(
            f"The model floats, but log {log.name!r} has no orientation of the base and no IMU"
            f"{''.join(f'; {note}' for note in log.notes if note.startswith('columns ignored'))}.",
            advice=f"{advice} For a robot that is fixed to the world omit --floating.",
        )
    if found is None:  # whose yaw is not that of positions
        place = None
    poses = {
        name: BasePose(log.time, known, turn, place, spin, force) for name, turn in turns.items()
    }
    first = next(iter(poses))
    return poses.pop(first), first, poses


def _turns(
    axes: Sequence[str], values: Array, known: NDArray[np.bool_], name: str
) -> dict[str, Rotation]:
    """Return R_WB of N rows by what values (N, k) may be, the most usual first."""
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
        turn = Rotation.from_matrix(values.reshape(-1, 3, 3))
        return {"a matrix row by row": turn, "a matrix column by column": turn.inv()}
    first = {"w, x, y, z": Rotation.from_quat(values, scalar_first=True)}
    return first if axes == QUATERNION else first | {"x, y, z, w": Rotation.from_quat(values)}


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


# What tells how columns are meant.


@dataclass(frozen=True)
class _Sign:
    """How far off a reading of the base is, NaN if unknown, and from where on it is doubted."""

    off: Callable[[BasePose], float]
    doubt: float  # from which on a reading is said to be off
    wrong: float  # from which on others are tried
    right: float  # below which another one is right
    words: str  # with how far it is off
    number: str  # of how far another one is off
    advice: str
    is_certain: bool = False  # whether a reading that is wrong is refused without a better one


def _signs(log: JointLog, model: RobotModel, pose: BasePose) -> Iterator[_Sign]:
    """Yield the evidence of gravity, the gyroscope, accelerations and feet."""
    up = upwards(model.tree.gravity)

    def off_vertical(pose: BasePose) -> float:
        if pose.force is None:
            return np.nan
        felt = pose.turn.apply(pose.force)[pose.known]
        return _angle(felt[np.isfinite(felt).all(axis=1)].sum(axis=0), up)

    def off_rates(pose: BasePose) -> float:
        seen, own = pose.turns
        size = np.square(seen).sum() + np.square(own).sum()
        return float(np.square(seen - own).sum() / size) if size else np.nan

    yield _Sign(
        off_vertical,
        *(_TILTED, _OFF_VERTICAL, _OFF_VERTICAL),
        "the IMU measures gravity {:.1f}° off the vertical of the orientation on average",
        "{:.1f}°",
        "the IMU is in that body's axes.",
        is_certain=True,
    )
    yield _Sign(
        off_rates,
        *(_DIFFERS, _DIFFERS, _AGREES),
        "the orientation does not turn as angular velocities say: {:.0%} of what they say is other",
        "{:.0%}",
        "angular velocities are in rad/s in that body's axes.",
    )
    yield _Sign(
        partial(_off_accelerations, gravity=model.tree.gravity),
        *(_DIFFERS, _DIFFERS, 0.5 * _DIFFERS),
        "the IMU does not feel the accelerations of the position: {:.0%} of what it feels is other",
        "{:.0%}",
        "the IMU is in that body's axes.",
    )
    if (feet := _Feet.of(log, model, pose)) is not None:
        place, is_told = "base.position.x … is in m, with z upwards.", feet.are_told
        yield _Sign(
            feet.sliding,
            *(_GLIDES if is_told else np.inf, _SLIDES, _RESTS),
            "no foot rests on the ground: the one that moves least still does by {:.2g} times as "
            "much as legs move feet",
            "by {:.2g} times",
            place,
        )
        yield _Sign(
            partial(feet.off_below, up=up),
            *(2.0 * _OFF_VERTICAL, 2.0 * _OFF_VERTICAL, _OFF_VERTICAL),
            "feet on the ground are {:.0f}° off from below the base",
            "{:.0f}°",
            place,
        )


def _off_accelerations(pose: BasePose, gravity: Array) -> float:
    """Return which share of mean accelerations differs by the IMU and by second differences."""
    if pose.place is None or pose.force is None:
        return np.nan
    period = float(np.median(np.diff(pose.time)))
    step = max(1, round(_SWINGING / period))
    felt = np.hstack([pose.turn.apply(pose.force) + gravity, pose.place])
    lost = uniform_filter1d((~np.isfinite(felt).all(axis=1)).astype(float), 2 * step + 1)
    rows = np.flatnonzero(lost[step:-step] < 1e-9) + step
    own = np.nan_to_num(felt[:, :3])
    for _ in range(2):  # of which the second differences are the means
        own = uniform_filter1d(own, step, axis=0)
    place = pose.place
    seen = (place[rows + step] - 2.0 * place[rows] + place[rows - step]) / (step * period) ** 2
    squares = [np.median(np.square(x).sum(axis=1)) for x in (seen - own[rows], seen, own[rows])]
    is_told = len(rows) and max(squares[1:]) > _ACCELERATES**2
    return float(squares[0] / sum(squares[1:])) if is_told else np.nan


def _angle(first: Array, second: Array) -> float:
    """Return the angle between two vectors (3,), degrees; NaN if one is zero."""
    size = float(np.linalg.norm(first) * np.linalg.norm(second))
    return float(np.degrees(np.arccos(np.clip(first @ second / size, -1, 1)))) if size else np.nan


@dataclass(frozen=True, eq=False)
class _Feet:
    """Where links are that may stand on the ground, in pairs of rows a short time apart."""

    rows: NDArray[np.intp]  # (2, K) numbers of the rows
    places: Array  # (2, K, F, 3) of the links in the base, m
    are_told: bool  # whether the log names the links

    @classmethod
    def of(cls, log: JointLog, model: RobotModel, pose: BasePose) -> _Feet | None:
        """Return the feet that the log names, otherwise the ends of limbs; None without legs."""
        names = (*frames_of(log.floating, FORCE), *frames_of(log.floating, FLAG))
        frames = contact_frames(model, [*dict.fromkeys(names)] or last_links(model))
        own = [joint for joint in model.joints if joint not in model.base_joints]
        if not frames or not set(own) <= set(log.joints):
            return None
        q = np.zeros((len(log), len(model.joints)))
        q[:, np.isin(model.joints, own)] = log.position[:, [log.joints.index(j) for j in own]]
        whole = pose.known & np.isfinite(q).all(axis=1)
        if pose.place is not None:
            whole &= np.isfinite(pose.place).all(axis=1)
        rows = np.flatnonzero(whole)
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
        ways = np.linalg.norm(places[1] - places[0], axis=-1)
        moves = np.median(ways, axis=0) > _MOVES if ways.size else np.zeros(len(frames), bool)
        return cls(pairs, places[:, :, moves], bool(names)) if moves.any() else None

    def _arms(self, pose: BasePose) -> Array:
        """Return where feet are from the base (2, K, F, 3), in W, m."""
        return np.asarray(pose.turn.as_matrix()[self.rows][:, :, None] @ self.places[..., None])[
            ..., 0
        ]

    def sliding(self, pose: BasePose) -> float:
        """Return how far the foot goes that goes least, over how far joints move it.

        Without positions of the base feet are seen from each other.
        """
        before, after = self._arms(pose)
        moved, by_joints = after - before, self.places[1] - self.places[0]
        if pose.place is not None:
            first, second = pose.place[self.rows]
            moved += (second - first)[:, None]
        else:
            one, other = np.triu_indices(moved.shape[1], 1)
            moved, by_joints = (each[:, one] - each[:, other] for each in (moved, by_joints))
        if not moved.shape[1]:
            return np.nan
        ways = (np.linalg.norm(each, axis=-1) + _LITTLE for each in (moved, by_joints))
        return float(np.median(np.divide(*ways).min(axis=1)))

    def off_below(self, pose: BasePose, up: Array) -> float:
        """Return the angle from below the base to feet that rest, degrees; NaN if none does."""
        if not self.sliding(pose) < _RESTS:
            return np.nan
        return _angle(self._arms(pose).sum(axis=(0, 1, 2)), -up)

    def without_mounting(self, pose: BasePose) -> tuple[BasePose, list[str]]:
        """Return the pose of the root where that of something mounted on it was tracked, and notes.

        Feet rest with a rotation and an offset between both.
        """
        turns, places = pose.turn.as_matrix()[self.rows], np.asarray(pose.place)[self.rows]

        scale = 2.0 * _LITTLE

        def moved(x: Array) -> Array:
            arms = self.places @ Rotation.from_rotvec(x[:3]).as_matrix().T + x[3:]
            before, after = np.einsum("akij,akfj->akfi", turns, arms) + places[:, :, None]
            return np.asarray(after - before).ravel()

        def cost(x: Array) -> float:
            return float(np.log1p(np.square(moved(x) / scale)).sum())

        def solved(which: Sequence[int]) -> Array:
            """Return the best rotation and offset of which only some numbers are not zero."""
            free = np.eye(6)[list(which)]
            start = np.zeros(len(free))
            fit = least_squares(lambda x: moved(x @ free), start, loss="cauchy", f_scale=scale)
            return np.asarray(fit.x @ free)

        tried = [solved(which) for which in _PARTS]
        at_first, least = cost(np.zeros(6)), cost(tried[-1])
        if least >= _MOUNTED * at_first:
            return pose, []
        # What is not clearly otherwise stays: a wrong tilt costs more than it mends.
        x = next(x for x in tried if cost(x) <= least + 0.1 * (at_first - least))
        turn, offset = Rotation.from_rotvec(x[:3]), x[3:]
        angles = ", ".join(f"{x:.1f}°" for x in turn.as_euler("ZYX", degrees=True))
        words = (
            f"what was tracked is not the root: feet rest if that is turned by {angles} (yaw, "
            f"pitch, roll) and is at {np.array2string(offset, precision=3)} m in its axes: mended"
        )
        place = np.asarray(pose.place) + pose.turn.apply(offset)
        return replace(pose, turn=pose.turn * turn, place=place), [words]
