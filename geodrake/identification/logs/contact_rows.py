"""Rows of a robot in contact that unknown contact forces do not reach.

    Y φ + Σ Y_e μ_e = τ + Jᵀ w,      N J̃ᵀ = 0,      N (Y φ + Σ Y_e μ_e) = N τ

J are the Jacobians of the frames that may touch, over all nv velocities. Rows of N span what no
force w changes, and are orthonormal in the units of the noise (J̃). Each row belongs to a velocity:
those of the base first, then joints of limbs in the air; joints of standing limbs have none. The
equation holds at each instant, and so does any filter of it, also across touches and lifts. A frame
in doubt counts as touching, which is valid and costs some rows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.effects.body_motion import RobotBodies
from geodrake.logs.motion import Trajectory
from geodrake.logs.smoothing import Segment
from geodrake.model.ground_contacts import contact_frames
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_LEAST = 0.05  # share of a row that is independent of the rows before it
_FORCE, _EFFORT = 0.01, 0.03  # noise of base rows over the weight, and of joints over their efforts
_ARM = 0.15  # m, by which forces make moments of the base


def contact_rows(model: RobotModel, trajectory: Trajectory, segment: Segment) -> Array | None:
    """Return N (N, nv, nv) at the instants of a segment; None if no contact force is unknown.

    Rows of velocities that have none are zero.
    """
    if (contacts := trajectory.contacts) is None:
        return None
    bodies = RobotBodies(model.tree, model.positions(segment.position), model.total_phi)
    frames = contact_frames(model, contacts.frames)
    J = np.stack([frame.jacobian(bodies) for frame in frames], 1)  # (N, c, 3, nv)
    base = [model.joints.index(joint) for joint in model.base_joints]
    return rows_without(J, contacts.at(segment.time), row_scales(model, trajectory), base)


def row_scales(model: RobotModel, trajectory: Trajectory) -> Array:
    """Return rough noise (nv,) of the rows of velocities, N·m or N, by which they are weighed."""
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


def rows_without(J: Array, flags: NDArray[np.bool_], scales: Array, base: Sequence[int]) -> Array:
    """Return N (N, nv, nv) for Jacobians (N, c, 3, nv) of frames, of which some touch (N, c).

    Args:
        scales: (nv,) noise of the rows of velocities, N·m or N.
        base: Velocities of the base, which get rows first.
    """
    count, _, _, nv = J.shape
    found = np.zeros((count, nv, nv))
    modes, which = np.unique(flags, axis=0, return_inverse=True)
    for number, mode in enumerate(modes):
        at = np.flatnonzero(which.ravel() == number)
        if not mode.any():
            found[at] = np.eye(nv)
            continue
        K = J[at][:, mode].reshape(len(at), -1, nv) / scales
        Q, _ = np.linalg.qr(np.swapaxes(K, 1, 2))
        P = np.eye(nv) - Q @ np.swapaxes(Q, 1, 2)
        own = _owners(P[len(at) // 2], base, nv - Q.shape[2])
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
