"""The recursion behind the regressor: motion outwards, a closed form a body, samples together.

From the world outwards it carries the motion of every body B, and the motion subspace of the
velocities that move it, about Bo and expressed in B. For one subspace column with angular part s
and linear part t, the effort that B asks of that velocity is

    τ = t·f + s·n,   f = m a + (α× + ω×ω×) h,   n = I α + ω × I ω + h × a,

with ω, α the angular velocity and acceleration of B, and a the acceleration of Bo less gravity.
This is linear in (m, h, I) with the closed-form row of `_body_block`: no wrench is propagated
inwards, and nothing is computed for the velocities that do not move B.

Samples are the last axis of every array, worked off in pieces that fit the cache. The first axis
is the components x y z x y of a vector: with two of them repeated, a cross product is a difference
of two products of slices, and the off-diagonal terms of I are products of shifted slices.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.robot.kinematics import KinematicTree, Mobilizer

Samples = tuple[Array, Array, Array]
"""Positions (N, nq), velocities (N, nv) and accelerations (N, nv)."""

_CYCLE = [0, 1, 2, 0, 1]
_CACHE_NUMBERS = 160_000  # of doubles, about a megabyte
_OMEGA, _ALPHA, _ACCEL, _COLUMNS = slice(0, 1), slice(1, 2), slice(2, 3), 3


def piece_size(tree: KinematicTree) -> int:
    """Samples for which the motion of one body, with its subspace, fits the cache."""
    most = max((len(mobilizer.dofs) for mobilizer in tree.mobilizers), default=0)
    return max(256, _CACHE_NUMBERS // (5 * (_COLUMNS + 2 * most)))


def pieces(
    tree: KinematicTree, samples: Samples
) -> Iterator[tuple[slice, Iterator[tuple[Mobilizer, Array]]]]:
    """Cuts samples into pieces.

    Args:
        tree: The kinematic tree.
        samples: Positions (N, nq), velocities (N, nv) and accelerations (N, nv) in Drake's order.

    Yields:
        Which samples a piece has, and an iterator over its bodies: the mobilizer that moves the
        body and the body's block (10, k, n) of the regressor, for the k velocities in `dofs` and
        the n samples. The next body overwrites the block.
    """
    work = _Workspace(tree, min(len(samples[0]), piece_size(tree)))
    for part, piece in sample_pieces(tree, samples):
        yield part, _blocks(tree, piece, work)


def motion_pieces(
    tree: KinematicTree, samples: Samples
) -> Iterator[tuple[slice, Samples, list[Array]]]:
    """Cuts samples into pieces, as `pieces` does, for what needs all bodies of a piece at once.

    Args:
        tree: The kinematic tree.
        samples: Positions (N, nq), velocities (N, nv) and accelerations (N, nv) in Drake's order.

    Yields:
        Which samples a piece has, its (nq, n), (nv, n) and (nv, n) positions, velocities and
        accelerations, and for every mobilizer the motion (5, 3 + 2k, n) of the body that it moves:
        the columns ω, α and a, then k angular and k linear parts of the motion subspace. The next
        piece overwrites the motions.
    """
    work = _Workspace(tree, min(len(samples[0]), piece_size(tree)))
    for part, piece in sample_pieces(tree, samples):
        yield part, piece, [motion for _, motion in _motions(tree, piece, work)]


def sample_pieces(tree: KinematicTree, samples: Samples) -> Iterator[tuple[slice, Samples]]:
    """Samples in pieces that fit the cache, with the samples as the last axis.

    Args:
        tree: The kinematic tree.
        samples: Positions (N, nq), velocities (N, nv) and accelerations (N, nv) in Drake's order.
    """
    count, size = len(samples[0]), piece_size(tree)
    for start in range(0, count, size):
        part = slice(start, min(start + size, count))
        q, v, vd = (np.ascontiguousarray(x[part].T) for x in samples)
        yield part, (q, v, vd)


class _Workspace:
    """Arrays for one piece of samples: to allocate them anew would cost as much as to fill them."""

    def __init__(self, tree: KinematicTree, count: int) -> None:
        dofs = [len(mobilizer.dofs) for mobilizer in tree.mobilizers]
        most = max(dofs, default=0)
        self.motions = [np.empty((5, _COLUMNS + 2 * k, count)) for k in dofs]
        self.inboard = np.empty((3, _COLUMNS + 2 * most, count))
        self.product = np.empty((3, _COLUMNS + 2 * most, count))
        self.turned = np.empty((5, most, count))
        self.block = np.empty((PARAMETERS_PER_BODY, most, count))

    def sum_products(self, out: Array, *pairs: tuple[Array, Array]) -> None:
        """Writes the sum of x y over the pairs (x, y) into `out` (3 or 1, rows, n)."""
        np.multiply(*pairs[0], out=out)
        self.add_products(out, *pairs[1:])

    def add_products(self, out: Array, *pairs: tuple[Array, Array]) -> None:
        """Adds the sum of x y over the pairs (x, y) to `out` (3 or 1, rows, n)."""
        product = self.product[: out.shape[0], : out.shape[1], : out.shape[2]]
        for x, y in pairs:
            np.multiply(x, y, out=product)
            out += product


def _blocks(
    tree: KinematicTree, piece: Samples, work: _Workspace
) -> Iterator[tuple[Mobilizer, Array]]:
    """The blocks of one piece, inboard bodies first."""
    for mobilizer, motion in _motions(tree, piece, work):
        if mobilizer.body >= 0:
            yield mobilizer, _body_block(motion, work)


def _motions(
    tree: KinematicTree, piece: Samples, work: _Workspace
) -> Iterator[tuple[Mobilizer, Array]]:
    """The motions of one piece, inboard bodies first."""
    q, v, vd = piece
    count = q.shape[1]
    for mobilizer, storage in zip(tree.mobilizers, work.motions, strict=True):
        if mobilizer.parent >= 0:
            parent = work.motions[mobilizer.parent][:, :, :count]
        else:
            parent = world_motion(tree, mobilizer)
        own = mobilizer.velocities
        motion = storage[:, :, :count]
        _move(mobilizer, parent, (q[mobilizer.positions], v[own], vd[own]), work, out=motion)
        yield mobilizer, motion


def world_motion(tree: KinematicTree, mobilizer: Mobilizer) -> Array:
    """Motion (5, 3, 1) of the world at the root of a robot: at rest, accelerated against g.

    Args:
        tree: The kinematic tree, for gravity.
        mobilizer: One that moves a body relative to the world.
    """
    motion = np.zeros((5, _COLUMNS, 1))
    motion[:, _ACCEL, 0] = -mobilizer.gravity * tree.gravity[_CYCLE, None]
    return motion


def _move(
    mobilizer: Mobilizer, parent: Array, sample: Samples, work: _Workspace, *, out: Array
) -> None:
    """Motion and subspace of B about Bo in B, from those of P about Po in P.

    Both are (5, 3 + 2k, n): ω, α, a, then k angular and k linear parts.
    """
    (q, v, vd), joint, k = sample, mobilizer.motion, len(mobilizer.dofs)
    old = _subspace(parent)[0].shape[
        1
    ]  # k where nothing is asked of the mobilizer's own velocities
    w_P, wd_P, a_P = parent[:, _OMEGA], parent[:, _ALPHA], parent[:, _ACCEL]
    angular, linear = joint.angular[_CYCLE], joint.linear[_CYCLE]
    w, wd, t, td = (_map(subspace, x)[:, None] for subspace in (angular, linear) for x in (v, vd))
    p = (joint.offset[_CYCLE, None] + _map(joint.translation[_CYCLE], q))[:, None]

    seen = work.inboard[:, : _COLUMNS + 2 * k, : out.shape[2]]  # of B about Mo, in P
    seen[:, _OMEGA] = w_P[:3] + w[:3]
    seen[:, _ALPHA] = wd_P[:3] + wd[:3] + _cross(w_P, w)
    coriolis = _cyclic(_cross(w_P, p)) + 2.0 * t
    seen[:, _ACCEL] = a_P[:3] + td[:3] + _cross(wd_P, p) + _cross(w_P, coriolis)
    (turn, slide), (turn_P, slide_P) = _subspace(seen), _subspace(parent)
    turn[:, :old], turn[:, old:] = turn_P[:3], angular[:3, : k - old, None]
    slide[:, :old], slide[:, old:] = slide_P[:3], linear[:3, : k - old, None]
    work.add_products(slide[:, :old], (turn_P[1:4], p[2:5]), (turn_P[2:5], -p[1:4]))

    R_PB = (joint.rotation @ joint.features(q)).reshape(3, 3, 1, -1)
    work.sum_products(out[:3], *((R_PB[i], seen[i]) for i in range(3)))
    out[3:] = out[:2]
    if mobilizer.p_MoBo_B.any():
        _shift(out, mobilizer.p_MoBo_B[_CYCLE, None, None])


def _shift(motion: Array, p: Array) -> None:
    """Moves the point of reference of a motion and its subspace by p, in place."""
    w, wd, (turn, slide) = motion[:, _OMEGA], motion[:, _ALPHA], _subspace(motion)
    motion[:, _ACCEL] += _cyclic(_cross(wd, p) + _cross(w, _cyclic(_cross(w, p))))
    slide += _cyclic(_cross(turn, p))


def _body_block(motion: Array, work: _Workspace) -> Array:
    """Regressor (10, k, n) of a body for the k velocities of its motion (5, 3 + 2k, n)."""
    w, wd, a = motion[:, _OMEGA], motion[:, _ALPHA], motion[:, _ACCEL]
    s, t = _subspace(motion)
    block = work.block[:, : s.shape[1], : s.shape[2]]
    mass, moment, diagonal, product = block[:1], block[1:4], block[4:7], block[7:]
    work.sum_products(mass, *((t[i : i + 1], a[i : i + 1]) for i in range(3)))

    # h: a × s + Bᵀ t with B = α× + ω×ω×, one cyclic diagonal for each shift of t.
    squares, cross = w * w, _cyclic(w[:3] * w[1:4])
    work.sum_products(
        moment,
        (a[1:4], s[2:5]),
        (-a[2:5], s[1:4]),
        (-(squares[1:4] + squares[2:5]), t[:3]),
        (cross[:3] + wd[2:5], t[1:4]),
        (cross[2:5] - wd[1:4], t[2:5]),
    )
    # I: s·(I α) + u·(I ω) with u = s × ω.
    u = work.turned[:, : s.shape[1], : s.shape[2]]
    work.sum_products(u[:3], (s[1:4], w[2:5]), (s[2:5], -w[1:4]))
    u[3:] = u[:2]
    work.sum_products(diagonal, (s[:3], wd[:3]), (u[:3], w[:3]))
    work.sum_products(product, (s[:3], wd[1:4]), (s[1:4], wd[:3]), (u[:3], w[1:4]), (u[1:4], w[:3]))
    return block


def _subspace(motion: Array) -> tuple[Array, Array]:
    """The angular and the linear parts of a motion's subspace, as views."""
    middle = (_COLUMNS + motion.shape[1]) // 2
    return motion[:, _COLUMNS:middle], motion[:, middle:]


def _map(matrix: Array, x: Array) -> Array:
    """The product of a matrix (m, k) and vectors (k, n), one column where it is all zero."""
    if not matrix.any():
        return np.zeros((len(matrix), 1))
    return matrix * x if len(x) == 1 else matrix @ x


def _cyclic(vector: Array) -> Array:
    """Vectors x y z (3, …) as x y z x y (5, …)."""
    return np.concatenate([vector, vector[:2]])


def _cross(a: Array, b: Array) -> Array:
    """Cross products (3, …) of cyclic vectors (5, …)."""
    return a[1:4] * b[2:5] - a[2:5] * b[1:4]
