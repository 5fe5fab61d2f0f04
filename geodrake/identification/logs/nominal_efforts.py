"""What efforts of joints could show: what errors are measured by, and joints are counted by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.identification.logs.dataset import JointData
from geodrake.logs.motion import Trajectory
from geodrake.logs.resting import resting
from geodrake.model.robot_model import RobotModel
from geodrake.robot.driven_tree import RobotTree, with_gravity
from geodrake.robot.regressor import inverse_dynamics, inverse_dynamics_regressor

Array = NDArray[np.float64]

_SAMPLES = 100_000  # of a segment that are looked at
_POSES = 50  # of each segment, at which gravity is looked at


def effort_scale(
    model: RobotModel,
    tree: RobotTree,
    trajectories: Sequence[Trajectory],
    data: Sequence[JointData],
    deviation: Array,
) -> Array:
    """Return (nv,) what each joint's effort could show, N·m or N.

    That is the `deviation` of its effort, if it moves. The effort of a joint at rest, or without a
    motor, deviates by next to nothing, and is no measure of an error: there it is the effort that
    it holds, or that by which gravity could load it if the robot stood on its side, whichever is
    larger.
    """
    still = _at_rest(model, data) | (deviation == 0.0)
    if not still.any():
        return deviation
    power = np.array([joint.effort_sums[:, 1].sum() for joint in data])
    count = np.maximum([joint.samples.sum() for joint in data], 1)
    held = np.maximum(np.sqrt(power / count), _load_by_gravity(model, tree, trajectories))
    return np.where(still, held, deviation)


def _at_rest(model: RobotModel, data: Sequence[JointData]) -> NDArray[np.bool_]:
    """(nv,) which joints of one degree of freedom hardly move."""
    low, high = np.full((2, len(data)), np.nan)
    for joint in model.single_joints:
        j = model.joints.index(joint)
        own = [rows.motion[:, 0] for fold in data[j].rows for rows in fold if len(rows.motion)]
        if own:
            low[j], high[j] = min(q.min() for q in own), max(q.max() for q in own)
    return resting(low, high, np.isin(model.joints, model.sliding_joints))


def passive_inertia(
    model: RobotModel, tree: RobotTree, trajectories: Sequence[Trajectory]
) -> Array | None:
    """Return `Dataset.passive_inertia`, the mean over poses of the logs."""
    passive = {joint for trajectory in trajectories for joint in trajectory.passive}
    if not passive:
        return None
    q, found = _poses(model, trajectories), np.zeros((len(model.joints), model.phi.size))
    still, weightless = np.zeros((len(q), len(model.joints))), with_gravity(tree, np.zeros(3))
    for joint in passive:
        j, vd = model.joints.index(joint), still.copy()
        vd[:, j] = 1.0
        columns = inverse_dynamics_regressor(weightless, q, still, vd)[:, j]
        inertia = columns @ model.total_phi.ravel()
        found[j] = (columns / np.maximum(inertia, np.finfo(float).tiny)[:, None]).mean(axis=0)
    return found


def _poses(model: RobotModel, trajectories: Sequence[Trajectory]) -> Array:
    """(K, nq) positions of the model at instants of the logs."""
    segments = [segment for trajectory in trajectories for segment in trajectory.segments]
    starts = [segment[:_SAMPLES].position for segment in segments]
    positions = [start[:: max(1, len(start) // _POSES)] for start in starts]
    return model.positions(np.concatenate(positions))


def _load_by_gravity(
    model: RobotModel, tree: RobotTree, trajectories: Sequence[Trajectory]
) -> Array:
    """(nv,) RMS of the loads by gravity from three sides, N·m or N."""
    q = _poses(model, trajectories)
    zero = np.zeros((len(q), len(model.joints)))
    power, g = np.zeros(len(model.joints)), float(np.linalg.norm(tree.gravity))
    for side in g * np.eye(3):
        load = inverse_dynamics(with_gravity(tree, side), q, zero, zero, model.total_phi)
        power += np.square(load).mean(axis=0)
    return np.sqrt(power)
