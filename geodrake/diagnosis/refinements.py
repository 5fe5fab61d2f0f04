"""Refinement of nonlinear parameters: delays, shapes, expansion points, loads.

Each is a coordinate of the explanation. Columns are made anew for its neighbouring values.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.log_model import Choice, Fit, LogModel
from geodrake.diagnosis.terms import Term, is_expandable
from geodrake.effects import FittedEffect
from geodrake.effects.base import Effect
from geodrake.effects.sensors import effort_delays
from geodrake.identification.logs.case import Case, reduced
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.reduce import peak_speeds, sign_widths
from geodrake.inertia import is_physical

Array = NDArray[np.float64]

_SHARES = (0.75, 0.5, 0.25, 0.0)  # of a step to bodies that are not physical
_MARGIN = 1.5  # of the noise, above which other speeds at which friction fades are tried
_MOST = 0.5  # of the squared error is what another speed must leave at most
_SAME = 1e-9  # delays that differ by less are the same, s
_OTHER_LOADS = 0.02
"""Columns are made anew if a load changes by more than this share of the effort's deviation."""


def least_between(offsets: Array, errors: Array) -> tuple[float, float]:
    """Return where the parabola through three errors is least, and the deviation of that place.

    `offsets` (3,) are in order, from the middle one on, which is zero, and `errors` (3,) are those
    there, twice log-likelihoods. Without a minimum it stays, and its deviation is infinite.
    """
    (first, _, last), (low, middle, high) = offsets.tolist(), errors.tolist()
    slopes = (low - middle) / first, (high - middle) / last
    curvature = (slopes[1] - slopes[0]) / (last - first)
    slope = slopes[0] - curvature * first
    if curvature <= 0.0:
        return 0.0, float("inf")
    step = float(np.clip(-slope / (2.0 * curvature), offsets[0], offsets[-1]))
    return step, curvature**-0.5


# Delays.


def delays_of(model: LogModel, fit: Fit) -> tuple[Array, Array]:
    """Find the delays near those of a fit at which it is most probable.

    Returned are those (nv,) on top of the model's, s, and their standard deviations (nv,), s;
    infinite where unknown.
    """
    dataset, delay = model.dataset, fit.choice.delay
    joints = np.arange(len(delay))
    seconds = dataset.delays[list(delay), joints].copy()
    deviations = np.full(len(delay), np.inf)
    late = model.lateness(fit.choice)
    alone = [[j] for j in np.flatnonzero(np.abs(late) > _SAME).tolist()]
    alike = len(alone) == len(late) and np.ptp(late) < _SAME
    for moved in [joints.tolist()] if alike else alone:
        grid, own = dataset.delays[:, moved[0]], delay[moved[0]]
        order = np.argsort(grid)
        if alike:  # each joint may have been advanced by another delay
            apart = np.ptp(dataset.delays - dataset.delays[own], axis=1)
            order = order[apart[order] < _SAME]
        order = order[(np.abs(grid[order] - grid[own]) > _SAME) | (order == own)]
        order = order[np.diff(grid[order], prepend=-np.inf) > _SAME]
        at = int(np.flatnonzero(order == own)[0])
        while 0 < at < len(order) - 1:
            near = order[at - 1 : at + 2]
            scores = [_score_at(model, fit, moved, int(k)) for k in near]
            if any(score is None for score in scores):
                break
            errors = -np.array(scores, float)
            better = int(np.argmin(errors)) - 1
            if errors[1] <= errors[1 + better] + 1e-9:
                step, deviations[moved] = least_between(grid[near] - grid[order[at]], errors)
                seconds[moved] += step
                break
            at += better
            seconds[moved] = dataset.delays[order[at], moved]
    return seconds, deviations


def common_delay(delays: Array, deviations: Array) -> float | None:
    """Return the mean, s, of the delays (nv,) found at some joints; None if all joints have one.

    Each counts by its deviation (nv,), s.
    """
    late = np.abs(delays) > _SAME
    if np.ptp(delays) < _SAME:
        return None
    known = deviations[late]  # infinite where unknown
    weights = known**-2.0 if np.isfinite(known).any() else None
    return float(np.average(delays[late], weights=weights))


def _score_at(model: LogModel, fit: Fit, joints: list[int], delay: int) -> float | None:
    """Return the score of a fit with another delay of some joints, prior odds left aside."""
    late = tuple(delay if j in joints else own for j, own in enumerate(fit.choice.delay))
    choice = Choice(fit.terms, fit.choice.width, late)
    found = model.fit(choice, model.shares(fit), fit.noise, is_timed=True)
    return None if found is None else found.score + model.odds_against(choice)


def fitted_delays(delays: Array, joints: Sequence[str]) -> list[FittedEffect]:
    """Return the effects of a fitted model that make delays (nv,), s, at its joints."""
    none = np.empty(0)
    return [FittedEffect(effect, none, none) for effect in effort_delays(delays, joints)]


# Shapes.


def finer_shapes(
    effect: Effect, grid: Sequence[Effect], tried: Container[Effect], level: int
) -> tuple[list[Effect], int]:
    """Return shapes around that of an effect that are not tried yet, and the level after theirs.

    They are between those of a grid, the finer the higher the level is. Where there are none, all
    levels are done.
    """
    near = list[Effect]()
    while not near and level < LEVELS:
        near = [e for e in _finer(effect, grid, _STEPS[level]) if e not in tried]
        level += 1
    return near, level


_STEPS = (1.0 / 3.0, 1.0 / 12.0, 1.0 / 48.0)
"""Steps of finer and finer grids of a shape, in steps of the coarse one."""
LEVELS = len(_STEPS)


def _finer(effect: Effect, grid: Sequence[Effect], share: float) -> list[Effect]:
    """Return neighbours of an effect's shape, two to either side where they make sense.

    There are none where no parameter varies on the grid, more than one does, or not continuously:
    one of two values is a choice.
    """
    values = _values(effect, grid)
    varied = [(name, found) for name, found in values.items() if len(found) > 2]
    if len(varied) != 1 or not all(isinstance(x, float) and x > 0.0 for x in varied[0][1]):
        return []
    name, known = varied[0][0], np.sort(np.array([*varied[0][1]]))
    value, gaps = getattr(effect, name), np.diff(np.log(known))
    at = int(np.clip(np.searchsorted(known, value) - 1, 0, len(gaps) - 1))
    steps = share * gaps[at] * np.array([-2.0, -1.0, 1.0, 2.0])
    # Rounded, so that shapes around two others are the same where they meet.
    values_near = [float(f"{value * factor:.9g}") for factor in np.exp(steps)]
    near = [replace(effect, **{name: each}) for each in values_near]  # type: ignore[type-var]
    return [e for e in near if e.distinct and bool(e.refines) == bool(effect.refines)]


def _values(effect: Effect, grid: Sequence[Effect]) -> dict[str, set[Any]]:
    """Return the values of each field that an effect has on a grid at its place."""
    tried = [e for e in grid if e.name == effect.name and e.where == effect.where]
    return {f.name: {getattr(e, f.name) for e in tried} for f in fields(effect)}  # type: ignore[arg-type]


def other_choices(model: LogModel, fit: Fit, grid: Sequence[Effect]) -> Iterator[Term]:
    """Yield, for each term of a fit, the most probable one with the other of two possible values.

    The wrong value may look better while the other shape parameters are on a coarse grid.
    """
    for term in fit.terms:
        if term.effect is None:
            continue
        choices = [name for name, found in _values(term.effect, grid).items() if len(found) == 2]
        others = [
            model.choice(fit.choice, [other if each is term else each for each in fit.terms])
            for other in model.terms
            if other.key == term.key
            and any(getattr(other.effect, n) != getattr(term.effect, n) for n in choices)
        ]
        for best in model.ranked(others, model.shares(fit), fit.noise)[:1]:
            yield next(each for each in best.terms if each.key == term.key)


# What columns are slopes of.


def expansions(case: Case, model: LogModel, fit: Fit) -> dict[Effect, Effect]:
    """Return the effects whose columns are slopes, moved to the fitted point, by effect."""
    slopes = {t.effect: t for t in fit.terms if t.effect is not None and is_expandable(t.effect)}
    if not slopes:
        return {}
    bodies = case.model.bodies_at_rest
    moved = {e: e.expanded_about(model.parameters(fit, t), bodies) for e, t in slopes.items()}
    return {effect: other for effect, other in moved.items() if other != effect}


# Loads.


def fitted_loads(
    case: Case, model: LogModel, fit: Fit, before: Array | None = None
) -> Array | None:
    """Return the bodies (nb, 10) of a fit with what they carry; None if loads barely change.

    They are compared with those of the columns, and with others from `before`.

    Friction that grows with the load, gears that give way or have play: what they do is known at
    the right instants only if the load is. Where the ground pushes, motors say what it is.
    """
    if all(trajectory.is_grounded for trajectory in case.trajectories):
        return None
    robot, was = case.model, case.load_model.phi
    phi = model.bodies(fit)
    for term in fit.terms:
        if term.is_body and term.effect is not None:
            phi[robot.bodies.index(term.where[0])] += model.parameters(fit, term)
    step = phi - robot.phi
    for share in _SHARES:
        beyond = ~is_physical(phi)
        phi[beyond] = robot.phi[beyond] + share * step[beyond]
    known = [was] if before is None else [was, before]
    changes = [_change_of_load(model.dataset, (phi - each).ravel()) for each in known]
    return phi if min(changes) >= _OTHER_LOADS else None


def _change_of_load(dataset: Dataset, step: Array) -> float:
    """Return how much a step of all inertial parameters changes a joint's effort, by its RMS."""
    most = 0.0
    for data, deviation in zip(dataset.data, dataset.effort_std, strict=True):
        local = data.local(np.arange(len(step)))
        seen = local >= 0
        rows, moved = int(data.samples.sum()), np.zeros(len(data.columns))
        moved[local[seen]] = step[seen]
        power = float(np.square(data.factors[:, :, : len(moved)] @ moved).sum())
        if rows and deviation > 0.0:
            most = max(most, float(np.sqrt(power / rows)) / deviation)
    return most


# The speed below which dry friction fades.


def fading_speeds(case: Case, model: LogModel, fit: Fit) -> Array | None:
    """Find the speeds (nv,) below which the dry friction of each joint fades, rad/s or m/s.

    Surfaces that touch give way a little before they slide, so that measured dry friction does not
    jump where a joint turns round.

    None where no joint has less than half of its squared error with another speed than now.
    Friction that fades with the way from a reversal on, as real friction does, has more: a speed
    found for it does not hold where joints creep.
    """
    robot, logs = case.model, case.trajectories
    effects = [*model.unknowns.effects, *(t.effect for t in fit.terms if t.effect is not None)]
    rubbing = {place for effect in effects if effect.jumps for place in effect.where}
    least = sign_widths(replace(robot, fading_speed=None), logs)
    most = _FASTEST * peak_speeds(logs)
    known = np.zeros(len(least)) if robot.fading_speed is None else robot.fading_speed

    def errors(speeds: Array) -> Array:
        """Return (nv,) mean squared residuals, what is not known of reversals left aside."""
        other = replace(robot, fading_speed=speeds)
        there = replace(case, model=other, shared=case.shared.read_only())
        dataset = reduced(there, list(dict.fromkeys(effects)))
        bare = LogModel(other, dataset, effects, model.beliefs, model.on_time, loads=case.loads)
        return bare.refitted(fit).variance

    before = errors(known)
    tried = np.array([joint in rubbing for joint in robot.joints]) & (least < most)
    tried &= before > np.square(_MARGIN * model.dataset.noise_floor)
    if not tried.any():
        return None
    speeds, left = [known], [before]
    for power in range(1, _DOUBLINGS + 1):
        speeds.append(np.where(tried, np.minimum(least * 2.0**power, most), known))
        left.append(errors(speeds[-1]))
        if np.all(speeds[-1][tried] >= most[tried]):
            break
    best, joints = np.argmin(left, axis=0), np.arange(len(known))
    hopeful = tried & (np.min(left, axis=0) <= _HOPEFUL * before) & (best > 0)
    if not hopeful.any():
        return None
    found, least_left = np.where(hopeful, np.array(speeds)[best, joints], known), before
    for ratio in _NEARER:
        factors = np.array([1.0 / ratio, 1.0, ratio])
        left = [errors(np.where(hopeful, found * each, known)) for each in factors]
        least_left = np.min([least_left, *left], axis=0)
        for j in np.flatnonzero(hopeful).tolist():
            near = np.log([each[j] for each in left])
            found[j] *= np.exp(least_between(np.log(factors), near)[0])
    clear = hopeful & (least_left <= _MOST * before)
    return np.where(clear, found, known) if clear.any() else None


_FASTEST = 0.1
"""Dry friction fades below this share of a joint's peak speed at most."""
_DOUBLINGS = 7
_HOPEFUL, _NEARER = 0.75, (1.7, 1.2)
"""Where no more than this share of the squared error is left, speeds of these ratios are tried."""
