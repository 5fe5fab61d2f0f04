"""Hill climbing from one explanation to a more probable neighbour."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.log_model import Fit, LogModel
from geodrake.diagnosis.moves import neighbours
from geodrake.effects.base import Effect

Array = NDArray[np.float64]

_MOST_STEPS = 40
_MOST_COUNTS = 4
_OPTIMISTIC = 0.3
"""On the way up, residuals are worth at least this share of their rows: what is missing still
makes them look as if they were worth less."""
_COUNTED = 20  # most promising neighbours, fitted with the present weights of the residuals
_ANY = 10_000  # more neighbours than there are
_JUDGED = 5
"""So many of the most promising neighbours have their residuals counted anew."""

Watch = Callable[[Fit, Fit], None]
"""Called with the explanation before and after each step."""


def climb(
    model: LogModel,
    fit: Fit,
    *,
    hopeful: bool,
    watch: Watch | None = None,
    pause: Callable[[Fit], bool] | None = None,
    joints: Collection[str] | None = None,
    further: int = 0,
    common: bool = False,
) -> Fit:
    """Climb from neighbour to more probable neighbour.

    Hopeful, residuals count for more than they do now, as terms may be missing still. `pause` tells
    whether to return with what a step led to, as it is to be made exact first. If `joints` are
    given, their own effects alone may change. `further` and `common` are as of `neighbours`.
    """
    seen = {fit.choice.key}  # samples are counted anew at each step, which may lead back
    for _ in range(_MOST_STEPS):
        better = _step(model, fit, seen, joints, further, hopeful=hopeful, common=common)
        if better is None:
            break
        if watch is not None:
            watch(fit, better)
        fit = better
        seen.add(fit.choice.key)
        if pause is not None and pause(fit):
            break
    return fit


def may_come(model: LogModel, fit: Fit, effects: Collection[Effect]) -> bool:
    """Return whether one of some effects is in a more probable neighbour of an explanation."""
    shares = model.shares(fit)
    fit = _refitted(model, fit, shares)
    near = neighbours(model, fit, most=_ANY)
    choices = [each for each in near if any(term.effect in effects for term in each.terms)]
    tried = model.ranked(choices[:_COUNTED], shares, fit.noise)[:_JUDGED]
    gains = (gain_of(model, fit, each) for each in tried)
    return any(found is not None and found[0] > 0.0 for found in gains)


def settled(model: LogModel, fit: Fit) -> Fit:
    """Climb until residuals count as those of the explanation that is reached.

    Probabilities are told by the samples that the residuals of the answer are worth. So nothing
    nearby may be more probable by them.
    """
    for _ in range(_MOST_COUNTS):
        model.level_noise(fit)
        shares, was = model.shares(fit), fit.choice.key
        better, seen = _refitted(model, fit, shares), {was}
        for _ in range(_MOST_STEPS):
            choices = [choice for choice in neighbours(model, better) if choice.key not in seen]
            tried = model.ranked(choices, shares, better.noise)
            gains = [model.lead(each, better, shares) for each in tried]
            if max(gains, default=0.0) <= 0.0:
                break
            better = tried[int(np.argmax(gains))]
            seen.add(better.choice.key)
        if better.choice.key == was:
            break
        fit = better
    return fit


def _step(
    model: LogModel,
    fit: Fit,
    seen: Collection[Hashable],
    joints: Collection[str] | None,
    further: int,
    *,
    hopeful: bool,
    common: bool,
) -> Fit | None:
    """Return the best neighbour of a fit not seen yet, if it is more probable."""
    model.level_noise(fit)
    own = model.shares(fit)
    high = np.maximum(own, _OPTIMISTIC)
    fit = _refitted(model, fit, high if hopeful else own)
    choices = neighbours(model, fit, joints=joints, further=further, common=common)
    choices = [choice for choice in choices if choice.key not in seen]
    tried = model.ranked(choices, high, fit.noise)
    promising = tried[:_JUDGED]
    if model.are_apart(fit.choice.delay, model.on_time):
        promising += [each for each in tried if each.choice.delay == model.on_time]
    if not hopeful:
        choices = [each.choice for each in tried[:_COUNTED]]
        promising += model.ranked(choices, own, fit.noise)[:_JUDGED]
        promising += sorted(tried, key=lambda each: -_potential(model, fit, each, high))[:further]
    best, gain = None, 1e-6
    for other in {each.choice.key: each for each in promising}.values():
        found = gain_of(model, fit, other, hopeful=hopeful)
        if found is not None and found[0] > gain:
            gain, best = found
    return best


def _potential(model: LogModel, fit: Fit, other: Fit, shares: Array) -> float:
    """Return the score of another fit if its residuals, where it leaves less, were white noise."""
    fallen = np.log(np.maximum(fit.noise / np.maximum(other.noise, 1e-300), 1.0))
    return other.score + float(((1.0 - shares)[model.joint_of] * model.block_rows) @ fallen)


def _refitted(model: LogModel, fit: Fit, shares: Array) -> Fit:
    found = model.fit(fit.choice, shares, fit.noise)
    return fit if found is None else found


def gain_of(
    model: LogModel, fit: Fit, other: Fit, *, hopeful: bool = False
) -> tuple[float, Fit] | None:
    """Return how much higher another fit scores, residuals counted alike, and that fit.

    Residuals of either joint are worth as many samples as those of the fit that leaves less.
    """
    shares = np.where(other.variance < fit.variance, model.shares(other), model.shares(fit))
    shares = np.maximum(shares, _OPTIMISTIC) if hopeful else shares
    one = model.fit(fit.choice, shares, fit.noise) or fit
    two = model.fit(other.choice, shares, other.noise)
    return None if two is None else (model.lead(two, one, shares), two)
