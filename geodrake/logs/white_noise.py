"""White noise of measured signals, as their spectra show it beyond the motion."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv

from geodrake.logs.spectrum import spectral_density

Array = NDArray[np.float64]

_LEAST_BINS = 12  # of a spectrum in a band


def quiet_density(
    signal: ArrayLike, rate: float, bandwidth: float, *, differences: int = 0
) -> Array:
    """Spectral density of white noise of signals: that of the quietest band above a bandwidth.

    Args:
        signal: (N, n) samples.
        rate: Sampling rate, Hz.
        bandwidth: Where the signals themselves end, Hz.
        differences: How often the signals are differenced before, so that what is large and slow
            in them does not leak into the spectrum; the density is that of the signals.

    Returns:
        (n,) one-sided density, squared units of the signals per Hz.
    """
    changes = np.diff(np.asarray(signal, float), differences, axis=0)
    length = min(len(changes), max(64, round(8 * rate / bandwidth)))
    frequency, density = spectral_density(changes, rate, length)
    frequency, density = frequency[1:], density[1:]
    density = density / (2.0 * np.sin(np.pi * frequency / rate)[:, None]) ** (2 * differences)
    lowest, highest = 1.6 * bandwidth, 0.45 * rate
    averages = max(1.0, 0.9 * (2 * len(changes) / length - 1))
    # The median of a mean of that many exponentials, over its mean.
    median = gammaincinv(averages, 0.5) / averages
    bands = max(1, int(np.log2(highest / lowest) * 2))
    edges = np.geomspace(lowest, highest, bands + 1)
    levels = []
    for low, high in pairwise(edges.tolist()):
        inside = (frequency >= low) & (frequency < high)
        if inside.sum() >= _LEAST_BINS:
            levels.append(np.median(density[inside], axis=0) / median)
    if not levels:
        inside = frequency >= min(lowest, frequency[-1])
        levels.append(np.median(density[inside], axis=0) / median)
    return np.min(levels, axis=0)
