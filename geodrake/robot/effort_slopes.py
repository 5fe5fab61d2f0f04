"""Slopes of the needed effort with respect to the motion of every joint, for many samples at once.

The derivatives of τ = M(q) v̇ + C(q, v) v − τ_g(q) with respect to q_j, v_j and v̇_j of a joint j of
one degree of freedom. Let P be the body inboard of j, B a body outboard of it, s and t the angular
and linear part of j's motion subspace about Bo, in B, and ω_r, v_r the velocity of B in P. Seen
from B, moving q_j moves P, and nothing that the joints between P and B add:

    δω = ω_P × s,   δα = α_P × s + δω × ω_r,
    δa = a_P × s + α_P × t + ω_P × (ω_P × t) + 2 δω × v_r,

with a_P the acceleration, less gravity, of the point of P that is at Bo. The efforts of joints
inboard of j change also because the wrench on B moves along. A change of v_j gives

    δω = s,   δα = ω_P × s + s × ω_r,   δa = 2 (ω_P × t + s × v_r),

and one of v̇_j δα = s, δa = t, so that the slope is a column of M.
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
    Record,
    Samples,
    TreeRecords,
    calc_inverse_dynamics,
    find_subspaces,
    move,
    subspace_room,
    wrench_of,
)
from geodrake.robot.regressor import checked_samples, checked_tree
from geodrake.robot.transmission import times
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
    vector,
)

_ALONG = 3  # what the wrench on B does by moving along with q, which joints inboard see


@dataclass(frozen=True, eq=False)
class EffortSlopes:
    """Derivatives [:, i, j] of the effort of velocity i; NaN for j of joints of several degrees."""

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
    """Return the slopes of `geodrake.robot.regressor.inverse_dynamics`.

    If `only_position`, the others may be NaN, which takes half of the time.
    """
    robot = checked_tree(plant)
    tree, samples, J = checked_samples(robot, q, v, vd)
    phi = contiguous(real_array(phi, "phi", (len(tree.bodies), PARAMETERS_PER_BODY)))
    count, nv = len(samples[0]), tree.num_velocities
    kinds, slopes = 1 if only_position and J is None else 3, np.full((3, count, nv, nv), np.nan)
    slopes[:kinds] = 0.0
    calc_effort_slopes(tree.records, samples, phi, slopes[:kinds])
    found = EffortSlopes(*np.swapaxes(slopes, 2, 3))  # one velocity's slopes are close together
    several = [m.velocities for m in tree.mobilizers if m.velocities.stop - m.velocities.start > 1]
    columns = [at for own in several for at in range(own.start, own.stop)]
    if J is not None and robot.actuation is not None:
        efforts = np.zeros((count, nv))
        calc_inverse_dynamics(tree.records, samples, phi, efforts)
        found = _at_actuators(
            found, robot.actuation, J, efforts, Motion(*(np.asarray(x, float) for x in (q, v, vd)))
        )
        columns = [at for at in map(robot.actuation.standing.get, columns) if at is not None]
    for slope in (found.position, found.velocity, found.acceleration):
        slope[..., columns] = np.nan
    return found


def _at_actuators(
    slopes: EffortSlopes, actuation: RobotCoordinates, J: Array, efforts: Array, motion: Motion
) -> EffortSlopes:
    """Slopes of τ_q = Jᵀ τ_θ(T(q), J q̇, J q̈ + J̇ q̇) with q, q̇ and q̈ by the chain rule.

    With H the second derivatives of T, ∂(J w)/∂q = H w, which is J̇ where q̇ = w; so

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
            position[:, :, at_v] += times(np.swapaxes(bend, 1, 2), efforts)
    return EffortSlopes(position, velocity, M @ J)


@compiled
def calc_effort_slopes(tree: TreeRecords, samples: Samples, phi: Array, out: Array) -> None:
    """Add slopes of all bodies' efforts to (3, N, nv, nv), or the first, by whose q, v and v̇."""
    mobilizers, dofs = tree
    motions, features, most = np.empty(len(mobilizers), MOTION), np.empty(9), dofs.shape[1]
    turn, slide = subspace_room(dofs)
    inboard = np.empty((5, most, 3))
    forces, moments = np.empty((4, most, 3)), np.empty((4, most, 3))
    for n in range(len(samples[0])):
        move(mobilizers, samples, n, features, motions)
        find_subspaces(mobilizers, motions, turn, slide)
        for i in range(len(mobilizers)):
            body, count = mobilizers[i].body, mobilizers[i].count
            if body < 0:
                continue
            look_inboard(mobilizers, motions, (turn, slide), (samples, n, i), inboard)
            force, moment = wrench_of(phi, body, motions[i])
            for j in range(count):
                s, t = row(turn, i, j), row(slide, i, j)
                changes = motion_changes(s, t, inboard, j)
                for kind in range(len(out)):
                    by_force, by_moment = wrench_change(
                        phi, body, vector(motions[i].w), changes[kind]
                    )
                    put_row(forces, kind, j, by_force)
                    put_row(moments, kind, j, by_moment)
                put_row(forces, _ALONG, j, cross(s, force))
                put_row(moments, _ALONG, j, add(cross(s, moment), cross(t, force)))
            for k in range(count):
                s, t = row(turn, i, k), row(slide, i, k)
                for j in range(count):
                    for kind in range(len(out)):
                        felt = dot(t, row(forces, kind, j)) + dot(s, row(moments, kind, j))
                        if kind == 0 and k < j:  # inboard of it
                            felt += dot(t, row(forces, _ALONG, j)) + dot(s, row(moments, _ALONG, j))
                        out[kind, n, dofs[i, j], dofs[i, k]] += felt


@inlined
def look_inboard(
    mobilizers: Record,
    motions: Record,
    subspaces: tuple[Array, Array],
    place: tuple[Samples, int, int],
    out: Array,
) -> None:
    """Write ω_P, α_P, a_P, ω_r and v_r (5, k, 3) of each velocity of a body, as seen from it.

    The place is the sample, of which motion, and the body's mobilizer.
    """
    (turn, slide), ((_, v, _, vd), n, i) = subspaces, place
    w, wd, a = vector(motions[i].w), vector(motions[i].wd), vector(motions[i].a)
    whole, speed = w, (0.0, 0.0, 0.0)
    last, step = mobilizers[i].count, i
    while step >= 0:
        # From the outboard to the inboard side of one joint.
        first, number = mobilizers[step].velocities[0], mobilizers[step].velocities[1]
        u = w_r = shift = du = dw_r = (0.0, 0.0, 0.0)
        for k in range(number):
            s, t = row(turn, i, last - number + k), row(slide, i, last - number + k)
            u, w_r = add(u, scale(v[n, first + k], t)), add(w_r, scale(v[n, first + k], s))
            du, dw_r = add(du, scale(vd[n, first + k], t)), add(dw_r, scale(vd[n, first + k], s))
            axis = column(mobilizers[step].angular, k)
            if dot(axis, axis) == 0.0:
                shift = add(shift, scale(v[n, first + k], t))  # what slides and does not turn
        w_P = subtract(w, w_r)
        a = subtract(a, du)
        a = subtract(a, add(scale(2.0, cross(w_P, u)), cross(w_r, subtract(u, shift))))
        wd = subtract(wd, add(dw_r, cross(w_P, w_r)))
        w, speed = w_P, add(speed, u)
        for k in range(last - number, last):
            put_row(out, 0, k, w)
            put_row(out, 1, k, wd)
            put_row(out, 2, k, a)
            put_row(out, 3, k, subtract(whole, w))
            put_row(out, 4, k, speed)
        last, step = last - number, mobilizers[step].parent


@inlined
def motion_changes(
    s: Vector, t: Vector, inboard: Array, j: int
) -> tuple[tuple[Vector, Vector, Vector], ...]:
    """Return the derivatives of a body's ω, α and a by q, v and v̇ of velocity j."""
    w_P, wd_P, a_P = row(inboard, 0, j), row(inboard, 1, j), row(inboard, 2, j)
    w_r, v_r = row(inboard, 3, j), row(inboard, 4, j)
    turned, slid = cross(w_P, s), cross(w_P, t)
    along = add(add(cross(a_P, s), cross(wd_P, t)), cross(w_P, slid))
    along = add(along, scale(2.0, cross(turned, v_r)))
    return (
        (turned, add(cross(wd_P, s), cross(turned, w_r)), along),
        (s, add(turned, cross(s, w_r)), scale(2.0, add(slid, cross(s, v_r)))),
        ((0.0, 0.0, 0.0), s, t),
    )


@inlined
def wrench_change(
    phi: Array, b: int, w: Vector, change: tuple[Vector, Vector, Vector]
) -> tuple[Vector, Vector]:
    """Return the first-order change of `wrench_of` with changes of ω, α and a."""
    dw, dwd, da = change
    h = phi[b, 1], phi[b, 2], phi[b, 3]
    force = add(scale(phi[b, 0], da), cross(dwd, h))
    force = add(force, add(cross(dw, cross(w, h)), cross(w, cross(dw, h))))
    moment = add(inertia_times(phi, b, dwd), cross(h, da))
    moment = add(moment, cross(dw, inertia_times(phi, b, w)))
    return force, add(moment, cross(w, inertia_times(phi, b, dw)))
