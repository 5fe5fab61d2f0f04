"""Spectrum of a residual over a joint's position, in which ripples are peaks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

Array = NDArray[np.float64]

LEAST_WAVES = 1.5
"""Least number of waves in the range of motion; fewer look like gravity or a spring."""

_SPEED_CLASSES = 16
_SAMPLES_A_WAVE = 8
_OVERSAMPLING = 8
_LARGEST = 4_000  # orders, without oversampling
_SLOW = 0.3  # quantile of the speed at which the filter must pass a wave
_BACKGROUND = 40.0  # width of the running median, in independent orders


@dataclass(frozen=True)
class Peak:
    """Peak of the spectrum."""

    order: float  # waves in 2π of position
    share: float  # share of the residual's variance that waves of this order explain
    height: float  # evidence for the waves; without waves, about χ² of two degrees of freedom
    tried: int  # number of independent orders
    resolution: float  # distance of orders that can be distinguished


def highest_peak(
    motion: tuple[Array, Array],
    residual: Array,
    *,
    effective: float,
    gain: Callable[[Array], Array],
    bandwidth: float,
    least_waves: float = LEAST_WAVES,
) -> Peak | None:
    """Return the order whose waves over position are clearest in a residual; None if there is none.

    A peak is compared with the surrounding spectrum, which has the color of the residual, and with
    the whole residual and its effective sample size.

    Efforts are low-pass filtered, so that a wave of order n at speed v has the amplitude H(n |v| /
    2π). Samples are therefore grouped by speed; each group is binned over position and transformed,
    and the transforms are added as in a matched filter.

    `motion` is positions (K,) and velocities (K,). The residual (K,) has an `effective` sample
    size, and was filtered with response `gain` at frequencies in Hz and a bandwidth in Hz. The
    range of motion must contain `least_waves`; if these exceed `LEAST_WAVES`, the peak must be a
    local maximum. The motion may also be too small or too fast to show any order.
    """
    q, speed = motion[0], np.abs(motion[1])
    residual = residual - residual.mean()  # an offset is not a wave
    span = float(np.ptp(q))
    slow = float(np.quantile(speed, _SLOW))
    if span <= 0.0 or slow <= 0.0 or not residual.any():
        return None
    resolution = 2.0 * np.pi / span
    lowest, highest = LEAST_WAVES * resolution, 2.0 * np.pi * bandwidth / slow
    highest = min(highest, lowest + _LARGEST * resolution)
    if highest < lowest + 2.0 * resolution:
        return None
    order, power = _spectrum(q, speed, residual, gain, (span, highest))
    kept = (order >= lowest) & (order <= highest)
    order, power = order[kept], power[kept]
    share = np.minimum(power / np.square(residual).sum(), 1.0 - 1e-9)
    width = min(1 + 2 * int(0.5 * _BACKGROUND * _OVERSAMPLING), len(power))
    background = np.maximum(median_filter(power, width, mode="nearest"), np.median(power))
    background = np.maximum(background, np.finfo(float).tiny)
    height = np.maximum(np.log(4.0) * power / background, -effective * np.log1p(-share))
    inner, fast = np.arange(1, len(power) - 1), order[1:-1] >= least_waves * resolution
    if least_waves > LEAST_WAVES:
        inner = inner[fast & (height[1:-1] >= height[:-2]) & (height[1:-1] >= height[2:])]
        if not len(inner):
            return None
    index = int(inner[np.argmax(height[inner])])
    low, middle, high = power[index - 1 : index + 2]
    bend = low - 2.0 * middle + high
    shift = np.clip(0.5 * (low - high) / bend, -1.0, 1.0) if bend < 0.0 else 0.0
    return Peak(
        float(order[index] + shift * (order[1] - order[0])),
        float(share[index]),
        float(height[index]),
        int((highest - lowest) / resolution) + 1,
        resolution,
    )


def _spectrum(
    q: Array,
    speed: Array,
    residual: Array,
    gain: Callable[[Array], Array],
    reach: tuple[float, float],
) -> tuple[Array, Array]:
    """Return orders, and the squared residual that waves of each order explain."""
    span, highest = reach
    bins = int(np.ceil(_SAMPLES_A_WAVE * highest * span / (2.0 * np.pi)))
    size = _OVERSAMPLING * bins
    width = span / (bins - 1)
    order = (2.0 * np.pi / (size * width)) * np.arange(float(size // (_SAMPLES_A_WAVE // 2)))
    bin_index = np.rint((q - q.min()) / width).astype(int)
    edges = np.quantile(speed, np.linspace(0.0, 1.0, _SPEED_CLASSES + 1))
    kinds = np.clip(np.searchsorted(edges, speed) - 1, 0, _SPEED_CLASSES - 1)
    transform, norm = np.zeros(len(order), complex), np.zeros(len(order))
    for kind in range(_SPEED_CLASSES):
        members = kinds == kind
        if members.any():
            heights = np.asarray(np.bincount(bin_index[members], residual[members], bins), float)
            passed = gain(order * (float(speed[members].mean()) / (2.0 * np.pi)))
            transform += passed * np.fft.rfft(heights, size)[: len(order)]
            norm += 0.5 * passed**2 * members.sum()
    least = 1e-3 * norm.max()
    power = np.where(norm > least, np.abs(transform) ** 2 / np.maximum(norm, least), 0.0)
    return np.asarray(order, float), power
