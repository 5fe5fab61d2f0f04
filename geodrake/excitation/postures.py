"""Postures that a robot can hold: where a motion can begin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import ArgumentError
from geodrake.excitation.collisions import CollisionWorld
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.trajectory import joint_order
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_POSTURES = 400
_ROUNDING = 1e-9


def holding_efforts(model: RobotModel, postures: Array) -> Array:
    """(N, nv) efforts that hold a robot still in postures (N, nv) by joint, N·m or N.

    Dry friction is no help: what it would hold depends on how the robot came there.

    Args:
        postures: (N, nv) positions by joint, rad or m.
    """
    q = postures[:, joint_order(model)]
    still = np.zeros_like(postures)
    return np.asarray(model.effort(Motion(q, still, still)))


def check_start(
    model: RobotModel, limits: MotionLimits, start: Array, collisions: CollisionWorld | None
) -> None:
    """Refuses a start (nv,) by joint that the robot cannot hold.

    Args:
        start: (nv,) positions by joint, rad or m.
        collisions: Bodies that must keep apart; None for no check.

    Raises:
        ArgumentError: It is outside the limits, needs more effort than there is, or is in
            collision; the message says which joint or which bodies.
    """
    if start.shape != (len(limits.joints),) or not np.isfinite(start).all():
        raise ArgumentError(
            f"The start has the shape {start.shape} and must be {len(limits.joints)} finite "
            f"positions: {start.tolist()}."
        )
    slack = _ROUNDING * (1.0 + limits.reach)
    outside = (start < limits.lower - slack) | (start > limits.upper + slack)
    if outside.any():
        i = int(np.argmax(outside))
        raise ArgumentError(
            f"The start is outside the limits: joint {limits.joints[i]!r} is at {start[i]:.4g}, "
            f"and may be from {limits.lower[i]:.4g} to {limits.upper[i]:.4g}.",
            advice="Move the robot inside first, or leave the start out.",
            joint=limits.joints[i],
        )
    effort = np.abs(holding_efforts(model, start[None])[0])
    if (effort > limits.effort).any():
        i = int(np.argmax(effort / limits.effort))
        raise ArgumentError(
            f"Joint {limits.joints[i]!r} needs {effort[i]:.4g} to hold the robot at the start, and "
            f"may give {limits.effort[i]:.4g}.",
            advice="Start from a posture that gravity pulls less at, or raise the limit.",
            joint=limits.joints[i],
        )
    if collisions is not None:
        distance, names = collisions.distances(start[None, joint_order(model)])
        if distance[0] < collisions.clearance:
            raise ArgumentError(
                f"The start is in collision: {names[0]} are {distance[0]:.4g} m apart, and shall "
                f"be {collisions.clearance:g} m.",
                advice="Start elsewhere, or check the geometry.",
            )


def possible_postures(
    model: RobotModel,
    limits: MotionLimits,
    collisions: CollisionWorld | None,
    *,
    seed: int = 0,
    most: int = _POSTURES,
) -> Array:
    """(n, nv) postures by joint that a robot can hold, the middle of its ranges first if it can.

    Raises:
        ArgumentError: No posture can be held; the message says why.
    """
    random = np.random.default_rng(seed)
    shares = random.uniform(-1.0, 1.0, (_POSTURES, len(limits.joints)))
    shares *= np.linspace(0.0, 0.95, _POSTURES)[:, None]  # the middle, and then further out
    postures = limits.middle + limits.reach * shares
    efforts = np.abs(holding_efforts(model, postures))
    holds = (efforts <= limits.effort).all(axis=1)
    if not holds.any():
        least = int(np.argmin((efforts / limits.effort).max(axis=1)))
        i = int(np.argmax(efforts[least] / limits.effort))
        at = ", ".join(
            f"{n} {x:.3g}" for n, x in zip(limits.joints, postures[least].tolist(), strict=True)
        )
        raise ArgumentError(
            f"Gravity is stronger than the robot: in the best of {_POSTURES} postures ({at}), "
            f"joint {limits.joints[i]!r} needs {efforts[least, i]:.4g} to hold it, and may give "
            f"{limits.effort[i]:.4g}.",
            advice="Raise the limits of effort, or check masses and units of the model.",
            joint=limits.joints[i],
        )
    postures = postures[holds]
    if collisions is None:
        return postures[:most]
    return _apart(postures, joint_order(model), collisions, most)


def _apart(
    postures: Array, order: NDArray[np.intp], collisions: CollisionWorld, most: int
) -> Array:
    """The first of the postures in which nothing collides; the others are not looked at."""
    free: list[Array] = []
    best, nearest = -np.inf, ""
    for posture in postures:
        distance, names = collisions.distances(posture[None, order])
        if distance[0] >= collisions.clearance:
            free.append(posture)
        if distance[0] > best:
            best, nearest = float(distance[0]), names[0]
        if len(free) == most:
            break
    if not free:
        raise ArgumentError(
            f"The robot collides in all of {len(postures)} postures; in the best one, "
            f"{nearest} are {best:.4g} m apart, and shall be {collisions.clearance:g} m.",
            advice="Check the geometry and where the obstacles are.",
        )
    return np.array(free)
