"""Derivatives of efforts with respect to the motion of every joint, for many samples at once.

They are those of τ = M(q) v̇ + C(q, v) v − τ_g(q) by q_j, v_j and v̇_j of a joint j with one degree
of freedom. A body's motion has a velocity field V = (ω, u), x ↦ u + ω × x in the world, and an
acceleration field A = (α, a), where α and a are the rates of ω and u less gravity. The motion
S_j = (s, t) at unit speed of j is such a field, too, and so are cross products

    V × S = (ω × s, ω × t + u × s).

Let P be the body inboard of j. Relative to the bodies outboard of j, which move with q_j, their
fields V and A change by

    q_j:  ψ = V_P × S_j      and  A_P × S_j + ψ × (V − V_P),
    v_j:  S_j                and  2 ψ + S_j × V,
    v̇_j:  0                  and  S_j.

The rate of a body's momentum, a wrench W = (f, n) about the world's origin, thus changes by

    q_j:  I ψ̇ + 2 B ψ with ψ̇ = A_P × S_j + V_P × ψ,   v_j:  2 (I ψ + B S_j),   v̇_j:  I S_j,

where I (s, t) is the momentum of the field, and B (s, t) has the force s × p and the moment
(tr Q − Q) s, with the momentum p = ∫ v dm and Q = ∫ v xᵀ dm. I and B are sums over all bodies
outboard of a joint. The effort of a joint k is the power of their wrench along S_k. If k is inboard
of j, the wrench also moves with q_j.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant

from geodrake.boundary.arguments import real_array
from geodrake.compiling import compiled, contiguous, inlined
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.logs.motion import Motion
from geodrake.robot.coordinates import RobotCoordinates
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.recursion import (
    MOTION,
    POSE,
    Record,
    Samples,
    TreeRecords,
    calc_inverse_dynamics,
    carried,
    move,
    put_pose,
    wrench_of,
)
from geodrake.robot.regressor import checked_samples, checked_tree
from geodrake.robot.transmission import times as products
from geodrake.robot.vectors import (
    Vector,
    add,
    column,
    cross,
    dot,
    inertia_times,
    put_row,
    row,
    scale,
    subtract,
    times,
    transposed_times,
    vector,
)

_SECOND, _TURNING, _MOMENTUM, _FORCE, _MOMENT = 1, 4, 7, 8, 9  # rows of sums over bodies


@dataclass(frozen=True, eq=False)
class EffortSlopes:
    """Derivatives [:, i, j] of effort i; NaN if j belongs to a joint of several degrees."""

    position: Array  # (N, nv, nv) ∂τ_i/∂q_j
    velocity: Array  # (N, nv, nv) ∂τ_i/∂v_j
    acceleration: Array  # (N, nv, nv) ∂τ_i/∂v̇_j = M_ij


def effort_slopes(
    plant: MultibodyPlant | KinematicTree,
    q: ArrayLike,
    v: ArrayLike,
    vd: ArrayLike,
    phi: ArrayLike,
    *,
    only_position: bool = False,
) -> EffortSlopes:
    """Return the derivatives of `geodrake.robot.regressor.inverse_dynamics`.

    With `only_position`, the others may be NaN, in half the time.
    """
    robot = checked_tree(plant)
    tree, samples, J = checked_samples(robot, q, v, vd)
    phi = contiguous(real_array(phi, "phi", (len(tree.bodies), PARAMETERS_PER_BODY)))
    count, nv = len(samples[0]), tree.num_velocities
    kinds, slopes = 1 if only_position and J is None else 3, np.full((3, count, nv, nv), np.nan)
    slopes[:kinds] = 0.0
    calc_effort_slopes(tree.records, samples, phi, slopes[:kinds])
    result = EffortSlopes(*np.swapaxes(slopes, 2, 3))  # contiguous by velocity
    several = [m.velocities for m in tree.mobilizers if m.velocities.stop - m.velocities.start > 1]
    columns = [k for span in several for k in range(span.start, span.stop)]
    if J is not None and robot.actuation is not None:
        efforts = np.zeros((count, nv))
        calc_inverse_dynamics(tree.records, samples, phi, efforts)
        result = _at_actuators(
            result, robot.actuation, J, efforts, Motion(*(np.asarray(x, float) for x in (q, v, vd)))
        )
        columns = [k for k in map(robot.actuation.standing.get, columns) if k is not None]
    for slope in (result.position, result.velocity, result.acceleration):
        slope[..., columns] = np.nan
    return result


def _at_actuators(
    slopes: EffortSlopes, actuation: RobotCoordinates, J: Array, efforts: Array, motion: Motion
) -> EffortSlopes:
    """Return the derivatives of τ_q = Jᵀ τ_θ(T(q), J q̇, J q̈ + J̇ q̇) by the chain rule.

    With the second derivatives H of T, ∂(J w)/∂q = H w, which is J̇ for q̇ = w. Thus

        ∂θ̈/∂q̇ = 2 J̇,   ∂θ̇/∂q = J̇,   ∂θ̈/∂q = H q̈ + ∂(J̇ q̇)/∂q,   ∂(Jᵀ τ)/∂q = Hᵀ τ.
    """
    JT, q, v, vd = np.swapaxes(J, 1, 2), motion.q, motion.v, motion.vd
    M = JT @ slopes.acceleration
    position, velocity = JT @ slopes.position @ J, JT @ slopes.velocity @ J
    if actuation.constant is None:
        rate = actuation.jacobian_rate(q, v)
        velocity = velocity + M @ (2.0 * rate)
        position = position + JT @ slopes.velocity @ rate
        position = position + M @ (
            actuation.jacobian_rate(q, vd) + actuation.jacobian_rate_slope(q, v)
        )
        for at_v in actuation.driven:
            unit = np.zeros_like(v)
            unit[:, at_v] = 1.0
            bend = actuation.jacobian_rate(q, unit)
            position[:, :, at_v] += products(np.swapaxes(bend, 1, 2), efforts)
    return EffortSlopes(position, velocity, M @ J)


@compiled
def calc_effort_slopes(tree: TreeRecords, samples: Samples, phi: Array, out: Array) -> None:
    """Add derivatives by q, v and v̇ of all bodies' efforts to (3, N, nv, nv), or by q to (1, …)."""
    mobilizers, _ = tree
    bodies, (_, v, _, _) = len(mobilizers), samples
    motions, poses, features = np.empty(bodies, MOTION), np.empty(bodies, POSE), np.empty(9)
    fields, lines = np.empty((bodies, 4, 3)), np.empty((v.shape[1], 6, 3))
    masses, sums = np.empty(bodies), np.empty((bodies, 10, 3))
    for n in range(len(v)):
        move(mobilizers, samples, n, features, motions)
        for i in range(bodies):
            put_pose(mobilizers[i], motions[i], poses, poses[i])
            put_fields(mobilizers[i], (motions[i], poses[i]), (v, n, i), fields, lines)
            put_inertia(mobilizers[i].body, phi, (motions[i], poses[i], fields), (masses, sums, i))
        for i in range(bodies - 1, -1, -1):
            first, number = mobilizers[i].velocities
            inertia, parent = (masses[i], sums, i), mobilizers[i].parent
            for k in range(first, first + number):
                s, t = row(lines, k, 0), row(lines, k, 1)
                force, moment = momentum_of(inertia, s, t)
                turning = turning_of(inertia, s, t)
                by_q, by_v = wrench_changes(inertia, lines, k)
                step = i
                while step >= 0:
                    start, several = mobilizers[step].velocities
                    for j in range(start, start + several):
                        s, t = row(lines, j, 0), row(lines, j, 1)
                        ds, dt = row(lines, j, 2), row(lines, j, 3)
                        dds, ddt = row(lines, j, 4), row(lines, j, 5)
                        felt = dot(force, ddt) + dot(moment, dds) + 2.0 * dot(turning, ds)
                        out[0, n, j, k] += felt
                        if step != i:
                            out[0, n, k, j] += dot(t, by_q[0]) + dot(s, by_q[1])
                        if len(out) == 1:
                            continue
                        felt = dot(force, dt) + dot(moment, ds) + dot(turning, s)
                        out[1, n, j, k] += 2.0 * felt
                        inertial = dot(force, t) + dot(moment, s)
                        out[2, n, j, k] += inertial
                        if step != i:
                            out[1, n, k, j] += dot(t, by_v[0]) + dot(s, by_v[1])
                            out[2, n, k, j] += inertial
                    step = mobilizers[step].parent
            if parent >= 0:
                masses[parent] += masses[i]
                for x in range(10):
                    put_row(sums, parent, x, add(row(sums, parent, x), row(sums, i, x)))


@inlined
def crossed(w: Vector, u: Vector, s: Vector, t: Vector) -> tuple[Vector, Vector]:
    """Return the cross product (w, u) × (s, t) of two fields."""
    return cross(w, s), add(cross(w, t), cross(u, s))


@inlined
def put_fields(
    mobilizer: Record,
    place: tuple[Record, Record],
    sample: tuple[Array, int, int],
    fields: Array,
    lines: Array,
) -> None:
    """Write ω, u, α and a of a body to (m, 4, 3), and S, ψ and ψ̇ of its joint.

    `place` is (motion, pose) of the body; `sample` is (velocities, sample index, body index).
    """
    (motion, pose), (v, n, i) = place, sample
    R, p, (first, number) = pose.R_WB, vector(pose.p_WoBo_W), mobilizer.velocities
    w_P = u_P = wd_P = (0.0, 0.0, 0.0)
    a_P = scale(-1.0, vector(mobilizer.gravity))
    if mobilizer.parent >= 0:
        w_P, u_P = row(fields, mobilizer.parent, 0), row(fields, mobilizer.parent, 1)
        wd_P, a_P = row(fields, mobilizer.parent, 2), row(fields, mobilizer.parent, 3)
    w, u = w_P, u_P
    for k in range(number):
        s, t = carried(mobilizer, motion, column(mobilizer.angular, k), column(mobilizer.linear, k))
        s, t = times(R, s), times(R, t)
        t = add(t, cross(p, s))
        w, u = add(w, scale(v[n, first + k], s)), add(u, scale(v[n, first + k], t))
        ds, dt = crossed(w_P, u_P, s, t)
        dds, ddt = crossed(wd_P, a_P, s, t)
        more_s, more_t = crossed(w_P, u_P, ds, dt)
        both = s, t, ds, dt, add(dds, more_s), add(ddt, more_t)
        for x in range(6):
            put_row(lines, first + k, x, both[x])
    wd, a = times(R, vector(motion.wd)), times(R, vector(motion.a))
    a = subtract(a, add(cross(wd, p), cross(w, add(u, cross(w, p)))))
    put_row(fields, i, 0, w)
    put_row(fields, i, 1, u)
    put_row(fields, i, 2, wd)
    put_row(fields, i, 3, a)


@inlined
def put_inertia(
    body: int,
    phi: Array,
    motion: tuple[Record, Record, Array],
    out: tuple[Array, Array, int],
) -> None:
    """Write mass and h, ∫ x xᵀ dm, columns of Q, p, f and n (10, 3) for a body of φ (nb, 10)."""
    (own, pose, fields), (masses, sums, i) = motion, out
    masses[i], sums[i] = 0.0, 0.0
    if body < 0:
        return
    R, p, m = pose.R_WB, vector(pose.p_WoBo_W), phi[body, 0]
    w, u = row(fields, i, 0), row(fields, i, 1)
    h = times(R, (phi[body, 1], phi[body, 2], phi[body, 3]))  # about Bo
    h_W = add(h, scale(m, p))
    trace = phi[body, 4] + phi[body, 5] + phi[body, 6]
    for x in range(3):
        axis = R[x, 0], R[x, 1], R[x, 2]
        second = subtract(scale(0.5 * trace, axis), inertia_times(phi, body, axis))
        second = add(times(R, second), add(scale(p[x], h), scale(h_W[x], p)))
        put_row(sums, i, _SECOND + x, second)
        put_row(sums, i, _TURNING + x, add(scale(h_W[x], u), cross(w, second)))
    force, moment = wrench_of(phi, body, own)
    force = times(R, force)
    masses[i] = m
    put_row(sums, i, 0, h_W)
    put_row(sums, i, _MOMENTUM, add(scale(m, u), cross(w, h_W)))
    put_row(sums, i, _FORCE, force)
    put_row(sums, i, _MOMENT, add(times(R, moment), cross(p, force)))


@inlined
def momentum_of(inertia: tuple[float, Array, int], s: Vector, t: Vector) -> tuple[Vector, Vector]:
    """Return the linear and angular momentum I (s, t) of a field."""
    m, sums, i = inertia
    h, E = row(sums, i, 0), sums[i, _SECOND:_TURNING]
    moment = subtract(scale(E[0, 0] + E[1, 1] + E[2, 2], s), times(E, s))
    return add(scale(m, t), cross(s, h)), add(moment, cross(h, t))


@inlined
def turning_of(inertia: tuple[float, Array, int], s: Vector, t: Vector) -> Vector:
    """Return the vector whose product with ω is the power of B (ω, ·) along (s, t)."""
    _, sums, i = inertia
    Q = sums[i, _TURNING:_MOMENTUM]  # transposed
    own = subtract(scale(Q[0, 0] + Q[1, 1] + Q[2, 2], s), times(Q, s))
    return add(cross(row(sums, i, _MOMENTUM), t), own)


@inlined
def wrench_changes(
    inertia: tuple[float, Array, int], lines: Array, k: int
) -> tuple[tuple[Vector, Vector], tuple[Vector, Vector]]:
    """Return derivatives of the wrench by q and v of a velocity, for joints inboard of it."""
    _, sums, i = inertia
    s, t = row(lines, k, 0), row(lines, k, 1)
    ds, dt = row(lines, k, 2), row(lines, k, 3)
    Q, p = sums[i, _TURNING:_MOMENTUM], row(sums, i, _MOMENTUM)
    f, n = row(sums, i, _FORCE), row(sums, i, _MOMENT)
    trace = Q[0, 0] + Q[1, 1] + Q[2, 2]
    force, moment = momentum_of(inertia, row(lines, k, 4), row(lines, k, 5))
    turned = subtract(scale(trace, ds), transposed_times(Q, ds))
    force = add(force, add(scale(2.0, cross(ds, p)), cross(s, f)))
    moment = add(add(moment, scale(2.0, turned)), add(cross(s, n), cross(t, f)))
    by_v, turning = momentum_of(inertia, ds, dt)
    turned = subtract(scale(trace, s), transposed_times(Q, s))
    return (force, moment), (scale(2.0, add(by_v, cross(s, p))), scale(2.0, add(turning, turned)))
