"""The speed at which the dry friction of a joint has its full height.

Surfaces that touch give way a little before they slide, so that measured dry friction does not jump
where a joint turns round. A width of the sign that is too small leaves an error at every reversal,
which looks like one more friction.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.case import Case, reduced
from geodrake.diagnosis.evidence import log_likelihood_gain
from geodrake.diagnosis.forward import Trail
from geodrake.diagnosis.hypothesis import Hypothesis
from geodrake.diagnosis.trials import PENALTY
from geodrake.identification.reduce import peak_speeds, sign_widths
from geodrake.model import RobotModel

Array = NDArray[np.float64]

_DRY = (
    "coulomb_friction",
    "asymmetric_friction",
    "load_dependent_friction",
    "stribeck_friction",
    "coupled_friction",
)
_MOST = 0.1
"""Share of its peak speed below which a joint's dry friction may fade."""
_DOUBLINGS = 7
_HARDLY = 1.01
"""Times the squared error that a width may leave of that of the one before, to try more."""
_CLEARLY = 0.5
"""Share of the squared error at its joint that a width other than the least may leave.

Real friction fades with the way from a reversal on rather than with the speed, so that a speed
found where joints turn round does not hold where they creep (UR10e, wrist 2: 16 % less error in
motions like that of the fit, 34 % more from point to point).
"""
_BETWEEN = (2.0**-0.5, 2.0**0.5, 2.0**-0.25, 2.0**0.25)
"""Times the best width so far, tried one after the other."""


def with_fading(case: Case, trail: Trail) -> tuple[Case, Trail]:
    """The case with dry friction that fades at low speeds, where its data say so, joint by joint.

    Args:
        case: The case.
        trail: A search.

    Returns:
        The case, its model with `fading_speed`, and the trail on its dataset; the same ones if this
        takes half of the squared error from no joint.
    """
    end, joints = trail.end, case.dataset.joints
    dry = {joint for e in end.unknowns.effects if e.name in _DRY for joint in e.where}
    noisy = end.held_out.mse <= np.square(case.dataset.noise_floor) / _CLEARLY
    tried = np.isin(joints, list(dry)) & ~noisy
    if not tried.any():
        return case, trail
    least = sign_widths(replace(case.model, fading_speed=None), case.trajectories)
    most = np.maximum(_MOST * peak_speeds(case.trajectories), least)
    before = best = sign_widths(case.model, case.trajectories)
    error, last, goes_on = end.held_out.mse, np.full(len(best), np.inf), tried & (least < most)
    for power in range(_DOUBLINGS + 1):
        width = np.where(goes_on, np.minimum(least * 2.0**power, most), best)
        new = _errors(case, end, width)
        best, error = np.where(new < error, width, best), np.minimum(new, error)
        goes_on, last = goes_on & (new < _HARDLY * last) & (width < most), new
        if not goes_on.any():
            break
    for width in (np.where(tried, np.clip(best * f, least, most), best) for f in _BETWEEN):
        new = _errors(case, end, width)
        best, error = np.where(new < error, width, best), np.minimum(new, error)
    gain = log_likelihood_gain(end.held_out.mse, error, end.effective)
    clear = (error <= _CLEARLY * end.held_out.mse) | (before > least)
    if not np.any(clear & (gain > PENALTY)):
        return case, trail
    width = np.where(clear & (gain > PENALTY), best, before)
    fading = np.where(width > least, width, 0.0)
    case = replace(case, model=replace(case.model, fading_speed=fading), kept={})
    case = replace(case, dataset=reduced(case, case.dataset.effects))
    start, end = (h.moved(case.dataset, delay=h.delay) for h in (trail.start, trail.end))
    return case, replace(trail, start=start, end=end)


def _errors(case: Case, end: Hypothesis, width: Array) -> Array:
    """(nv,) mean squared held-out errors of a hypothesis with other widths."""
    model = replace(case.model, fading_speed=width)
    dataset = reduced(replace(case, model=model), end.unknowns.effects)
    return end.moved(dataset, delay=end.delay).held_out.mse


def fading_notes(model: RobotModel) -> list[str]:
    """At which speeds dry friction fades, in words."""
    if model.fading_speed is None:
        return []
    unit = dict.fromkeys(model.sliding_joints, "m/s")
    return [
        f"dry friction of {joint} fades below {speed:.2g} {unit.get(joint, 'rad/s')}"
        for joint, speed in zip(model.joints, model.fading_speed, strict=True)
        if speed > 0.0
    ]
