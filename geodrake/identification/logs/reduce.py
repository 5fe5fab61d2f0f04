"""From prepared logs to a `Dataset`, chunk by chunk, so that memory does not grow with a log."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.effects.base import Effect
from geodrake.errors import LogError
from geodrake.identification.logs.dataset import Dataset, Indices, JointData, JointRows
from geodrake.identification.logs.log_slices import Layout, LogSlice
from geodrake.identification.logs.noise import known_noise
from geodrake.identification.logs.nominal_efforts import effort_scale, passive_inertia
from geodrake.identification.logs.shared_rows import SharedRows
from geodrake.identification.logs.unknowns import payload_reference
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.logs.folds import Block, Fold
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.motion import Trajectory
from geodrake.logs.smoothing import CHUNK
from geodrake.model.carried_payloads import joints_with_known_gain
from geodrake.model.robot_model import LARGEST_REGRESSOR, RobotModel
from geodrake.robot.reduction import triangular_factor

Array = NDArray[np.float64]

LEAST_SIGN_WIDTH = 0.002  # of a joint's peak speed, below which its direction is not known
SIGN_NOISE = 1.2  # deviations σ of a speed's noise; the mean sign is erf(v/√2σ) ≈ tanh(v/1.2σ)
AT_REST = 8.0  # deviations of a speed's noise, below which a joint never moves
LEAST_SPEED = 1e-4  # of the fastest joint's speed, below which a joint never moves
STILL_SPEED = 0.01  # of a joint's peak speed, below which it is at rest
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
    noise: tuple[Array, NDArray[np.bool_] | bool] | None = None,
    fitted: bool = False,
    shared: SharedRows | None = None,
) -> Dataset:
    """Reduce logs to the triangular factors of every fold and joint.

    Args:
        model: The model; its inertial parameters give the load, its delays shift the efforts.
        effects: Effects that get columns: those of the model and those to try.
        delays: Delays to try on top of the model's, s, of all joints or (nv,) of each; the first
            must be 0.
        noise: (nv,) noise floor and whether it is known, if that was looked at already.
        fitted: Whether the model was fitted to these logs, for the noise floor.
        shared: What earlier reductions of the same logs by the same robot have in common with this
            one; used and filled.

    Raises:
        LogError: The effort of a joint never changes, or a joint moves for a moment only.
    """
    effects = tuple(e for e in dict.fromkeys(effects) if e.parameters)
    still = STILL_SPEED * peak_speeds(trajectories)
    layout = Layout.of(model, effects, sign_widths(model, trajectories), still)
    further = np.array([np.broadcast_to(delay, len(model.joints)) for delay in delays])
    data = reduced_joints(layout, trajectories, folds, list(further + model.delays), shared)
    _check_moving(model.joints, data)
    passive = {joint for trajectory in trajectories for joint in trajectory.passive}
    deviation = effort_deviation(model.joints, data, passive)
    floor, known = noise or known_noise(
        trajectories, model, sign_width=layout.sign_width, fitted=fitted
    )
    return Dataset(
        model.joints,
        model.bodies,
        effects,
        further,
        tuple(fold.name for fold in folds),
        tuple(trajectory.name for trajectory in trajectories),
        data,
        effort_scale(model, layout.tree, trajectories, data, deviation),
        floor,
        trajectories[0].filter.bandwidth,
        np.array([joint.still for joint in data]),
        payload_reference(model.phi),
        gain_uncertainty(model, trajectories),
        known,
        passive_inertia(model, layout.tree, trajectories),
    )


def reduced_joints(
    layout: Layout,
    trajectories: Sequence[Trajectory],
    folds: Sequence[Fold],
    advance: Sequence[Array],
    shared: SharedRows | None = None,
) -> tuple[JointData, ...]:
    """Return what logs say about every joint, over the columns of a layout; see `reduce_logs`.

    A joint may rest all the time. `advance` are (nv,) seconds by which the efforts were logged
    late, for each column of efforts.
    """
    shared = SharedRows(0) if shared is None else shared
    boxes = [[_Box(len(c) + len(advance)) for _ in folds] for c in layout.columns]
    members: dict[tuple[int, int], list[tuple[int, Block]]] = defaultdict(list)
    for f, fold in enumerate(folds):
        for block in fold.blocks:
            members[block.trajectory, block.segment].append((f, block))
    for at, blocks in sorted(members.items()):
        for first, part in _slices(layout, trajectories, at, advance):
            chunk = part.rows(shared)
            for f, block in blocks:
                low, high = max(block.start - first, 0), min(block.stop - first, len(chunk[0].b))
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


class HasGains(Protocol):
    """A log, prepared or digested, of which it is known how well the gains of its efforts are."""

    @property
    def payloads(self) -> tuple[KnownPayload, ...]:
        """Known payloads that the robot carried."""

    @property
    def gain_deviations(self) -> Array | float:
        """(n,) how well the gain of each joint's efforts is known."""


def gain_uncertainty(model: RobotModel, logs: Sequence[HasGains]) -> Array:
    """Return (nv,) how well gains of efforts are known; 0 where known payloads say them."""
    payloads = [log.payloads for log in logs]
    known = joints_with_known_gain(model, payloads) if any(payloads) else ()
    largest = np.max(
        [np.broadcast_to(log.gain_deviations, len(model.joints)) for log in logs], axis=0
    )
    return np.where(np.isin(model.joints, known), 0.0, largest)


def peak_speeds(trajectories: Sequence[Trajectory]) -> Array:
    """Return (nv,) the largest speed of every joint, rad/s or m/s; 0 for one that does not move."""
    segments = [segment for trajectory in trajectories for segment in trajectory.segments]
    peak = np.max([segment.peak_speed for segment in segments], axis=0)
    noise = np.max([trajectory.speed_noise for trajectory in trajectories], axis=0)
    moving = (peak > AT_REST * noise) & (peak > LEAST_SPEED * peak.max())
    return np.where(moving, peak, 0.0)


def sign_widths(model: RobotModel, trajectories: Sequence[Trajectory]) -> Array:
    """Return (nv,) the speed below which dry friction of the model fades, or signs are unknown."""
    noise = np.max([trajectory.speed_noise for trajectory in trajectories], axis=0)
    return model.sign_widths(least_sign_widths(peak_speeds(trajectories), noise))


def least_sign_widths(peaks: Array, noise: Array) -> Array:
    """Return (nv,) the speed below which the direction of motion is not known.

    Peak speeds (nv,) and deviations (nv,) of the noise of velocities are in rad/s or m/s.
    """
    return np.maximum(LEAST_SIGN_WIDTH * peaks, SIGN_NOISE * noise)


@dataclass(eq=False)
class _Box:
    """Rows of one joint and fold on their way into a factor."""

    width: int
    factor: Array | None = None
    pending: list[Array] = field(default_factory=list)
    kept: dict[Block, list[JointRows]] = field(default_factory=lambda: defaultdict(list))
    seen: int = 0
    samples: int = 0
    sums: Array = field(default_factory=lambda: np.zeros(2))
    carried: Array = field(init=False)

    def __post_init__(self) -> None:
        self.carried = np.zeros(self.width)

    def add(self, block: Block, rows: JointRows) -> None:
        if self.samples < ROWS_KEPT:
            self.kept[block].append(rows)
        effort = rows.b[:, 0] + rows.carried
        self.sums += effort.sum(), effort @ effort
        self.samples += len(effort)
        self.pending.append(np.hstack([rows.A, rows.b]))
        self.carried += self.pending[-1].T @ rows.carried
        if sum(map(len, self.pending)) > WORTHWHILE * self.width:
            self.factor, self.pending = self.whole_factor(), []

    def whole_factor(self) -> Array:
        """Return the factor of all rows: they themselves where they are fewer than the columns."""
        blocks = [*([] if self.factor is None else [self.factor]), *self.pending]
        if sum(map(len, blocks)) > self.width:
            return triangular_factor(blocks)
        return np.concatenate([np.zeros((0, self.width)), *blocks])


def _stacked(factors: Sequence[Array]) -> Array:
    """(F, m, p) factors (m_i, p), with rows of zeros where one has fewer than another."""
    most = max(map(len, factors))
    return np.array([np.pad(factor, ((0, most - len(factor)), (0, 0))) for factor in factors])


def _slices(
    layout: Layout,
    trajectories: Sequence[Trajectory],
    at: tuple[int, int],
    advance: Sequence[Array],
) -> Iterator[tuple[int, LogSlice]]:
    """First output of every slice of a segment, and the slice."""
    trajectory, stretch = trajectories[at[0]], trajectories[at[0]].segments[at[1]]
    width = len(layout.model.joints) * PARAMETERS_PER_BODY * len(layout.model.bodies)
    size, first = min(CHUNK, LARGEST_REGRESSOR // width), 0
    for samples, outputs in trajectory.filter.chunks(len(stretch), size):
        place = (*at, samples.start, samples.stop)
        yield first, LogSlice(layout, trajectory, stretch, samples, advance, place)
        first += outputs


def effort_deviation(
    joints: Sequence[str], data: Sequence[JointData], passive: Collection[str] = ()
) -> Array:
    """(nv,) standard deviation of the measured efforts, N·m or N; 0 of a joint at rest.

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
                f"The effort of {joint} never changes in the log: it is {value:.4g} N·m or N.",
                advice="Check what is logged there, or leave the joint's columns out.",
                joint=joint,
            )
    return deviation


def _check_moving(joints: Sequence[str], data: Sequence[JointData]) -> None:
    for joint, own in zip(joints, data, strict=True):
        if not own.samples.any():
            raise LogError(
                f"{joint} stands still but for a moment: in no filtered sample it moves for most "
                "of the filter's window.",
                advice="Record a log in which it moves, or always stands. Did its sensor jump?",
                joint=joint,
            )
