"""Motion limits of a robot's joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, instances, number, one_of, positive, real_array
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.logs.motion import SIGNAL_KINDS, Motion
from geodrake.model.effort_signal import signal_of
from geodrake.model.robot_model import RobotModel

ByJoint = float | Mapping[str, float] | ArrayLike | None

FULL_SPEED, FULL_EFFORT = 0.2, 0.1
"""Shortest times in which a joint may reach its largest speed, and its largest acceleration, s."""

_FARTHEST = 1e9  # rad or m, from which a position counts as unlimited
_SIZES = ("velocity", "acceleration", "effort", "jerk")
_POSTURES = 200  # random postures to find the largest inertia


@dataclass(frozen=True, eq=False)
class MotionLimits(Short):
    """Limits of the nv joints of a robot, with one degree of freedom each.

    Attributes:
        lower: (nv,) least positions, rad or m.
        upper: (nv,) greatest positions, rad or m.
        velocity: (nv,) largest speeds, rad/s or m/s.
        acceleration: (nv,) largest accelerations, rad/s² or m/s²; infinite for none.
        effort: (nv,) largest efforts, N·m or N; infinite for none.
        jerk: (nv,) largest changes of the acceleration, rad/s³ or m/s³; infinite for none.
    """

    joints: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    effort: Array
    jerk: Array | float = np.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", instances(self.joints, "joints", str))
        for field in fields(self)[1:]:
            given = real_array(getattr(self, field.name), field.name, finite=False)
            if field.name == "jerk" and given.ndim == 0:
                given = np.full(len(self.joints), given)
            values = real_array(given, field.name, (len(self.joints),), finite=False)
            object.__setattr__(self, field.name, values.copy())
        for j, joint in enumerate(self.joints):
            low, high = float(self.lower[j]), float(self.upper[j])
            fixed, interval = f"Joint {joint!r} has no range of motion: its", f"{low:g} … {high:g}"
            sizes = {name: float(getattr(self, name)[j]) for name in _SIZES}
            zero = next((name for name, size in sizes.items() if not size > 0), None)
            if not low < high:
                problem = f"{fixed} positions are limited to {interval}."
                advice = "Correct the limits, or weld the joint."
            elif not -_FARTHEST < low < high < _FARTHEST:
                problem = f"The position of joint {joint!r} is not limited: {interval}."
                advice = f"Limit it, such as position={{{joint!r}: (-0.5, 0.5)}}."
            elif zero is not None:
                problem = f"{fixed} largest {zero} is {sizes[zero]:g}."
                advice = f"Give it a positive {zero} limit, or weld the joint."
            elif not sizes["velocity"] < np.inf:
                problem = f"The velocity of joint {joint!r} is unlimited, so no motion is optimal."
                advice = f"Limit it, such as velocity={{{joint!r}: 1.0}}."
            else:
                continue
            raise ArgumentError(problem, advice=advice, joint=joint)

    @property
    def middle(self) -> Array:
        """(nv,) positions halfway between the limits, rad or m."""
        return 0.5 * (self.lower + self.upper)

    @property
    def reach(self) -> Array:
        """(nv,) half the ranges of positions, rad or m."""
        return 0.5 * (self.upper - self.lower)

    def scaled(self, share: float) -> MotionLimits:
        """Return limits scaled by a share; positions shrink towards the middle."""
        positive(share, "share")
        return replace(
            self,
            lower=self.middle - share * self.reach,
            upper=self.middle + share * self.reach,
            velocity=share * self.velocity,
            acceleration=share * self.acceleration,
            effort=share * self.effort,
            jerk=share * self.jerk,
        )


def motion_limits(
    model: RobotModel,
    *,
    position: Mapping[str, tuple[float, float]] | None = None,
    velocity: ByJoint = None,
    acceleration: ByJoint = None,
    effort: ByJoint = None,
    jerk: ByJoint = None,
    bounded: bool = False,
) -> MotionLimits:
    """Return the limits of a robot's model file, with overrides.

    Efforts do not exceed the known capability of the motors (`EffortSignal.limit`). An unlimited
    revolute joint may go half a turn to either side. Joints of a floating base have no limits and
    are omitted.

    Args:
        position: Least and greatest position of joints by name, rad or m.
        velocity: Largest speed: one, one per joint, or by name for some joints, rad/s or m/s.
        acceleration: Largest acceleration, likewise, rad/s² or m/s².
        effort: Largest effort, likewise, N·m or N.
        jerk: Largest jerk, likewise, rad/s³ or m/s³.
        bounded: Whether to limit accelerations that the file does not limit by
            `motor_accelerations`, and jerks to reach the acceleration in a tenth of a second.
    """
    instance(model, "model", RobotModel)
    model.positions(np.zeros((1, len(model.joints))))  # rejects joints with several degrees
    joints = motors_of(model)
    index = np.flatnonzero(np.isin(model.joints, joints))
    lower, upper = (ends[index] for ends in model.position_limits)
    turning = np.array([name not in model.sliding_joints for name in joints])
    lower = np.where(turning & np.isneginf(lower), np.minimum(-np.pi, upper - 2 * np.pi), lower)
    upper = np.where(turning & np.isposinf(upper), np.maximum(np.pi, lower + 2 * np.pi), upper)
    ranges = {} if position is None else instance(position, "position", Mapping)
    for joint, pair in ranges.items():
        k = _index(joints, joint)
        lower[k], upper[k] = real_array(pair, f"position of {joint}", (2,), finite=False)
    limits = MotionLimits(
        joints,
        lower,
        upper,
        _overridden(joints, model.velocity_limits[index], velocity, "velocity"),
        np.full(len(lower), np.inf),
        _overridden(joints, model.known_effort_limits[index], effort, "effort"),
    )
    accelerations = model.acceleration_limits[index]
    if bounded:
        stated = np.isfinite(accelerations)
        accelerations = np.where(stated, accelerations, motor_accelerations(model, limits))
    accelerations = _overridden(joints, accelerations, acceleration, "acceleration")
    jerks = accelerations / FULL_EFFORT if bounded else np.full(len(lower), np.inf)
    jerks = _overridden(joints, jerks, jerk, "jerk")
    return replace(limits, acceleration=accelerations, jerk=jerks)


def motors_of(model: RobotModel) -> tuple[str, ...]:
    """Return the names of a robot's joints except those of a floating base."""
    return tuple(name for name in model.joints if name not in model.base_joints)


def motor_accelerations(model: RobotModel, limits: MotionLimits) -> Array:
    """Return accelerations of joints without stated limits, rad/s² or m/s².

    Each is the smaller of two: the effort limit over the largest joint inertia Mⱼⱼ(q) within the
    position limits; and the velocity limit over 0.2 s, as model files without rotor inertias would
    allow wrists excessive accelerations. Gravity and couplings enter the efforts of a design.
    """
    random, index = np.random.default_rng(0), np.flatnonzero(np.isin(model.joints, limits.joints))
    shares = random.uniform(-1.0, 1.0, (_POSTURES, len(index)))
    q, zeros = np.zeros((2, _POSTURES, len(model.joints)))
    q[:, index] = limits.middle + limits.reach * shares
    static, inertia = model.effort(Motion(q, zeros, zeros)), np.empty(len(index))
    for k, j in enumerate(index):
        unit = zeros.copy()
        unit[:, j] = 1.0
        inertia[k] = np.abs(model.effort(Motion(q, zeros, unit)) - static)[:, j].max()
    with np.errstate(divide="ignore"):
        return np.asarray(np.minimum(limits.effort / inertia, limits.velocity / FULL_SPEED))


def signal_limits(model: RobotModel, signal: Mapping[str, float]) -> Array:
    """Return the effort limits from limits of currents, voltages or duty cycles, N·m or N.

    Signal limits are by joint, A, V or 1; efforts of other joints are infinite.
    """
    joints = motors_of(model)
    efforts = np.full(len(joints), np.inf)
    for joint, limit in instance(signal, "signal", Mapping).items():
        k, fitted = _index(joints, joint), signal_of(model.effort_signals, joint)
        if fitted is None or fitted.kind not in SIGNAL_KINDS:
            raise ArgumentError(
                f"The model has no current, voltage or duty cycle of {joint!r}.",
                advice="Limit its effort, or use a model that was fitted to such logs.",
                joint=joint,
            )
        efforts[k] = abs(fitted.gain) * number(limit, f"signal of {joint}", lower=0.0)
    return efforts


def _overridden(joints: Sequence[str], values: Array, given: ByJoint, what: str) -> Array:
    """Return values (n,) of joints with overrides."""
    values = np.array(values, float)
    if given is None:
        return values
    if isinstance(given, Mapping):
        for joint, value in given.items():
            values[_index(joints, joint)] = number(value, f"{what} of {joint}", finite=False)
        return values
    limits = real_array(given, what, finite=False)
    if limits.shape not in ((), (1,), values.shape):
        raise ArgumentError(
            f"The {what} limits have shape {limits.shape}, but there are {len(values)} joints."
        )
    return np.broadcast_to(limits, values.shape).copy()


def _index(joints: Sequence[str], joint: str) -> int:
    return joints.index(one_of(joint, "joint", joints))
