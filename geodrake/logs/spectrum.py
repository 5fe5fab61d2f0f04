"""Power spectra of signals, by Welch's method: the mean over windows that overlap by half."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy.fft import rfft

Array = NDArray[np.float64]

# Windows, each a sum of cosines Σ_k (−1)ᵏ a_k cos(2π k t) over one period: the a_k.
HANN = (0.5, 0.5)
BLACKMAN_HARRIS = (0.35875, 0.48829, 0.14128, 0.01168)


def spectral_density(
    signal: ArrayLike,
    rate: float,
    length: int,
    *,
    window: tuple[float, ...] = HANN,
    centered: bool = True,
) -> tuple[Array, Array]:
    """One-sided spectral density of signals.

    Args:
        signal: (N, n) samples.
        rate: Sampling rate, Hz.
        length: Samples in a window, two or more and at most N.
        centered: Whether the mean of every window is taken away.

    Returns:
        frequency (K,), Hz, and density (K, n), squared units of the signal per Hz.
    """
    signal, turn = np.asarray(signal, float), 2.0 * np.pi * np.arange(length) / length
    weight = np.sum([(-1) ** k * a * np.cos(k * turn) for k, a in enumerate(window)], axis=0)
    step = length - length // 2
    pieces = sliding_window_view(signal, length, axis=0)[::step]
    power = np.zeros((signal.shape[1], length // 2 + 1))
    for piece in pieces:  # (n, length) each
        level = piece.mean(axis=1, keepdims=True) if centered else 0.0
        transform = rfft((piece - level) * weight)
        power += np.square(transform.real) + np.square(transform.imag)
    density = power.T / (len(pieces) * rate * (weight @ weight))
    density[1 : len(density) - (length % 2 == 0)] *= 2.0
    frequency = rate / length * np.arange(length // 2 + 1.0)
    return frequency, np.asarray(density)
