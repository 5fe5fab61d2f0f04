"""Episodes: stretches of time in which several joints feel what no model of the motion explains.

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
from geodrake.diagnosis.residuals import cut_out, full_motion, joint_residuals
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.episode import PointEpisode
from geodrake.effects.robot_motion import log_number
from geodrake.identification.logs.case import Case, error_table, reduced
from geodrake.identification.logs.criteria import ALARM
from geodrake.identification.logs.evidence import chi2_tail
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.logs.folds import set_apart
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
_HOPELESS = 0.2  # share that the best guess predicts before its times and point are looked for
_REFINED = 4  # guesses whose times and point are looked for
_AS_GOOD = 0.9  # share of the best body's reduction with which one nearer to the base is preferred
_MODEL = 0.05  # share of its effort that even a right contact leaves unexplained
_REST = 1.0  # s, of standing still that do not end an episode
_MARGIN = 0.3  # s, around a window that is set apart
_RISE = 0.03  # s, at first
_FIXED = 1e-3  # of the width of their prior: inertias stay as they are


@dataclass(frozen=True, eq=False)
class _Scale:
    """Residuals of all joints on one grid of time for each log, over their typical size."""

    size: Array
    grids: list[Array]
    periods: list[float]


def find_episodes(case: Case, hypothesis: Hypothesis) -> tuple[PointEpisode, ...]:
    """Return contacts that stand out of the held-out residuals of a hypothesis."""
    tried = [hypothesis]
    if not error_table(case.dataset, hypothesis.held_out).is_noise:
        # Bodies that are free to follow a contact spread its error all over the log.
        tried.append(hypothesis.loosened(_FIXED / hypothesis.prior_scale))
    for each in tried:
        scale, windows = _seen(case, each)
        found, promising = _contacts(case, scale, windows)
        if not found and promising:
            found = _contacts_apart(case, each, windows)
        if found:
            return found
    return ()


def _contacts_apart(
    case: Case, hypothesis: Hypothesis, windows: Sequence[Window]
) -> tuple[PointEpisode, ...]:
    """Return contacts in what a fit leaves that has not seen some windows, nor followed these."""
    wide = [(log, start - _MARGIN, end + _MARGIN) for log, start, end in windows]
    apart = replace(case, folds=set_apart(case.folds, case.trajectories, wide))
    dataset = reduced(apart, hypothesis.unknowns.effects)
    apart = replace(apart, dataset=dataset)
    moved = hypothesis.moved(dataset, delay=hypothesis.delay)
    unseen = np.broadcast_to(moved.held_out.x[-1], moved.held_out.x.shape)
    return _contacts(apart, *_seen(apart, moved, unseen))[0]


def _seen(
    case: Case, hypothesis: Hypothesis, x: Array | None = None
) -> tuple[_Scale, list[Window]]:
    """Return residuals, and windows where the hypothesis has no contact; none if there are many.

    They are of held-out parameters (F, p) of the folds, or of others.
    """
    scale = _scaled(case, hypothesis, x)
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
    return scale, windows if len(windows) <= _MOST else []


def _contacts(
    case: Case, scale: _Scale, windows: Sequence[Window]
) -> tuple[tuple[PointEpisode, ...], bool]:
    """Return contacts that explain windows, and whether one explains a good part of one."""
    motion = full_motion(case) if windows else []
    cut = [(w[0], _cut_out(case, scale, motion, w)) for w in windows]
    names = [trajectory.name for trajectory in case.trajectories]
    tried = [_contact(case, names[k], w, len(windows)) for k, w in cut if w is not None]
    found = tuple(contact for contacts, _ in tried for contact in contacts)
    return found, any(share >= 0.5 * _LEAST_SHARE for _, share in tried)


def _scaled(case: Case, hypothesis: Hypothesis, x: Array | None) -> _Scale:
    joints = joint_residuals(case, hypothesis, x)
    periods = [trajectory.filter.output_period for trajectory in case.trajectories]
    sizes = np.array([np.median(np.abs(j.residual)) / 0.6745 for j in joints])
    size = np.maximum(sizes, np.finfo(float).tiny)
    grids = []
    for log, period in enumerate(periods):
        kept = [joint.part(joint.log == log) for joint in joints]
        places = [np.rint(joint.time / period).astype(int) for joint in kept]
        length = 1 + max((int(place.max()) for place in places if len(place)), default=0)
        grid = np.full((length, len(joints)), np.nan)
        for k, (joint, place) in enumerate(zip(kept, places, strict=True)):
            grid[place, k] = joint.residual / size[k]
        grids.append(grid)
    return _Scale(size, grids, periods)


def _windows(log: int, grid: Array, period: float) -> Iterator[Window]:
    """Log, start and end of stretches in which several joints err beyond the usual."""
    known, width = np.isfinite(grid), max(3, round(_AVERAGE / period))
    sums, counts = (
        uniform_filter1d(values, width, axis=0, mode="nearest")
        for values in (np.where(known, np.square(grid), 0.0), known.astype(float))
    )
    mean = np.where(known, sums / np.maximum(counts, 1.0 / width), 1.0)
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


def _contact(
    case: Case, log: str, window: ResidualWindow, tried: int
) -> tuple[list[PointEpisode], float]:
    """Return the contacts that explain a window, likeliest first, and the share that the best does.

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
    shares = [evidence(window, guess).share for guess in rough]
    best = max(shares)
    if best < _HOPELESS:
        return [], best
    order = sorted(range(len(rough)), key=lambda k: -shares[k])[:_REFINED]
    shapes = [refined(window, rough[k], tries=FEW) for k in sorted(order)]
    tried_shapes = [(shape, evidence(window, shape)) for shape in shapes]
    best = max(found.share for _, found in tried_shapes)
    if best < 0.5 * _LEAST_SHARE:
        return [], best
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
    return convincing, best


def _explains_all(found: Predicted) -> bool:
    """Return whether several joints' residuals vanish; friction could explain one joint's."""
    explained = (found.before > _LOW) & (found.after < 0.5 * found.before)
    return bool(explained.sum() >= _LEAST_JOINTS and np.all(found.after <= _LOW))
