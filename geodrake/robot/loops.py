"""Closed kinematic loops, as transmissions from their free joints.

A robot with closed loops is a tree of joints θ with closures c(θ) = 0: points or frames of two
bodies that coincide. With J = ∂c/∂θ, some joints q are free, and the others depend on them,

    θ̇ = G q̇,   J G = 0,   θ̈ = G q̈ + Ġ q̇,   J Ġ = −J̇ G,   τ_q = Gᵀ τ_θ        [Lee2019] Eq. (3.6.57)

where rows of G of the free joints are those of the identity. Forces in closures do no work, so they
cancel in Gᵀ τ_θ. A loop is therefore a transmission from the free joints to all of its joints.

If joints of a loop have drives, the actuators are coordinates of the loop, too, and c(θ) includes
their coupling to the joints.

Newton's method finds the dependent positions by continuation from the posture of the file, or from
the previous sample, so that the assembly mode of the loop does not change.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from scipy.optimize import least_squares

from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import Array
from geodrake.robot.joints import (
    Features,
    Tie,
    axis_motion,
    joint_names,
    scoped,
    single_joints,
    slide_motion,
)
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.recursion import Mobilizer, records_of
from geodrake.robot.stated import WORLD, Closure, places_of_links
from geodrake.robot.transmission.loop import (
    CLOSURE,
    LoopRecords,
    LoopTransmission,
    in_loop,
    merged_loops,
    residuals,
    solve_loop,
    uncoupled_records,
)
from geodrake.robot.transmission.schema import Drive

# Relative tolerances of linearly dependent columns, and displacements to test whether a posture is
# singular, rad or shares of the size: first for axes that are parallel up to rounding, then for
# postures that are nearly singular.
_FREE = (1e-3, 0.1), (1e-5, 0.02)
_WELL = 0.1, 0.01, 0.0  # relative residuals of independent columns, in the order of trials
_IDLE = 1e-9  # relative size of the column of a joint that does not affect a loop
_CLOSED, _NEARLY = 1e-9, 1e-3  # residuals of a loop relative to its size; the latter by rounding
_STILL = 1e-14  # rad or shares, step at convergence
_MOST_ITERATIONS, _LONGEST = 100, 0.3  # to close a loop in the posture of the file; rad or shares
_FARTHEST = 1e6  # m, of a closure from its body


@dataclass(frozen=True)
class LoopJoints:
    """Facts about joints in closed loops."""

    followers: Mapping[str, Tie] = field(default_factory=dict)  # by scoped names
    driven: Collection[str] = ()
    # Names of joints with springs, the stiffest first. They are free if motors do not determine the
    # motion of a loop, as they hardly move.
    sprung: Sequence[str] = ()
    first: Collection[str] = ()  # names of preferred free joints
    # Joint -> start of the search for the loops' posture, rad or m; by default the plant's.
    start: Mapping[str, float] = field(default_factory=dict)
    drives: Sequence[Drive] = ()  # of joints that may be in loops
    placed: Mapping[str, float] = field(default_factory=dict)  # actuator -> its position


@dataclass(frozen=True, eq=False)
class Loops:
    """The closed loops of a robot."""

    loops: tuple[LoopTransmission, ...] = ()
    left_out: tuple[str, ...] = ()
    taken: tuple[str, ...] = ()  # scoped names of following joints within loops
    # Joint -> position at which constraints fix it, rad or m.
    held: Mapping[str, float] = field(default_factory=dict)

    @property
    def notes(self) -> tuple[str, ...]:
        """Return notes on the loops."""
        notes = [note for loop in self.loops for note in loop.notes]
        if held := ", ".join(f"{joint} at {place:.4g}" for joint, place in self.held.items()):
            notes.append(f"Fixed, as constraints of the file do not let them move: {held}.")
        return tuple(notes)

    def places(
        self, held: Mapping[str, float], path: object
    ) -> tuple[dict[str, float], dict[str, float]]:
        """Return joint -> position with some joints fixed, of all joints and of immobile ones."""
        positions, immobile = dict[str, float](), dict[str, float]()
        for loop in self.loops:
            posture = loop.posture(held, path)
            positions |= posture
            if held.keys() >= set(loop.actuators):
                immobile |= {joint: x for joint, x in posture.items() if joint not in held}
        return positions, immobile


def closed_loops(
    plant: MultibodyPlant, closures: Sequence[Closure], *, path: object, how: LoopJoints
) -> Loops:
    """Return the closed loops of a plant.

    Driven joints of a loop are free, and then those closest to the base.
    """
    return _LoopFinder(plant, path, how).loops(closures) if closures else Loops()


class _Link(NamedTuple):
    """A loop closure with its frames, and the mobilizers that move only one of its sides."""

    closure: Closure
    ends: list[tuple[int, RigidTransform]]
    apart: set[int]


class _Shape(NamedTuple):
    """A loop without a choice of free joints."""

    records: LoopRecords
    names: tuple[str, ...]  # of the k coordinates
    slides: tuple[bool, ...]
    places: Mapping[str, int]  # joint or actuator -> index of its coordinate


_Group = tuple[set[int], list[_Link], list[str], list[Drive]]
"""Velocities, closures of their loops, scoped names of following joints, and drives."""


class _LoopFinder:
    def __init__(self, plant: MultibodyPlant, path: object, how: LoopJoints) -> None:
        self.plant, self.names, self.path, self.how = plant, joint_names(plant), path, how
        self.tree = KinematicTree.from_plant(plant)
        self.at = {scoped(joint): int(joint.velocity_start()) for joint in single_joints(plant)}
        lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
        stated = plant.GetPositions(plant.CreateDefaultContext())
        q = np.clip(stated, lower, upper)
        for name, tie in how.followers.items():
            follower, leader = self.at[name], self.at[tie.leader]
            if q[follower] != stated[follower]:
                q[leader] = tie.leader_at(float(q[follower]))
            else:
                q[follower] = tie.at(float(q[leader]))
        self.place = {at: how.start.get(self.names[at], float(q[at])) for at in self.at.values()}
        self.limits = {at: (float(lower[at]), float(upper[at])) for at in self.place}
        self.beyond = {at for at in self.place if not lower[at] <= stated[at] <= upper[at]}
        # Scoped name of a body -> its mobilizer, -1 for the world, and its pose there.
        moving = {
            self.tree.bodies[m.body]: k for k, m in enumerate(self.tree.mobilizers) if m.body >= 0
        }
        links = places_of_links(plant).items()
        self.bodies = {link: (moving.get(body, -1), X) for link, (body, X) in links}
        self.bodies[WORLD] = -1, RigidTransform()

    def loops(self, closures: Sequence[Closure]) -> Loops:
        links, left_out = list[_Link](), list[str]()
        for closure in closures:
            link = self._link(closure)
            several = [i for i in sorted(link.apart) if self._velocity(i) not in self.place]
            if several:
                moved = (self.tree.mobilizers[i].body for i in several)
                bodies = dict.fromkeys(self.tree.bodies[body] for body in moved if body >= 0)
                left_out.append(
                    f"The closed loop of {closure.name} is ignored, and the robot read as an "
                    f"open tree, as {', '.join(bodies)} moves there by a joint of several "
                    "degrees of freedom."
                )
            elif link.apart:
                links.append(link)
        groups = list[_Group]()
        new: list[_Group] = [
            ({self._velocity(i) for i in link.apart}, [link], [], []) for link in links
        ]
        for own, tie in self.how.followers.items():
            new.append(({self.at[own], self.at[tie.leader]}, [], [own], []))
        for drive in self.how.drives:
            new.append(({self.names.index(joint) for joint in drive.joints}, [], [], [drive]))
        for group in new:  # merge groups with common velocities
            together = [other for other in groups if not group[0].isdisjoint(other[0])]
            groups = [other for other in groups if group[0].isdisjoint(other[0])]
            every, own_links, ties, drives = zip(*together, group, strict=True)
            lists = list(chain(*own_links)), list(chain(*ties)), list(chain(*drives))
            groups.append((set().union(*every), *lists))
        loops = [self._loop(sorted(at), own, ties, by) for at, own, ties, by in groups if own]
        taken = [joint for _, own, ties, _ in groups if own for joint in ties]
        moving = tuple(loop for loop in loops if len(loop.shown))
        return Loops(moving, tuple(left_out), tuple(taken))

    def _velocity(self, mobilizer: int) -> int:
        """Return the velocity of a mobilizer."""
        return int(self.tree.mobilizers[mobilizer].velocities.start)

    def _link(self, closure: Closure) -> _Link:
        ends, chains = list[tuple[int, RigidTransform]](), list[list[int]]()
        for body, X_BP in zip(closure.bodies, closure.poses, strict=True):
            place, name = X_BP.translation(), body.rpartition("::")[2]
            wrong = "" if body in self.bodies else f"has an unknown body {name!r}."
            if not wrong and not (np.abs(place) <= _FARTHEST).all():
                at_place = " ".join(f"{x:g}" for x in place)
                wrong = f"is at {at_place} of {name}, where no loop closes."
            if wrong:
                advice = "Correct the file there."
                raise ModelError(f"{self.path}: {closure.name} {wrong}", advice=advice)
            at, X_RB = self.bodies[body]
            ends.append((at, X_RB @ X_BP))
            chains.append([])
            while at >= 0:
                chains[-1].append(at)
                at = self.tree.mobilizers[at].parent
        return _Link(closure, ends, set(chains[0]) ^ set(chains[1]))

    def _loop(
        self,
        velocities: list[int],
        links: Sequence[_Link],
        ties: Sequence[str],
        drives: Sequence[Drive],
    ) -> LoopTransmission:
        name = " and ".join(dict.fromkeys(link.closure.name for link in links))
        loop_shape = self._shape(velocities, links, ties)
        for drive in drives:
            loop_shape = self._with_drive(loop_shape, drive)
        shape, x = loop_shape.records, loop_shape.records.reference
        joints, at = loop_shape.names, loop_shape.places
        tied = {self.names[self.at[title]] for title in ties}
        leading = [n for n in at if n not in tied]
        driven = tuple(n for n in leading if n in self.how.driven)
        first = [n for n in at if n in self.how.first]
        sprung = [n for n in self.how.sprung if driven and n in leading]
        order = [[at[n] for n in rank] for rank in (first, driven, sprung, leading)]
        order.append(list(range(len(joints))))
        title, start, count = f"{self.path}: the closed loop of {name}", x, len(velocities)
        free_ends = [(-np.inf, np.inf)] * (len(joints) - count)
        limits = np.array([*(self.limits[v] for v in velocities), *free_ends]).T
        if self.beyond.intersection(velocities) and not self.how.start:
            start = _closed_within(shape, x, limits)
        for least, nudge in _FREE:
            dependent = _dependent(residuals(shape, start)[1], order, least)
            x, gap = _close_posture(shape, start, dependent)
            free, following = _free_and_dependent(shape, x, order, (least, nudge))
            if free and gap <= _NEARLY:
                break
        if not gap <= _NEARLY:
            where = ", ".join(f"{n} = {at:.4g}" for n, at in zip(joints, x, strict=True))
            or_turned = f" or {gap:.3g} rad" if any(x.closure.turns for x in links) else ""
            raise ModelError(
                f"{title} cannot close near the posture of the file: the gap is "
                f"{gap * shape.units[-1]:.3g} m{or_turned}, and smallest at {where}.",
                advice="Correct where its bodies are joined, or the joint positions.",
            )
        if free is None:
            raise ModelError(
                f"{title} is singular at {', '.join(joints)} as in the file, so its motion is "
                "undetermined.",
                advice="Use another posture in the file.",
            )
        outside = (x < limits[0] - _NEARLY) | (x > limits[1] + _NEARLY)
        if not free and outside.any():
            at_limit = int(np.argmax(outside))
            low, high = limits[:, at_limit]
            raise ModelError(
                f"{title} cannot move, with {joints[at_limit]} at {x[at_limit]:.4g} outside of its "
                f"limits {low:g} … {high:g}.",
                advice="Correct the axes, which may not be parallel, or where bodies are joined.",
            )
        shown = [k for k in range(count) if k in free or k in following]
        return LoopTransmission(
            name,
            joints,
            _with_free_joints(shape, free, following, x),
            np.array(shown, np.int64),
            tuple(k for k in at.values() if k >= count),
            loop_shape.slides,
            limits,
            driven,
            float(gap * shape.units[-1] * (gap > _CLOSED)),
        )

    def _shape(self, velocities: list[int], links: Sequence[_Link], ties: Sequence[str]) -> _Shape:
        """Return a loop without drives and without a choice of free joints."""
        indices, mobilizers = sorted({i for link in links for i in link.apart}), list[Mobilizer]()
        local = {-1: -1, **{i: at for at, i in enumerate(indices)}}
        for i in indices:
            mobilizer, at = self.tree.mobilizers[i], velocities.index(self._velocity(i))
            parent, motion = local.get(mobilizer.parent, -1), mobilizer.motion
            mobilizers.append(in_loop(mobilizers, parent, at, motion, mobilizer.p_MoBo_B))
        sliding = [m for m in self.tree.mobilizers if m.motion.features is Features.CONSTANT]
        along = {int(m.velocities.start) for m in sliding}
        names, slides = [self.names[v] for v in velocities], [v in along for v in velocities]
        closures = np.zeros(len(links), CLOSURE)
        for closure, link in zip(closures, links, strict=True):
            ends = [(local.get(at, -1), X) for at, X in link.ends]
            if (cut := link.closure.cut) is not None:
                at, X = ends[0]
                motion = slide_motion(cut.axis) if cut.slides else axis_motion(cut.axis)
                ends[0] = len(mobilizers), RigidTransform()
                between = motion.between(X, np.eye(3))
                mobilizers.append(in_loop(mobilizers, at, len(names), between))
                names.append(cut.name)
                slides.append(cut.slides)
            for k, (at, X) in enumerate(ends):
                closure["bodies"][k], closure["positions"][k] = at, X.translation()
                closure["rotations"][k] = X.rotation().matrix()
            closure["turns"], closure["radius"] = link.closure.turns, link.closure.radius
        size, count = _size(mobilizers, closures), len(names)
        most = max((len(self.how.followers[tied].coefficients) for tied in ties), default=2)
        couplings = np.zeros((len(ties), count, most))
        for row, tied in zip(couplings, ties, strict=True):  # p(x) − y
            leader, polynomial = self.how.followers[tied]
            row[velocities.index(self.at[leader]), : len(polynomial)] = polynomial
            row[velocities.index(self.at[tied]), 1] -= 1.0
        couplings /= np.abs(couplings[:, :, 1:2]).max(axis=1, keepdims=True)
        tree, none = records_of(mobilizers, np.zeros(3)), np.zeros(0, np.int64)
        x = np.array([*(self.place[v] for v in velocities), *np.zeros(count - len(velocities))])
        units = np.array([*(size if slide else 1.0 for slide in slides), size])
        records = LoopRecords(tree, closures, couplings, none, none, x, units)
        places = {name: k for k, name in enumerate(names)}
        return _Shape(records, tuple(names), tuple(slides), places)

    def _with_drive(self, shape: _Shape, drive: Drive) -> _Shape:
        """Return a loop with the actuators of a drive of its joints, or with the drive's loop."""
        first, joints = len(shape.names), [shape.places[joint] for joint in drive.joints]
        start = np.array([[self.how.placed[name] for name in drive.actuators]])
        if isinstance(loop := drive.map, LoopTransmission):
            (x,), _, _ = solve_loop(loop.records, start)
            records = loop.records._replace(reference=x)
            names, slides = loop.joints, loop.slides
            rows = np.zeros((len(joints), first + len(x), 2))
            for row, at, k in zip(rows, joints, loop.shown.tolist(), strict=True):
                row[at, 1], row[first + k, 1] = -1.0, 1.0
            more = [k for k in (*loop.cut, *loop.free.tolist()) if k not in loop.shown]
        elif (J := drive.map.constant_jacobian) is not None:
            names = drive.actuators
            slides = drive.slides or tuple(shape.slides[at] for at in joints[: len(names)])
            records = uncoupled_records(start[0], slides, shape.records.units[-1])
            rows = np.zeros((len(joints), first + len(names), 2))
            offsets = drive.map.joint_positions(np.zeros(start.shape))[0]
            for row, at, ratios, offset in zip(rows, joints, J, offsets, strict=True):
                row[at, 1], row[at, 0], row[first:, 1] = -1.0, offset, ratios
            more = list(range(len(names)))
        else:
            raise ArgumentError(
                "Standing legs and other closed loops cannot have joints that follow actuators "
                f"by a table or formula: {', '.join(drive.joints)} (of "
                f"{', '.join(drive.actuators)}).",
                advice="Use the positions and efforts of these joints, without that transmission.",
            )
        return _Shape(
            merged_loops(shape.records, records, rows),
            (*shape.names, *names),
            (*shape.slides, *slides),
            {**shape.places, **{names[k]: first + k for k in more}},
        )


def _with_free_joints(
    shape: LoopRecords, free: Collection[int], following: Collection[int], x: Array
) -> LoopRecords:
    """Return a loop with a choice of free joints, at a posture (k,)."""
    one, other = (np.array(sorted(each), np.int64) for each in (free, following))
    return shape._replace(free=one, following=other, reference=x)


def _close_posture(shape: LoopRecords, x: Array, following: Sequence[int]) -> tuple[Array, float]:
    """Return the closed posture (k,) of a loop close to x, and the remaining residual."""
    x = x.copy()
    for _ in range(_MOST_ITERATIONS):
        c, J = residuals(shape, x)
        step = -np.linalg.lstsq(J[:, following], c)[0]
        largest = float(np.abs(step).max(initial=0.0))
        x[following] += shape.units[following] * step * min(1.0, _LONGEST / max(largest, 1e-300))
        if largest < _STILL:
            break
    return x, float(np.abs(residuals(shape, x)[0]).max(initial=0.0))


def _closed_within(shape: LoopRecords, x: Array, limits: Array) -> Array:
    """Return a nearly closed posture (k,) of a loop close to x, within limits (2, k)."""
    found = least_squares(
        lambda y: residuals(shape, y)[0],
        np.clip(x, *limits),
        lambda y: residuals(shape, y)[1] / shape.units[:-1],
        bounds=(limits[0] - _CLOSED, limits[1] + _CLOSED),
    )
    return np.asarray(found.x)


def _free_and_dependent(
    shape: LoopRecords, x: Array, order: Sequence[Sequence[int]], tried: tuple[float, float]
) -> tuple[list[int] | None, list[int]]:
    """Return free joints, or None if singular, and dependent joints at a posture (k,).

    Joints that do not affect the loop, such as that of a rod about its own axis, are neither.
    """
    (least, nudge), J = tried, residuals(shape, x)[1]
    following = _dependent(J, order, least)
    others = [k for k in range(len(x)) if k not in following]
    free, nearby = set[int](), _with_free_joints(shape, others, following, x)
    units = shape.units[others]
    moved = np.abs(solve_loop(nearby, x[others][None])[1][0] @ units / shape.units[:-1])
    moved *= J[: len(J) - len(shape.couplings)].any(axis=0)  # gears may turn any number of times
    for sign in (0.0, 1.0, -1.0):  # the result must be the same nearby
        q = x[others] + sign * nudge * units / max(1.0, moved.max(initial=0.0))
        theta, _, (reached,) = solve_loop(nearby, q[None])
        J = residuals(shape, theta[0])[1]
        free |= {k for k in others if np.abs(J[:, k]).max() > _IDLE * np.abs(J).max()}
        if reached < 1.0 or len(_dependent(J, order, least)) != len(following):
            return None, following
    return sorted(free), following


def _dependent(J: Array, order: Sequence[Sequence[int]], least: float) -> list[int]:
    """Return joints whose columns of J (m, k) are a basis of its range, which become dependent.

    Joints of the last ranks are preferred, and in a rank the last ones with large residuals.
    """
    sizes, basis_joints, basis = np.linalg.norm(J, axis=0), list[int](), np.zeros((len(J), 0))
    least, before = least * float(sizes.max(initial=0.0)), set[int]()
    ranks = list[list[int]]()
    for rank in order:
        ranks.insert(0, [at for at in rank if at not in before])
        before |= set(rank)
    for rank, well in product(ranks, _WELL):
        for at in reversed(rank):
            residual = J[:, at]
            for _ in range(2):
                residual = residual - basis @ (basis.T @ residual)
            size = float(np.linalg.norm(residual))
            if at not in basis_joints and size > max(least, well * sizes[at]):
                basis_joints.append(at)
                basis = np.column_stack([basis, residual / size])
    return sorted(basis_joints)


def _size(mobilizers: Sequence[Mobilizer], closures: NDArray[np.void]) -> float:
    """Return the length of a loop's longest part, m; 1 if all parts are at one point."""
    at_base = [m.motion.offset for m in mobilizers if m.parent < 0]
    arms = [m.p_MoBo_B for m in mobilizers]
    arms += [m.motion.offset - (at_base[0] if m.parent < 0 else 0.0) for m in mobilizers]
    for closure in closures:
        for at, place in zip(closure["bodies"], closure["positions"], strict=True):
            arms.append(place - (at_base[0] if at < 0 else 0.0))
    return float(np.linalg.norm(arms, axis=1).max(initial=0.0)) or 1.0
