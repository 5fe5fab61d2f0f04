"""The linear fit of Eq. (1) of the design for one motion of the joints, as normal matrices."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.samples import ColumnSamples
from geodrake.effects import catalogue
from geodrake.effects.base import Effect
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.role import Role
from geodrake.identification.logs.criteria import LARGEST, SPREAD
from geodrake.identification.logs.log_slices import INERTIA, Layout
from geodrake.identification.logs.unknowns import pullback_information
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel
from geodrake.robot.driven_tree import with_gravity
from geodrake.robot.effort_slopes import effort_slopes
from geodrake.robot.regressor import inverse_dynamics_regressor

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

USUAL_TILT = 0.03
"""Standard deviation of the angles by which bases are off the level, rad."""

USUAL_ZERO = 0.02
"""Standard deviation of the zeros of positions, rad; that of a prismatic joint is so many m."""

USUAL_REST = 0.1
"""Of friction and rotors that drives take out, so much may be left, or be taken out twice."""

EffectRows = dict[Hashable, Mapping[int, Array]]
"""Columns (N, ·) of effects, by the effect and what they depend on, and by joint."""


@dataclass(frozen=True, eq=False)
class Parameters:
    """What fits may move: bodies, effects, tilt, and small errors of zeros and gains.

    Attributes:
        model: The model.
        layout: Columns of bodies and effects at each joint.
        mean: (p,) prior mean.
        information: (p, p) prior information.
        lower: (p,) lower bounds.
    """

    model: RobotModel
    layout: Layout
    mean: Array
    information: Array
    lower: Array

    @classmethod
    def of(cls, samples: ColumnSamples) -> Parameters:
        """The parameters of a model and of what any joint may have beside it."""
        model, n = samples.model, len(samples.model.joints)
        own = [f for f in model.effects if _is_seen(f.effect)]
        said = {(f.effect.name, f.effect.where) for f in own}
        more = [
            effect
            for kind in catalogue()
            if kind.beside_gains
            for joint in model.single_joints
            for effect in kind.shaped(joint)
            if (effect.name, effect.where) not in said
        ]
        effects = (*(f.effect for f in own), *more)
        layout = Layout.of(model, effects, samples.width, samples.width)
        known = _information(model)
        further = sum(len(effect.parameters) for effect in more)
        p = len(known) + further + 2 + 2 * n
        information = np.zeros((p, p))
        information[: len(known), : len(known)] = known
        mean = np.zeros(p)
        mean[: len(known)] = np.concatenate([model.total_phi.ravel(), *(f.parameters for f in own)])
        at = p - 2 - 2 * n
        usual = np.concatenate(
            [
                np.full(2, USUAL_TILT),
                np.full(n, USUAL_ZERO),
                np.maximum(samples.gain_deviations, 1e-3),
            ]
        )
        information[range(at, p), range(at, p)] = usual**-2.0
        lower = np.full(p, -np.inf)
        bounds = [q.lower for effect in effects for q in effect.parameters]
        lower[model.phi.size : at] = bounds
        return cls(model, layout, mean, information, lower)

    @property
    def nuisance(self) -> slice:
        """Those of effects that the model lacks."""
        n, further = len(self.model.joints), len(self._known)
        return slice(further, len(self.mean) - 2 - 2 * n)

    @cached_property
    def _known(self) -> Array:
        return _information(self.model)

    @property
    def shared(self) -> int:
        """Number of the parameters that are not small errors."""
        return len(self.mean) - 2 - 2 * len(self.model.joints)

    def tilt(self) -> Indices:
        """(2,) those of the base's tilt."""
        return self.shared + np.arange(2)

    def zeros(self) -> Indices:
        """(n,) errors of the positions' zeros."""
        return self.shared + 2 + np.arange(len(self.model.joints))

    def gains(self) -> Indices:
        """(n,) errors of the efforts' gains."""
        return self.shared + 2 + len(self.model.joints) + np.arange(len(self.model.joints))

    def taken_out(self, names: frozenset[str]) -> Indices:
        """Parameters of the effects of some names of `Effect.taken_out_as`."""
        at, found = self.model.phi.size, list[int]()
        for effect in self.layout.effects:
            here = range(at, at + len(effect.parameters))
            found += here if effect.taken_out_as in names else ()
            at += len(effect.parameters)
        return np.array(found, int)

    def stated(self, name: str) -> Indices:
        """Parameters of effects that the model states, of a name of `Effect.taken_out_as`."""
        gone = self.taken_out(frozenset({name}))
        return gone[gone < self.nuisance.start]

    @property
    def can_be_taken_out(self) -> tuple[str, ...]:
        """Names of `Effect.taken_out_as` of which the model states something."""
        stated = [f.effect for f in self.model.effects if np.any(f.parameters)]
        return tuple(sorted({e.taken_out_as for e in stated if e.taken_out_as}))


def _is_seen(effect: Effect) -> bool:
    """Whether columns of an effect can be had from samples that do not follow each other."""
    apart = "history" in effect.depends_on or effect.state_count > 0 or effect.places == "log"
    return bool(effect.parameters) and effect.role is not Role.BODY and not apart


def _information(model: RobotModel) -> Array:
    """Prior information of the bodies and of the effects whose columns are seen."""
    d, fitted = model.phi.size, [f for f in model.effects if len(f.effect.parameters)]
    sizes = [len(f.parameters) for f in fitted]
    seen = np.concatenate(
        [
            np.ones(d, bool),
            *(np.full(k, _is_seen(f.effect)) for k, f in zip(sizes, fitted, strict=True)),
        ]
    )
    if model.information is not None:
        return model.information[np.ix_(seen, seen)]
    information = np.zeros((len(seen), len(seen)))
    information[:d, :d] = pullback_information(model.phi, SPREAD)
    rest = np.concatenate([np.zeros(0), *(f.parameters for f in fitted)])
    information[range(d, len(seen)), range(d, len(seen))] = 1.0 / np.maximum(rest**2, 1e-12)
    return information[np.ix_(seen, seen)]


@dataclass(frozen=True, eq=False)
class JointDesign:
    """What the samples say of one joint.

    Attributes:
        columns: (m,) parameters that matter, without the joint's gain.
        rows: (K,) samples.
        X: (K, m) their columns; at the end known payloads' efforts and all columns of efforts.
        grams: (F, m + 1 + n, m + 1 + n) normal matrices of X, fold by fold.
        peak: (m,) largest entry of each column.
        beyond: Share of the samples in which more effort was asked for than the motor gives, and
            the mean square of what was too much.
    """

    columns: Indices
    rows: Indices
    X: Array
    grams: Array
    peak: Array
    beyond: tuple[float, float] = (0.0, 1.0)

    @cached_property
    def total(self) -> Array:
        """Normal matrix of all folds."""
        return np.asarray(self.grams.sum(axis=0))

    @property
    def summary(self) -> JointDesign:
        """What a fit to all folds needs: one normal matrix, and no samples."""
        return replace(self, X=self.X[:0], grams=self.total[None])

    def asked(
        self, samples: ColumnSamples, assignment: Assignment, joint: int
    ) -> tuple[Array, Array]:
        """Efforts (K,) of the log at the joint, and velocities (K,).

        Args:
            samples: The samples.
            assignment: What the columns are.
            joint: The joint.
        """
        velocity = samples.v[self.rows, assignment.position[joint]] * assignment.scale[joint]
        effort = samples.effort[self.rows, assignment.effort[joint]]
        return assignment.gain[joint] * effort, velocity / assignment.time

    def limited(self, samples: ColumnSamples, assignment: Assignment, joint: int) -> JointDesign:
        """With no more effort than the joint's motor gives.

        Args:
            samples: The samples.
            assignment: An assignment that says what it gives.
            joint: The joint.
        """
        asked, velocity = self.asked(samples, assignment, joint)
        limit, X = assignment.limit_of(joint), self.X.copy()
        column = len(self.columns) + 1 + assignment.effort[joint]
        X[:, column] = limit.given(asked, velocity) / assignment.gain[joint]
        grams = _grams(X, samples.fold[self.rows], samples.folds)
        return replace(self, X=X, grams=grams, beyond=limit.beyond(asked, velocity))


def joint_motion(samples: ColumnSamples, assignment: Assignment) -> tuple[Array, Array, Array]:
    """(N, n) positions, velocities and accelerations of the joints by an assignment.

    Args:
        samples: The samples.
        assignment: What the columns are.
    """
    at, scale, time = assignment.position, assignment.scale, assignment.time
    q = samples.q[:, at] * scale + assignment.zero
    return q, samples.v[:, at] * scale / time, samples.vd[:, at] * scale / time**2


def joint_designs(
    samples: ColumnSamples,
    parameters: Parameters,
    assignment: Assignment,
    known: EffectRows,
    *,
    slopes: bool,
) -> tuple[JointDesign, ...]:
    """The designs of all joints for one motion.

    Args:
        samples: The samples.
        parameters: What fits may move.
        assignment: What the columns are.
        known: Columns of effects that were computed before; used and filled.
        slopes: Whether errors of zeros have columns other than zeros.
    """
    model, n = parameters.model, len(parameters.model.joints)
    width = parameters.layout.sign_width[assignment.position]
    width = width * np.abs(assignment.scale) / assignment.time
    layout = replace(parameters.layout, sign_width=width)
    inertial, held, others = _columns_of(samples, layout, assignment, known)
    tilts, turned = _errors_of(samples, model, assignment, slopes=slopes)
    more = _further_weight(samples, model, assignment)
    further = np.concatenate([parameters.tilt(), parameters.zeros()])
    designs = []
    for j in range(n):
        columns, own = layout.columns[j], inertial[j]
        if more is not None:
            own = own + more[:, j, columns[columns < model.phi.size]]
        effects = [part[j] for part in others if j in part]
        X = np.column_stack([own, *effects, tilts[:, j], turned[:, j], held[:, j], samples.effort])
        own_columns = np.concatenate([columns, further])
        designs.append(_reduced(samples, own_columns, X, assignment.position[j]))
    return tuple(designs)


def _further_weight(
    samples: ColumnSamples, model: RobotModel, assignment: Assignment
) -> Array | None:
    """(N, n, 10 nb) weight of bodies beside that of the model; None if there is no other."""
    gravity = -model.tree.gravity
    if not assignment.level:
        if assignment.gravity is None:
            return None
        gravity = gravity + assignment.gravity
    q, v, _ = joint_motion(samples, assignment)
    tree, still = with_gravity(model.tree, gravity), np.zeros_like(v)
    return inverse_dynamics_regressor(tree, model.positions(q), still, still)


def _columns_of(
    samples: ColumnSamples, layout: Layout, assignment: Assignment, known: EffectRows
) -> tuple[list[Array], Array, list[Mapping[int, Array]]]:
    """Columns of bodies by joint, efforts (N, n) of known payloads, and columns of all effects."""
    model, n = layout.model, len(layout.columns)
    q, v, vd = joint_motion(samples, assignment)
    keys = {e: _key(e, layout, assignment) for e in layout.parts if isinstance(e, Effect)}
    missing = [effect for effect, key in keys.items() if key is None or key not in known]
    parts: list[Effect | str] = [INERTIA, *missing]
    pieces: list[dict[int, list[Array]]] = [defaultdict(list) for _ in parts]
    held = np.empty_like(v)
    for k, trajectory in enumerate(samples.trajectories):
        here = samples.log == k
        motion = Motion(model.positions(q[here]), v[here], vd[here], np.zeros(int(here.sum())))
        found, load = layout.evaluate(motion, trajectory, parts)
        for out, blocks in zip(pieces, found, strict=True):
            for j, block in blocks.items():
                out[j].append(block)
        own = [found[0][j] @ _local(model, layout, j) for j in range(n)]
        held[here] = load - np.stack(own, 1)
    order = np.argsort(np.argsort(samples.log, kind="stable"))
    joined = [{j: np.concatenate(own)[order] for j, own in out.items()} for out in pieces]
    new = dict(zip(parts[1:], joined[1:], strict=True))
    for effect, blocks in new.items():
        if isinstance(effect, Effect) and (key := keys[effect]) is not None:
            known[key] = blocks
    others = [new[e] if e in new else known[key] for e, key in keys.items()]
    effects = dict(zip(keys, others, strict=True))
    held = held - np.stack([np.zeros(len(q)) + layout.in_bodies(j, effects) for j in range(n)], 1)
    return [joined[0][j] for j in range(n)], held, others


def _key(effect: Effect, layout: Layout, assignment: Assignment) -> Hashable | None:
    """What columns of an effect depend on; None if on more than the motion of its joints."""
    if not effect.depends_on <= {"q", "v", "vd"} or not set(effect.where) <= set(
        layout.model.joints
    ):
        return None
    at = [layout.model.joints.index(joint) for joint in effect.where]
    motion = assignment.position[at], assignment.scale[at], assignment.zero[at]
    return (effect, *(values.tobytes() for values in motion), assignment.time)


def _errors_of(
    samples: ColumnSamples, model: RobotModel, assignment: Assignment, *, slopes: bool
) -> tuple[Array, Array]:
    """Slopes (N, n, 2) of the efforts with a tilt of the base, and (N, n, n) with the zeros."""
    q, v, vd = joint_motion(samples, assignment)
    at, still = model.positions(q), np.zeros_like(v)
    turned = np.zeros((*v.shape, v.shape[1]))
    tree = model.tree
    if assignment.gravity is not None:
        tree = with_gravity(tree, np.array(assignment.gravity))
    if slopes:
        turned = np.nan_to_num(effort_slopes(tree, at, v, vd, model.total_phi).position)
    if not assignment.level:
        bodies = RobotBodies(tree, at, model.total_phi)
        return bodies.gravity_efforts(np.cross(bodies.gravity, np.eye(3)[:2]).T), turned
    if slopes:
        held = effort_slopes(tree, at, still, still, model.total_phi).position
        turned = turned - np.nan_to_num(held)
    return np.zeros((*v.shape, 2)), turned


def _local(model: RobotModel, layout: Layout, joint: int) -> Array:
    """The inertial parameters that a joint has columns of."""
    columns = layout.columns[joint]
    return model.total_phi.ravel()[columns[columns < model.phi.size]]


def _reduced(samples: ColumnSamples, columns: Indices, X: Array, position: int) -> JointDesign:
    rows = np.flatnonzero(samples.used[:, position])
    X = X[rows]
    peak = np.abs(X[:, : len(columns)]).max(axis=0)
    return JointDesign(columns, rows, X, _grams(X, samples.fold[rows], samples.folds), peak)


def _grams(X: Array, fold: Indices, folds: int) -> Array:
    """(F, m, m) normal matrices of rows (K, m) of F folds."""
    parts = [X[fold == f] for f in range(folds)]
    return np.stack([part.T @ part for part in parts])


def nuisance_information(
    parameters: Parameters, designs: tuple[JointDesign, ...], sizes: Array
) -> Array:
    """(p,) information of effects that the model lacks: none needs more than `LARGEST` efforts.

    Args:
        parameters: What fits may move.
        designs: Of all joints.
        sizes: (n,) deviations of the efforts.
    """
    information = np.zeros(len(parameters.mean))
    for design, size in zip(designs, sizes, strict=True):
        at = np.searchsorted(
            design.columns, np.arange(parameters.nuisance.start, parameters.nuisance.stop)
        )
        for place, column in zip(
            at.tolist(), range(parameters.nuisance.start, parameters.nuisance.stop), strict=True
        ):
            if place < len(design.columns) and design.columns[place] == column:
                information[column] += (design.peak[place] / (LARGEST * size)) ** 2
    return information
