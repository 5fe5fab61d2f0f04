"""Zero-phase filtering with decimation, spectral densities, and the bandwidth of a motion.

Signals are (N, n), with samples along axis 0. Rates and bandwidths are in Hz, and spectral
densities are one-sided, in squared units of the signal per Hz. Measured efforts and regressor
columns pass through the same `ZeroPhaseFilter`, so that filtering changes neither the parameters
nor the model (1) of the design. Filtered white noise is nearly white again after decimation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline
from scipy.ndimage import spline_filter1d
from scipy.special import gammaincinv

from geodrake.boundary.arguments import Array
from geodrake.compiling import compiled, contiguous, summing
from geodrake.errors import ArgumentError, LogError

HANN = (0.5, -0.5)
"""Cosine coefficients of the Hann window."""

SHARP = (0.35875, -0.48829, 0.14128, -0.01168)
"""Cosine coefficients of the Blackman–Harris window, with side lobes below −92 dB."""


def spectral_density(
    signal: ArrayLike,
    rate: float,
    length: int,
    *,
    window: Sequence[float] = HANN,
    centered: bool = True,
) -> tuple[Array, Array]:
    """Estimate spectral densities (K, n) at frequencies (K,), Hz, by Welch's method."""
    angle = 2.0 * np.pi * np.arange(length) / length
    weights = np.array(window) @ np.cos(np.outer(np.arange(len(window)), angle))
    parts = sliding_window_view(np.asarray(signal, float), length, axis=0)[:: length - length // 2]
    parts = parts - parts.mean(axis=2, keepdims=True) if centered else parts
    power = np.asarray(np.square(np.abs(rfft(parts * weights))).mean(axis=0).T)
    power[1 : (length + 1) // 2] *= 2.0  # includes negative frequencies
    frequency = np.linspace(0.0, (len(power) - 1) * rate / length, len(power))
    return frequency, power / (rate * float(np.square(weights).sum()))


_LEAST_BINS = 12  # frequencies in a band
_PARTS = 4  # number of parts of a passband
_STEP = 1.2  # ratio of the frequencies of neighbouring bands
_WIDE = 3  # bands over which a falling spectrum is measured


def quiet_density(
    signal: ArrayLike, rate: float, bandwidth: float, *, differences: int = 0
) -> Array:
    """Estimate the white-noise densities (n,) of signals from the quietest band above a bandwidth.

    Signals are differenced `differences` times first, so that large slow components do not leak
    into the spectrum. The density returned is that of the signals themselves.
    """
    changes = np.diff(np.asarray(signal, float), differences, axis=0)
    length = min(len(changes), max(64, round(8 * rate / bandwidth)))
    frequency, density = spectral_density(changes, rate, length)
    frequency, density = frequency[1:], density[1:]
    density = density / (2.0 * np.sin(np.pi * frequency / rate)[:, None]) ** (2 * differences)
    lowest, highest = 1.6 * bandwidth, 0.45 * rate
    averages = max(1.0, 0.9 * (2 * len(changes) / length - 1))
    # Median of the average of that many exponential variables, relative to its mean.
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
    """Return the mean densities (n,) below a bandwidth, and those (n,) of its quietest part."""
    signal = np.asarray(signal, float)
    length = min(len(signal), max(64, round(16 * rate / bandwidth)))
    frequency, density = spectral_density(signal, rate, length)
    # Subtracting the mean removes power from the lowest bins.
    within = np.flatnonzero((frequency > 1.5 * rate / length) & (frequency < bandwidth))
    parts = [density[part].mean(axis=0) for part in np.array_split(within, _PARTS) if len(part)]
    return density[within].mean(axis=0), np.min(parts, axis=0)


def steepest_fall(signal: ArrayLike, rate: float, bandwidth: float) -> Array:
    """Return the frequencies (n,), Hz, at which spectra fall most, as at a filter's cutoff."""
    signal = np.asarray(signal, float)
    length = min(len(signal), max(64, round(32 * rate / bandwidth)))
    frequency, density = spectral_density(signal, rate, length, window=SHARP)
    lowest, highest = 6.0 * rate / length, 0.45 * rate  # so that each band contains a bin
    edges = lowest * _STEP ** np.arange(int(np.log(highest / lowest) / np.log(_STEP)))
    logs = np.log(np.maximum(density, 1e-300))
    bands = [(frequency >= low) & (frequency < _STEP * low) for low in edges]
    level = np.array([logs[band].mean(axis=0) for band in bands])
    if len(edges) <= _WIDE:
        return np.full(signal.shape[1], bandwidth)
    fall = level[:-_WIDE] - level[_WIDE:]
    return np.asarray(edges[fall.argmax(axis=0)] * _STEP ** (0.5 * (_WIDE + 1)))


LEAST_SPECTRUM = 32  # fewest samples for a spectrum
HIGHEST_BANDWIDTH = 0.25  # of the sampling rate: above it, splines and jitter spoil derivatives
HIGHEST_MOTION = 0.5  # of the sampling rate, for a motion that is filtered with the efforts later
_LARGEST_DECIMATION = 10_000  # the kernel then has 120,000 samples
_KAISER_SHAPE = 6.76  # 70 dB: the passband is flat to 3e-4
_RESPONSE_POINTS = 257
_HALFWIDTH = 6  # in output samples; the passband then ends at 0.64 of the bandwidth
_LARGEST_EXCESS = 1.04  # output rate over 2·bandwidth; above it the filtered noise is correlated
_DYNAMIC_RANGE = 1e-8  # of the acceleration's spectrum; a motion below this share is negligible
_RISE = 2.0  # of the power of positions: chance makes their noise rise by less
_PART = 0.1  # of the largest power of velocities: a larger share belongs to the motion
_FALL = 10.0  # of the power of positions: noise alone falls by less
_LEAST_MARGIN, _LARGEST_MARGIN = 4.0, 10.0  # bandwidth relative to that of the velocity
_WELCH_SECONDS = 20.0
_LEAST_SAMPLES = 6  # for a quintic spline
_QUINTIC = 5  # degree of a spline
_SAME_INSTANT = 1e-4  # of the time between samples


@dataclass(frozen=True, eq=False)
class ZeroPhaseFilter:
    """Symmetric low-pass filter (windowed sinc) with decimation."""

    half: Array  # (L+1,) right half of the kernel, centre first; the whole kernel sums to one
    decimation: int  # input samples per output sample
    period: float  # time between input samples, s
    bandwidth: float  # frequency at which the gain is one half, Hz

    @property
    def kernel(self) -> Array:
        """(2L+1,) kernel, dimensionless."""
        return np.concatenate([self.half[:0:-1], self.half])

    @property
    def halfwidth(self) -> int:
        """Number L of input samples before, and after, an output's instant that affect it."""
        return len(self.half) - 1

    @property
    def output_period(self) -> float:
        """Time between output samples, s."""
        return self.decimation * self.period

    @property
    def noise_gain(self) -> float:
        """Standard deviation of filtered white noise of unit standard deviation."""
        return float(np.linalg.norm(self.kernel))

    def response(self, frequency: ArrayLike) -> Array:
        """Return the gain at frequencies, Hz."""
        return np.interp(np.abs(frequency), *self._passed, right=0.0)

    @cached_property
    def _passed(self) -> tuple[Array, Array]:
        """Frequencies, Hz, and the gains at them."""
        grid = np.linspace(0.0, 2.0 * self.bandwidth, _RESPONSE_POINTS)
        angle = 2.0 * np.pi * self.period * grid[:, None] * np.arange(1, len(self.half))
        return grid, self.half[0] + 2.0 * np.cos(angle) @ self.half[1:]

    def output_count(self, n: int) -> int:
        """Return the number of outputs that `n` input samples fully support."""
        return max(0, (n - 2 * self.halfwidth - 1) // self.decimation + 1)

    def output_indices(self, n: int) -> NDArray[np.intp]:
        """Return the indices (K,) of the input samples at which `apply` has its outputs."""
        return self.halfwidth + self.decimation * np.arange(self.output_count(n))

    def apply(self, columns: ArrayLike, at: NDArray[np.intp] | None = None) -> Array:
        """Filter and decimate (N, ...) to (K, ...), at all `output_indices(N)` or those `at`."""
        columns = np.asarray(columns, float)
        instants = self.output_indices(len(columns))
        instants = instants if at is None else instants[at]
        flat = contiguous(columns.reshape(len(columns), math.prod(columns.shape[1:])).T)
        outputs = np.empty((len(flat), len(instants)))
        calc_outputs(self.kernel, flat, instants, outputs)
        return outputs.T.reshape(len(instants), *columns.shape[1:])

    def apply_weighted(self, columns: Array, weights: Array) -> Array:
        """Filter and decimate contiguous columns (N, ...) times weights (N,) to (K, ...)."""
        flat = columns.reshape(len(columns), -1)
        outputs = np.zeros((self.output_count(len(flat)), flat.shape[1]))
        calc_weighted_outputs(self.kernel, (flat, weights), self.output_indices(len(flat)), outputs)
        return outputs.reshape(len(outputs), *columns.shape[1:])

    def chunks(self, n: int, size: int) -> Iterator[tuple[slice, int]]:
        """Yield input slices that together give all outputs, and the number of outputs of each.

        Slices have at most `size` samples, but at least as many as one output needs.
        """
        count, window = self.output_count(n), 2 * self.halfwidth + 1
        most = max(1, self.output_count(size))
        for begin in range(0, count, most):
            outputs = min(most, count - begin)
            start = begin * self.decimation
            yield slice(start, start + (outputs - 1) * self.decimation + window), outputs

    def smooth(self, signal: ArrayLike) -> Array:
        """Low-pass (N, ...) at the full rate; the first and last L use an odd reflection."""
        signal = np.asarray(signal, float)
        padding = [(self.halfwidth,) * 2] + [(0, 0)] * (signal.ndim - 1)
        padded = np.pad(signal, padding, mode="reflect", reflect_type="odd")
        size = next_fast_len(len(padded), real=True)
        response = rfft(self.kernel, size).reshape(-1, *(1,) * (signal.ndim - 1))
        smooth = irfft(rfft(padded, size, axis=0) * response, size, axis=0)
        return np.asarray(smooth[2 * self.halfwidth : len(padded)])


@summing
def calc_outputs(kernel: Array, columns: Array, at: NDArray[np.intp], outputs: Array) -> None:
    """Compute weighted averages (k, K) of columns (k, N) around samples (K,), kernel (2L+1,)."""
    for k in range(len(columns)):
        for n in range(len(at)):
            first, total = at[n] - len(kernel) // 2, 0.0
            window = columns[k, first : first + len(kernel)]
            for i in range(len(kernel)):
                total += kernel[i] * window[i]
            outputs[k, n] = total


@compiled
def calc_weighted_outputs(
    kernel: Array, columns: tuple[Array, Array], at: NDArray[np.intp], outputs: Array
) -> None:
    """Add averages of columns (N, k) times weights (N,) around samples (K,) to outputs (K, k)."""
    values, weights = columns
    for n in range(len(at)):
        first, output = at[n] - len(kernel) // 2, outputs[n]
        for i in range(len(kernel)):
            weight, row = kernel[i] * weights[first + i], values[first + i]
            for k in range(len(output)):
                output[k] += weight * row[k]


def design_filter(
    period: float, bandwidth: float, *, highest: float = HIGHEST_BANDWIDTH
) -> ZeroPhaseFilter:
    """Design a low-pass filter that decimates to about twice its bandwidth.

    Its bandwidth, Hz, is the nearest to the requested one at which integer decimation keeps noise
    white: at worst 20 % off at a decimation by 2 or 3, 5 % at 10. `highest` is a share of the rate.
    """
    if not 0.0 < period < np.inf:
        raise ArgumentError(f"A sampling period must be positive; got {period:g} s.")
    lowest, highest = 0.5 / (_LARGEST_DECIMATION * period), highest / period
    if not lowest <= bandwidth <= highest * (1 + 1e-9):
        raise ArgumentError(
            f"A bandwidth of {bandwidth:g} Hz is not possible at a sampling rate of "
            f"{1 / period:g} Hz.",
            advice=f"Choose a bandwidth between {lowest:g} and {highest:g} Hz.",
        )
    decimation = round(0.5 / (bandwidth * period))
    white = 0.5 / (decimation * period)
    bandwidth = min(max(bandwidth, white / _LARGEST_EXCESS), white)
    offsets = np.arange(_HALFWIDTH * decimation + 1)
    window = np.kaiser(2 * len(offsets) - 1, _KAISER_SHAPE)[len(offsets) - 1 :]
    half = np.sinc(2.0 * bandwidth * period * offsets) * window
    return ZeroPhaseFilter(half / (2.0 * half.sum() - half[0]), decimation, period, bandwidth)


SPLINE_REACH = 40
"""Number of samples beyond which a change does not affect an interpolating spline."""

_DERIVATIVES = {
    1: np.array([-1.0, -10.0, 0.0, 10.0, 1.0]) / 24.0,
    2: np.array([1, 2, -6, 2, 1]) / 6,
}
"""Derivatives of a quintic spline at a sample, from the five coefficients around it."""


def differentiate(signal: ArrayLike, period: float, *, order: int = 1) -> Array:
    """Differentiate a smooth signal of at least 6 samples with respect to time by a quintic spline.

    The `order` is 1 or 2. The derivative has no lag. The relative error of the first is below 1e-3
    up to a quarter of the rate.
    """
    signal = np.asarray(signal, float)
    if len(signal) < _LEAST_SAMPLES:
        raise ArgumentError(
            f"A derivative needs {_LEAST_SAMPLES} samples; got {len(signal)}.",
            advice="Use a longer signal.",
        )
    if len(signal) <= 4 * SPLINE_REACH:
        spline = spline_through(signal).derivative(order)
        return np.asarray(spline(np.arange(float(len(signal)))) / period**order)
    # Only near the ends does the spline depend on their conditions.
    start, end = signal[: 2 * SPLINE_REACH], signal[-2 * SPLINE_REACH :]
    first, last = (differentiate(part, period, order=order) for part in (start, end))
    coefficients = spline_coefficients(signal)[SPLINE_REACH - 2 : 2 - SPLINE_REACH]
    weights, count = _DERIVATIVES[order] / period**order, len(signal) - 2 * SPLINE_REACH
    middle = sum(w * coefficients[k : k + count] for k, w in enumerate(weights.tolist()) if w)
    return np.concatenate([first[:SPLINE_REACH], middle, last[-SPLINE_REACH:]])


def spline_through(signal: Array) -> BSpline:
    """Return the quintic spline through samples (N, ...), N ≥ 2, as a function of their index."""
    degree = min(5, len(signal) - 1)
    samples = np.arange(len(signal), dtype=float)
    return make_interp_spline(samples, signal, k=degree - (degree % 2 == 0), axis=0)


def spline_coefficients(signal: Array) -> Array:
    """Return coefficients (N, n) of quintic splines through a signal (N, n), for `shifted`."""
    return np.asarray(spline_filter1d(signal, _QUINTIC, axis=0, mode="mirror"))


def shifted(coefficients: Array, at: NDArray[np.intp], steps: Array) -> Array:
    """Return values (K, n) of splines, or of filtered ones, at samples (K,) plus `steps` (n,).

    A spline's coefficients (N, n) may be filtered instead of its values. Steps are in samples.
    Three more samples are needed on either side.
    """
    columns, whole = contiguous(coefficients.T), np.floor(steps).astype(int)
    values = np.empty((len(columns), len(at)))
    basis = BSpline.basis_element(np.arange(-3.0, 4.0), extrapolate=False)
    for j, step in enumerate(steps - whole):
        weights = np.nan_to_num(basis(step - np.arange(-3.0, 4.0)))
        calc_outputs(weights, columns[j : j + 1], at + whole[j], values[j : j + 1])
    return values.T


def resample(time: Array, signals: Array, instants: Array, *, sharp: bool = False) -> Array:
    """Interpolate jittered signals (N, n) at other instants (K,); existing samples are unchanged.

    `sharp` signals, such as efforts, are interpolated linearly, without overshoot. Others, such as
    positions and velocities, are interpolated by a cubic spline.
    """
    start = int(np.argmin(np.abs(time - instants[0]))) if len(instants) else 0
    same = time[start : start + len(instants)]
    tolerance = _SAME_INSTANT * (time[-1] - time[0]) / max(len(time) - 1, 1)
    if len(same) == len(instants) and (np.abs(same - instants) <= tolerance).all():
        return signals[start : start + len(instants)]
    if sharp:
        return np.stack([np.interp(instants, time, column) for column in signals.T], 1)
    return np.asarray(CubicSpline(time, signals)(instants))


def choose_bandwidth(pieces: Sequence[tuple[Array, float]]) -> float:
    """Choose the bandwidth that contains the motion and little of the position noise.

    The acceleration's spectrum falls where the motion ends, and rises again with the position
    noise, as f⁴. The bandwidth is at its minimum between 4 and 10 times the frequency below which
    lie 99.9 % of the velocity's power, and at most a quarter of the rate. All joints have equal
    weight. Pieces are positions (N, n) of moving joints, and their sampling period, s.
    """
    pieces = [(position, period) for position, period in pieces if len(position) >= LEAST_SPECTRUM]
    if not pieces:
        raise LogError(
            f"The log has no {LEAST_SPECTRUM} samples without a gap, which a spectrum needs.",
            advice="Record a longer motion without gaps.",
        )
    longest = min(_WELCH_SECONDS, max(len(position) * period for position, period in pieces))
    highest = HIGHEST_BANDWIDTH / max(period for _, period in pieces)
    edges = highest * 2.0 ** (np.arange(-np.floor(6 * np.log2(highest * longest / 4)), 1.0) / 6)
    frequency = np.sqrt(edges[1:] * edges[:-1])
    power = _acceleration_power(pieces, edges)
    power[1:-1] = np.exp(  # the valley is wide: a single low bin must not decide
        0.25 * np.log(power[:-2]) + 0.5 * np.log(power[1:-1]) + 0.25 * np.log(power[2:])
    )
    velocity = power / frequency**2
    valley = _end_of_motion(power, frequency)
    power_below = np.cumsum((velocity * frequency)[: valley + 1])
    motion = frequency[np.searchsorted(power_below, 0.999 * power_below[-1])]
    inside = (frequency >= _LEAST_MARGIN * motion) & (frequency <= _LARGEST_MARGIN * motion)
    if not inside.any():
        return float(highest)
    # Below the dynamic range all frequencies are equally good, and the lowest is chosen.
    return float(frequency[inside][np.argmin(power[inside])])


def _end_of_motion(power: Array, frequency: Array) -> int:
    """Return the index at which an acceleration spectrum (m,) is lowest between motion and noise.

    Position noise is at most white. Bands beyond the minimum with clearly more power belong to the
    motion; so do bands with much less if they are a large part of it, as a gait beside a slow sway.
    """
    position, velocity = power / frequency**4, power / frequency**2
    peak = int(np.argmax(velocity))
    large = velocity >= _PART * velocity[peak]
    while True:
        valley = peak + int(np.argmin(power[peak:]))
        relative = position[valley:] / position[valley]
        beyond = np.flatnonzero((relative > _RISE) | ((relative < 1.0 / _FALL) & large[valley:]))
        if not len(beyond):
            return valley
        peak = valley + int(beyond[-1])


def _acceleration_power(pieces: Sequence[tuple[Array, float]], edges: Array) -> Array:
    """Return the acceleration spectrum (m,) in bands: geometric mean over joints, peak 1."""
    bands = np.diff(edges)[:, None]
    total = np.zeros((len(bands), pieces[0][0].shape[1]))
    for position, period in pieces:
        acceleration = np.diff(position, 2, axis=0) / period**2
        length = min(len(acceleration), round(_WELCH_SECONDS / period))
        # Differences remove the trend and most of the dynamic range; the window does the rest.
        frequency, density = spectral_density(
            acceleration, 1 / period, length, window=SHARP, centered=False
        )
        cumulative = np.cumsum(density, axis=0) * frequency[1]
        at_edges = [np.interp(edges, frequency, column) for column in cumulative.T]
        total += len(position) * period * np.diff(np.stack(at_edges, 1), axis=0) / bands
    peaks = np.max(total, axis=0)
    # A joint that does not move in these pieces has no preference for a frequency.
    relative = np.maximum(total / np.where(peaks > 0.0, peaks, 1.0), _DYNAMIC_RANGE)
    return np.exp(np.log(relative).mean(axis=1))
