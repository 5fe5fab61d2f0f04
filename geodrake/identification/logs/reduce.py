"""From prepared logs to a `Dataset`, chunk by chunk, so that memory does not grow with a log."""

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

LEAST_SIGN_WIDTH = 0.002  # of a joint's peak speed, below which its direction is not known
SIGN_NOISE = 1.2  # deviations σ of a speed's noise; the mean sign is erf(v/√2σ) ≈ tanh(v/1.2σ)
AT_REST = 8.0  # deviations of a speed's noise, below which a joint never moves
LEAST_SPEED = 1e-4  # of the fastest joint's speed, below which a joint never moves
STILL_SPEED, STILL_NOISE = 0.01, 2.0  # of the peak speed, and of its noise: below, a joint rests
_AT_ONCE = 0.1  # of the time for which the joint that moves less is in motion
_ALIKE = 0.1  # of a joint's speed, by which it is another joint's times a ratio
WORTHWHILE = 20  # times more rows than columns are folded into a triangular factor
LEAST_DEVIATION = 1e-7  # of an effort's RMS: what is less is rounding of a constant
ROWS_KEPT = 4_000  # filtered rows of each fold and joint, for autocorrelations and figures


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

    The model's inertial parameters give the load, its delays shift the efforts. Effects get columns
    if they are of the model or to be tried. Further `delays` to try, s, are of all joints or (nv,)
    of each; the first must be 0. `noise` is what `known_noise` says, if that was looked
    at already; else it depends on whether the model was `fitted` to these logs. `shared`
    is what reductions of the same logs by the same robot have in common; it is used and filled.

    Raises:
        LogError: The effort of a joint never changes, or a joint moves for a moment only.
    """
    effects = tuple(e for e in dict.fromkeys(effects) if e.parameters)
    still = still_speeds(trajectories)
    still[np.isin(model.joints, model.base_joints)] = 0.0
    widths = sign_widths(model, trajectories)
    shared = RowCache(0) if shared is None else shared
    shared.begin()
    empty = Layout(model, (), widths, still, (np.zeros(0, np.intp),) * len(model.joints))
    coupling = coupling_of(empty, trajectories, shared)
    layout = Layout.of(model, effects, widths, still, coupling=coupling)
    noise = noise or known_noise(trajectories, model, sign_width=widths, fitted=fitted)
    dataset = reduce_over(layout, trajectories, folds, delays=delays, noise=noise, shared=shared)
    for joint, moves in zip(model.joints, dataset.has_rows, strict=True):
        if not moves and coupling is None:
            raise LogError(
                f"{joint} moves only for a moment: in no filtered sample it moves for most "
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
    """Return (nv, nv) which velocities are in the row of which, in any slice of any log.

    None if neither a contact force nor a motor's effort is unknown.
    """
    if not any(trajectory.has_unknown_forces for trajectory in trajectories):
        return None

    def make() -> dict[int, Array]:
        found = np.eye(len(layout.columns), dtype=bool)
        places = [(k, i) for k, each in enumerate(trajectories) for i in range(len(each.segments))]
        for at in places:
            for _, part in _slices(layout, trajectories, at, ()):
                if (rows := part.contact_rows(shared)) is not None:
                    found |= rows.coupling
        return {0: found.astype(float)}

    return np.asarray(shared.once(("coupling",), make)[0] > 0.0)


def reduced_joints(
    layout: Layout,
    trajectories: Sequence[Trajectory],
    folds: Sequence[Fold],
    advance: Sequence[Array],
    shared: RowCache | None = None,
) -> tuple[JointData, ...]:
    """Return the reduced data of every joint, with the columns of a layout; see `reduce_logs`.

    A joint may rest all the time. `advance` are (nv,) seconds by which the efforts were logged
    late, for each column of efforts.
    """
    shared = RowCache(0) if shared is None else shared
    boxes = [[_Box(len(c) + len(advance)) for _ in folds] for c in layout.columns]
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
                        boxes[j][f].seen += high - low
                        boxes[j][f].add(block, rows.part(low, high))
    return tuple(
        _joint_data(columns, joint) for columns, joint in zip(layout.columns, boxes, strict=True)
    )


def _joint_data(columns: Indices, boxes: Sequence[_Box]) -> JointData:
    rows = tuple(tuple(map(JointRows.join, box.kept.values())) for box in boxes)
    kept = [np.abs(each.A).max(axis=0) for fold in rows for each in fold if len(each.A)]
    return JointData(
        columns,
        _stacked([box.whole_factor() for box in boxes]),
        np.array([box.samples for box in boxes]),
        rows,
        np.array([box.carried[: len(columns)] for box in boxes]),
        np.array([box.seen for box in boxes]),
        np.array([box.sums for box in boxes]),
        np.max([np.zeros(len(columns)), *kept], axis=0),
    )


def gain_uncertainty(
    model: RobotModel,
    payloads: Sequence[tuple[KnownPayload, ...]],
    deviations: Sequence[Array | float],
    frames: Sequence[str] = (),
) -> Array:
    """Return (nv,) how well gains of efforts are known, by payloads and deviations (nv,) of logs.

    It is 0 where known payloads, or forces of the ground at `frames`, say them.
    """
    known = joints_with_known_gain(model, payloads, frames) if any(payloads) or frames else ()
    largest = np.max([np.broadcast_to(each, len(model.joints)) for each in deviations], axis=0)
    return np.where(np.isin(model.joints, known), 0.0, largest)


def peak_speeds(trajectories: Sequence[Trajectory]) -> Array:
    """Return (nv,) the largest speed of every joint, rad/s or m/s; 0 for one that does not move."""
    segments = [segment for trajectory in trajectories for segment in trajectory.segments]
    peak = np.max([segment.peak_speed for segment in segments], axis=0)
    noise = np.max([trajectory.speed_noise for trajectory in trajectories], axis=0)
    moving = (peak > AT_REST * noise) & (peak > LEAST_SPEED * peak.max())
    return np.where(moving, peak, 0.0)


def still_speeds(trajectories: Sequence[Trajectory]) -> Array:
    """Return (nv,) speeds below which a joint is at rest, or its velocity is mere noise.

    It is zero for joints that never move: what they hold is all that is known of them.
    """
    noise = np.max([trajectory.speed_noise for trajectory in trajectories], axis=0)
    return least_still_speeds(peak_speeds(trajectories), noise)


def least_still_speeds(peaks: Array, noise: Array) -> Array:
    """Return `still_speeds` of peak speeds (nv,) and their noise (nv,), rad/s or m/s."""
    return np.where(peaks > 0.0, np.maximum(STILL_SPEED * peaks, STILL_NOISE * noise), 0.0)


def moving_together(trajectories: Sequence[Trajectory]) -> NDArray[np.bool_]:
    """Return (nv, nv) whether two joints move at the same time, and not always alike.

    They must do so for a tenth of the time for which the joint that moves less is in motion. Joints
    whose speeds are in one ratio, as those of legs whose feet stand, show what each has.
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
                square += np.square(speed).T @ moves  # of the first where the second moves, too
    alone = np.diag(count)
    at_once = count >= _AT_ONCE * np.maximum(np.minimum.outer(alone, alone), 1.0)
    alike = product**2 > (1.0 - _ALIKE**2) * square * square.T
    return np.asarray(at_once & ~(alike & ~np.eye(len(peaks), dtype=bool)))


def sign_widths(model: RobotModel, trajectories: Sequence[Trajectory]) -> Array:
    """Return (nv,) the speed below which dry friction of the model fades, or signs are unknown."""
    noise = np.max([trajectory.speed_noise for trajectory in trajectories], axis=0)
    return model.sign_widths(least_sign_widths(peak_speeds(trajectories), noise))


def least_sign_widths(peaks: Array, noise: Array) -> Array:
    """Return (nv,) the speed below which the direction of motion is not known.

    Peak speeds (nv,) and deviations (nv,) of the noise of velocities are in rad/s or m/s.
    """
    return np.maximum(LEAST_SIGN_WIDTH * peaks, SIGN_NOISE * noise)


class _Box:
    """Rows of one joint and fold on their way into a factor."""

    def __init__(self, width: int) -> None:
        self.width, self.seen, self.samples = width, 0, 0
        self.kept: dict[Block, list[JointRows]] = defaultdict(list)
        self.pending = list[Array]()  # the factor of earlier rows first, if there is one
        self.sums, self.carried = np.zeros(2), np.zeros(width)

    def add(self, block: Block, rows: JointRows) -> None:
        if self.samples < ROWS_KEPT:
            self.kept[block].append(rows)
        effort = rows.b[:, 0] + rows.carried
        self.sums += effort.sum(), effort @ effort
        self.samples += len(effort)
        self.pending.append(np.concatenate([rows.A.T, rows.b.T]).T)
        self.carried += self.pending[-1].T @ rows.carried
        if sum(map(len, self.pending)) > (WORTHWHILE + 1) * self.width:
            self.pending = [self.whole_factor()]

    def whole_factor(self) -> Array:
        """Return the factor of all rows: they themselves where they are fewer than the columns."""
        if sum(map(len, self.pending)) > self.width:
            return triangular_factor(self.pending)
        return np.concatenate([np.zeros((0, self.width)), *self.pending])


def _stacked(factors: Sequence[Array]) -> Array:
    """Return (F, m, p) factors (m_i, p), with rows of zeros where one has fewer than another."""
    most = max(map(len, factors))
    return np.array([np.pad(factor, ((0, most - len(factor)), (0, 0))) for factor in factors])


def _slices(
    layout: Layout,
    trajectories: Sequence[Trajectory],
    at: tuple[int, int],
    advance: Sequence[Array],
) -> Iterator[tuple[int, LogSlice]]:
    """Yield the first output of every slice of a segment, and the slice."""
    trajectory, stretch = trajectories[at[0]], trajectories[at[0]].segments[at[1]]
    felt = sum(len(mobilizer.dofs) for mobilizer in layout.model.tree.mobilizers)
    width = PARAMETERS_PER_BODY * felt  # of what a regressor has beside zeros
    size, first = min(CHUNK, LARGEST_REGRESSOR // width), 0
    for samples, outputs in trajectory.filter.chunks(len(stretch), size):
        place = (*at, samples.start, samples.stop)
        yield first, LogSlice(layout, trajectory, stretch, samples, advance, place)
        first += outputs


def effort_deviation(
    joints: Sequence[str], data: Sequence[JointData], passive: Collection[str] = ()
) -> Array:
    """Return (nv,) standard deviation of the measured efforts, N·m or N; 0 of a joint at rest.

    Raises:
        LogError: The effort of a joint that moves never changes: its sensor has nothing to say.
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


_SAMPLES = 100_000  # of a segment that are looked at
_POSES = 50  # of each segment, at which gravity is looked at


def effort_scale(
    model: RobotModel,
    tree: KinematicTree,
    trajectories: Sequence[Trajectory],
    data: Sequence[JointData],
    deviation: Array,
) -> Array:
    """Return (nv,) the scale of each joint's effort, N·m or N.

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
    """Return (nv,) which joints of one degree of freedom hardly move."""
    low, high = np.full((2, len(data)), np.nan)
    for joint in model.single_joints:
        j = model.joints.index(joint)
        own = [rows.motion[:, 0] for fold in data[j].rows for rows in fold if len(rows.motion)]
        if own:
            low[j], high[j] = min(q.min() for q in own), max(q.max() for q in own)
    return resting(low, high, np.isin(model.joints, model.sliding_joints))


def passive_inertia(
    model: RobotModel, tree: KinematicTree, trajectories: Sequence[Trajectory]
) -> Array | None:
    """Return `Dataset.passive_inertia`, the mean over poses of the logs."""
    passive = {joint for trajectory in trajectories for joint in trajectory.passive}
    if not passive:
        return None
    q, found = _poses(model, trajectories), np.zeros((len(model.joints), model.phi.size))
    still, weightless = np.zeros((len(q), len(model.joints))), replace(tree, gravity=np.zeros(3))
    for joint in passive:
        j, vd = model.joints.index(joint), still.copy()
        vd[:, j] = 1.0
        columns = inverse_dynamics_regressor(weightless, q, still, vd)[:, j]
        inertia = columns @ model.total_phi.ravel()
        found[j] = (columns / np.maximum(inertia, np.finfo(float).tiny)[:, None]).mean(axis=0)
    return found


def _poses(model: RobotModel, trajectories: Sequence[Trajectory]) -> Array:
    """Return (K, nq) positions of the model at instants of the logs."""
    segments = [segment for trajectory in trajectories for segment in trajectory.segments]
    starts = [segment[:_SAMPLES].position for segment in segments]
    positions = [start[:: max(1, len(start) // _POSES)] for start in starts]
    return model.positions(np.concatenate(positions))


def _load_by_gravity(
    model: RobotModel, tree: KinematicTree, trajectories: Sequence[Trajectory]
) -> Array:
    """Return (nv,) RMS of the loads by gravity from three sides, N·m or N."""
    q = _poses(model, trajectories)
    zero = np.zeros((len(q), len(model.joints)))
    power, g = np.zeros(len(model.joints)), float(np.linalg.norm(tree.gravity))
    for side in g * np.eye(3):
        load = inverse_dynamics(replace(tree, gravity=side), q, zero, zero, model.total_phi)
        power += np.square(load).mean(axis=0)
    return np.sqrt(power)
