"""Rows of a robot in contact, of which unknown contact forces are no part.

    Y φ + Σ Y_e μ_e = τ + Jᵀ w,      N J̃ᵀ = 0,      N (Y φ + Σ Y_e μ_e) = N τ

where J are the Jacobians of the frames that may touch, over all nv velocities, and rows of N, which
are orthonormal in the units of the noise, span what forces w of any size do not reach. Each row
belongs to a velocity: those of the base come first, then joints of limbs in the air, so that joints
of standing limbs have none. It holds at each instant, so that filtered rows hold as well, also
across touches and lifts. To take a frame for touching that does not is valid, and costs some rows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.effects.body_motion import RobotBodies
from geodrake.logs.motion import Trajectory
from geodrake.logs.smoothing import Segment
from geodrake.model.base_logs import contact_frames, frame_heights, may_touch
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_LEAST = 0.05  # of a row, that others leave of it
_FORCE, _EFFORT = 0.01, 0.03  # noise of base rows over the weight, and of joints over their efforts
_ARM = 0.15  # m, by which forces make moments of the base


def contact_rows(model: RobotModel, trajectory: Trajectory, segment: Segment) -> Array | None:
    """(N, nv, nv) N at instants of a segment, zeros in rows that there are none of.

    None of robots without unknown contacts.
    """
    contacts = trajectory.contacts
    if contacts is None:
        return None
    frames = contact_frames(model, contacts.frames)
    bodies = RobotBodies(model.tree, model.positions(segment.position), model.total_phi)
    J = np.stack([frame.jacobian(bodies) for frame in frames], 1)  # (N, c, 3, nv)
    flags = contacts.at(segment.time)
    if contacts.heights:
        near = may_touch(frame_heights(frames, bodies))
        flags = near if flags is None else flags | near
    if flags is None:
        flags = np.ones(J.shape[:2], bool)
    return rows_without(J, flags, row_scales(model, trajectory), len(model.base_joints), model)


def row_scales(model: RobotModel, trajectory: Trajectory) -> Array:
    """(nv,) about how noisy each velocity's row is, N·m or N; it weighs rows, and nothing else."""
    power, count = np.zeros(len(model.joints)), 0
    for segment in trajectory.segments:
        effort = segment[:10_000].effort
        power, count = power + np.square(effort).sum(axis=0), count + len(effort)
    scales = _EFFORT * np.sqrt(power / max(count, 1))
    scales = np.maximum(scales, 1e-3 * scales.max(initial=0.0))
    weight = float(model.total_phi[:, 0].sum() * np.linalg.norm(model.tree.gravity))
    for at, joint in enumerate(model.joints):
        if joint in model.base_joints:
            slides = joint in model.sliding_joints
            scales[at] = _FORCE * weight * (1.0 if slides else _ARM)
    return scales


def rows_without(
    J: Array, flags: NDArray[np.bool_], scales: Array, base: int, model: RobotModel
) -> Array:
    """Return `contact_rows` for Jacobians (N, c, 3, nv) of frames of which some touch (N, c)."""
    count, _, _, nv = J.shape
    found = np.zeros((count, nv, nv))
    first = [model.joints.index(joint) for joint in model.base_joints[:base]]
    modes, which = np.unique(flags, axis=0, return_inverse=True)
    for number, mode in enumerate(modes):
        at = np.flatnonzero(which.ravel() == number)
        if not mode.any():
            found[at] = np.eye(nv)
            continue
        K = J[at][:, mode].reshape(len(at), -1, nv) / scales
        Q, _ = np.linalg.qr(np.swapaxes(K, 1, 2))
        P = np.eye(nv) - Q @ np.swapaxes(Q, 1, 2)
        own = _owners(P[len(at) // 2], first, nv - Q.shape[2])
        A = P[:, :, own]
        G = A[:, own] + 1e-12 * np.eye(len(own))
        L = np.linalg.cholesky(G)
        N = np.linalg.solve(L, np.swapaxes(A, 1, 2))  # (n, r, nv), rows orthonormal
        rows = scales[own][:, None] * N / scales
        found[np.ix_(at, np.array(own))] = rows
    return found


def _owners(P: Array, first: Sequence[int], rank: int) -> list[int]:
    """Return velocities whose rows of a projection are a basis of it, those of the base first."""
    rest, own = P.copy(), list[int]()

    def take(at: int) -> None:
        nonlocal rest
        unit = rest[:, at] / np.linalg.norm(rest[:, at])
        rest = rest - np.outer(unit, unit @ rest)
        own.append(at)

    for at in first:
        if len(own) < rank and np.linalg.norm(rest[:, at]) > _LEAST:
            take(at)
    while len(own) < rank:
        sizes = np.linalg.norm(rest, axis=0)
        sizes[own] = 0.0
        take(int(np.argmax(sizes)))
    return own
