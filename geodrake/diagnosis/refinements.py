"""Refinement of nonlinear parameters: delays, shapes, expansion points, loads.

Each is a coordinate of the explanation; columns are recomputed for neighbouring values.
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

_SHARES = (0.75, 0.5, 0.25, 0.0)  # of a step that leads to unphysical bodies
_MARGIN = 1.5  # least residual over the noise, to try fading speeds
_MOST = 0.5  # largest ratio of squared errors with and without a fading speed
_SAME = 1e-9  # largest difference of equal delays, s
_OTHER_LOADS = 0.02
"""Least change of loads, over the effort's deviation, to recompute columns."""


def parabola_minimum(offsets: Array, errors: Array) -> tuple[float, float]:
    """Return the minimum of the parabola through three errors, and its standard deviation.

    `offsets` (3,) are in order and relative to the middle one, and `errors` (3,) are −2
    log-likelihoods. Without a minimum, the result is zero with an infinite deviation.
    """
    (first, _, last), (left, middle, right) = offsets.tolist(), errors.tolist()
    slopes = (left - middle) / first, (right - middle) / last
    curvature = (slopes[1] - slopes[0]) / (last - first)
    slope = slopes[0] - curvature * first
    if curvature <= 0.0:
        return 0.0, float("inf")
    step = float(np.clip(-slope / (2.0 * curvature), offsets[0], offsets[-1]))
    return step, curvature**-0.5


# Delays.


def delays_of(model: LogModel, fit: Fit) -> tuple[Array, Array]:
    """Return the most probable delays close to those of a fit, and their standard deviations.

    Delays (nv,), s, are relative to the model's; deviations (nv,), s, are infinite where unknown.
    """
    dataset, delay = model.dataset, fit.choice.delay
    joints = np.arange(len(delay))
    seconds = dataset.delays[list(delay), joints].copy()
    deviations = np.full(len(delay), np.inf)
    delays = model.lateness(fit.choice)
    singles = [[j] for j in np.flatnonzero(np.abs(delays) > _SAME).tolist()]
    is_common = len(singles) == len(delays) and np.ptp(delays) < _SAME
    for moved in [joints.tolist()] if is_common else singles:
        grid, current = dataset.delays[:, moved[0]], delay[moved[0]]
        order = np.argsort(grid)
        if is_common:  # joints may have been advanced by different delays
            spread = np.ptp(dataset.delays - dataset.delays[current], axis=1)
            order = order[spread[order] < _SAME]
        order = order[(np.abs(grid[order] - grid[current]) > _SAME) | (order == current)]
        order = order[np.diff(grid[order], prepend=-np.inf) > _SAME]
        index = int(np.flatnonzero(order == current)[0])
        while 0 < index < len(order) - 1:
            near = order[index - 1 : index + 2]
            scores = [_score_at(model, fit, moved, int(k)) for k in near]
            if any(score is None for score in scores):
                break
            errors = -np.array(scores, float)
            better = int(np.argmin(errors)) - 1
            if errors[1] <= errors[1 + better] + 1e-9:
                offsets = grid[near] - grid[order[index]]
                step, deviations[moved] = parabola_minimum(offsets, errors)
                seconds[moved] += step
                break
            index += better
            seconds[moved] = dataset.delays[order[index], moved]
    return seconds, deviations


def common_delay(delays: Array, deviations: Array) -> float | None:
    """Return the mean, s, of the delays (nv,) found at some joints; None if all joints have one.

    Delays are weighted by their deviations (nv,), s.
    """
    differs = np.abs(delays) > _SAME
    if np.ptp(delays) < _SAME:
        return None
    known = deviations[differs]  # infinite where unknown
    weights = known**-2.0 if np.isfinite(known).any() else None
    return float(np.average(delays[differs], weights=weights))


def _score_at(model: LogModel, fit: Fit, joints: list[int], delay: int) -> float | None:
    """Return the score of a fit with another delay of some joints, without prior odds."""
    delays = tuple(delay if j in joints else own for j, own in enumerate(fit.choice.delay))
    choice = Choice(fit.terms, fit.choice.width, delays)
    other_fit = model.fit(choice, model.shares(fit), fit.noise, is_timed=True)
    return None if other_fit is None else other_fit.score + model.odds_against(choice)


def fitted_delays(delays: Array, joints: Sequence[str]) -> list[FittedEffect]:
    """Return the effects of delays (nv,), s, at the joints of a fitted model."""
    none = np.empty(0)
    return [FittedEffect(effect, none, none) for effect in effort_delays(delays, joints)]


# Shapes.


def finer_shapes(
    effect: Effect, grid: Sequence[Effect], tried: Container[Effect], level: int
) -> tuple[list[Effect], int]:
    """Return untried shapes around an effect's shape, and the next level.

    They refine a grid, more finely at higher levels. If there are none, all levels are done.
    """
    near = list[Effect]()
    while effect.shapes and not near and level < LEVELS:
        near = [e for e in _finer(effect, grid, _STEPS[level]) if e not in tried]
        level += 1
    return near, level


_STEPS = (1.0 / 3.0, 1.0 / 12.0, 1.0 / 48.0)
"""Steps of refined grids of a shape, relative to the coarse one."""
LEVELS = len(_STEPS)


def _varied(effect: Effect, grid: Sequence[Effect]) -> tuple[str, Array] | None:
    """Return the only parameter of a shape that varies continuously on a grid, and its values.

    A parameter with two values is a choice. The result is None if several parameters vary, or if a
    value is not positive.
    """
    varied = [(name, found) for name, found in _values(effect, grid).items() if len(found) > 2]
    if len(varied) != 1 or not all(isinstance(x, float) and x > 0.0 for x in varied[0][1]):
        return None
    return varied[0][0], np.sort(np.array([*varied[0][1]]))


def _finer(effect: Effect, grid: Sequence[Effect], share: float) -> list[Effect]:
    """Return neighbours of an effect's shape, up to two on either side."""
    varied = _varied(effect, grid)
    if varied is None:
        return []
    name, known = varied
    value, gaps = getattr(effect, name), np.diff(np.log(known))
    index = int(np.clip(np.searchsorted(known, value) - 1, 0, len(gaps) - 1))
    steps = share * gaps[index] * np.array([-2.0, -1.0, 1.0, 2.0])
    # Rounding makes neighbours of different shapes equal where they meet.
    values_near = [float(f"{value * factor:.9g}") for factor in np.exp(steps)]
    neighbours = [replace(effect, **{name: each}) for each in values_near]  # type: ignore[type-var]
    return [e for e in neighbours if e.distinct and bool(e.refines) == bool(effect.refines)]


def gain_of_finer_shape(model: LogModel, fit: Fit, term: Term, grid: Sequence[Effect]) -> float:
    """Return the gain in score by the best shape between a term's neighbours, by a parabola.

    It is infinite if a neighbour is missing, is better, or violates its bounds.
    """
    effect, unknown = term.effect, float("inf")
    varied = None if effect is None else _varied(effect, grid)
    if effect is None or varied is None:
        return unknown
    name, _ = varied
    alike = {
        getattr(t.effect, name): t
        for t in model.terms
        if t.key == term.key and t.effect == replace(effect, **{name: getattr(t.effect, name)})  # type: ignore[type-var]
    }
    value = getattr(effect, name)
    alike[value], values = term, sorted(alike)
    at, scores = values.index(value), list[float]()
    near = values[at - 1 : at + 2] if 0 < at < len(values) - 1 else []
    rest = [t for t in fit.terms if t.key != term.key]
    for each in near:
        choice = model.choice(fit.choice, [*rest, alike[each]])
        found = model.fit(choice, model.shares(fit), fit.noise)
        scores += [] if found is None else [found.score + model.odds_against(choice)]
    if len(scores) < 3 or np.argmax(scores) != 1:
        return unknown
    step, deviation = parabola_minimum(np.log(np.array(near) / value), -np.array(scores))
    return float((step / deviation) ** 2)


def _values(effect: Effect, grid: Sequence[Effect]) -> dict[str, set[Any]]:
    """Return the values of each field of an effect on a grid at its place."""
    tried = [e for e in grid if e.name == effect.name and e.where == effect.where]
    return {f.name: {getattr(e, f.name) for e in tried} for f in fields(effect)}  # type: ignore[arg-type]


def other_choices(model: LogModel, fit: Fit, grid: Sequence[Effect]) -> Iterator[Term]:
    """Yield, for each term of a fit, the most probable term with the other of two values.

    The wrong value may be more probable while the other shape parameters are on a coarse grid.
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


# Expansion points.


def expansions(case: Case, model: LogModel, fit: Fit) -> dict[Effect, Effect]:
    """Return effects whose columns are slopes -> the same, expanded about the fitted point."""
    terms = {t.effect: t for t in fit.terms if t.effect is not None and is_expandable(t.effect)}
    if not terms:
        return {}
    bodies = case.model.bodies_at_rest
    moved = {e: e.expanded_about(model.parameters(fit, t), bodies) for e, t in terms.items()}
    return {effect: other for effect, other in moved.items() if other != effect}


# Loads.


def fitted_loads(
    case: Case, model: LogModel, fit: Fit, before: Array | None = None
) -> Array | None:
    """Return the bodies (nb, 10) of a fit with payloads; None if loads barely change.

    They are compared with those of the columns, and with `before`.

    The load determines friction that grows with it, and deflections and play of gears. On the
    ground, it follows from the motors' efforts.
    """
    if all(trajectory.is_grounded for trajectory in case.trajectories):
        return None
    robot, current = case.model, case.load_model.phi
    phi = model.bodies(fit)
    for term in fit.terms:
        if term.is_body and term.effect is not None:
            phi[robot.bodies.index(term.where[0])] += model.parameters(fit, term)
    step = phi - robot.phi
    for share in _SHARES:
        unphysical = ~is_physical(phi)
        phi[unphysical] = robot.phi[unphysical] + share * step[unphysical]
    others = [current] if before is None else [current, before]
    changes = [_change_of_load(model.dataset, (phi - other).ravel()) for other in others]
    return phi if min(changes) >= _OTHER_LOADS else None


def _change_of_load(dataset: Dataset, step: Array) -> float:
    """Return the largest RMS change of a joint's effort by a step, over the effort's deviation."""
    most = 0.0
    for data, deviation in zip(dataset.data, dataset.effort_std, strict=True):
        local = data.local(np.arange(len(step)))
        used = local >= 0
        rows, moved = int(data.samples.sum()), np.zeros(len(data.columns))
        moved[local[used]] = step[used]
        power = float(np.square(data.factors[:, :, : len(moved)] @ moved).sum())
        if rows and deviation > 0.0:
            most = max(most, float(np.sqrt(power / rows)) / deviation)
    return most


# Speeds below which dry friction fades.


def fading_speeds(case: Case, model: LogModel, fit: Fit) -> Array | None:
    """Return the speeds (nv,) below which the dry friction of each joint fades, rad/s or m/s.

    Surfaces deform before they slide, so that dry friction does not jump at a reversal. The result
    is None unless the squared error of some joint falls by half. Real friction fades with
    displacement from a reversal rather than with speed, and leaves more error: a fitted speed would
    be wrong in slow motion.
    """
    robot, logs = case.model, case.trajectories
    effects = [*model.unknowns.effects, *(t.effect for t in fit.terms if t.effect is not None)]
    rubbing = {place for effect in effects if effect.jumps for place in effect.where}
    least = sign_widths(replace(robot, fading_speed=None), logs)
    largest = _FASTEST * peak_speeds(logs)
    current = np.zeros(len(least)) if robot.fading_speed is None else robot.fading_speed

    def errors(speeds: Array) -> Array:
        """Return (nv,) mean squared residuals outside of reversals."""
        other = replace(robot, fading_speed=speeds)
        faded_case = replace(case, model=other, shared=case.shared.read_only())
        dataset = reduced(faded_case, list(dict.fromkeys(effects)))
        bare = LogModel(other, dataset, effects, model.beliefs, model.on_time, loads=case.loads)
        return bare.refitted(fit).variance

    before = errors(current)
    candidates = np.array([joint in rubbing for joint in robot.joints]) & (least < largest)
    candidates &= before > np.square(_MARGIN * model.dataset.noise_floor)
    if not candidates.any():
        return None
    speeds, errors_at = [current], [before]
    for power in range(1, _DOUBLINGS + 1):
        speeds.append(np.where(candidates, np.minimum(least * 2.0**power, largest), current))
        errors_at.append(errors(speeds[-1]))
        too_fast = errors_at[-1] > np.maximum(before, errors_at[-2])
        if np.all((too_fast | (speeds[-1] >= largest))[candidates]):
            break
    best, joints = np.argmin(errors_at, axis=0), np.arange(len(current))
    hopeful = candidates & (np.min(errors_at, axis=0) <= _HOPEFUL * before) & (best > 0)
    if not hopeful.any():
        return None
    fitted, least_left = np.where(hopeful, np.array(speeds)[best, joints], current), before
    for ratio in _NEARER:
        factors = np.array([1.0 / ratio, 1.0, ratio])
        errors_at = [errors(np.where(hopeful, fitted * each, current)) for each in factors]
        least_left = np.min([least_left, *errors_at], axis=0)
        for j in np.flatnonzero(hopeful).tolist():
            local_errors = np.log([each[j] for each in errors_at])
            fitted[j] *= np.exp(parabola_minimum(np.log(factors), local_errors)[0])
    clear = hopeful & (least_left <= _MOST * before)
    return np.where(clear, fitted, current) if clear.any() else None


_FASTEST = 0.1
"""Largest speed at which dry friction fades, over a joint's peak speed."""
_DOUBLINGS = 7
_HOPEFUL, _NEARER = 0.75, (1.7, 1.2)
"""Largest ratio of squared errors to refine a speed, and the ratios of refined speeds."""
