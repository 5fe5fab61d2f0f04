"""Episodes: time windows in which several joints have an effort that no model explains.

A contact is no property of the robot, so that nothing can be learned of it from other parts of a
log. It is looked for in the residual itself: a window in which two joints or more err far beyond
what they do elsewhere, a body whose wrench explains them all, and, as evidence, that the wrench of
one half of the window, in alternate pieces, predicts the other.
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
_HIGH, _LOW = 12.0, 4.0  # of their typical size: within an episode, and at its ends
_LEAST_JOINTS = 2
MOST_TIME = 0.3  # share of a log: what is there longer is no contact
_MOST = 8
_LEAST_SHARE = 0.6  # of the squared error in the window that the wrench must predict
_HOPELESS = 0.2  # share that the best guess takes before its times and point are looked for
# So many guesses whose wrench predicts most, and so many whose wrench fits best, have their times
# and point looked for: edges that are not exact yet spoil what the right wrench predicts.
_REFINED = 4
_AS_GOOD = 0.9  # share of the best body's reduction with which one nearer to the base is preferred
_MODEL = 0.05  # share of its effort that even a right contact leaves unexplained
_REST = 1.0  # s, of standing still that do not end an episode
_RISE = 0.03  # s, at first
_ROBUST_FITS = 12


@dataclass(frozen=True, eq=False)
class _Scale:
    """Residuals of all joints on one grid of time for each log, over their typical size.

    They are NaN, and the size is one, at joints without rows.
    """

    size: Array
    grids: list[Array]
    periods: list[float]


def find_episodes(
    case: Case, hypothesis: Hypothesis, on_time: tuple[int, ...]
) -> tuple[PointEpisode, ...]:
    """Return contacts that stand out in the residual of a robust fit of a hypothesis.

    The model's own delays are `on_time`, indices of the dataset's.
    """
    scale = _scaled(case, hypothesis, on_time)
    windows = _new_windows(case, hypothesis, scale)
    motion = full_motion(case) if windows else []
    cut = [(w[0], _cut_out(case, scale, motion, w)) for w in windows]
    names = [trajectory.name for trajectory in case.trajectories]
    tried = [_contacts(case, names[k], w, len(windows)) for k, w in cut if w is not None]
    return tuple(contact for contacts in tried for contact in contacts)


def _new_windows(case: Case, hypothesis: Hypothesis, scale: _Scale) -> list[Window]:
    """Return windows where the hypothesis has no contact; none if there are many."""
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
    """Return the standard deviation of residuals (K,), robust to outliers."""
    return max(float(np.median(np.abs(residual))) / 0.6745, least)


class _Grids:
    """Grids of time, one for each log, and where on them each joint has rows."""

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
        """Return values (K,) of each joint over a size, as (T, n) of each log; NaN without row."""
        grids = []
        for length, places in zip(self._lengths, self._places, strict=True):
            grid = np.full((length, len(values)), np.nan)
            for k, (rows, at) in enumerate(places):
                grid[at, k] = values[k][rows] / size[k]
            grids.append(grid)
        return grids

    def at_rows(self, grids: Sequence[Array], joint: int, count: int) -> Array:
        """Return what grids (T,) of the logs have at the rows (count,) of a joint."""
        found = np.empty(count)
        for grid, places in zip(grids, self._places, strict=True):
            rows, at = places[joint]
            found[rows] = grid[at]
        return found


def _robust_residuals(
    case: Case, hypothesis: Hypothesis, on_time: tuple[int, ...]
) -> list[JointResidual]:
    """Fit again with little weight on windows of large errors, and return the residual.

    An ordinary fit bends towards a contact and spreads its error over the whole log. So may a
    delay: efforts that are on time are tried, too. Bounds of parameters are left aside.
    """
    dataset, unknowns = hypothesis.dataset, hypothesis.unknowns
    columns = list[tuple[Array, NDArray[np.intp]]]()  # of each joint, and which unknowns' they are
    joints, efforts = joint_residuals(case, hypothesis), list[Array]()
    moving = np.flatnonzero([data.samples.any() for data in dataset.data])
    for j in moving:
        data = dataset.data[j]
        parts, local = [part for kept in data.rows for part in kept], data.local(unknowns.columns)
        A, felt = np.concatenate([part.A for part in parts]), np.flatnonzero(local >= 0)
        columns.append((A[:, local[felt]], felt))
        efforts.append(np.concatenate([part.b for part in parts]))
    grids = _Grids(joints, [trajectory.filter.output_period for trajectory in case.trajectories])
    least = np.maximum(dataset.noise_floor, LEAST_NOISE * np.maximum(dataset.effort_std, 1e-12))

    def sizes(left: Sequence[Array]) -> Array:
        return np.array([_typical(own, least[j]) for j, own in zip(moving, left, strict=True)])

    def settled(x: Array, delay: tuple[int, ...]) -> list[Array]:
        """Return the residuals (K,) of each joint after fits that begin with parameters (p,)."""
        rows = [(*own, b[:, delay[j]]) for j, own, b in zip(moving, columns, efforts, strict=True)]
        left = [b - A @ x[felt] for A, felt, b in rows]
        for _ in range(_ROBUST_FITS):
            size, H = sizes(left), unknowns.information.copy()
            right = H @ unknowns.mean + unknowns.pull
            means = [
                _averaged(grid, period).mean(axis=1)
                for grid, period in zip(grids.of(left, size), grids.periods, strict=True)
            ]
            for k, (A, felt, b) in enumerate(rows):
                share = hypothesis.power[moving[k]] / (len(b) * size[k] ** 2)
                weight = share / (1.0 + grids.at_rows(means, k, len(b)) / _LOW)
                weighted = weight[:, None] * A
                H[np.ix_(felt, felt)] += weighted.T @ A
                right[felt] += weighted.T @ b
            untold = np.flatnonzero(np.diagonal(H) <= 0.0)  # neither by data nor by a prior
            H[untold, untold], right[untold] = 1.0, unknowns.mean[untold]
            factor, scale = scaled_cholesky(H)
            x = scale * solved(factor, scale * right)
            left = [b - A @ x[felt] for A, felt, b in rows]
        return left

    tried = [settled(hypothesis.held_out.x.mean(axis=0), hypothesis.delay)]
    if hypothesis.delay != on_time:
        tried.append(settled(unknowns.mean, on_time))
    best = min(tried, key=lambda left: float(np.log(sizes(left)).sum()))
    return [replace(joint, residual=own) for joint, own in zip(joints, best, strict=True)]


def _averaged(grid: Array, period: float) -> Array:
    """Return squares (T, n) of values averaged over a time; 1 where there is none."""
    known, width = np.isfinite(grid), max(3, round(_AVERAGE / period))
    sums, counts = (
        uniform_filter1d(values, width, axis=0, mode="nearest")
        for values in (np.where(known, np.square(grid), 0.0), known.astype(float))
    )
    return np.where(known, sums / np.maximum(counts, 1.0 / width), 1.0)


def _windows(log: int, grid: Array, period: float) -> Iterator[Window]:
    """Yield log, start and end of windows in which several joints have unusual errors."""
    known, mean = np.isfinite(grid), _averaged(grid, period)
    # At rest nothing is known; a push goes on meanwhile.
    rows = np.flatnonzero(known.any(1))
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
    here, time, outputs = cut
    place = np.rint(outputs / low_pass.output_period).astype(int)
    inside = (place >= 0) & (place < len(scale.grids[log]))
    residual = np.full((len(outputs), len(scale.size)), np.nan)
    residual[inside] = scale.grids[log][place[inside]]
    model = case.model
    bodies = RobotBodies(model.tree, model.positions(here.position), model.total_phi)
    within = residual[(outputs >= start) & (outputs <= end)]
    known = np.maximum((~np.isnan(within)).sum(0), 1)
    size = np.sqrt(1.0 + _MODEL**2 * (np.nansum(np.square(within), 0) / known))
    return ResidualWindow(
        start, end, time, bodies, outputs, residual / size, size * scale.size, low_pass
    )


def _contacts(case: Case, log: str, window: ResidualWindow, tried: int) -> list[PointEpisode]:
    """Return the contacts that explain a window, most probable first.

    They are of one body, one whose wrench turns with it and one whose wrench does not.
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
    shapes = [refined(window, rough[k], tries=FEW) for k in sorted({*by_share, *by_fit})]
    tried_shapes = [(shape, evidence(window, shape)) for shape in shapes]
    best = max(found.share for _, found in tried_shapes)
    if best < 0.5 * _LEAST_SHARE:
        return []
    good = [(s, found) for s, found in tried_shapes if found.share >= _AS_GOOD * best]
    nearest = next((shape for shape, found in good if _explains_all(found)), good[0][0])
    same = [(_explains_all(f), f.share, s) for s, f in good if s.body == nearest.body]
    convincing, turning = list[PointEpisode](), set[int]()
    for *_, shape in sorted(same, key=lambda each: each[:2], reverse=True):
        if shape.turning in turning:
            continue
        turning.add(shape.turning)
        contact = refined(window, shape)
        found = evidence(window, contact)
        # Times, rise and point were looked for too, the body, and whether it turns.
        chance = chi2_tail(found.gain, found.felt + contact.free_shapes)
        chance = min(1.0, tried * len(guesses) * chance)
        if found.share >= _LEAST_SHARE and chance <= ALARM and _explains_all(found):
            convincing.append(contact)
    return convincing


def _explains_all(found: Predicted) -> bool:
    """Return whether several joints' residuals vanish; friction could explain one joint's."""
    explained = (found.before > _LOW) & (found.after < 0.5 * found.before)
    return bool(explained.sum() >= _LEAST_JOINTS and np.all(found.after <= _LOW))
