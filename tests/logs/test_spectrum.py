"""Spectral densities against SciPy's, and against what is known of white noise and of sines."""

import numpy as np
import pytest
from scipy.signal import welch

from geodrake.logs.filtering import BLACKMAN_HARRIS, HANN, spectral_density

RATE = 250.0


@pytest.mark.parametrize("length", [2, 3, 64, 255, 256, 999, 1000])
@pytest.mark.parametrize(("window", "name"), [(HANN, "hann"), (BLACKMAN_HARRIS, "blackmanharris")])
@pytest.mark.parametrize("centered", [True, False])
def test_is_that_of_scipy(length, window, name, centered):
    signal = 3.0 + np.cumsum(np.random.default_rng(0).normal(size=(1000, 3)), axis=0)
    found = spectral_density(signal, RATE, length, window=window, centered=centered)
    detrend = "constant" if centered else False
    expected = welch(signal, RATE, name, length, axis=0, detrend=detrend)
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-14)
    np.testing.assert_allclose(found[1], expected[1], rtol=1e-9, atol=1e-14 * expected[1].max())


def test_of_white_noise_and_a_sine():
    time = np.arange(100_000) / RATE
    noise = 0.2 * np.random.default_rng(1).normal(size=len(time))
    both = np.stack([noise, 2.0 * np.sin(2 * np.pi * 31.25 * time)], 1)
    frequency, density = spectral_density(both, RATE, 512)
    assert density[:, 0].mean() == pytest.approx(0.2**2 / (RATE / 2), rel=0.02)
    assert frequency[density[:, 1].argmax()] == 31.25
    assert density[:, 1].sum() * frequency[1] == pytest.approx(2.0, rel=1e-6)
