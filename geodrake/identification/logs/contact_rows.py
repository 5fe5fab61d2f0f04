"""Rows of a robot in contact that unknown contact forces and unmeasured efforts do not reach.

    Y φ + Σ Y_e μ_e = τ + Jᵀ w,      N J̃ᵀ = 0,      N (Y φ + Σ Y_e μ_e) = N τ

J are the Jacobians of the frames that may touch, over all nv velocities. Rows of N span what no
force w changes, and are orthonormal in the units of the noise (J̃). Each row belongs to a velocity:
those of the base first, then joints of limbs in the air; joints of standing limbs have none. The
equation holds at each instant, and so does any filter of it, also across touches and lifts. A frame
in doubt counts as touching, which is valid and costs some rows. Joints whose efforts nobody
measured have no rows, and are in none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, contiguous, inlined
from geodrake.effects.body_motion import RobotBodies
from geodrake.inertia import inertial_parameters
from geodrake.logs.floating import ContactFlags
from geodrake.logs.motion import Trajectory
from geodrake.logs.smoothing import Segment
from geodrake.model.ground_contacts import contact_frames, contact_jacobians, on_soles
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_LEAST = 0.05  # share of a row that is independent of the rows before it
_FORCE, _EFFORT = 0.01, 0.03  # noise of base rows over the weight, and of joints over their efforts
_NONE = 1e-9  # of a row, what is rounding
_ARM = 0.15  # m, by which forces make moments of the base


def contact_rows(model: RobotModel, trajectory: Trajectory, segment: Segment) -> MixedRows | None:
    """Return rows N at the instants of a segment; None if all forces and efforts are known."""
    measured = ~np.isin(model.joints, trajectory.unmeasured)
    if (contacts := trajectory.contacts) is None:
        own = np.tile(measured.astype(float), (len(segment), 1))
        return None if measured.all() else MixedRows(own, {})
    base = [model.joints.index(joint) for joint in model.base_joints]
    (J, flags), scales = contacts_in(model, contacts, segment), row_scales(model, trajectory)
    return rows_without(J, flags, scales, base, measured=measured)


def contacts_in(
    model: RobotModel, contacts: ContactFlags, segment: Segment
) -> tuple[Array, NDArray[np.bool_]]:
    """Return Jacobians (N, c, k, nv) of frames at the instants of a segment, and if they touch."""
    bodies = RobotBodies(model.tree, model.positions(segment.position), model.total_phi)
    frames = contact_frames(model, contacts.frames)
    J = contact_jacobians(frames, bodies, soles=on_soles(contacts, frames))
    return J, contacts.at(segment.time)


@dataclass(frozen=True, eq=False)
class MixedRows:
    """Rows N of a segment without the zeros of limbs in the air, whose rows are their own.

    Attributes:
        own: (N, nv) 1 where a row is that of its velocity alone, 0 where it is none or mixed.
        mixed: Velocity -> its row (N, nv), where that has others in it at any instant.
    """

    own: Array
    mixed: Mapping[int, Array]

    @property
    def coupling(self) -> NDArray[np.bool_]:
        """(nv, nv) whether the row of the first velocity ever has the second in it."""
        found = np.eye(self.own.shape[1], dtype=bool)
        for i, row in self.mixed.items():
            found[i] |= (np.abs(row) > _NONE).any(axis=0)
        return found

    @property
    def shares(self) -> Array:
        """(nv,) share of the instants in which a velocity has a row."""
        found = self.own.mean(axis=0)
        for i, row in self.mixed.items():
            found[i] = row.any(axis=1).mean()
        return np.asarray(found)

    def __getitem__(self, at: slice) -> MixedRows:
        """Return the rows at some of the instants."""
        return MixedRows(self.own[at], {i: row[at] for i, row in self.mixed.items()})

    def efforts(self, efforts: Array) -> Array:
        """Return efforts (N, nv) of rows from those of velocities."""
        found = self.own * efforts
        for i, row in self.mixed.items():
            found[:, i] = np.einsum("nj,nj->n", row, efforts)
        return found

    def powers(self, powers: Array) -> Array:
        """Return the mean power (nv,) of rows of noise that has a power (nv,) in velocities."""
        found = np.square(self.own).mean(axis=0) * powers
        for i, row in self.mixed.items():
            found[i] = np.square(row).mean(axis=0) @ powers
        return np.asarray(found)


@compiled
def add_weighted(
    row: Array, columns: Array, which: tuple[Indices, Indices, Indices], total: Array
) -> None:
    """Add columns (·, N) of velocities, weighted by a row (nv, N), to others.

    Args:
        which: (k,) the columns, the velocities that they are of, and which others they go to.
    """
    used, sources, at = which
    for k in range(len(used)):
        weight, own, sums = row[sources[k]], columns[used[k]], total[at[k]]
        for n in range(len(sums)):
            sums[n] += weight[n] * own[n]


def row_scales(model: RobotModel, trajectory: Trajectory) -> Array:
    """Return rough noise (nv,) of the rows of velocities, N·m or N, by which they are weighed.

    The weight is that of the file, so that rows are the same for all fits of a model.
    """
    power, count = np.zeros(len(model.joints)), 0
    for segment in trajectory.segments:
        effort = segment[:10_000].effort
        power, count = power + np.square(effort).sum(axis=0), count + len(effort)
    scales = _EFFORT * np.sqrt(power / max(count, 1))
    scales = np.maximum(scales, 1e-3 * scales.max(initial=0.0))
    mass = inertial_parameters(model.plant)[:, 0].sum()
    weight = float(mass * np.linalg.norm(model.tree.gravity))
    for at, joint in enumerate(model.joints):
        if joint in model.base_joints and weight > 0.0:
            slides = joint in model.sliding_joints
            scales[at] = _FORCE * weight * (1.0 if slides else _ARM)
    return scales


def rows_without(
    J: Array,
    flags: NDArray[np.bool_],
    scales: Array,
    base: Sequence[int],
    *,
    measured: NDArray[np.bool_] | None = None,
) -> MixedRows:
    """Return rows N for the Jacobians (N, c, k, nv) of frames; (N, c) marks contacts.

    Args:
        scales: (nv,) noise of the rows of velocities, N·m or N.
        base: Velocities of the base, which get rows first.
        measured: (nv,) whether efforts of velocities are known; by default of all.
    """
    count, _, _, nv = J.shape
    reached, J = np.asarray(J.any(axis=(0, 2))), contiguous(J)
    states, which = np.unique(flags, axis=0, return_inverse=True)
    known = np.ones(nv, bool) if measured is None else measured
    own, modes = (
        np.tile(known.astype(float), (count, 1)),
        list[tuple[Indices, Indices, Indices, Indices]](),
    )
    for number, state in enumerate(states):
        at, feet = np.flatnonzero(which.ravel() == number), np.flatnonzero(state)
        moving = np.flatnonzero(reached[feet].any(axis=0) & known)  # others' rows are their own
        if not len(moving):
            continue
        own[at[:, None], moving] = 0.0
        K = J[at[len(at) // 2]][state][:, :, moving].reshape(-1, len(moving)) / scales[moving]
        Q = np.linalg.qr(K.T)[0]
        first = np.flatnonzero(np.isin(moving, base)).tolist()
        rank = len(moving) - Q.shape[1]
        owners = np.array(_owners(np.eye(len(moving)) - Q @ Q.T, first, rank), np.intp)
        modes.append((at, feet, moving, owners))
    mixed = {
        int(i): np.zeros((count, nv)) for _, _, moving, owners in modes for i in moving[owners]
    }
    for i, row in mixed.items():
        row[:, i], own[:, i] = own[:, i], 0.0
    for at, feet, moving, owners in modes:
        if len(owners):
            rows = np.zeros((len(at), len(owners), len(moving)))
            calc_free_rows(J, (at, feet, moving, owners), scales, rows)
            for k, i in enumerate(moving[owners].tolist()):
                mixed[i][at[:, None], moving] = rows[:, k]
    return MixedRows(own, mixed)


@inlined
def _orthogonalize(basis: Array, k: int) -> None:
    """Orthonormalize row k of a basis against those before it, or set it to zero."""
    row, whole = basis[k], 0.0
    for i in range(len(row)):
        whole += row[i] * row[i]
    size, before = whole, np.inf
    while size < 0.5 * before:  # once leaves what rounding left of the first ones
        before = size
        for other in range(k):
            along = 0.0
            for i in range(len(row)):
                along += basis[other, i] * row[i]
            for i in range(len(row)):
                row[i] -= along * basis[other, i]
        size = 0.0
        for i in range(len(row)):
            size += row[i] * row[i]
        if size <= _NONE**2 * whole:
            row[:] = 0.0
            return
    for i in range(len(row)):
        row[i] /= np.sqrt(size)


@compiled
def calc_free_rows(
    J: Array,
    which: tuple[Indices, Indices, Indices, Indices],
    scales: Array,
    rows: Array,
) -> None:
    """Write rows that are orthogonal to those of J (N, c, k, nv), by Gram and Schmidt.

    Args:
        which: Instants, frames that touch there, velocities (m,) that move them, and (r,) those of
            the latter from whose unit vectors rows begin.
        scales: (nv,) units of velocities' rows in which they are orthonormal.
        rows: (N', r, m) rows at these instants, to be written.
    """
    instants, frames, moving, own = which
    axes, nv = J.shape[2], len(moving)
    m = len(frames) * axes
    basis = np.empty((m + len(own), nv))
    for at, n in enumerate(instants):
        for k in range(m + len(own)):
            row = basis[k]
            for i in range(nv):
                if k < m:
                    row[i] = J[n, frames[k // axes], k % axes, moving[i]] / scales[moving[i]]
                else:
                    row[i] = 1.0 if i == own[k - m] else 0.0
            _orthogonalize(basis, k)
            if k >= m:
                scale = scales[moving[own[k - m]]]
                for i in range(nv):
                    rows[at, k - m, i] = scale * row[i] / scales[moving[i]]


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
