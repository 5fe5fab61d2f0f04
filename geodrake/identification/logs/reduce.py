"""Reduce prepared logs to a `Dataset`, chunk by chunk, in constant memory."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.effects.base import Effect
from geodrake.errors import LogError
from geodrake.identification.logs.dataset import Dataset, Indices, JointData, JointRows
from geodrake.identification.logs.log_slices import Layout, LogSlice, RowCache
from geodrake.identification.logs.noise import known_noise
from geodrake.identification.logs.unknowns import payload_reference
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.logs.folds import Block, Fold
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.motion import Trajectory
from geodrake.logs.resting import resting
from geodrake.logs.smoothing import CHUNK
from geodrake.model.carried_payloads import joints_with_known_gain
from geodrake.model.robot_model import LARGEST_REGRESSOR, RobotModel
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.reduction import triangular_factor
from geodrake.robot.regressor import inverse_dynamics, inverse_dynamics_regressor

Array = NDArray[np.float64]
Noise = tuple[Array, NDArray[np.bool_] | bool, Array | float]

LEAST_SIGN_WIDTH = 0.002  # speed of unknown direction, relative to the peak speed
SIGN_NOISE = 1.2  # the same, in standard deviations σ of the speed: E sgn ≈ tanh(v/1.2σ)
AT_REST = 8.0  # peak speed of a joint that never moves, in standard deviations of its noise
LEAST_SPEED = 1e-4  # the same, relative to the fastest joint's
STILL_SPEED, STILL_NOISE = 0.01, 2.0  # speed at rest, relative to the peak speed and to its noise
_AT_ONCE = 0.1  # least common motion, relative to the motion of the joint that moves less
_ALIKE = 0.1  # largest sine of the angle between speeds of joints that move alike
WORTHWHILE = 20  # pending rows per column before they are reduced
LEAST_DEVIATION = 1e-7  # rounding error of a constant effort, relative to its RMS
ROWS_KEPT = 4_000  # filtered rows kept of each fold and joint, for autocorrelations and figures


def reduce_logs(
    model: RobotModel,
    trajectories: Sequence[Trajectory],
    folds: Sequence[Fold],
    *,
    effects: Sequence[Effect],
    delays: Sequence[ArrayLike] = (0.0,),
    noise: Noise | None = None,
    fitted: bool = False,
    shared: RowCache | None = None,
) -> Dataset:
    """Reduce logs to the triangular factors of every fold and joint.

    The model provides the loads, and delays that shift the efforts. `effects` are those with
    columns, fitted or candidates. Candidate `delays` beyond the model's, s, are for all joints or
    (nv,) for each; the first must be 0. `noise` is the result of `known_noise`; by default it is
    computed, for a model that may have been `fitted` to these logs. `shared` is the cache of
    reductions of the same logs and robot.

    Raises:
        LogError: The effort of a joint never changes, or a joint moves only for a moment.
    """
    effects = tuple(e for e in dict.fromkeys(effects) if e.parameters)
    still = still_speeds(trajectories)
    still[np.isin(model.joints, model.base_joints)] = 0.0
    widths = sign_widths(model, trajectories)
    shared = RowCache(0) if shared is None else shared
    shared.begin()
    empty = Layout(model, (), widths, still, (np.zeros(0, np.intp),) * len(model.joints))
    coupling = coupling_of(empty, trajectories, shared)
    layout = Layout.of(model, effects, widths, still, coupling=coupling, shared=shared)
    noise = noise or known_noise(trajectories, model, sign_width=widths, fitted=fitted)
    dataset = reduce_over(layout, trajectories, folds, delays=delays, noise=noise, shared=shared)
    for joint, moves in zip(model.joints, dataset.has_rows, strict=True):
        if not moves and coupling is None:
            raise LogError(
                f"{joint} moves only for a moment: no filtered sample has it moving for most "
                "of the filter's window.",
                advice="Record a log in which it moves, or always rests. Did its sensor jump?",
                joint=joint,
            )
    return dataset


def reduce_over(
    layout: Layout,
    trajectories: Sequence[Trajectory],
    folds: Sequence[Fold],
    *,
    delays: Sequence[ArrayLike],
    noise: Noise,
    shared: RowCache | None = None,
) -> Dataset:
    """Reduce logs to the columns of a layout; a joint may rest throughout. See `reduce_logs`."""
    model = layout.model
    further = np.array([np.broadcast_to(delay, len(model.joints)) for delay in delays])
    data = reduced_joints(layout, trajectories, folds, list(further + model.delays), shared)
    passive = {joint for trajectory in trajectories for joint in trajectory.passive}
    deviation = effort_deviation(model.joints, data, {*passive, *model.base_joints})
    floor, known, of_motion = noise
    return Dataset(
        model.joints,
        model.bodies,
        layout.effects,
        further,
        tuple(fold.name for fold in folds),
        tuple(trajectory.name for trajectory in trajectories),
        data,
        effort_scale(model, layout.tree, trajectories, data, deviation),
        floor,
        trajectories[0].filter.bandwidth,
        np.array([joint.still for joint in data]),
        payload_reference(model.phi),
        gain_uncertainty(
            model,
            [t.payloads for t in trajectories],
            [t.gain_deviations for t in trajectories],
            [frame for t in trajectories for frame in t.ground_frames],
        ),
        known,
        of_motion,
        passive_inertia(model, layout.tree, trajectories),
        is_mixed=layout.coupling is not None,
    )


def coupling_of(
    layout: Layout, trajectories: Sequence[Trajectory], shared: RowCache
) -> NDArray[np.bool_] | None:
    """Return whether a row includes a velocity (nv, nv), in any slice of any log.

    Return None if all contact forces and efforts are known.
    """
    if not any(trajectory.has_unknown_forces for trajectory in trajectories):
        return None

    def make() -> dict[int, Array]:
        coupling = np.eye(len(layout.columns), dtype=bool)
        for k, trajectory in enumerate(trajectories):
            for i in range(len(trajectory.segments)):
                for _, part in _slices(layout, trajectories, (k, i), ()):
                    if (rows := part.contact_rows(shared)) is not None:
                        coupling |= rows.coupling
        return {0: coupling.astype(float)}

    return np.asarray(shared.once(("coupling",), make)[0] > 0.0)


def reduced_joints(
    layout: Layout,
    trajectories: Sequence[Trajectory],
    folds: Sequence[Fold],
    advance: Sequence[Array],
    shared: RowCache | None = None,
) -> tuple[JointData, ...]:
    """Return the reduced data of every joint, with the columns of a layout; see `reduce_logs`.

    A joint may rest throughout. `advance` are the delays (nv,) of the logged efforts, s, for each
    column of efforts.
    """
    shared = RowCache(0) if shared is None else shared
    builders = [[_FactorBuilder(len(c) + len(advance)) for _ in folds] for c in layout.columns]
    members: dict[tuple[int, int], list[tuple[int, Block]]] = defaultdict(list)
    for f, fold in enumerate(folds):
        for block in fold.blocks:
            members[block.trajectory, block.segment].append((f, block))
    for at, blocks in sorted(members.items()):
        for first, part in _slices(layout, trajectories, at, advance):
            chunk = part.rows(shared)
            for f, block in blocks:
                low, high = max(block.start - first, 0), min(block.stop - first, part.count)
                if low < high:
                    for j, rows in enumerate(chunk):
                        builders[j][f].seen += high - low
                        builders[j][f].add(block, rows.part(low, high))
    return tuple(map(_joint_data, layout.columns, builders))


def _joint_data(columns: Indices, folds: Sequence[_FactorBuilder]) -> JointData:
    rows = tuple(tuple(map(JointRows.join, fold.kept.values())) for fold in folds)
    peaks = [np.abs(block.A).max(axis=0) for fold in rows for block in fold if len(block.A)]
    return JointData(
        columns,
        _stacked([fold.whole_factor() for fold in folds]),
        np.array([fold.samples for fold in folds]),
        rows,
        np.array([fold.carried[: len(columns)] for fold in folds]),
        np.array([fold.seen for fold in folds]),
        np.array([fold.sums for fold in folds]),
        np.max([np.zeros(len(columns)), *peaks], axis=0),
    )


def gain_uncertainty(
    model: RobotModel,
    payloads: Sequence[tuple[KnownPayload, ...]],
    deviations: Sequence[Array | float],
    frames: Sequence[str] = (),
) -> Array:
    """Return the relative uncertainty (nv,) of the efforts' gains, from `deviations` of logs.

    It is 0 where known payloads, or ground forces at `frames`, determine the gain.
    """
    known = joints_with_known_gain(model, payloads, frames) if any(payloads) or frames else ()
    largest = np.max([np.broadcast_to(each, len(model.joints)) for each in deviations], axis=0)
    return np.where(np.isin(model.joints, known), 0.0, largest)


def peak_speeds(trajectories: Sequence[Trajectory]) -> Array:
    """Return the peak speed (nv,) of every joint, rad/s or m/s; 0 if it never moves."""
    segments = [segment for trajectory in trajectories for segment in trajectory.segments]
    peak = np.max([segment.peak_speed for segment in segments], axis=0)
    noise = np.max([trajectory.speed_noise for trajectory in trajectories], axis=0)
    moving = (peak > AT_REST * noise) & (peak > LEAST_SPEED * peak.max())
    return np.where(moving, peak, 0.0)


def still_speeds(trajectories: Sequence[Trajectory]) -> Array:
    """Return speeds (nv,) below which a joint is at rest, or its velocity is only noise.

    They are zero for joints that never move, of which all samples are used.
    """
    noise = np.max([trajectory.speed_noise for trajectory in trajectories], axis=0)
    return least_still_speeds(peak_speeds(trajectories), noise)


def least_still_speeds(peaks: Array, noise: Array) -> Array:
    """Return `still_speeds` from peak speeds (nv,) and their noise (nv,), rad/s or m/s."""
    return np.where(peaks > 0.0, np.maximum(STILL_SPEED * peaks, STILL_NOISE * noise), 0.0)


def moving_together(trajectories: Sequence[Trajectory]) -> NDArray[np.bool_]:
    """Return whether two joints (nv, nv) move at the same time, and not in proportion.

    The common motion must last at least a tenth of that of the joint that moves less. Joints move
    in proportion, for example, in legs with feet on the ground.
    """
    peaks = peak_speeds(trajectories)
    noise = np.max([trajectory.speed_noise for trajectory in trajectories], axis=0)
    still = np.maximum(STILL_SPEED * peaks, AT_REST * noise)
    count, product, square = np.zeros((3, len(peaks), len(peaks)))
    for trajectory in trajectories:
        for segment in trajectory.segments:
            for _, chunk in segment.chunks():
                moves = (np.abs(chunk.velocity) > still).astype(float)
                speed = moves * chunk.velocity
                count += moves.T @ moves
                product += speed.T @ speed
                square += np.square(speed).T @ moves  # of the first while the second moves
    moving = np.diag(count)
    together = count >= _AT_ONCE * np.maximum(np.minimum.outer(moving, moving), 1.0)
    alike = product**2 > (1.0 - _ALIKE**2) * square * square.T
    return np.asarray(together & ~(alike & ~np.eye(len(peaks), dtype=bool)))


def sign_widths(model: RobotModel, trajectories: Sequence[Trajectory]) -> Array:
    """Return the speed (nv,) below which the model's dry friction fades, or signs are unknown."""
    noise = np.max([trajectory.speed_noise for trajectory in trajectories], axis=0)
    return model.sign_widths(least_sign_widths(peak_speeds(trajectories), noise))


def least_sign_widths(peaks: Array, noise: Array) -> Array:
    """Return the speed (nv,) below which the direction of motion is unknown.

    `noise` (nv,) is the standard deviation of the velocities, rad/s or m/s.
    """
    return np.maximum(LEAST_SIGN_WIDTH * peaks, SIGN_NOISE * noise)


class _FactorBuilder:
    """Incremental reduction of the rows of one joint and fold."""

    def __init__(self, width: int) -> None:
        self.width, self.seen, self.samples = width, 0, 0
        self.kept: dict[Block, list[JointRows]] = defaultdict(list)
        self.pending = list[Array]()  # the factor of earlier rows, if any, comes first
        self.sums, self.carried = np.zeros(2), np.zeros(width)

    def add(self, block: Block, rows: JointRows) -> None:
        if self.samples < ROWS_KEPT:
            self.kept[block].append(rows)
        effort = rows.b[:, 0] + rows.carried
        self.sums += effort.sum(), effort @ effort
        self.samples += len(effort)
        self.pending.append(rows.joined)
        self.carried += rows.joined.T @ rows.carried
        if sum(map(len, self.pending)) > (WORTHWHILE + 1) * self.width:
            self.pending = [self.whole_factor()]

    def whole_factor(self) -> Array:
        """Return the factor of all rows, or the rows if they are fewer than the columns."""
        if sum(map(len, self.pending)) > self.width:
            return triangular_factor(self.pending)
        return np.concatenate([np.zeros((0, self.width)), *self.pending])


def _stacked(factors: Sequence[Array]) -> Array:
    """Stack factors (m_i, p), padded with zero rows."""
    stacked = np.zeros((len(factors), max(map(len, factors)), factors[0].shape[1]))
    for padded, factor in zip(stacked, factors, strict=True):
        padded[: len(factor)] = factor
    return stacked


def _slices(
    layout: Layout,
    trajectories: Sequence[Trajectory],
    at: tuple[int, int],
    advance: Sequence[Array],
) -> Iterator[tuple[int, LogSlice]]:
    """Yield the first output of every slice of a segment, and the slice."""
    trajectory, stretch = trajectories[at[0]], trajectories[at[0]].segments[at[1]]
    dofs = sum(len(mobilizer.dofs) for mobilizer in layout.model.tree.mobilizers)
    width = PARAMETERS_PER_BODY * dofs  # nonzero entries of a regressor
    size, first = min(CHUNK, LARGEST_REGRESSOR // width), 0
    for samples, outputs in trajectory.filter.chunks(len(stretch), size):
        place = (*at, samples.start, samples.stop)
        yield first, LogSlice(layout, trajectory, stretch, samples, advance, place)
        first += outputs


def effort_deviation(
    joints: Sequence[str], data: Sequence[JointData], passive: Collection[str] = ()
) -> Array:
    """Return the standard deviation (nv,) of the measured efforts, N·m or N; 0 without rows.

    Raises:
        LogError: The effort of a moving joint is constant.
    """
    count = np.array([joint.samples.sum() for joint in data])
    sums = np.array([joint.effort_sums.sum(axis=0) for joint in data])
    mean, power = sums.T / np.maximum(count, 1)
    deviation = np.sqrt(np.maximum(power - mean**2, 0.0))
    constant = (count > 0) & (deviation <= LEAST_DEVIATION * np.sqrt(power))
    constant &= ~np.isin(joints, list(passive))
    for joint, value, stuck in zip(joints, mean.tolist(), constant.tolist(), strict=True):
        if stuck:
            raise LogError(
                f"The effort of {joint} is constant in the log: {value:.4g} N·m or N.",
                advice="Check what is logged, or remove the joint's columns.",
                joint=joint,
            )
    return deviation


_SAMPLES = 100_000  # largest number of samples of a segment to use
_POSES = 50  # poses of each segment at which gravity is evaluated


def effort_scale(
    model: RobotModel,
    tree: KinematicTree,
    trajectories: Sequence[Trajectory],
    data: Sequence[JointData],
    deviation: Array,
) -> Array:
    """Return the scale (nv,) of each joint's effort, N·m or N.

    It is the standard `deviation` of the effort of a moving joint. The effort of a joint at rest,
    or without a motor, hardly varies; its scale is the larger of its holding effort and of the
    effort of gravity with the robot on its side.
    """
    still = _at_rest(model, data) | (deviation == 0.0)
    if not still.any():
        return deviation
    power = np.array([joint.effort_sums[:, 1].sum() for joint in data])
    count = np.maximum([joint.samples.sum() for joint in data], 1)
    held = np.maximum(np.sqrt(power / count), _load_by_gravity(model, tree, trajectories))
    return np.where(still, held, deviation)


def _at_rest(model: RobotModel, data: Sequence[JointData]) -> NDArray[np.bool_]:
    """Return which joints (nv,) of one degree of freedom hardly move."""
    low, high = np.full((2, len(data)), np.nan)
    for joint in model.single_joints:
        j = model.joints.index(joint)
        q = [rows.motion[:, 0] for fold in data[j].rows for rows in fold if len(rows.motion)]
        if q:
            low[j], high[j] = min(part.min() for part in q), max(part.max() for part in q)
    return resting(low, high, np.isin(model.joints, model.sliding_joints))


def passive_inertia(
    model: RobotModel, tree: KinematicTree, trajectories: Sequence[Trajectory]
) -> Array | None:
    """Return `Dataset.passive_inertia`, averaged over poses of the logs."""
    passive = {joint for trajectory in trajectories for joint in trajectory.passive}
    if not passive:
        return None
    q, shares = _poses(model, trajectories), np.zeros((len(model.joints), model.phi.size))
    still, weightless = np.zeros((len(q), len(model.joints))), replace(tree, gravity=np.zeros(3))
    for joint in passive:
        j, vd = model.joints.index(joint), still.copy()
        vd[:, j] = 1.0
        columns = inverse_dynamics_regressor(weightless, q, still, vd)[:, j]
        inertia = columns @ model.total_phi.ravel()
        shares[j] = (columns / np.maximum(inertia, np.finfo(float).tiny)[:, None]).mean(axis=0)
    return shares


def _poses(model: RobotModel, trajectories: Sequence[Trajectory]) -> Array:
    """Return positions (K, nq) of the model at instants of the logs."""
    segments = [segment for trajectory in trajectories for segment in trajectory.segments]
    starts = [segment[:_SAMPLES].position for segment in segments]
    positions = [start[:: max(1, len(start) // _POSES)] for start in starts]
    return model.positions(np.concatenate(positions))


def _load_by_gravity(
    model: RobotModel, tree: KinematicTree, trajectories: Sequence[Trajectory]
) -> Array:
    """Return the RMS (nv,) of the efforts of gravity along three axes, N·m or N."""
    q = _poses(model, trajectories)
    zero = np.zeros((len(q), len(model.joints)))
    power, g = np.zeros(len(model.joints)), float(np.linalg.norm(tree.gravity))
    for side in g * np.eye(3):
        load = inverse_dynamics(replace(tree, gravity=side), q, zero, zero, model.total_phi)
        power += np.square(load).mean(axis=0)
    return np.sqrt(power)
