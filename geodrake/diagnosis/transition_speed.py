"""The speed at which the dry friction of a joint has its full height.

Surfaces that touch give way a little before they slide, so that measured dry friction does not jump
where a joint turns round. A width of the sign that is too small leaves an error at every reversal,
which looks like one more friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.judgement import judge
from geodrake.diagnosis.parabola import least_between
from geodrake.diagnosis.stepwise_search import Trail
from geodrake.effects.base import Effect
from geodrake.identification.logs.case import Case, KeptMotion, reduced
from geodrake.identification.logs.criteria import MOST, SEARCH_MARGIN
from geodrake.identification.logs.hypothesis import Hypothesis, residual_blocks
from geodrake.identification.logs.reduce import peak_speeds, sign_widths
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_FASTEST = 0.1
"""Dry friction fades below this share of a joint's peak speed at most."""
_SLOW = 0.15
"""If friction fades, most of a joint's squared error is below this share of its peak speed."""
_DOUBLINGS = 7
_HARDLY = 1.01
"""A wider transition is tried while the squared error stays below this multiple of the last one."""
_CLOSER = 2
"""So often the least error between widths that were tried is looked for."""


def with_transition_speed(case: Case, trail: Trail) -> tuple[Case, Trail] | None:
    """The case with dry friction that fades at low speeds, where its data say so, joint by joint.

    Args:
        case: The case.
        trail: A search.

    Returns:
        The case, its model with `fading_speed`, and the trail on its dataset; None if this takes
        half of the squared error from no joint.
    """
    end, known, error = trail.end, case.model.fading_speed, trail.end.held_out.mse
    least = sign_widths(replace(case.model, fading_speed=None), case.trajectories)
    peak = peak_speeds(case.trajectories)
    tried = _rubbing(case.dataset.joints, end.unknowns.effects) & (least < _FASTEST * peak)
    tried &= error > np.square(SEARCH_MARGIN * case.dataset.noise_floor)
    if not tried.any():
        return None
    tried &= _share_of_slow(end, _SLOW * peak) > MOST
    if not tried.any():
        return None
    before = sign_widths(case.model, case.trajectories)
    best = _best_widths(case, end, least, _FASTEST * peak, tried)
    width = np.where(tried, best, before)
    # A transition speed must take away most of the squared error at its joint. Real friction fades
    # with the way from a reversal on rather than with the speed, so that a speed found where joints
    # turn round does not hold where they creep (UR10e, wrist 2: 16 % less error in motions like
    # that of the fit, 34 % more from point to point).
    clear = _errors(case, end, width) <= MOST * error
    if not clear.any():
        return None
    fading = np.zeros(len(least)) if known is None else known
    fading = np.where(clear & tried, np.where(width > least, width, 0.0), fading)
    faded = replace(case, model=replace(case.model, fading_speed=fading), kept=KeptMotion())
    faded = replace(faded, dataset=reduced(faded, case.dataset.effects))
    start, after = (h.moved(faded.dataset, delay=h.delay) for h in (trail.start, end))
    if not judge(end, after, parameters=int(np.count_nonzero(clear & tried))).is_better:
        return None
    return faded, replace(trail.asking_anew(), start=start, end=after)


def _best_widths(case: Case, end: Hypothesis, least: Array, most: Array, tried: Mask) -> Array:
    """(nv,) widths with the least error at each joint, the others following theirs.

    Args:
        case: The case.
        end: What was found.
        least: (nv,) narrowest widths.
        most: (nv,) widest ones.
        tried: (nv,) whether a joint's width is looked for.
    """
    widths, errors = [sign_widths(case.model, case.trajectories)], [end.held_out.mse]

    def best() -> Array:
        chosen = np.argmin(errors, axis=0)[None]
        return np.asarray(np.take_along_axis(np.array(widths), chosen, 0)[0])

    def error_with(width: Array) -> Array:
        widths.append(width)
        errors.append(_errors(case, end, width))
        return errors[-1]

    last, goes_on = np.full(len(least), np.inf), tried
    for power in range(_DOUBLINGS + 1):
        width = np.where(goes_on, np.minimum(least * 2.0**power, most), best())
        new = error_with(width)
        goes_on, last = goes_on & (new < _HARDLY * last) & (width < most), new
        if not goes_on.any():
            break
    for _ in range(_CLOSER):
        at = zip(np.transpose(widths), np.transpose(errors), tried, strict=True)
        error_with(np.array([_between(*each) for each in at]))
    return best()


def _between(widths: Array, errors: Array, searched: bool) -> float:
    """The width of a joint at the minimum of a parabola around the best that was tried.

    Args:
        widths: (n,) widths that were tried.
        errors: (n,) its squared errors with them.
        searched: Whether its width is looked for.
    """
    values, first = np.unique(widths, return_index=True)
    at = int(np.argmin(errors[first]))
    if not searched or not 0 < at < len(values) - 1:
        return float(values[at])
    near = slice(at - 1, at + 2)
    offsets = values[near] - values[at]
    return float(values[at] + least_between(offsets, errors[first][near]).step)


def _share_of_slow(end: Hypothesis, speed: Array) -> Array:
    """(nv,) share of the squared held-out error that lies below a speed (nv,)."""
    blocks = residual_blocks(end.dataset, end.unknowns.columns, end.held_out.x, delay=end.delay)
    shares = []
    for data, residuals, slow in zip(end.dataset.data, blocks, speed, strict=True):
        v = np.concatenate([rows.motion[:, 1] for fold in data.rows for rows in fold])
        square = np.square(np.concatenate(residuals))
        shares.append(square[np.abs(v) < slow].sum() / max(square.sum(), np.finfo(float).tiny))
    return np.array(shares)


def _errors(case: Case, end: Hypothesis, width: Array) -> Array:
    """(nv,) mean squared held-out errors of a hypothesis with other widths."""
    model = replace(case.model, fading_speed=width)
    other = replace(case, model=model, shared=case.shared.read_only())
    dataset = reduced(other, end.unknowns.effects)
    return end.moved(dataset, delay=end.delay).held_out.mse


def _rubbing(joints: Sequence[str], effects: Sequence[Effect]) -> Mask:
    """(nv,) whether a joint has dry friction among some effects."""
    return np.isin(joints, [joint for e in effects if e.jumps for joint in e.where])


def transition_speed_notes(before: RobotModel, after: RobotModel) -> list[str]:
    """At which speeds dry friction was found to fade, in words.

    Args:
        before: The model as it came.
        after: The fitted model.
    """
    speeds, known = after.sign_widths(0.0), before.sign_widths(0.0)
    rubs = _rubbing(after.joints, [fitted.effect for fitted in after.effects])
    return [
        f"dry friction of {joint} fades below {speeds[j]:.2g} "
        f"{'m/s' if joint in after.sliding_joints else 'rad/s'}"
        for j, joint in enumerate(after.joints)
        if rubs[j] and speeds[j] not in (0.0, known[j])
    ]
