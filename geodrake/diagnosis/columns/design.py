"""The linear model of one joint's efforts, as normal matrices of its columns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.samples import ColumnSamples
from geodrake.diagnosis.unknown_efforts import UnknownFunction
from geodrake.effects.base import Effect, JointMotion
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.episode import Episode
from geodrake.identification.logs.log_slices import Layout
from geodrake.logs.motion import Motion
from geodrake.robot.effort_slopes import effort_slopes
from geodrake.robot.regressor import inverse_dynamics_regressor

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

UNKNOWN = len(UnknownFunction.parameters)
"""Columns of an unknown function of a joint's motion."""


@dataclass(frozen=True, eq=False)
class JointDesign:
    """Columns and efforts of K samples of one joint.

    Columns are those of bodies and effects, the slopes with a tilt (2) and with all zeros (n), the
    efforts of known payloads, all n columns of efforts, and those of an unknown function if asked.
    """

    columns: Indices  # (m,) bodies and effects that matter
    rows: Indices  # (K,) samples
    joints: int
    X: Array  # (K, m + 2 + n + 1 + n), or as many as UNKNOWN more
    gram: Array  # normal matrix of X
    # Share of the samples in which more effort was asked for than the motor gives, and the mean
    # square of what was too much.
    beyond: tuple[float, float] = (0.0, 1.0)

    @cached_property
    def peaks(self) -> Array:
        """(m,) largest sizes of the columns of bodies and effects."""
        return np.asarray(np.abs(self.X[:, : len(self.columns)]).max(axis=0))

    @property
    def linear(self) -> int:
        """Return how many columns come before those of efforts."""
        return len(self.columns) + 2 + self.joints

    @property
    def unknown(self) -> Indices:
        """Return where the columns of the unknown function stand in X."""
        return self.effort(self.joints) + np.arange(UNKNOWN)

    def effort(self, source: int) -> int:
        """Return where a column of efforts stands in X; before the first one are payloads."""
        return self.linear + 1 + source

    def read_as(self, samples: ColumnSamples, assignment: Assignment, joint: int) -> JointDesign:
        """Return the design with the joint's efforts signed, or kept to what its motor gives."""
        source, limit = int(assignment.effort[joint]), assignment.limit_of(joint)
        signs, beyond = assignment.signs.get(source), self.beyond
        if signs is None and limit is None:
            return self
        effort = samples.effort[self.rows, source]
        if signs is not None:
            effort = effort * signs[self.rows]
        if limit is not None:
            gain, velocity = assignment.gain[joint], samples.motion(assignment, self.rows)[1]
            asked, velocity = gain * effort, velocity[:, joint]
            effort, beyond = limit.given(asked, velocity) / gain, limit.beyond(asked, velocity)
        X, gram, column = self.X.copy(), self.gram.copy(), self.effort(source)
        X[:, column] = effort
        gram[column] = gram[:, column] = X.T @ effort
        return replace(self, X=X, gram=gram, beyond=beyond)


class MotionDesigns:
    """Designs of all joints for one motion, each with any column of efforts.

    Data are the samples of a column of efforts in which the joint that it is named after moves,
    whatever else it is taken for: what is judged by other samples cannot be compared.
    """

    def __init__(self, samples: ColumnSamples, layout: Layout, assignment: Assignment) -> None:
        self._samples, self._layout, self._assignment = samples, layout, assignment
        self._all = _joint_columns(samples, layout, assignment)
        self._made = dict[tuple[int, int, bool], JointDesign]()
        self.nbytes = sum(part.nbytes for own in self._all for part in own)

    def __call__(self, joint: int, source: int, *, unknown: bool) -> JointDesign:
        """Return the design of a joint with the samples of a column of efforts.

        It may have an unknown function of the joint's motion.
        """
        key, samples = (joint, source, unknown), self._samples
        if key not in self._made:
            rows, columns = np.flatnonzero(samples.used[:, source]), self._layout.columns[joint]
            parts = [*self._all[joint], samples.effort]
            if unknown:
                q, v, _ = samples.motion(self._assignment)
                width = _sign_width(self._layout, self._assignment)[joint]
                own = _unknown_function(
                    samples.model.joints[joint], q[:, joint], v[:, joint], width
                )
                parts.append(own)
            X = np.concatenate([part[rows] for part in parts], axis=1)
            self.nbytes += X.nbytes
            self._made[key] = JointDesign(columns, rows, len(self._all), X, X.T @ X)
        return self._made[key]


def _sign_width(layout: Layout, assignment: Assignment) -> Array:
    """Return speeds (n,) below which a motion has no direction."""
    scale = np.abs(assignment.scale) / assignment.time
    return np.asarray(layout.sign_width[assignment.position] * scale)


def _joint_columns(
    samples: ColumnSamples, layout: Layout, assignment: Assignment
) -> list[list[Array]]:
    """Return the columns of all joints for one motion, in all samples and in parts."""
    model, (q, v, vd) = layout.model, samples.motion(assignment)
    at, down = model.positions(q), np.array(assignment.gravity or model.tree.gravity)
    tree = replace(model.tree, gravity=down)
    width = _sign_width(layout, assignment)
    columns, held = _columns(samples, replace(layout, sign_width=width), (at, v, vd))
    if assignment.gravity is not None:  # weight beside that which the model's bodies have
        still, more = np.zeros_like(v), replace(model.tree, gravity=down - model.tree.gravity)
        weight = inverse_dynamics_regressor(more, at, still, still)
        for j, seen in enumerate(layout.columns):
            columns[j][0] = columns[j][0] + weight[:, j, seen[seen < model.phi.size]]
    tilts = RobotBodies(tree, at, model.total_phi).gravity_efforts(np.cross(down, np.eye(3)[:2]).T)
    slopes = effort_slopes(tree, at, v, vd, model.total_phi, only_position=True)
    turned = np.nan_to_num(slopes.position)
    return [
        [*columns[j], tilts[:, j], turned[:, j], held[:, j, None]] for j in range(len(model.joints))
    ]


def _columns(
    samples: ColumnSamples, layout: Layout, motion: tuple[Array, Array, Array]
) -> tuple[list[list[Array]], Array]:
    """Per joint (N, ·) columns of bodies and effects, and (N, n) efforts of known payloads."""
    model, columns = layout.model, list[list[list[Array]]]()
    phi, held = model.total_phi.ravel(), np.empty_like(motion[1])
    trajectories, logs = samples.trajectories, samples.log
    timed = any(isinstance(effect, Episode) for effect in layout.effects)
    if len({t.payloads for t in trajectories}) == 1 and not timed:
        trajectories, logs = trajectories[:1], np.zeros_like(logs)  # all logs are alike
    for k, trajectory in enumerate(trajectories):
        here = logs == k
        q, v, vd = (own[here] for own in motion)
        seen = Motion(q, v, vd, np.zeros(len(q)))
        found, held[here] = layout.evaluate(seen, trajectory, layout.parts)
        effects = {e: f for e, f in zip(layout.parts, found, strict=True) if isinstance(e, Effect)}
        for j, own in enumerate(layout.columns):
            in_bodies = layout.in_bodies(j, effects)
            held[here, j] -= found[0][j] @ phi[own[own < len(phi)]] + in_bodies
        columns.append([[p[j] for p in found if j in p] for j in range(held.shape[1])])
    if len(columns) == 1:
        return columns[0], held
    joints = zip(*columns, strict=True)
    return [[np.concatenate(part) for part in zip(*own, strict=True)] for own in joints], held


def _unknown_function(joint: str, q: Array, v: Array, width: float) -> Array:
    """Return (K, UNKNOWN) columns of a smooth function of a joint's motion, at most about 1."""
    reach, speed = 0.5 * float(np.ptp(q)), float(np.abs(v).max())
    middle = 0.5 * float(q.max() + q.min())
    function = UnknownFunction(joint, middle, max(reach, 1e-300), max(speed, 1e-300))
    sign, none = np.tanh(v / max(width, 1e-300)), np.zeros_like(v)
    return np.stack(function.columns(JointMotion(q, v, none, none, sign)), -1)
