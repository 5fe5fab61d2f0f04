"""White noise of measured signals, as their spectra show it beyond the motion."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv

from geodrake.logs.spectrum import BLACKMAN_HARRIS, spectral_density

Array = NDArray[np.float64]

_LEAST_BINS = 12  # of a spectrum in a band
_PARTS = 4  # of a passband
_STEP = 1.2  # ratio of the frequencies of neighbouring bands
_WIDE = 3  # steps over which a spectrum falls


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


def passband_density(signal: ArrayLike, rate: float, bandwidth: float) -> tuple[Array, Array]:
    """Spectral densities of signals below a bandwidth.

    Args:
        signal: (N, n) samples.
        rate: Sampling rate, Hz.
        bandwidth: Where the band ends, Hz.

    Returns:
        (n,) mean, and (n,) that of the quietest part of the band, squared units per Hz.
    """
    signal = np.asarray(signal, float)
    length = min(len(signal), max(64, round(16 * rate / bandwidth)))
    frequency, density = spectral_density(signal, rate, length)
    # The slowest bins lack what is taken away with the mean.
    within = np.flatnonzero((frequency > 1.5 * rate / length) & (frequency < bandwidth))
    parts = [density[part].mean(axis=0) for part in np.array_split(within, _PARTS) if len(part)]
    return density[within].mean(axis=0), np.min(parts, axis=0)


def steepest_fall(signal: ArrayLike, rate: float, bandwidth: float) -> Array:
    """(n,) frequencies at which the spectra of signals fall most, as at the end of a filter, Hz.

    Args:
        signal: (N, n) samples.
        rate: Sampling rate, Hz.
        bandwidth: About where the signals end, Hz.
    """
    signal = np.asarray(signal, float)
    length = min(len(signal), max(64, round(32 * rate / bandwidth)))
    frequency, density = spectral_density(signal, rate, length, window=BLACKMAN_HARRIS)
    lowest, highest = 6.0 * rate / length, 0.45 * rate  # each band has a bin of the spectrum
    edges = lowest * _STEP ** np.arange(int(np.log(highest / lowest) / np.log(_STEP)))
    level = np.array(
        [
            np.log(
                np.maximum(density[(frequency >= low) & (frequency < _STEP * low)], 1e-300)
            ).mean(axis=0)
            for low in edges
        ]
    )
    if len(edges) <= _WIDE:
        return np.full(signal.shape[1], bandwidth)
    fall = level[:-_WIDE] - level[_WIDE:]
    return np.asarray(edges[fall.argmax(axis=0)] * _STEP ** (0.5 * (_WIDE + 1)))
