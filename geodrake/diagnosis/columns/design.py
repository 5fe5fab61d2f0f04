"""The linear model of the efforts for one motion of the joints, as normal matrices."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.samples import ColumnSamples
from geodrake.diagnosis.unknown_efforts import UnknownFunction
from geodrake.effects import catalogue
from geodrake.effects.base import Effect, JointMotion
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.role import Role
from geodrake.identification.logs.criteria import SPREAD
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

UNKNOWN = len(UnknownFunction.parameters)
"""Columns of an unknown function of a joint's motion."""

EffectRows = dict[Hashable, Mapping[int, Array]]
"""Columns (N, ·) of effects, by the effect and what they depend on, and by joint."""


@dataclass(frozen=True, eq=False)
class Parameters:
    """What fits may move: bodies, effects, tilt, small errors of zeros and gains, functions.

    Attributes:
        model: The model.
        layout: Columns of bodies and effects at each joint.
        mean: (p,) prior mean.
        information: (p, p) prior information; that of what the model lacks depends on efforts.
        lower: (p,) lower bounds.
    """

    model: RobotModel
    layout: Layout
    mean: Array
    information: Array
    lower: Array

    @classmethod
    def of(cls, samples: ColumnSamples) -> Parameters:
        """Return the parameters of a model and of what any joint may have beside it."""
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
        first = len(known) + sum(len(effect.parameters) for effect in more)
        p = first + 2 + n * (2 + UNKNOWN)
        information, mean, lower = np.zeros((p, p)), np.zeros(p), np.full(p, -np.inf)
        information[: len(known), : len(known)] = known
        mean[: len(known)] = np.concatenate([model.total_phi.ravel(), *(f.parameters for f in own)])
        gains = np.maximum(samples.gain_deviations, 1e-3)
        usual = np.concatenate([np.full(2, USUAL_TILT), np.full(n, USUAL_ZERO), gains]) ** -2.0
        errors = np.arange(first, first + 2 + 2 * n)
        information[errors, errors] = usual
        lower[model.phi.size : first] = [q.lower for effect in effects for q in effect.parameters]
        return cls(model, layout, mean, information, lower)

    @property
    def shared(self) -> int:
        """Return the number of the parameters of bodies and effects."""
        return len(self.mean) - 2 - (2 + UNKNOWN) * len(self.model.joints)

    @cached_property
    def lacking(self) -> slice:
        """Return the parameters of effects that the model lacks."""
        return slice(len(_information(self.model)), self.shared)

    def tilt(self) -> Indices:
        """(2,) those of the base's tilt."""
        return self.shared + np.arange(2)

    def zeros(self) -> Indices:
        """(n,) errors of the positions' zeros."""
        return self.shared + 2 + np.arange(len(self.model.joints))

    def gains(self) -> Indices:
        """(n,) logarithms of the errors of the efforts' gains."""
        return self.zeros() + len(self.model.joints)

    def unknown(self, joint: int) -> Indices:
        """(11,) those of the unknown function of a joint's motion."""
        return self.gains()[-1] + 1 + UNKNOWN * joint + np.arange(UNKNOWN)

    def taken_out(self, names: frozenset[str]) -> Indices:
        """Parameters of the effects of some names of `Effect.taken_out_as`."""
        at, found = self.model.phi.size, list[int]()
        for effect in self.layout.effects:
            here = range(at, at + len(effect.parameters))
            found += here if effect.taken_out_as in names else ()
            at += len(effect.parameters)
        return np.array(found, int)

    @property
    def can_be_taken_out(self) -> tuple[str, ...]:
        """Names of `Effect.taken_out_as` of which the model states something."""
        stated = [f.effect for f in self.model.effects if np.any(f.parameters)]
        return tuple(sorted({e.taken_out_as for e in stated if e.taken_out_as}))


def _is_seen(effect: Effect) -> bool:
    """Return whether an effect's columns need no samples that follow each other."""
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
        X: (K, m + 1 + n) their columns, known payloads' efforts, and all columns of efforts.
        gram: (m + 1 + n, m + 1 + n) normal matrix of X.
        peak: (m,) largest entry of each column.
        beyond: Share of the samples in which more effort was asked for than the motor gives, and
            the mean square of what was too much.
    """

    columns: Indices
    rows: Indices
    X: Array
    gram: Array
    peak: Array
    beyond: tuple[float, float] = (0.0, 1.0)

    def place_of(self, source: int) -> int:
        """Return where a column of efforts stands in X."""
        return len(self.columns) + 1 + int(source)

    def asked(
        self, samples: ColumnSamples, assignment: Assignment, joint: int
    ) -> tuple[Array, Array]:
        """Return efforts (K,) of the log at the joint, and velocities (K,)."""
        velocity = samples.v[self.rows, assignment.position[joint]] * assignment.scale[joint]
        effort = self.X[:, self.place_of(assignment.effort[joint])]
        return assignment.gain[joint] * effort, velocity / assignment.time

    def read_as(self, samples: ColumnSamples, assignment: Assignment, joint: int) -> JointDesign:
        """Return the design with the joint's efforts signed, or kept to what its motor gives."""
        source, found = int(assignment.effort[joint]), self
        if source in assignment.signs:
            effort = samples.effort[self.rows, source] * assignment.signs[source][self.rows]
            found = found._with_effort(source, effort)
        if source in assignment.limits:
            (asked, velocity), limit = (
                found.asked(samples, assignment, joint),
                assignment.limit_of(joint),
            )
            given = limit.given(asked, velocity) / assignment.gain[joint]
            found = replace(found._with_effort(source, given), beyond=limit.beyond(asked, velocity))
        return found

    def _with_effort(self, source: int, effort: Array) -> JointDesign:
        X, column = self.X.copy(), self.place_of(source)
        X[:, column] = effort
        gram, changed = self.gram.copy(), X.T @ effort
        gram[column], gram[:, column] = changed, changed
        return replace(self, X=X, gram=gram)


def joint_motion(samples: ColumnSamples, assignment: Assignment) -> tuple[Array, Array, Array]:
    """Return (N, n) positions, velocities and accelerations of the joints by an assignment."""
    at, scale, time = assignment.position, assignment.scale, assignment.time
    q = samples.q[:, at] * scale + assignment.zero
    return q, samples.v[:, at] * scale / time, samples.vd[:, at] * scale / time**2


def joint_designs(
    samples: ColumnSamples, parameters: Parameters, assignment: Assignment, known: EffectRows
) -> tuple[JointDesign, ...]:
    """Return the designs of all joints for one motion."""
    model = parameters.model
    width = parameters.layout.sign_width[assignment.position]
    width = width * np.abs(assignment.scale) / assignment.time
    layout = replace(parameters.layout, sign_width=width)
    inertial, held, others = _columns_of(samples, layout, assignment, known)
    tilts, turned = _errors_of(samples, model, assignment)
    more = _further_weight(samples, model, assignment)
    q, v, _ = joint_motion(samples, assignment)
    further = np.concatenate([parameters.tilt(), parameters.zeros()])
    designs = []
    for j in range(len(model.joints)):
        columns, own = layout.columns[j], inertial[j]
        if more is not None:
            own = own + more[:, j, columns[columns < model.phi.size]]
        effects = [part[j] for part in others if j in part]
        rows = np.flatnonzero(samples.used[:, assignment.position[j]])
        unknown = _unknown_function(model.joints[j], q[rows, j], v[rows, j], width[j])
        parts = (own, *effects, tilts[:, j], turned[:, j])
        after = held[rows, j], samples.effort[rows]
        X = np.column_stack([*(part[rows] for part in parts), unknown, *after])
        columns = np.concatenate([columns, further, parameters.unknown(j)])
        peak = np.abs(X[:, : len(columns)]).max(axis=0)
        designs.append(JointDesign(columns, rows, X, X.T @ X, peak))
    return tuple(designs)


def _unknown_function(joint: str, q: Array, v: Array, width: float) -> Array:
    """(K, 11) columns of a smooth function of a joint's motion, none larger than about one."""
    reach = max(0.5 * float(np.ptp(q)), 1e-300)
    speed = max(float(np.abs(v).max()), 1e-300)
    function = UnknownFunction(joint, 0.5 * float(q.max() + q.min()), reach, speed)
    sign = np.tanh(v / max(float(width), 1e-300))
    return np.column_stack(
        function.columns(JointMotion(q, v, np.zeros_like(v), np.zeros_like(v), sign))
    )


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
    samples: ColumnSamples, model: RobotModel, assignment: Assignment
) -> tuple[Array, Array]:
    """Slopes (N, n, 2) of the efforts with a tilt of the base, and (N, n, n) with the zeros."""
    q, v, vd = joint_motion(samples, assignment)
    at, still, tree = model.positions(q), np.zeros_like(v), model.tree
    if assignment.gravity is not None:
        tree = with_gravity(tree, np.array(assignment.gravity))
    turned = np.nan_to_num(effort_slopes(tree, at, v, vd, model.total_phi).position)
    if assignment.level:
        held = effort_slopes(tree, at, still, still, model.total_phi).position
        return np.zeros((*v.shape, 2)), turned - np.nan_to_num(held)
    bodies = RobotBodies(tree, at, model.total_phi)
    return bodies.gravity_efforts(np.cross(bodies.gravity, np.eye(3)[:2]).T), turned


def _local(model: RobotModel, layout: Layout, joint: int) -> Array:
    """The inertial parameters that a joint has columns of."""
    columns = layout.columns[joint]
    return model.total_phi.ravel()[columns[columns < model.phi.size]]
