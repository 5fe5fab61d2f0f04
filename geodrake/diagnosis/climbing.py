"""Hill climbing between neighbouring explanations."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.log_model import Fit, LogModel
from geodrake.diagnosis.moves import neighbours, together
from geodrake.effects.base import Effect

Array = NDArray[np.float64]

_MOST_STEPS = 40
_MOST_COUNTS = 4
_RECOUNTS = 2
_OPTIMISTIC = 0.3
"""Least effective samples per row in an optimistic climb: effects that are still missing make
residuals vary slowly, which lowers their effective sample size."""
_COUNTED = 20  # best neighbours that are refitted with the present sample sizes
_ANY = 10_000  # exceeds the number of neighbours
_LEAST_GAIN = 1e-6  # of a step; smaller ones may be due to rounding
_JUDGED = 5
"""Number of best neighbours whose effective sample sizes are recomputed."""

Watch = Callable[[Fit, Fit], None]
"""Callback with the explanations before and after each step."""


def climb(
    model: LogModel,
    fit: Fit,
    *,
    optimistic: bool,
    watch: Watch | None = None,
    pause: Callable[[Fit], bool] | None = None,
    joints: Collection[str] | None = None,
    further: int = 0,
    common: bool = False,
) -> Fit:
    """Climb from neighbour to more probable neighbour.

    An optimistic climb assumes larger effective sample sizes, as terms may still be missing.
    `pause` returns whether to stop after a step, before the result is refined. If `joints` are
    given, only their own effects may change. `further` and `common` are passed to `neighbours`.
    """
    seen = {fit.choice.key}  # changing sample sizes may lead back
    for _ in range(_MOST_STEPS):
        better = _step(model, fit, seen, joints, further, optimistic=optimistic, common=common)
        if better is None:
            break
        if watch is not None:
            watch(fit, better)
        fit = better
        seen.add(fit.choice.key)
        if pause is not None and pause(fit):
            break
    return fit


def can_gain(
    model: LogModel, fit: Fit, effects: Collection[Effect], *, optimistic: bool = False
) -> bool:
    """Return whether any of some effects is in a more probable neighbour of an explanation."""
    if not effects:
        return False
    shares = np.maximum(model.shares(fit), _OPTIMISTIC if optimistic else 0.0)
    fit = _refitted(model, fit, shares)
    moves = neighbours(model, fit, most=_ANY)
    choices = [each for each in moves if any(term.effect in effects for term in each.terms)]
    fits = model.ranked(choices[:_COUNTED], shares, fit.noise)[:_JUDGED]
    gains = (gain_of(model, fit, each, optimistic=optimistic) for each in fits)
    return any(gain is not None and gain[0] > 0.0 for gain in gains)


def settled(model: LogModel, fit: Fit) -> Fit:
    """Climb until the sample sizes are those of the residuals of the result.

    Probabilities depend on the effective sample sizes of the answer's residuals, by which no
    neighbour may be more probable.
    """
    for _ in range(_MOST_COUNTS):
        model.level_noise(fit)
        fit = _recounted(model, fit)
        shares, previous = model.shares(fit), fit.choice.key
        better, seen = fit, {previous}
        for _ in range(_MOST_STEPS):
            choices = [choice for choice in neighbours(model, better) if choice.key not in seen]
            fits = model.ranked(choices, shares, better.noise)
            gains = [model.lead(each, better, shares) for each in fits]
            if max(gains, default=0.0) <= 0.0:
                break
            better = fits[int(np.argmax(gains))]
            seen.add(better.choice.key)
        if better.choice.key == previous:
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
    optimistic: bool,
    common: bool,
) -> Fit | None:
    """Return the best new neighbour of a fit, or the best changes of several joints together.

    The result is None if nothing is more probable.
    """
    model.level_noise(fit)
    shares = model.shares(fit)
    high = np.maximum(shares, _OPTIMISTIC)
    fit = _refitted(model, fit, high if optimistic else shares)
    choices = neighbours(model, fit, joints=joints, further=further, common=common)
    choices = [choice for choice in choices if choice.key not in seen]
    fits = model.ranked(choices, high, fit.noise)
    promising = fits[:_JUDGED]
    if model.delays_differ(fit.choice.delay, model.on_time):
        promising += [each for each in fits if each.choice.delay == model.on_time]
    if not optimistic:
        choices = [each.choice for each in fits[:_COUNTED]]
        promising += model.ranked(choices, shares, fit.noise)[:_JUDGED]
        promising += sorted(fits, key=lambda each: -_potential(model, fit, each, high))[:further]
    judged = {each.choice.key: each for each in promising}

    def gains(others: Iterable[Fit]) -> list[tuple[float, Fit]]:
        results = (gain_of(model, fit, other, optimistic=optimistic) for other in others)
        found = [each for each in results if each is not None and each[0] > _LEAST_GAIN]
        return sorted(found, key=lambda each: -each[0])

    better = gains(judged.values())
    several = together(model, fit, [other.choice for _, other in better])
    if several is not None and several.key not in {*seen, *judged}:
        better += gains(model.ranked([several], high, fit.noise))
    return max(better, key=lambda each: each[0])[1] if better else None


def _potential(model: LogModel, fit: Fit, other: Fit, shares: Array) -> float:
    """Return the score of another fit if its residuals were white noise where it reduces them."""
    reduction = np.log(np.maximum(fit.noise / np.maximum(other.noise, 1e-300), 1.0))
    return other.score + float(((1.0 - shares)[model.joint_of] * model.block_rows) @ reduction)


def _refitted(model: LogModel, fit: Fit, shares: Array) -> Fit:
    found = model.fit(fit.choice, shares, fit.noise)
    return fit if found is None else found


def _recounted(model: LogModel, fit: Fit) -> Fit:
    """Refit by the effective sample sizes of the fit's own residuals, whatever led to it."""
    for _ in range(_RECOUNTS):
        model.forget_shares(fit)
        fit = _refitted(model, fit, model.shares(fit))
    return fit


def gain_of(
    model: LogModel, fit: Fit, other: Fit, *, optimistic: bool = False
) -> tuple[float, Fit] | None:
    """Return the score of another fit relative to `fit`, and that fit, with equal sample sizes.

    At each joint, the sample size is that of the fit with the smaller residual.
    """
    shares = np.where(other.variance < fit.variance, model.shares(other), model.shares(fit))
    shares = np.maximum(shares, _OPTIMISTIC) if optimistic else shares
    base = model.fit(fit.choice, shares, fit.noise) or fit
    better = model.fit(other.choice, shares, other.noise)
    return None if better is None else (model.lead(better, base, shares), better)
