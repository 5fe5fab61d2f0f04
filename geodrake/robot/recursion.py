"""Recursive computation of efforts and their regressor.

From the world outwards, the recursion computes the motion of each body B, and the motion subspace
of the velocities that move it, about Bo and expressed in B. The contribution of B to the effort of
a velocity with the angular part s and the linear part t of the subspace is

    τ = t·f + s·n,   f = m a + α × h + u × (ω × h),
    n = I (α − ½ ω × u) + ½ (ω × I u + u × I ω) + h × a,

with the angular velocities ω of B and u of a reference motion v, and the rates α and a of the
reference motion's velocities, the latter at Bo and less gravity. The efforts are thus
M v̇ + C(q, q̇) v − τ_g with a skew-symmetric Ṁ − 2 C ([Lee2019] Eq. (5.2.10)). If velocities are
rates of positions, C is the matrix of Christoffel symbols. Inverse dynamics has v = q̇ and u = ω.

This is linear in (m, h, I), and the ten factors are a block of the regressor. If φ is known, the
wrenches (f, n) are propagated inwards instead (Newton–Euler), without subspaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.compiling import compiled, inlined
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.robot.joints import Features, FrameMotion
from geodrake.robot.vectors import (
    Vector,
    add,
    column,
    combination,
    cross,
    dot,
    inertia_times,
    put,
    put_row,
    row,
    scale,
    subtract,
    times,
    transposed_times,
    vector,
)

Samples = tuple[Array, Array, Array, Array]
"""Positions q (N, nq), velocities q̇, reference velocities v (usually q̇) and rates v̇, (N, nv)."""

Indices = NDArray[np.int64]
Numbers = NDArray[np.float64] | NDArray[np.complex128]
Record = Any
"""An entry of a structured array, whose fields compiled code reads by name."""

Motion = tuple[Vector, Vector, Vector, Vector]
"""ω, u, α and a of a body B, in B."""


@dataclass(frozen=True)
class Mobilizer:
    """A joint of the tree and the body B that it moves relative to the inboard body P."""

    parent: int  # index of the inboard mobilizer in the tree, -1 for the world
    body: int  # index of B among the lumped bodies, negative for a massless frame within a joint
    positions: slice  # in q
    velocities: slice  # in v
    dofs: tuple[int, ...]  # indices in v of all velocities that move B, the mobilizer's last
    motion: FrameMotion  # motion of the frame B, displaced to Mo, in P
    p_MoBo_B: Array  # noqa: N815
    gravity: bool  # whether gravity acts on B


MOBILIZER = np.dtype(
    [
        ("parent", np.int64),
        ("body", np.int64),
        ("positions", np.int64, (2,)),  # first index and count
        ("velocities", np.int64, (2,)),
        ("count", np.int64),  # number of velocities that move the body
        ("features", np.int64),
        ("rotation", float, (9, 9)),
        ("offset", float, (3,)),
        ("translation", float, (3, 7)),
        ("angular", float, (3, 6)),
        ("linear", float, (3, 6)),
        ("p_MoBo_B", float, (3,)),
        ("gravity", float, (3,)),  # acceleration of gravity in the world
    ],
    align=True,
)
"""A `Mobilizer` for compiled code."""

MOTION = np.dtype(
    [
        ("R_PB", float, (3, 3)),
        ("p_PMo", float, (3,)),
        ("w", float, (3,)),
        ("u", float, (3,)),
        ("wd", float, (3,)),
        ("a", float, (3,)),
    ],
    align=True,
)
"""Pose of a body B in P at one sample, and ω, u, α and a of Bo, in B."""

POSE = np.dtype([("R_WB", float, (3, 3)), ("p_WoBo_W", float, (3,))], align=True)
"""Pose of a body at one sample."""

_CONSTANT, _ANGLE, _RPY = (int(f) for f in (Features.CONSTANT, Features.ANGLE, Features.RPY))


TreeRecords = tuple[NDArray[np.void], Indices]
"""A tree for compiled code: records (m,) of `MOBILIZER`, and `dofs` (m, k), padded."""


def records_of(mobilizers: Sequence[Mobilizer], gravity: Array) -> TreeRecords:
    """Return the records of mobilizers, each after its parent."""
    most = max((len(mobilizer.dofs) for mobilizer in mobilizers), default=0)
    dofs = np.zeros((len(mobilizers), most), np.int64)
    records = np.zeros(len(mobilizers), MOBILIZER)
    for record, indices, mobilizer in zip(records, dofs, mobilizers, strict=True):
        joint, q, v = mobilizer.motion, mobilizer.positions, mobilizer.velocities
        indices[: len(mobilizer.dofs)] = mobilizer.dofs
        record["parent"], record["body"] = mobilizer.parent, mobilizer.body
        record["positions"], record["velocities"] = ((x.start, x.stop - x.start) for x in (q, v))
        record["count"], record["features"] = len(mobilizer.dofs), joint.features
        for name in ("rotation", "translation", "angular", "linear"):
            matrix = getattr(joint, name)
            record[name][:, : matrix.shape[1]] = matrix
        record["offset"], record["p_MoBo_B"] = joint.offset, mobilizer.p_MoBo_B
        record["gravity"] = mobilizer.gravity * gravity
    return records, dofs


@inlined
def features_of(mobilizer: Record, q: Numbers, n: int, out: Numbers) -> int:
    """Write the features of a joint's positions; return their number."""
    kind = mobilizer.features
    first, number = mobilizer.positions
    if kind == _CONSTANT:
        out[0] = 1.0
        return 1
    if kind == _ANGLE:
        angle = q[n, first + number - 1]
        out[0], out[1], out[2] = 1.0, np.cos(angle), np.sin(angle)
        return 3
    x, y, z = q[n, first], q[n, first + 1], q[n, first + 2]
    if kind == _RPY:
        sr, sp, sy = np.sin(x), np.sin(y), np.sin(z)
        cr, cp, cy = np.cos(x), np.cos(y), np.cos(z)
        out[0], out[1], out[2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
        out[3], out[4], out[5] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
        out[6], out[7], out[8] = -sp, cp * sr, cp * cr
        return 9
    w, x, y, z = x, y, z, q[n, first + 3]
    size = np.sqrt(2.0 / (w * w + x * x + y * y + z * z))
    w, x, y, z = size * w, size * x, size * y, size * z
    out[0], out[1], out[2] = 1.0 - y * y - z * z, x * y - w * z, x * z + w * y
    out[3], out[4], out[5] = x * y + w * z, 1.0 - x * x - z * z, y * z - w * x
    out[6], out[7], out[8] = x * z - w * y, y * z + w * x, 1.0 - x * x - y * y
    return 9


@inlined
def pose(mobilizer: Record, q: Array, n: int, features: Array, out: Record) -> None:
    """Write R_PB and the position of Mo in P at sample n; `features` (9,) is a work array."""
    number = features_of(mobilizer, q, n, features)
    C, R = mobilizer.rotation, out.R_PB
    for j in range(3):
        for k in range(3):
            R[j, k] = C[3 * j + k, 0] * features[0]
    for f in range(1, number):
        for j in range(3):
            for k in range(3):
                R[j, k] += C[3 * j + k, f] * features[f]
    slid = combination(mobilizer.translation, q, n, mobilizer.positions)
    put(out.p_PMo, add(vector(mobilizer.offset), slid))


@inlined
def motion_of(motion: Record) -> Motion:
    """Return ω, u, α and a of a body as values, so that compiled code reads the record once."""
    return vector(motion.w), vector(motion.u), vector(motion.wd), vector(motion.a)


@inlined
def inboard_motion(mobilizer: Record, motions: Record) -> Motion:
    """Return ω, u, α and a of the inboard body; the world is accelerated against gravity."""
    if mobilizer.parent < 0:
        still = (0.0, 0.0, 0.0)
        return still, still, still, scale(-1.0, vector(mobilizer.gravity))
    return motion_of(motions[mobilizer.parent])


@inlined
def move(mobilizers: Record, samples: Samples, n: int, features: Array, motions: Record) -> None:
    """Write the motion of all bodies at sample n, inboard before outboard."""
    q, qd, v, vd = samples
    for i in range(len(mobilizers)):
        mobilizer, motion = mobilizers[i], motions[i]
        pose(mobilizer, q, n, features, motion)
        span, R, p = mobilizer.velocities, motion.R_PB, vector(motion.p_PMo)
        w_P, u_P, wd_P, a_P = inboard_motion(mobilizer, motions)
        turned = combination(mobilizer.angular, v, n, span)
        slid = combination(mobilizer.linear, v, n, span)
        slide = combination(mobilizer.linear, qd, n, span)
        # Motion of B about Mo, in P, with ṗ = ω_P × p + slide.
        w, u = add(w_P, combination(mobilizer.angular, qd, n, span)), add(u_P, turned)
        wd = add(add(wd_P, combination(mobilizer.angular, vd, n, span)), cross(w_P, turned))
        a = add(add(a_P, combination(mobilizer.linear, vd, n, span)), cross(wd_P, p))
        a = add(a, add(cross(u_P, add(cross(w_P, p), slide)), cross(w_P, slid)))
        w, u = transposed_times(R, w), transposed_times(R, u)
        wd, a = transposed_times(R, wd), transposed_times(R, a)
        shift = vector(mobilizer.p_MoBo_B)
        put(motion.w, w)
        put(motion.u, u)
        put(motion.wd, wd)
        put(motion.a, add(a, add(cross(wd, shift), cross(u, cross(w, shift)))))


@inlined
def carried(mobilizer: Record, motion: Record, s: Vector, t: Vector) -> tuple[Vector, Vector]:
    """Return a motion (s, t) about Mo in P, expressed about Bo in B."""
    s, t = transposed_times(motion.R_PB, s), transposed_times(motion.R_PB, t)
    return s, add(t, cross(s, vector(mobilizer.p_MoBo_B)))


@inlined
def subspace_room(dofs: Indices) -> tuple[Array, Array]:
    """Return work arrays for the angular and linear parts (m, k, 3) of the motion subspaces."""
    shape = len(dofs), dofs.shape[1], 3
    return np.empty(shape), np.empty(shape)


@inlined
def find_subspaces(mobilizers: Record, motions: Record, turn: Array, slide: Array) -> None:
    """Write the angular and linear parts (m, k, 3) of the motion subspaces, about Bo, in B."""
    for i in range(len(mobilizers)):
        mobilizer, p = mobilizers[i], vector(motions[i].p_PMo)
        parent = mobilizer.parent
        old = mobilizers[parent].count if parent >= 0 else 0
        for k in range(mobilizer.count):
            if k < old:
                s = row(turn, parent, k)
                t = add(row(slide, parent, k), cross(s, p))
            else:
                s, t = column(mobilizer.angular, k - old), column(mobilizer.linear, k - old)
            s, t = carried(mobilizer, motions[i], s, t)
            put_row(turn, i, k, s)
            put_row(slide, i, k, t)


@inlined
def put_block(motion: Motion, s: Vector, t: Vector, out: Array, place: Any) -> None:
    """Write the ten factors of φ in the effort of a body at a velocity.

    `place` is the index of the first one in `out` (N, rows, columns).
    """
    (w, u, wd, a), (n, line, start) = motion, place
    # h: a × s + Bᵀ t with B = α× + u×ω×.
    h = add(cross(a, s), cross(t, wd))
    h = add(h, subtract(scale(dot(w, t), u), scale(dot(w, u), t)))
    # I: s·(I α) + c·(I u) − ½ tr(I) c·u with c = s × ω.
    c = cross(s, w)
    trace = 0.5 * dot(c, u)
    out[n, line, start] = dot(t, a)
    out[n, line, start + 1], out[n, line, start + 2], out[n, line, start + 3] = h
    out[n, line, start + 4] = s[0] * wd[0] + c[0] * u[0] - trace
    out[n, line, start + 5] = s[1] * wd[1] + c[1] * u[1] - trace
    out[n, line, start + 6] = s[2] * wd[2] + c[2] * u[2] - trace
    out[n, line, start + 7] = s[0] * wd[1] + s[1] * wd[0] + c[0] * u[1] + c[1] * u[0]
    out[n, line, start + 8] = s[1] * wd[2] + s[2] * wd[1] + c[1] * u[2] + c[2] * u[1]
    out[n, line, start + 9] = s[2] * wd[0] + s[0] * wd[2] + c[2] * u[0] + c[0] * u[2]


@compiled
def calc_regressor(tree: TreeRecords, samples: Samples, which: tuple[int, int], out: Array) -> None:
    """Write the regressor into zeros (N, rows, 10 nb), or (N, rows, 10) for one body.

    `which` is the velocity of the first row, and the body or −1 for all.
    """
    (mobilizers, dofs), (first, only) = tree, which
    motions, features = np.empty(len(mobilizers), MOTION), np.empty(9)
    turn, slide = subspace_room(dofs)
    for n in range(len(samples[0])):
        move(mobilizers, samples, n, features, motions)
        find_subspaces(mobilizers, motions, turn, slide)
        for i in range(len(mobilizers)):
            body = mobilizers[i].body
            if body >= 0 and (only < 0 or body == only):
                start = PARAMETERS_PER_BODY * body if only < 0 else 0
                motion = motion_of(motions[i])
                for k in range(mobilizers[i].count):
                    s, t, line = row(turn, i, k), row(slide, i, k), dofs[i, k] - first
                    put_block(motion, s, t, out, (n, line, start))


@inlined
def wrench_of(phi: Array, b: int, motion: Record) -> tuple[Vector, Vector]:
    """Return the force and the moment about Bo for the motion of body b of φ (nb, 10)."""
    w, u, wd, a = motion_of(motion)
    h = phi[b, 1], phi[b, 2], phi[b, 3]
    force = add(scale(phi[b, 0], a), add(cross(wd, h), cross(u, cross(w, h))))
    gyroscopic = add(cross(w, inertia_times(phi, b, u)), cross(u, inertia_times(phi, b, w)))
    moment = inertia_times(phi, b, subtract(wd, scale(0.5, cross(w, u))))
    return force, add(add(moment, scale(0.5, gyroscopic)), cross(h, a))


@compiled
def calc_inverse_dynamics(tree: TreeRecords, samples: Samples, phi: Array, out: Array) -> None:
    """Add the efforts of a motion for φ (nb, 10), N·m or N, to zeros (N, nv)."""
    mobilizers, _ = tree
    bodies = len(mobilizers)
    motions, features = np.empty(bodies, MOTION), np.empty(9)
    forces, moments = np.empty((bodies, 3)), np.empty((bodies, 3))
    for n in range(len(samples[0])):
        move(mobilizers, samples, n, features, motions)
        for i in range(bodies):
            force = moment = (0.0, 0.0, 0.0)
            if mobilizers[i].body >= 0:
                force, moment = wrench_of(phi, mobilizers[i].body, motions[i])
            forces[i, 0], forces[i, 1], forces[i, 2] = force
            moments[i, 0], moments[i, 1], moments[i, 2] = moment
        for i in range(bodies - 1, -1, -1):
            mobilizer, R = mobilizers[i], motions[i].R_PB
            force = forces[i, 0], forces[i, 1], forces[i, 2]
            moment = moments[i, 0], moments[i, 1], moments[i, 2]
            moment = add(moment, cross(vector(mobilizer.p_MoBo_B), force))  # about Mo
            force, moment = times(R, force), times(R, moment)
            first, number = mobilizer.velocities[0], mobilizer.velocities[1]
            for k in range(number):
                s, t = column(mobilizer.angular, k), column(mobilizer.linear, k)
                out[n, first + k] += dot(s, moment) + dot(t, force)
            parent = mobilizer.parent
            if parent >= 0:
                moment = add(moment, cross(vector(motions[i].p_PMo), force))
                for x in range(3):
                    forces[parent, x] += force[x]
                    moments[parent, x] += moment[x]


@compiled
def calc_acceleration(tree: TreeRecords, samples: Samples, angular: Array, linear: Array) -> None:
    """Write the accelerations (N, 3) of the last body B: angular, and of Bo less gravity, in B."""
    mobilizers, _ = tree
    motions, features, last = np.empty(len(mobilizers), MOTION), np.empty(9), len(mobilizers) - 1
    for n in range(len(samples[0])):
        move(mobilizers, samples, n, features, motions)
        put(angular[n], vector(motions[last].wd))
        put(linear[n], vector(motions[last].a))


@inlined
def put_pose(mobilizer: Record, motion: Record, world: Record, out: Record) -> None:
    """Write R_WB and the position of Bo in W, from the pose of the inboard body."""
    place = add(vector(motion.p_PMo), times(motion.R_PB, vector(mobilizer.p_MoBo_B)))
    if mobilizer.parent < 0:
        for k in range(3):
            out.R_WB[0, k], out.R_WB[1, k], out.R_WB[2, k] = column(motion.R_PB, k)
        put(out.p_WoBo_W, place)
    else:
        inboard = world[mobilizer.parent]
        for k in range(3):
            axis = times(inboard.R_WB, column(motion.R_PB, k))
            out.R_WB[0, k], out.R_WB[1, k], out.R_WB[2, k] = axis
        put(out.p_WoBo_W, add(vector(inboard.p_WoBo_W), times(inboard.R_WB, place)))


@inlined
def place_bodies(
    mobilizers: Record, sample: tuple[Array, int, Array], motions: Record, world: Record
) -> None:
    """Write the poses of all bodies, relative and in the world; `sample` is q, row, work array."""
    q, n, features = sample
    for i in range(len(mobilizers)):
        pose(mobilizers[i], q, n, features, motions[i])
        put_pose(mobilizers[i], motions[i], world, world[i])


@compiled
def calc_places(tree: TreeRecords, q: Array, rotations: Array, lines: Array) -> None:
    """Write R_WBᵀ (m, N, 3, 3) of bodies B, and the motion of B by its own velocities.

    The latter has ω and the velocity of Bo at unit speed, and p_WoBo, (nv, N, 3, 3), in W.
    """
    mobilizers, _ = tree
    bodies = len(mobilizers)
    motions, features = np.empty(bodies, MOTION), np.empty(9)
    world = np.empty(bodies, POSE)
    for n in range(len(q)):
        place_bodies(mobilizers, (q, n, features), motions, world)
        for i in range(bodies):
            mobilizer, pose_B = mobilizers[i], world[i]
            for k in range(3):
                put_row(rotations[i], n, k, column(pose_B.R_WB, k))
            first, number = mobilizer.velocities
            for k in range(number):
                s, t = column(mobilizer.angular, k), column(mobilizer.linear, k)
                s, t = carried(mobilizer, motions[i], s, t)
                line = lines[first + k]
                put_row(line, n, 0, times(pose_B.R_WB, s))
                put_row(line, n, 1, times(pose_B.R_WB, t))
                put_row(line, n, 2, vector(pose_B.p_WoBo_W))


@compiled
def calc_kinematics(
    tree: TreeRecords, q: Array, poses: Array, angular: Array, linear: Array
) -> None:
    """Write poses X_WB (N, nb, 4, 4) of all bodies into zeros, and their Jacobians (N, nb, 3, nv).

    The Jacobians are those of ω and of the velocity of Bo, in W; empty arrays omit them.
    """
    mobilizers, dofs = tree
    bodies = len(mobilizers)
    motions, features = np.empty(bodies, MOTION), np.empty(9)
    turn, slide = subspace_room(dofs)
    world = np.empty(bodies, POSE)
    for n in range(len(q)):
        place_bodies(mobilizers, (q, n, features), motions, world)
        for i in range(bodies):
            body, pose_B = mobilizers[i].body, world[i]
            if body >= 0:
                poses[n, body, 3, 3] = 1.0
                for j in range(3):
                    poses[n, body, j, 3] = pose_B.p_WoBo_W[j]
                    for k in range(3):
                        poses[n, body, j, k] = pose_B.R_WB[j, k]
        if len(angular):
            find_subspaces(mobilizers, motions, turn, slide)
            for i in range(bodies):
                body, R = mobilizers[i].body, world[i].R_WB
                if body >= 0:
                    for k in range(mobilizers[i].count):
                        s, t = times(R, row(turn, i, k)), times(R, row(slide, i, k))
                        for x in range(3):
                            angular[n, body, x, dofs[i, k]] += s[x]
                            linear[n, body, x, dofs[i, k]] += t[x]
