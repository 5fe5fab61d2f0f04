"""Episodes: time windows in which several joints have an effort that no model explains.

A contact is not a property of the robot, so that other parts of a log say nothing about it. It is
found in the residual: a window in which at least two joints have unusually large errors, and a body
whose wrench explains all of them. The evidence is that the wrench fitted to alternate pieces of the
window predicts the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from geodrake.diagnosis.contact_window import (
    FEW,
    SHORTEST,
    Predicted,
    ResidualWindow,
    evidence,
    refined,
    with_point,
)
from geodrake.diagnosis.residuals import JointResidual, cut_out, full_motion, joint_residuals
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.episode import PointEpisode
from geodrake.effects.robot_motion import log_number
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.criteria import ALARM, LEAST_NOISE
from geodrake.identification.logs.evidence import chi2_tail
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.identification.normal_equations import scaled_cholesky, solved
from geodrake.logs.smoothing import Segment

Array = NDArray[np.float64]
Window = tuple[int, float, float]
"""Index of a log, and the instants since it began, s, at which a window starts and ends."""

_AVERAGE = 0.3  # s, over which squared residuals are averaged
_HIGH, _LOW = 12.0, 4.0  # over their typical value: within an episode, and at its ends
_LEAST_JOINTS = 2
MOST_TIME = 0.3  # largest share of a log that is contact
_MOST = 8
_LEAST_SHARE = 0.6  # of the squared error in the window, predicted by the wrench
_HOPELESS = 0.2  # least share fitted by the best guess, before its times and point are refined
# Number of guesses to refine: those that predict most, and those that fit best, as inexact edges
# spoil the prediction of the right wrench.
_REFINED = 4
_AS_GOOD = 0.9  # share of the best prediction with which a body closer to the base is preferred
_MODEL = 0.05  # relative model error of a contact's efforts
_REST = 1.0  # s, longest rest within an episode
_RISE = 0.03  # s, initial value
_ROBUST_FITS = 12


@dataclass(frozen=True, eq=False)
class _Scale:
    """Residuals of all joints on a time grid of each log, relative to their typical size.

    At joints without rows they are NaN, and the size is one.
    """

    size: Array
    grids: list[Array]
    periods: list[float]


def find_episodes(
    case: Case, hypothesis: Hypothesis, on_time: tuple[int, ...]
) -> tuple[PointEpisode, ...]:
    """Return contacts that are clear in the residual of a robust fit of a hypothesis.

    `on_time` are the indices of the dataset's delays that equal the model's.
    """
    scale = _scaled(case, hypothesis, on_time)
    windows = _new_windows(case, hypothesis, scale)
    motion = full_motion(case) if windows else []
    cut = [(w[0], _cut_out(case, scale, motion, w)) for w in windows]
    names = [trajectory.name for trajectory in case.trajectories]
    found = [_contacts(case, names[k], w, len(windows)) for k, w in cut if w is not None]
    return tuple(contact for contacts in found for contact in contacts)


def _new_windows(case: Case, hypothesis: Hypothesis, scale: _Scale) -> list[Window]:
    """Return windows in which the hypothesis has no contact; none if there are too many."""
    known = [e for e in hypothesis.unknowns.effects if isinstance(e, PointEpisode)]
    numbers = [log_number(trajectory.name) for trajectory in case.trajectories]
    logs = enumerate(zip(scale.grids, scale.periods, strict=True))
    windows = [
        (log, start, end)
        for log, (grid, period) in logs
        for log, start, end in _windows(log, grid, period)
        if not any(
            contact.is_of(numbers[log]) and start < contact.end and contact.start < end
            for contact in known
        )
    ]
    return windows if len(windows) <= _MOST else []


def _scaled(case: Case, hypothesis: Hypothesis, on_time: tuple[int, ...]) -> _Scale:
    joints = _robust_residuals(case, hypothesis, on_time)
    periods = [trajectory.filter.output_period for trajectory in case.trajectories]
    known = np.array([_typical(joint.residual, np.finfo(float).tiny) for joint in joints])
    names = hypothesis.dataset.joints
    at, size = [names.index(joint.joint) for joint in joints], np.ones(len(names))
    size[at], grids = known, list[Array]()
    for grid in _Grids(joints, periods).of([joint.residual for joint in joints], known):
        grids.append(np.full((len(grid), len(names)), np.nan))
        grids[-1][:, at] = grid
    return _Scale(size, grids, periods)


def _typical(residual: Array, least: float) -> float:
    """Return the standard deviation of residuals (K,), robust to outliers, and at least `least`."""
    return max(float(np.median(np.abs(residual))) / 0.6745, least)


class _Grids:
    """Time grids of the logs, with the indices of each joint's rows."""

    def __init__(self, joints: Sequence[JointResidual], periods: Sequence[float]) -> None:
        self.periods, self._lengths = periods, [1] * len(periods)
        self._places = list[list[tuple[NDArray[np.bool_], NDArray[np.intp]]]]()
        for log, period in enumerate(periods):
            rows = [joint.log == log for joint in joints]
            times = [joint.time[own] for joint, own in zip(joints, rows, strict=True)]
            places = [np.rint(time / period).astype(np.intp) for time in times]
            self._lengths[log] += max((int(at.max()) for at in places if len(at)), default=0)
            self._places.append([*zip(rows, places, strict=True)])

    def of(self, values: Sequence[Array], size: Array) -> list[Array]:
        """Return values (K,) of each joint, over a size, as (T, n) of each log; else NaN."""
        grids = []
        for length, places in zip(self._lengths, self._places, strict=True):
            grid = np.full((length, len(values)), np.nan)
            for k, (rows, at) in enumerate(places):
                grid[at, k] = values[k][rows] / size[k]
            grids.append(grid)
        return grids

    def at_rows(self, grids: Sequence[Array], joint: int, count: int) -> Array:
        """Return the values of the logs' grids (T,) at the rows (count,) of a joint."""
        values = np.empty(count)
        for grid, places in zip(grids, self._places, strict=True):
            rows, at = places[joint]
            values[rows] = grid[at]
        return values


def _robust_residuals(
    case: Case, hypothesis: Hypothesis, on_time: tuple[int, ...]
) -> list[JointResidual]:
    """Return the residuals of a fit with small weights in windows of large errors.

    An ordinary fit bends towards a contact and spreads its error over the whole log. A delay may do
    the same, so that efforts without delay are tried, too. Bounds are ignored.
    """
    dataset, unknowns = hypothesis.dataset, hypothesis.unknowns
    columns = list[tuple[Array, NDArray[np.intp]]]()  # of each joint, and indices of unknowns
    joints, efforts = joint_residuals(case, hypothesis), list[Array]()
    moving = np.flatnonzero([data.samples.any() for data in dataset.data])
    for j in moving:
        data = dataset.data[j]
        parts, local = [part for kept in data.rows for part in kept], data.local(unknowns.columns)
        A, indices = np.concatenate([part.A for part in parts]), np.flatnonzero(local >= 0)
        columns.append((A[:, local[indices]], indices))
        efforts.append(np.concatenate([part.b for part in parts]))
    grids = _Grids(joints, [trajectory.filter.output_period for trajectory in case.trajectories])
    least = np.maximum(dataset.noise_floor, LEAST_NOISE * np.maximum(dataset.effort_std, 1e-12))

    def sizes(residuals: Sequence[Array]) -> Array:
        return np.array([_typical(own, least[j]) for j, own in zip(moving, residuals, strict=True)])

    def robust_fit(x: Array, delay: tuple[int, ...]) -> list[Array]:
        """Return the residuals (K,) of each joint, starting from parameters (p,)."""
        rows = [(*own, b[:, delay[j]]) for j, own, b in zip(moving, columns, efforts, strict=True)]
        residuals = [b - A @ x[indices] for A, indices, b in rows]
        for _ in range(_ROBUST_FITS):
            size, H = sizes(residuals), unknowns.information.copy()
            right = H @ unknowns.mean + unknowns.pull
            means = [
                _averaged(grid, period).mean(axis=1)
                for grid, period in zip(grids.of(residuals, size), grids.periods, strict=True)
            ]
            for k, (A, indices, b) in enumerate(rows):
                share = hypothesis.power[moving[k]] / (len(b) * size[k] ** 2)
                weight = share / (1.0 + grids.at_rows(means, k, len(b)) / _LOW)
                weighted = weight[:, None] * A
                H[np.ix_(indices, indices)] += weighted.T @ A
                right[indices] += weighted.T @ b
            unknown = np.flatnonzero(np.diagonal(H) <= 0.0)  # without data or prior
            H[unknown, unknown], right[unknown] = 1.0, unknowns.mean[unknown]
            factor, scale = scaled_cholesky(H)
            x = scale * solved(factor, scale * right)
            residuals = [b - A @ x[indices] for A, indices, b in rows]
        return residuals

    fits = [robust_fit(hypothesis.held_out.x.mean(axis=0), hypothesis.delay)]
    if hypothesis.delay != on_time:
        fits.append(robust_fit(unknowns.mean, on_time))
    best = min(fits, key=lambda residuals: float(np.log(sizes(residuals)).sum()))
    return [replace(joint, residual=own) for joint, own in zip(joints, best, strict=True)]


def _averaged(grid: Array, period: float) -> Array:
    """Return moving averages (T, n) of squared values; 1 where there is none."""
    known, width = np.isfinite(grid), max(3, round(_AVERAGE / period))
    sums, counts = (
        uniform_filter1d(values, width, axis=0, mode="nearest")
        for values in (np.where(known, np.square(grid), 0.0), known.astype(float))
    )
    return np.where(known, sums / np.maximum(counts, 1.0 / width), 1.0)


def _windows(log: int, grid: Array, period: float) -> Iterator[Window]:
    """Yield log, start and end of windows in which several joints have unusual errors."""
    finite, mean = np.isfinite(grid), _averaged(grid, period)
    # There are no rows at rest, during which a contact may continue.
    rows = np.flatnonzero(finite.any(1))
    wide = np.any(mean[rows] > _LOW, axis=1)
    core = np.sum(mean[rows] > _HIGH, axis=1) >= _LEAST_JOINTS
    parts = np.cumsum(np.diff(wide, prepend=False) | (np.diff(rows, prepend=0) * period > _REST))
    kept = [rows[parts == k] for k in np.unique(parts[wide & core]).tolist()]
    kept = [part for part in kept if np.ptp(part) * period >= SHORTEST]
    if sum(map(len, kept)) <= MOST_TIME * len(rows):
        for part in kept:
            yield log, float(part[0] * period), float(part[-1] * period)


def _cut_out(
    case: Case,
    scale: _Scale,
    motion: Sequence[tuple[int, Segment]],
    window: Window,
) -> ResidualWindow | None:
    log, start, end = window
    trajectory = case.trajectories[log]
    low_pass = trajectory.filter
    pad = (low_pass.halfwidth + 2 * low_pass.decimation) * low_pass.period + _AVERAGE
    cut = cut_out(trajectory, (s for index, s in motion if index == log), (start, end), pad)
    if cut is None:
        return None
    segment, time, outputs = cut
    rows = np.rint(outputs / low_pass.output_period).astype(int)
    inside = (rows >= 0) & (rows < len(scale.grids[log]))
    residual = np.full((len(outputs), len(scale.size)), np.nan)
    residual[inside] = scale.grids[log][rows[inside]]
    model = case.model
    bodies = RobotBodies(model.tree, model.positions(segment.position), model.total_phi)
    selected = residual[(outputs >= start) & (outputs <= end)]
    counts = np.maximum((~np.isnan(selected)).sum(0), 1)
    size = np.sqrt(1.0 + _MODEL**2 * (np.nansum(np.square(selected), 0) / counts))
    return ResidualWindow(
        start, end, time, bodies, outputs, residual / size, size * scale.size, low_pass
    )


def _contacts(case: Case, log: str, window: ResidualWindow, tests: int) -> list[PointEpisode]:
    """Return the contacts that explain a window, most probable first.

    They act on one body; one wrench is constant in the body's frame, another in the world frame.
    """
    bodies = sorted(case.model.bodies, key=lambda name: len(window.bodies.motion(name).dofs))
    kinds = [kind for kind in case.effect_classes if issubclass(kind, PointEpisode)]
    window_of = {"rise": _RISE, "log": log_number(log)}
    guesses = [
        guess
        for kind in kinds
        for body in bodies
        for guess in kind.in_window(body, window.start, window.end, **window_of)
    ]
    rough = [with_point(window, guess) for guess in guesses]
    first = [evidence(window, guess) for guess in rough]
    if max(found.fitted for found in first) < _HOPELESS:
        return []
    by_share = sorted(range(len(rough)), key=lambda k: -first[k].share)[:_REFINED]
    by_fit = sorted(range(len(rough)), key=lambda k: -first[k].fitted)[:_REFINED]
    shapes = [refined(window, rough[k], steps=FEW) for k in sorted({*by_share, *by_fit})]
    tried_shapes = [(shape, evidence(window, shape)) for shape in shapes]
    best = max(found.share for _, found in tried_shapes)
    if best < 0.5 * _LEAST_SHARE:
        return []
    good = [(s, found) for s, found in tried_shapes if found.share >= _AS_GOOD * best]
    inner = next((shape for shape, found in good if _explains_all(found)), good[0][0])
    of_body = [(_explains_all(f), f.share, s) for s, f in good if s.body == inner.body]
    convincing, turning = list[PointEpisode](), set[int]()
    for *_, shape in sorted(of_body, key=lambda item: item[:2], reverse=True):
        if shape.turning in turning:
            continue
        turning.add(shape.turning)
        contact = refined(window, shape)
        found = evidence(window, contact)
        # Times, rise and point were fitted as well; bodies and frames are multiple tests.
        chance = chi2_tail(found.gain, found.rank + contact.free_shapes)
        chance = min(1.0, tests * len(guesses) * chance)
        if found.share >= _LEAST_SHARE and chance <= ALARM and _explains_all(found):
            convincing.append(contact)
    return convincing


def _explains_all(found: Predicted) -> bool:
    """Return whether several joints' residuals vanish; friction could explain that of one joint."""
    explained = (found.before > _LOW) & (found.after < 0.5 * found.before)
    return bool(explained.sum() >= _LEAST_JOINTS and np.all(found.after <= _LOW))
