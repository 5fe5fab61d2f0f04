"""Equations of motion free of unknown contact forces and unmeasured efforts.

    Y φ + Σ Y_e μ_e = τ + Jᵀ w,      N J̃ᵀ = 0,      N (Y φ + Σ Y_e μ_e) = N τ

J are the Jacobians of the frames that may be in contact, over all nv velocities. The rows of N span
the directions that no contact force w affects, and are orthonormal in units of the noise (J̃). Each
row belongs to a velocity: first those of the base, then joints of limbs in the air; joints of
standing limbs have none. The equation holds at each instant, so that filtering is valid across
touches and lifts. A frame in doubt counts as touching, which is valid and costs some rows. Joints
with unmeasured efforts have no rows, and no part in others.
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

_LEAST = 0.05  # least norm of a row's part orthogonal to the rows before it
_FORCE, _EFFORT = 0.01, 0.03  # noise of base rows over the weight, of joint rows over their efforts
_NONE = 1e-9  # relative rounding error of a row
_ARM = 0.15  # lever arm of forces for moments of the base, m


def contact_rows(model: RobotModel, trajectory: Trajectory, segment: Segment) -> MixedRows | None:
    """Return the rows N at the instants of a segment; None if all forces and efforts are known."""
    measured = ~np.isin(model.joints, trajectory.unmeasured)
    if (contacts := trajectory.contacts) is None:
        single = np.tile(measured.astype(float), (len(segment), 1))
        return None if measured.all() else MixedRows(single, {})
    base = [model.joints.index(joint) for joint in model.base_joints]
    (J, flags), scales = contacts_in(model, contacts, segment), row_scales(model, trajectory)
    return rows_without(J, flags, scales, base, measured=measured)


def contacts_in(
    model: RobotModel, contacts: ContactFlags, segment: Segment
) -> tuple[Array, NDArray[np.bool_]]:
    """Return Jacobians (N, c, k, nv) and contact flags (N, c) of frames in a segment."""
    bodies = RobotBodies(model.tree, model.positions(segment.position), model.total_phi)
    frames = contact_frames(model, contacts.frames)
    J = contact_jacobians(frames, bodies, soles=on_soles(contacts, frames))
    return J, contacts.at(segment.time)


@dataclass(frozen=True, eq=False)
class MixedRows:
    """Rows N of a segment, stored densely only where they combine several velocities."""

    single: Array  # (N, nv) 1 where a row is that of its velocity alone, 0 if mixed or absent
    mixed: Mapping[int, Array]  # velocity -> its row (N, nv), if it is mixed at any instant

    @property
    def coupling(self) -> NDArray[np.bool_]:
        """(nv, nv) whether the row of the first velocity ever includes the second."""
        coupling = np.eye(self.single.shape[1], dtype=bool)
        for i, row in self.mixed.items():
            coupling[i] |= (np.abs(row) > _NONE).any(axis=0)
        return coupling

    @property
    def shares(self) -> Array:
        """(nv,) share of the instants at which a velocity has a row."""
        shares = self.single.mean(axis=0)
        for i, row in self.mixed.items():
            shares[i] = row.any(axis=1).mean()
        return np.asarray(shares)

    def __getitem__(self, instants: slice) -> MixedRows:
        """Return the rows at some of the instants."""
        mixed = {i: row[instants] for i, row in self.mixed.items()}
        return MixedRows(self.single[instants], mixed)

    def efforts(self, efforts: Array) -> Array:
        """Return the efforts (N, nv) of rows from those of velocities."""
        of_rows = self.single * efforts
        for i, row in self.mixed.items():
            of_rows[:, i] = np.einsum("nj,nj->n", row, efforts)
        return of_rows

    def powers(self, powers: Array) -> Array:
        """Return the mean noise power (nv,) of rows from that of velocities (nv,)."""
        of_rows = np.square(self.single).mean(axis=0) * powers
        for i, row in self.mixed.items():
            of_rows[i] = np.square(row).mean(axis=0) @ powers
        return np.asarray(of_rows)


@compiled
def add_weighted(
    row: Array, columns: Array, which: tuple[Indices, Indices, Indices], total: Array
) -> None:
    """Add columns (·, N) of velocities, weighted by a mixed row (nv, N), to `total`.

    Args:
        which: Indices (k,) of the columns, of their velocities, and of their targets in `total`.
    """
    used, sources, targets = which
    for k in range(len(used)):
        weight, column, sums = row[sources[k]], columns[used[k]], total[targets[k]]
        for n in range(len(sums)):
            sums[n] += weight[n] * column[n]


def row_scales(model: RobotModel, trajectory: Trajectory) -> Array:
    """Return rough noise levels (nv,) of the velocities' rows, N·m or N.

    They depend on the weight in the file, so that rows are the same for all fits of a model.
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
    """Return the rows N for Jacobians (N, c, k, nv) and contact flags (N, c) of frames.

    Args:
        scales: (nv,) noise of the rows of velocities, N·m or N.
        base: Velocities of the base, which get rows first.
        measured: (nv,) whether the effort of a velocity is measured; by default all are.
    """
    count, _, _, nv = J.shape
    affects, J = np.asarray(J.any(axis=(0, 2))), contiguous(J)
    states, state_indices = np.unique(flags, axis=0, return_inverse=True)
    known = np.ones(nv, bool) if measured is None else measured
    single = np.tile(known.astype(float), (count, 1))
    modes = list[tuple[Indices, Indices, Indices, Indices]]()
    for number, state in enumerate(states):
        at, feet = np.flatnonzero(state_indices.ravel() == number), np.flatnonzero(state)
        moving = np.flatnonzero(affects[feet].any(axis=0) & known)  # the others have single rows
        if not len(moving):
            continue
        single[at[:, None], moving] = 0.0
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
        row[:, i], single[:, i] = single[:, i], 0.0
    for at, feet, moving, owners in modes:
        if len(owners):
            rows = np.zeros((len(at), len(owners), len(moving)))
            calc_free_rows(J, (at, feet, moving, owners), scales, rows)
            for k, i in enumerate(moving[owners].tolist()):
                mixed[i][at[:, None], moving] = rows[:, k]
    return MixedRows(single, mixed)


@inlined
def _orthogonalize(basis: Array, k: int) -> None:
    """Orthonormalize row k of a basis against those before it, or set it to zero."""
    row, whole = basis[k], 0.0
    for i in range(len(row)):
        whole += row[i] * row[i]
    size, before = whole, np.inf
    while size < 0.5 * before:  # repeat after cancellation
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
    """Write rows orthogonal to those of J (N, c, k, nv), by Gram–Schmidt.

    Args:
        which: Instants, frames in contact there, velocities (m,) that move them, and the owners
            (r,) of rows among these, whose unit vectors are orthogonalized.
        scales: (nv,) units of velocities' rows in which they are orthonormal.
        rows: (N', r, m) rows at these instants, to be written.
    """
    instants, frames, moving, owners = which
    axes, nv = J.shape[2], len(moving)
    m = len(frames) * axes
    basis = np.empty((m + len(owners), nv))
    for at, n in enumerate(instants):
        for k in range(m + len(owners)):
            row = basis[k]
            for i in range(nv):
                if k < m:
                    row[i] = J[n, frames[k // axes], k % axes, moving[i]] / scales[moving[i]]
                else:
                    row[i] = 1.0 if i == owners[k - m] else 0.0
            _orthogonalize(basis, k)
            if k >= m:
                scale = scales[moving[owners[k - m]]]
                for i in range(nv):
                    rows[at, k - m, i] = scale * row[i] / scales[moving[i]]


def _owners(P: Array, first: Sequence[int], rank: int) -> list[int]:
    """Return velocities whose rows of a projection P span its range, those of `first` preferred."""
    rest, owners = P.copy(), list[int]()

    def take(index: int) -> None:
        nonlocal rest
        unit = rest[:, index] / np.linalg.norm(rest[:, index])
        rest = rest - np.outer(unit, unit @ rest)
        owners.append(index)

    for index in first:
        if len(owners) < rank and np.linalg.norm(rest[:, index]) > _LEAST:
            take(index)
    while len(owners) < rank:
        sizes = np.linalg.norm(rest, axis=0)
        sizes[owners] = 0.0
        take(int(np.argmax(sizes)))
    return owners
