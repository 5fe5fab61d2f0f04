"""Shape parameters between those of a grid: a Stribeck velocity, an exponent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.parabola import least_between
from geodrake.effects.base import Effect
from geodrake.identification.logs.hypothesis import Hypothesis

Array = NDArray[np.float64]

_ROUNDING = 1e-9
"""Shapes whose logarithms differ by less are one."""


def variants(effect: Effect, effects: Sequence[Effect]) -> list[Effect]:
    """Those of some effects that have the name and the place of one: its shapes.

    Args:
        effect: The effect.
        effects: Effects to choose from.
    """
    return [e for e in effects if (e.name, e.where) == (effect.name, effect.where)]


def free_shape(effect: Effect, grid: Sequence[Effect]) -> tuple[str, Array] | None:
    """The shape parameter that a grid tries at several positive values, and these in order.

    Args:
        effect: An effect.
        grid: Effects that are tried, among them those of its name and place.

    Returns:
        None where no parameter varies, more than one does, or not continuously.
    """
    tried = variants(effect, grid)
    values = {f.name: {getattr(e, f.name) for e in tried} for f in fields(effect)}  # type: ignore[arg-type]
    varied = [name for name, found in values.items() if len(found) > 1]
    if len(varied) != 1:
        return None
    (name,) = varied
    if not all(isinstance(value, float) and value > 0.0 for value in values[name]):
        return None
    return name, np.sort(np.array([*values[name]]))


def is_round(effect: Effect, grid: Sequence[Effect]) -> bool:
    """Whether the free shape of an effect is a multiple of one half, as a law's exponent is.

    Args:
        effect: An effect.
        grid: Effects that are tried, among them those of its name and place.
    """
    found = free_shape(effect, grid)
    return found is not None and float(2.0 * getattr(effect, found[0])).is_integer()


def finer(effect: Effect, grid: Sequence[Effect], share: float) -> tuple[Effect, ...]:
    """The effect and its neighbours on a finer grid, two to either side where they make sense.

    Args:
        effect: An effect with a free shape.
        grid: The coarse grid.
        share: Step of the finer grid, as a share of the coarse one's in the logarithm.
    """
    found = free_shape(effect, grid)
    if found is None:
        return (effect,)
    name, values = found
    value, gaps = getattr(effect, name), np.diff(np.log(values))
    above = int(np.clip(np.searchsorted(values, value, side="right") - 1, 0, len(gaps) - 1))
    below = int(np.clip(np.searchsorted(values, value) - 1, 0, len(gaps) - 1))
    near = [effect]
    for gap in (-gaps[below], gaps[above]):
        for shrunk in (1.0, 0.5, 0.25):  # toward the border of a kind, |v|^1.5 toward |v|
            factors = np.exp(shrunk * share * gap * np.array([1.0, 2.0]))
            side = [replace(effect, **{name: float(value * f)}) for f in factors]  # type: ignore[type-var]
            alike = [e for e in side if _is_alike(e, effect)]
            if alike:
                near += alike
                break
    return tuple(near)


def peak(hypothesis: Hypothesis, effect: Effect, grid: Sequence[Effect]) -> tuple[Effect, float]:
    """The effect with the shape at which a parabola through the squared errors has its minimum.

    Args:
        hypothesis: A hypothesis whose dataset has the shapes next to the effect's.
        effect: One of its effects, the best of its variants in the dataset.
        grid: The coarse grid, which says what is varied.

    Returns:
        That effect, and what it should gain; the effect itself where there is no such minimum.
    """
    found = free_shape(effect, grid)
    if found is None:
        return effect, 0.0
    name, _ = found
    own, tried = np.log(getattr(effect, name)), variants(effect, hypothesis.dataset.effects)
    # A finer grid around a shape of another one comes back to it but for rounding.
    tried = [e for e in tried if e == effect or abs(np.log(getattr(e, name)) - own) > _ROUNDING]
    tried.sort(key=lambda e: getattr(e, name))
    at = tried.index(effect)
    if not 0 < at < len(tried) - 1:
        return effect, 0.0
    near = tried[at - 1 : at + 2]
    place = np.log([getattr(e, name) for e in near])
    weight = hypothesis.effective / np.maximum(hypothesis.held_out.mse, np.finfo(float).tiny)
    errors = [hypothesis.exchanged([effect], [e]).held_out.mse @ weight for e in near]
    least = least_between(place - place[1], np.array(errors))
    best = replace(effect, **{name: float(np.exp(place[1] + least.step))})  # type: ignore[type-var]
    return (best, least.gain) if least.gain and _is_alike(best, effect) else (effect, 0.0)


def _is_alike(variant: Effect, effect: Effect) -> bool:
    """Whether a shape is one of the same nature as another, |v|^α with α < 1 or with α > 1."""
    return variant.distinct and bool(variant.refines) == bool(effect.refines)
