"""Closed loops as transmissions, from the free joints to all; see `geodrake.robot.loops`.

Closures have residuals c(θ), relative to the size of the loop, and in rad. Dependent joints solve
J θ̇ = 0 for given θ̇ of the free ones in the least-squares sense, because closures may be redundant:
those of a planar linkage also constrain it to its plane.

A ball of radius r that rolls on the ground without slip has its center displaced by r θ × z, with
the rotation vector θ of its frame. This is exact for rotation about one axis; otherwise the slip is
of second order in θ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.showing import Short
from geodrake.compiling import compiled, contiguous, inlined
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import Array
from geodrake.robot.joints import Features, FrameMotion
from geodrake.robot.recursion import Mobilizer, Record, TreeRecords, calc_kinematics, records_of
from geodrake.robot.transmission import JointlyEvaluated
from geodrake.robot.vectors import Vector, add, column, cross, dot, scale, times, vector

Indices = NDArray[np.int64]

_LONGEST, _SHORTEST = 0.25, 1e-6  # steps towards a posture, rad or shares of the size
_MOST_STEPS, _MOST_ITERATIONS = 400, 15
_STILL = 1e-12  # rad or share of the size, step at convergence
_STEP = 2e-3  # rad or share of the size; differences have errors of about 1e-12
_SLACK = 1e-3  # rad or share of the size, tolerated correction in addition to half a step

CLOSURE = np.dtype(
    [
        ("bodies", np.int64, (2,)),  # -1 for the world
        ("rotations", float, (2, 3, 3)),
        ("positions", float, (2, 3)),
        ("turns", np.int64),
        ("radius", float),
    ],
    align=True,
)
"""A closure for compiled code: its two bodies, and its frames in them."""


class LoopRecords(NamedTuple):
    """A loop of k joints for compiled code."""

    tree: TreeRecords  # mobilizers, with bodies of the same indices
    closures: NDArray[np.void]
    couplings: Array  # (·, k, ·) coefficients of polynomials in each joint whose sums are zero
    free: Indices  # indices of the n free joints
    following: Indices  # indices of the dependent joints
    reference: Array  # (k,) posture of the file
    # (k + 1,) scale of each joint, 1 rad or the loop's size in m, and that size.
    units: Array


def in_loop(
    before: Sequence[Mobilizer],
    parent: int,
    joint: int,
    motion: FrameMotion,
    p_MoBo_B: ArrayLike = (0.0, 0.0, 0.0),
) -> Mobilizer:
    """Return the next mobilizer of a loop, for the indices of its parent and of its joint."""
    inner = before[parent].dofs if parent >= 0 else ()
    dof, offset = slice(joint, joint + 1), np.asarray(p_MoBo_B, float)
    return Mobilizer(parent, len(before), dof, dof, (*inner, joint), motion, offset, False)


def uncoupled_records(x: Array, slides: Sequence[bool], size: float) -> LoopRecords:
    """Return records of uncoupled coordinates at x (k,), scaled for a loop of a size, m."""
    empty, units = np.zeros(0, np.int64), [*(size if slide else 1.0 for slide in slides), size]
    tree, couplings = records_of((), np.zeros(3)), np.zeros((0, len(x), 1))
    return LoopRecords(tree, np.zeros(0, CLOSURE), couplings, empty, empty, x, np.array(units))


def merged_loops(left: LoopRecords, right: LoopRecords, rows: Array) -> LoopRecords:
    """Return two loops merged into one, with further couplings (·, k, ·), without free joints."""
    (inner, inner_dofs), (outer, outer_dofs) = left.tree, right.tree
    bodies, count = len(inner), len(left.reference)
    mobilizers = np.concatenate([inner, outer])
    added = mobilizers[bodies:]
    added["parent"] += np.where(added["parent"] < 0, 0, bodies)
    added["body"] += bodies
    for name in ("positions", "velocities"):
        added[name][:, 0] += count
    dofs = np.zeros((len(mobilizers), max(inner_dofs.shape[1], outer_dofs.shape[1])), np.int64)
    dofs[:bodies, : inner_dofs.shape[1]] = inner_dofs
    dofs[bodies:, : outer_dofs.shape[1]] = outer_dofs + count
    closures = np.concatenate([left.closures, right.closures])
    joined = closures[len(left.closures) :]["bodies"]
    joined += np.where(joined < 0, 0, bodies)
    parts, start = (left.couplings, right.couplings, rows), 0
    couplings = np.zeros((sum(map(len, parts)), rows.shape[1], max(x.shape[2] for x in parts)))
    for part, first in zip(parts, (0, count, 0), strict=True):
        stop, powers = start + len(part), part.shape[2]
        couplings[start:stop, first : first + part.shape[1], :powers] = part
        start = stop
    size = max(left.units[-1], right.units[-1])
    return left._replace(
        tree=(mobilizers, dofs),
        closures=closures,
        couplings=couplings,
        reference=np.concatenate([left.reference, right.reference]),
        units=np.array([*left.units[:-1], *right.units[:-1], size]),
    )


@inlined
def _copy(x: Array, out: Array) -> None:
    # Assignment of whole arrays would check their shapes, which takes seconds to compile.
    for j in range(len(x)):
        out[j] = x[j]


@inlined
def _axis(closure: Record, side: int, k: int, X: Array) -> Vector:
    """Return the k-th axis of a closure's frame in the world, for poses (nb, 4, 4)."""
    axis, at = column(closure.rotations[side], k), closure.bodies[side]
    return axis if at < 0 else times(X[at], axis)


@inlined
def _turned(closure: Record, X: Array) -> tuple[Vector, float]:
    """Return the rotation vector θ between a closure's frames in W, and b for `_turning`."""
    turn, trace = (0.0, 0.0, 0.0), 0.0
    for k in range(3):
        one, other = _axis(closure, 0, k, X), _axis(closure, 1, k, X)
        turn, trace = add(turn, cross(one, other)), trace + dot(one, other)
    sine, cosine = 0.5 * np.sqrt(dot(turn, turn)), 0.5 * (trace - 1.0)
    angle = np.arctan2(sine, cosine)
    ratio = 0.5 * angle / sine if sine > 0.0 else 0.5
    b = (1.0 - ratio * (1.0 + cosine)) / angle**2 if angle > 1e-3 else 1.0 / 12.0
    return scale(ratio, turn), b


@inlined
def _turning(turn: Vector, b: float, spin: Vector) -> Vector:
    """Return the rate of a rotation vector θ: (1 − [θ]/2 + b [θ]²) ω."""
    once = cross(turn, spin)
    return add(spin, add(scale(-0.5, once), scale(b, cross(turn, once))))


@compiled
def _calc_residuals(loop: Any, x: Array, room: Any, c: Array, J: Array) -> None:
    """Write the residuals c (m,) of closures and their Jacobian J (m, k) at x (1, k)."""
    closures, size, first = loop.closures, loop.units[-1], 0
    poses, angular, linear = room
    c[:], J[:], poses[:], angular[:], linear[:] = 0.0, 0.0, 0.0, 0.0, 0.0
    calc_kinematics(loop.tree, x, poses, angular, linear)
    X = poses[0]
    for e in range(len(closures)):
        closure, turn, b = closures[e], (0.0, 0.0, 0.0), 0.0
        if closure.radius > 0.0:
            turn, b = _turned(closure, X)
        for side in range(2):
            sign, at, arm = 2.0 * side - 1.0, closure.bodies[side], vector(closure.positions[side])
            place = arm
            if at >= 0:
                arm = times(X[at], arm)
                place = add(arm, (X[at, 0, 3], X[at, 1, 3], X[at, 2, 3]))
                for k in range(J.shape[1]):
                    spin = column(angular[0, at], k)
                    slide = add(column(linear[0, at], k), cross(spin, arm))
                    for j in range(3):
                        J[first + j, k] += sign / size * slide[j]
                        if closure.turns:
                            J[first + 3 + j, k] += sign * spin[j]
                    if closure.radius > 0.0:
                        rate = _turning(turn, b, spin)
                        J[first, k] -= closure.radius / size * rate[1]
                        J[first + 1, k] += closure.radius / size * rate[0]
            for j in range(3):
                c[first + j] += sign / size * place[j]
        if closure.radius > 0.0:
            c[first] -= closure.radius / size * turn[1]
            c[first + 1] += closure.radius / size * turn[0]
        for k in range(3 if closure.turns else 0):
            turn = cross(_axis(closure, 0, k, X), _axis(closure, 1, k, X))
            for j in range(3):
                c[first + 3 + j] += 0.5 * turn[j]
        first += 6 if closure.turns else 3
    _add_couplings(loop.couplings, x, first, c, J)


@inlined
def _add_couplings(couplings: Array, x: Array, first: int, c: Array, J: Array) -> None:
    """Add sums of polynomials in the joints, and their derivatives."""
    for row in range(len(couplings)):
        for k in range(J.shape[1]):
            power, slope = 1.0, 0.0
            for n in range(couplings.shape[2]):
                c[first + row] += couplings[row, k, n] * power
                J[first + row, k] += couplings[row, k, n] * slope
                slope, power = (n + 1) * power, power * x[0, k]


@compiled
def _calc_rates(loop: Any, motion: Any, rooms: Any, rate: Array) -> None:
    """Write J̇ (m, k) at x (k,) and ẋ (k,), by fourth-order differences of J."""
    (at, xd), (room, _, c, J, x), speed = motion, rooms, 0.0
    rate[:] = 0.0
    for j in range(len(xd)):
        speed = max(speed, abs(xd[j]) / loop.units[j])
    for weight, steps in ((8.0, 1.0), (-8.0, -1.0), (-1.0, 2.0), (1.0, -2.0)):
        if speed > 0.0:
            for j in range(len(xd)):
                x[0, j] = at[j] + steps * _STEP / speed * xd[j]
            _calc_residuals(loop, x, room, c, J)
            for i in range(len(c)):
                for j in range(len(xd)):
                    rate[i, j] += weight * speed / (12.0 * _STEP) * J[i, j]


@inlined
def _project_out(A: Array, j: int, B: Array, k: int) -> float:
    """Subtract from column k of B its projection on the unit column j of A; return the factor."""
    along = 0.0
    for i in range(len(A)):
        along += A[i, j] * B[i, k]
    for i in range(len(A)):
        B[i, k] -= along * A[i, j]
    return along


@inlined
def _solve_least(A: Array, B: Array, T: Array, X: Array) -> None:
    """Write X (d, ·) with the least |A X − B|, by modified Gram–Schmidt; overwrites A and B."""
    m, d = A.shape
    for j in range(d):
        square = 0.0
        for i in range(m):
            square += A[i, j] ** 2
        T[j, j] = np.sqrt(square)
        for i in range(m):
            A[i, j] /= T[j, j]
        for k in range(j + 1, d):
            T[j, k] = _project_out(A, j, A, k)
        for k in range(B.shape[1]):
            X[j, k] = _project_out(A, j, B, k)
    for j in range(d - 1, -1, -1):
        for k in range(B.shape[1]):
            for i in range(j + 1, d):
                X[j, k] -= T[j, i] * X[i, k]
            X[j, k] /= T[j, j]


@compiled
def _solve_dependent(loop: Any, J: Array, B: Array, rooms: Any, out: Array) -> None:
    """Write the rows of dependent joints that solve J out = B, from those of the free joints."""
    free, following = loop.free, loop.following
    A, rhs, T, X = rooms
    for i in range(len(J)):
        for k in range(len(following)):
            A[i, k] = J[i, following[k]]
        for k in range(out.shape[1]):
            rhs[i, k] = B[i, k]
            for f in free:
                rhs[i, k] -= J[i, f] * out[f, k]
    part = rhs[:, : out.shape[1]]
    _solve_least(A, part, T, X)
    for k in range(len(following)):
        for x in range(out.shape[1]):
            out[following[k], x] = X[k, x]


@inlined
def _work_arrays(loop: Any) -> Any:
    """Return work arrays for kinematics and solution, c (m,), J (m, k), and a posture (1, k)."""
    (mobilizers, _), closures, k = loop.tree, loop.closures, len(loop.reference)
    m, width, d = len(loop.couplings), max(len(loop.free), 1), len(loop.following)
    for e in range(len(closures)):
        m += 6 if closures[e].turns else 3
    shape = 1, len(mobilizers), 3, k
    room = np.empty((1, len(mobilizers), 4, 4)), np.empty(shape), np.empty(shape)
    solving = np.empty((m, d)), np.empty((m, width)), np.empty((d, d)), np.empty((d, width))
    return room, solving, np.empty(m), np.empty((m, k)), np.empty((1, k))


@compiled
def _close(loop: Any, rooms: Any, most: float) -> bool:
    """Close the loop by Newton's method from the posture in the last room; return success.

    The joints may move by at most `most`, rad or shares of the size.
    """
    units, (room, solving, c, J, x) = loop.units, rooms
    step, target, moved = np.zeros((J.shape[1], 1)), np.empty((len(c), 1)), 0.0
    for _ in range(_MOST_ITERATIONS):
        _calc_residuals(loop, x, room, c, J)
        for i in range(len(c)):
            target[i, 0] = -c[i]
        step[:] = 0.0
        _solve_dependent(loop, J, target, solving, step)
        last = 0.0
        for j in range(len(step)):
            x[0, j] += step[j, 0]
            last = max(last, abs(step[j, 0]) / units[j])
        moved += last
        if last <= _STILL or not moved <= most:
            break
    return last <= _STILL and moved <= most


@compiled
def _move_to(loop: Any, wanted: Array, x: Array, rooms: Any) -> float:
    """Move the posture x (k,) to the wanted positions (n,) of the free joints; return the progress.

    Each step follows the tangent, and then closes the loop; if that fails, it is shortened.
    """
    free, units, (room, solving, c, J, trial) = loop.free, loop.units, rooms
    none, move = np.zeros((len(c), 1)), np.zeros((len(x), 1))
    done, longest = 0.0, _LONGEST
    for _ in range(_MOST_STEPS):
        _copy(x, trial[0])
        _calc_residuals(loop, trial, room, c, J)
        for f in range(len(free)):
            move[free[f], 0] = wanted[f] - x[free[f]]
        _solve_dependent(loop, J, none, solving, move)
        length = 0.0
        for j in range(len(x)):
            length = max(length, abs(move[j, 0]) / units[j])
        share = 1.0 if length <= longest else longest / length
        for j in range(len(x)):
            trial[0, j] += share * move[j, 0]
        if share == 1.0:
            for f in range(len(free)):
                trial[0, free[f]] = wanted[f]
        if _close(loop, rooms, 0.5 * share * length + _SLACK):
            _copy(trial[0], x)
            if share == 1.0:
                return 1.0
            done += (1.0 - done) * share
            longest = min(2.0 * longest, _LONGEST)
        else:
            longest = 0.5 * min(longest, length)
        if not longest > _SHORTEST:
            break
    return done


@compiled
def calc_loop(loop: LoopRecords, wanted: Array, theta: Array, G: Array, reached: Array) -> None:
    """Write postures θ (N, k) of a loop for wanted positions (N, n) of the free joints, and G.

    `reached` (N,) gets the progress from the posture of the file: 1 if the loop closes at the
    wanted positions.
    """
    free, reference, rooms = loop.free, loop.reference, _work_arrays(loop)
    room, solving, c, J, x = rooms
    none = np.zeros((len(c), max(len(free), 1)))
    for i in range(len(wanted)):
        done, near, far = 0.0, 0.0, 0.0
        before = theta[i - 1] if i > 0 and reached[i - 1] == 1.0 else reference
        for f in range(len(free)):
            unit, at = loop.units[free[f]], free[f]
            near = max(near, abs(wanted[i, f] - before[at]) / unit)
            far = max(far, abs(wanted[i, f] - reference[at]) / unit)
        if near < far:
            _copy(before, theta[i])
            done = _move_to(loop, wanted[i], theta[i], rooms)
        if done < 1.0:
            _copy(reference, theta[i])
            done = _move_to(loop, wanted[i], theta[i], rooms)
        reached[i] = done
        _copy(theta[i], x[0])
        _calc_residuals(loop, x, room, c, J)
        G[i] = 0.0
        for f in range(len(free)):
            G[i, free[f], f] = 1.0
        _solve_dependent(loop, J, none, solving, G[i])


@compiled
def calc_loop_rates(loop: LoopRecords, theta: Array, G: Array, v: Array, out: Array) -> None:
    """Write Ġ into zeros (N, k, n), at positions θ (N, k) with G, for velocities v (N, n)."""
    rooms = _work_arrays(loop)
    room, solving, c, J, x = rooms
    (m, k), n = J.shape, v.shape[1]
    rate, xd, B = np.empty((m, k)), np.empty(k), np.empty((m, n))
    for i in range(len(theta)):
        for j in range(k):
            xd[j] = 0.0
            for f in range(n):
                xd[j] += G[i, j, f] * v[i, f]
        _calc_rates(loop, (theta[i], xd), rooms, rate)
        _copy(theta[i], x[0])
        _calc_residuals(loop, x, room, c, J)
        for j in range(m):
            for f in range(n):
                B[j, f] = 0.0
                for a in range(k):
                    B[j, f] -= rate[j, a] * G[i, a, f]
        _solve_dependent(loop, J, B, solving, out[i])


_FAR = 10.0  # rad or sizes of the loop, search range for ends of its motion
_OFF_THE_END = 1e-3  # relative margin to an end, where the loop still moves
_SAME = 1e-3  # rad or m, tolerance of fixed positions
_CORNERS = 4  # most free joints of which all corners of ranges are checked
_SMALLER, _MOST_TRIALS = 0.8, 15  # to shrink ranges of several free joints


def residuals(loop: LoopRecords, x: Array) -> tuple[Array, Array]:
    """Return the residuals (m,) of closures at x (k,), and their scaled Jacobian (m, k)."""
    rows = len(loop.couplings) + sum(6 if turns else 3 for turns in loop.closures["turns"])
    c, J, shape = np.zeros(rows), np.zeros((rows, len(x))), (1, len(loop.tree[0]))
    room = np.zeros((*shape, 4, 4)), *np.zeros((2, *shape, 3, len(x)))
    _calc_residuals(loop, contiguous(x[None]), room, c, J)
    return c, J * loop.units[:-1]


def solve_loop(loop: LoopRecords, q: Array) -> tuple[Array, Array, Array]:
    """Return positions (N, k) of all joints, G (N, k, n), and the progress (N,) of `calc_loop`."""
    q = contiguous(q)
    theta = np.empty((len(q), len(loop.reference)))
    G, reached = np.empty((*theta.shape, len(loop.free))), np.empty(len(q))
    calc_loop(loop, q, theta, G, reached)
    return theta, G, reached


@dataclass(frozen=True, eq=False)
class LoopTransmission(JointlyEvaluated, Short):
    """The map from the free joints of a closed loop, or of coupled loops, to all joints."""

    name: str  # description of the closure
    joints: tuple[str, ...]  # names of the k joints; the last ones may be cut
    records: LoopRecords  # the loop for compiled code
    shown: Indices  # indices of the joints in the tree
    cut: tuple[int, ...]  # indices of the joints that close the loop and are not in the tree
    slides: tuple[bool, ...]  # prismatic joints
    limits: Array  # (2, k) position limits of the joints
    motors: tuple[str, ...]  # names of the joints with motors, according to the file
    gap: float  # residual in the posture of the file, m or rad

    @property
    def free(self) -> Indices:
        """Return the indices of the free joints."""
        return self.records.free

    @property
    def reference(self) -> Array:
        """Return the posture (k,) of the file, in which the loop is closed."""
        return self.records.reference

    @property
    def actuators(self) -> tuple[str, ...]:
        """Return the names of the free joints."""
        return tuple(self.joints[k] for k in self.free)

    @property
    def driven(self) -> tuple[str, ...]:
        """Return the names of dependent joints with motors."""
        following = (self.joints[k] for k in self.records.following)
        return tuple(name for name in following if name in self.motors)

    @property
    def shape(self) -> tuple[int, int]:
        """Return the numbers of joints in the tree and of free ones."""
        return len(self.shown), len(self.free)

    @property
    def notes(self) -> tuple[str, ...]:
        """Return notes on the joints of the loop."""
        free = self.actuators
        others = [self.joints[k] for k in (*self.shown, *self.cut) if self.joints[k] not in free]
        follow = f"{', '.join(others)} follow{'s' if len(others) == 1 else ''} {', '.join(free)}"
        notes = [f"In the closed loop of {self.name}, {follow if free else 'nothing moves'}."]
        if passive := [name for name in free if self.motors and name not in self.motors]:
            verb = "are" if passive[1:] else "is"
            notes.append(
                f"{', '.join(passive)} of that loop {verb} passive and independent, as no motor of "
                "the file moves the loop there."
            )
        if driven := self.driven:
            notes.append(
                "The loop has more motors than degrees of freedom: efforts of "
                f"{', '.join(driven)} act at {', '.join(free)}, so logs need them too."
            )
        if self.gap:
            notes.append(f"That loop has a gap of {self.gap:.2g} m in the posture of the file.")
        return tuple(notes)

    def posture(self, held: Mapping[str, float], path: object) -> dict[str, float]:
        """Return joint -> position with some joints fixed."""
        names = self.joints
        q = np.array([held.get(names[at], self.reference[at]) for at in self.free])
        theta, _, reached = solve_loop(self.records, q[None])
        positions = dict(zip(names, theta[0].tolist(), strict=True))
        violated = {n: x for n, x in held.items() if n in names and abs(positions[n] - x) > _SAME}
        if reached[0] < 1.0 or violated:
            where = ", ".join(f"{name} at {held[name]:g}" for name in names if name in held)
            closes = {name: f"{positions[name]:.6g}" for name in violated}
            raise ModelError(
                f"{path}: the closed loop of {self.name} does not close with {where}.",
                advice=f"Fix {', '.join(f'{n} at {x}' for n, x in closes.items())}."
                if reached[0] == 1.0
                else "Fix its joints elsewhere.",
            )
        return {names[at]: positions[names[at]] for at in self.shown}

    def along(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return θ = T(q), J and J̇ for a motion."""
        theta, G, rate = self.of_all(q, v)
        return theta[:, self.shown], G[:, self.shown], rate[:, self.shown]

    def of_all(self, q: Array, v: Array | None = None) -> tuple[Array, Array, Array]:
        """Return positions (N, k) of all joints by Newton's method, G and Ġ (N, k, n)."""
        q = self._q(q)
        theta, G, reached = solve_loop(self.records, q)
        if (open_ := reached < 1.0).any():
            at = int(np.argmax(open_))
            start = self.reference[self.free]
            end = start + reached[at] * (q[at] - start)
            raise ArgumentError(
                f"The closed loop of {self.name} does not close at "
                f"{_places(self.actuators, q[at])}: starting from the posture of the file, it "
                f"ends at {_places(self.actuators, end)}.",
                advice="Check its lengths and zero positions, and that the log is of this robot.",
            )
        rate = np.zeros_like(G)
        if v is not None:
            calc_loop_rates(self.records, theta, G, contiguous(v), rate)
        return theta, G, rate

    def actuator_positions(self, theta: Array, *, start: ArrayLike = 0.0) -> Array:
        """Return positions (N, n) of the free joints, read from θ if all are in the tree."""
        if not np.isin(self.free, self.shown).all():
            return super().actuator_positions(theta, start=start)
        return np.array(theta[:, np.searchsorted(self.shown, self.free)])

    def inside(self, q: Array) -> Array:
        """Return positions moved towards the posture of the file until the loop closes."""
        share, there = solve_loop(self.records, q)[2], self.reference[self.free]
        moved = there + (1.0 - _OFF_THE_END) * share[:, None] * (q - there)
        return np.where((share < 1.0)[:, None], moved, q)

    @cached_property
    def range(self) -> tuple[Array, Array]:
        """Return limits (n,) of the free joints between which the loop closes.

        With several free joints, the dependent joints respect their limits there, too.
        """
        (lower, upper), start = self.limits[:, self.free], self.reference[self.free]
        units = self.records.units[self.free]
        ends = [np.maximum(lower, start - _FAR * units), np.minimum(upper, start + _FAR * units)]
        for k, (end, limit) in enumerate(zip(ends, (lower, upper), strict=True)):
            q = start + np.diag(end - start)  # one joint at a time
            share = solve_loop(self.records, q)[2]
            stops = start + (1.0 - _OFF_THE_END) * share * (end - start)
            ends[k] = np.where(share < 1.0, stops, limit)
        if 1 < len(start) <= _CORNERS:
            least, most = self.limits
            least, most = np.minimum(least, self.reference), np.maximum(most, self.reference)
            for _ in range(_MOST_TRIALS):
                near = [np.clip(end, start - _FAR * units, start + _FAR * units) for end in ends]
                corners = np.array(list(product(*zip(*near, strict=True))))
                theta, _, share = solve_loop(self.records, corners)
                within = (theta >= least - _SAME) & (theta <= most + _SAME)
                if (share == 1.0).all() and within.all():
                    break
                ends = [start + _SMALLER * (end - start) for end in near]
        return ends[0], ends[1]


def _places(names: Sequence[str], values: ArrayLike) -> str:
    return ", ".join(f"{n} = {x:.4g}" for n, x in zip(names, np.asarray(values), strict=True))


def linkage(
    what: str,
    joints: Sequence[tuple[str, int, FrameMotion]],
    ends: Sequence[tuple[int, float]],
    reference: ArrayLike,
    *,
    free: int,
    size: float,
) -> LoopTransmission:
    """Return the map from one joint of a planar linkage with three joints to the last one.

    Args:
        joints: Name, index of the inboard joint or −1 for the ground, and motion of each joint.
        ends: Two joints, and the position on their outboard bodies' x axes of the closing point, m.
        reference: (3,) posture in which the linkage is closed.
        free: Index of the actuated joint.
        size: Size of the linkage, m.
    """
    mobilizers, closures = list[Mobilizer](), np.zeros(1, CLOSURE)
    for at, (_, parent, motion) in enumerate(joints):
        mobilizers.append(in_loop(mobilizers, parent, at, motion))
    for side, (at, place) in enumerate(ends):
        closures[0]["bodies"][side], closures[0]["positions"][side] = at, [place, 0.0, 0.0]
        closures[0]["rotations"][side] = np.eye(3)
    slides = tuple(motion.features is Features.CONSTANT for _, _, motion in joints)
    records = LoopRecords(
        records_of(mobilizers, np.zeros(3)),
        closures,
        np.zeros((0, 3, 1)),
        np.array([free]),
        np.array([at for at in range(3) if at != free]),
        np.array(reference, float),
        np.array([*(size if slide else 1.0 for slide in slides), size]),
    )
    names, limits = tuple(name for name, _, _ in joints), np.outer([-1.0, 1.0], np.full(3, np.inf))
    return LoopTransmission(what, names, records, np.array([2]), (), slides, limits, (), 0.0)
