"""Linear model of one joint's efforts, as the normal matrix of its columns."""

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
"""Number of columns of an unknown function of a joint's motion."""


@dataclass(frozen=True, eq=False)
class JointDesign:
    """Columns of one joint's linear model over K samples.

    X contains the columns of bodies and effects, the slopes by a tilt (2) and by all zeros (n), the
    known payload efforts (1), all effort columns (n), and optionally an unknown function.
    """

    columns: Indices  # (m,) bodies and effects that affect the joint
    rows: Indices  # (K,) samples
    joints: int
    X: Array  # (K, m + 2 + n + 1 + n), plus UNKNOWN columns of an unknown function
    gram: Array  # normal matrix of X
    # Share of samples whose commanded effort exceeds the motor limit, and the mean square excess.
    beyond: tuple[float, float] = (0.0, 1.0)

    @cached_property
    def peaks(self) -> Array:
        """(m,) largest magnitudes of the columns of bodies and effects."""
        return np.asarray(np.abs(self.X[:, : len(self.columns)]).max(axis=0))

    @property
    def linear(self) -> int:
        """Return the number of columns of bodies, effects, tilt and zeros."""
        return len(self.columns) + 2 + self.joints

    @property
    def unknown(self) -> Indices:
        """Return the indices in X of the columns of the unknown function."""
        return self.effort(self.joints) + np.arange(UNKNOWN)

    def effort(self, source: int) -> int:
        """Return the index in X of an effort column; the known payloads are at `effort(-1)`."""
        return self.linear + 1 + source

    def read_as(self, samples: ColumnSamples, assignment: Assignment, joint: int) -> JointDesign:
        """Return the design with an assignment's signs and motor limit applied to the efforts."""
        source, limit = int(assignment.effort[joint]), assignment.limit_of(joint)
        signs, beyond = assignment.signs.get(source), self.beyond
        if signs is None and limit is None:
            return self
        effort = samples.effort[self.rows, source]
        if signs is not None:
            effort = effort * signs[self.rows]
        if limit is not None:
            gain, velocity = assignment.gain[joint], samples.motion(assignment, self.rows)[1]
            command, velocity = gain * effort, velocity[:, joint]
            effort, beyond = limit.given(command, velocity) / gain, limit.beyond(command, velocity)
        X, gram, column = self.X.copy(), self.gram.copy(), self.effort(source)
        X[:, column] = effort
        gram[column] = gram[:, column] = X.T @ effort
        return replace(self, X=X, gram=gram, beyond=beyond)


class MotionDesigns:
    """Designs of all joints for one motion, each with any column of efforts.

    The samples depend on the effort column only: those in which the joint that it is named after
    moves one way. Scores of different assignments are comparable only on the same samples.
    """

    def __init__(self, samples: ColumnSamples, layout: Layout, assignment: Assignment) -> None:
        self._samples, self._layout, self._assignment = samples, layout, assignment
        self._parts = _joint_columns(samples, layout, assignment)
        self._designs = dict[tuple[int, int, bool], JointDesign]()
        self.nbytes = sum(part.nbytes for parts in self._parts for part in parts)

    def __call__(self, joint: int, source: int, *, unknown: bool) -> JointDesign:
        """Return the design of a joint with the samples of an effort column.

        `unknown` adds the columns of an unknown function of the joint's motion.
        """
        key, samples = (joint, source, unknown), self._samples
        if key not in self._designs:
            rows, columns = np.flatnonzero(samples.used[:, source]), self._layout.columns[joint]
            parts = [*self._parts[joint], samples.effort]
            if unknown:
                q, v, _ = samples.motion(self._assignment)
                width = _sign_width(self._layout, self._assignment)[joint]
                function = _unknown_function(
                    samples.model.joints[joint], q[:, joint], v[:, joint], width
                )
                parts.append(function)
            X = np.concatenate([part[rows] for part in parts], axis=1)
            self.nbytes += X.nbytes
            self._designs[key] = JointDesign(columns, rows, len(self._parts), X, X.T @ X)
        return self._designs[key]


def _sign_width(layout: Layout, assignment: Assignment) -> Array:
    """Return the speeds (n,) below which the direction of motion is unknown."""
    scale = np.abs(assignment.scale) / assignment.time
    return np.asarray(layout.sign_width[assignment.position] * scale)


def _joint_columns(
    samples: ColumnSamples, layout: Layout, assignment: Assignment
) -> list[list[Array]]:
    """Return the columns of all joints for one motion at all samples, as a list of parts."""
    model, (q, v, vd) = layout.model, samples.motion(assignment)
    at, gravity = model.positions(q), np.array(assignment.gravity or model.tree.gravity)
    tree = replace(model.tree, gravity=gravity)
    width = _sign_width(layout, assignment)
    columns, loads = _columns(samples, replace(layout, sign_width=width), (at, v, vd))
    if assignment.gravity is not None:  # weight by the difference of gravity
        zero, added = np.zeros_like(v), replace(model.tree, gravity=gravity - model.tree.gravity)
        weight = inverse_dynamics_regressor(added, at, zero, zero)
        for j, indices in enumerate(layout.columns):
            columns[j][0] = columns[j][0] + weight[:, j, indices[indices < model.phi.size]]
    axes = np.cross(gravity, np.eye(3)[:2]).T
    tilts = RobotBodies(tree, at, model.total_phi).gravity_efforts(axes)
    slopes = effort_slopes(tree, at, v, vd, model.total_phi, only_position=True)
    zeros = np.nan_to_num(slopes.position)
    return [
        [*columns[j], tilts[:, j], zeros[:, j], loads[:, j, None]] for j in range(len(model.joints))
    ]


def _columns(
    samples: ColumnSamples, layout: Layout, motion: tuple[Array, Array, Array]
) -> tuple[list[list[Array]], Array]:
    """Return per joint (N, ·) columns of bodies and effects, and (N, n) known payload efforts."""
    model, columns = layout.model, list[list[list[Array]]]()
    phi, loads = model.total_phi.ravel(), np.empty_like(motion[1])
    trajectories, logs = samples.trajectories, samples.log
    timed = any(isinstance(effect, Episode) for effect in layout.effects)
    if len({t.payloads for t in trajectories}) == 1 and not timed:
        trajectories, logs = trajectories[:1], np.zeros_like(logs)  # all logs are alike
    for k, trajectory in enumerate(trajectories):
        rows = logs == k
        q, v, vd = (values[rows] for values in motion)
        motions = Motion(q, v, vd, np.zeros(len(q)))
        parts, loads[rows] = layout.evaluate(motions, trajectory, layout.parts)
        effects = {e: f for e, f in zip(layout.parts, parts, strict=True) if isinstance(e, Effect)}
        for j, indices in enumerate(layout.columns):
            known = layout.in_bodies(j, effects)
            loads[rows, j] -= parts[0][j] @ phi[indices[indices < len(phi)]] + known
        columns.append([[p[j] for p in parts if j in p] for j in range(loads.shape[1])])
    if len(columns) == 1:
        return columns[0], loads
    joints = zip(*columns, strict=True)
    return [[np.concatenate(part) for part in zip(*logs, strict=True)] for logs in joints], loads


def _unknown_function(joint: str, q: Array, v: Array, width: float) -> Array:
    """Return (K, UNKNOWN) columns of a smooth function of a joint's motion, at most about 1."""
    reach, speed = 0.5 * float(np.ptp(q)), float(np.abs(v).max())
    middle = 0.5 * float(q.max() + q.min())
    function = UnknownFunction(joint, middle, max(reach, 1e-300), max(speed, 1e-300))
    sign, zero = np.tanh(v / max(width, 1e-300)), np.zeros_like(v)
    return np.stack(function.columns(JointMotion(q, v, zero, zero, sign)), -1)
