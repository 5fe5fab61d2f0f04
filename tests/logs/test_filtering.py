"""Zero-phase filtering, differentiation and the choice of a bandwidth."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geodrake.errors import ArgumentError, LogError
from geodrake.logs.filtering import choose_bandwidth, design_filter, differentiate, resample

PERIOD = 0.002
BANDWIDTH = 10.0
PASSBAND = 0.6  # of the bandwidth


@pytest.fixture
def low_pass():
    return design_filter(PERIOD, BANDWIDTH)


def test_kernel_is_symmetric_and_keeps_constants(low_pass):
    assert np.array_equal(low_pass.kernel, low_pass.kernel[::-1])
    assert low_pass.kernel.sum() == pytest.approx(1.0)
    assert np.allclose(low_pass.apply(np.full((1000, 2), 3.0)), 3.0)
    assert np.allclose(low_pass.smooth(np.full(1000, 3.0)), 3.0)


@pytest.mark.parametrize("frequency", [0.3, 3.0, PASSBAND * BANDWIDTH])
def test_passband_is_untouched_and_without_lag(low_pass, frequency):
    time = PERIOD * np.arange(5000)
    rate = 2 * np.pi * frequency
    inner = slice(low_pass.halfwidth, -low_pass.halfwidth)
    signal = np.sin(rate * time)
    position = low_pass.smooth(signal)
    assert np.abs(position - signal)[inner].max() < 1e-3
    assert np.abs(low_pass.apply(signal) - signal[low_pass.output_indices(5000)]).max() < 1e-3
    velocity = differentiate(position, PERIOD)
    acceleration = differentiate(velocity, PERIOD)
    assert np.abs(velocity - rate * np.cos(rate * time))[inner].max() < 1e-3 * rate
    assert np.abs(acceleration + rate**2 * np.sin(rate * time))[inner].max() < 1e-3 * rate**2


@pytest.mark.parametrize("share", [0.01, 0.13, 0.19, 0.25])
def test_filtered_white_noise_is_white_after_decimation(share):
    noise = np.random.default_rng(3).standard_normal((200_000, 1))
    low_pass = design_filter(PERIOD, share / PERIOD)
    filtered = low_pass.apply(noise)[:, 0]
    assert np.std(filtered) == pytest.approx(low_pass.noise_gain, rel=0.05)
    assert abs(np.corrcoef(filtered[1:], filtered[:-1])[0, 1]) < 0.15
    rate = 1 / low_pass.output_period
    assert 2 * low_pass.bandwidth - 1e-9 <= rate <= 2.1 * low_pass.bandwidth


@given(n=st.integers(0, 1500), size=st.integers(1, 900), bandwidth=st.floats(8.0, 120.0))
def test_chunks_are_the_whole(n, size, bandwidth):
    low_pass = design_filter(PERIOD, bandwidth)
    columns = np.random.default_rng(n).standard_normal((n, 3))
    whole = low_pass.apply(columns)
    assert len(whole) == low_pass.output_count(n) == len(low_pass.output_indices(n))
    parts = [np.empty((0, 3))]
    for rows, outputs in low_pass.chunks(n, size):
        assert rows.stop - rows.start <= max(size, 2 * low_pass.halfwidth + 1)
        parts.append(low_pass.apply(columns[rows]))
        assert len(parts[-1]) == outputs
    assert np.array_equal(np.concatenate(parts), whole)


def test_what_no_filter_can_have():
    for bandwidth in (0.0, -1.0, 126.0, np.nan):
        with pytest.raises(ArgumentError, match="500 Hz"):
            design_filter(PERIOD, bandwidth)
    for period in (0.0, -0.1, np.nan):
        with pytest.raises(ArgumentError, match="must be positive"):
            design_filter(period, 1.0)
    with pytest.raises(ArgumentError, match="6 samples; got 5"):
        differentiate(np.zeros(5), PERIOD)
    with pytest.raises(LogError, match="32 samples"):
        choose_bandwidth([(np.zeros((20, 1)), 0.01)])


def test_resampled_efforts_do_not_overshoot():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.choice([0.01, 0.012, 0.03], 300, p=[0.7, 0.28, 0.02]))
    step = (time > 1.5).astype(float)[:, None]
    grid = np.arange(time[0], time[-1], 0.01)
    smooth = resample(time, np.sin(3 * time)[:, None], grid)
    sharp = resample(time, step, grid, sharp=True)
    assert np.abs(smooth[:, 0] - np.sin(3 * grid)).max() < 1e-4
    assert sharp.min() == 0.0
    assert sharp.max() == 1.0


def _motion(highest, noise, period=0.001, seconds=40.0):
    time = period * np.arange(int(seconds / period))
    rng = np.random.default_rng(1)
    rates = 2 * np.pi * highest * np.arange(1, 6) / 5
    waves = np.sin(rates[:, None] * time + rng.uniform(0, 6, (3, 5, 1))) / rates[:, None]
    return waves.sum(1).T + noise * rng.standard_normal((len(time), 3))


@pytest.mark.parametrize("highest", [0.4, 2.0, 7.0])
@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-4])
def test_bandwidth_holds_the_motion(highest, noise):
    chosen = choose_bandwidth([(_motion(highest, noise), 0.001)])
    assert 3.0 * highest < chosen < 12.0 * highest


def test_bandwidth_holds_a_gait_beside_a_slow_sway():
    """The spectrum is low between the two, and not for noise."""
    sway, gait = _motion(0.4, 1e-5), _motion(10.0, 0.0)
    begins = 0.5 + 0.5 * np.tanh(2.0 * np.linspace(-20.0, 20.0, len(gait)))[:, None]
    for pieces in ([sway, sway + gait], [sway + begins * gait]):
        assert choose_bandwidth([(piece, 0.001) for piece in pieces]) > 12.0


def test_bandwidth_holds_a_trot_that_positions_hardly_show_beside_a_sway():
    """Its impacts shake the robot at all frequencies, so that nothing is as quiet as the sway."""
    count, rng = 8000, np.random.default_rng(0)
    rates = np.fft.rfftfreq(count, 0.005)
    at = 0.23, 0.29, 0.41, 0.59, 0.93, 1.2, 1.5, 2.1, 2.8, 4.2, 5.0, 10.0, 100.0
    power = 1.6, 6.6, 2.9, 14.0, 6.0, 34.0, 15.0, 290.0, 27.0, 600.0, 200.0, 450.0, 400.0
    size = np.sqrt(np.interp(rates, at, power)) / np.maximum(rates, 0.2) ** 2
    phases = rng.uniform(0.0, 2.0 * np.pi, (len(rates), 18))
    position = np.fft.irfft(size[:, None] * np.exp(1j * phases), count, axis=0)
    assert choose_bandwidth([(position, 0.005)]) > 8.0
