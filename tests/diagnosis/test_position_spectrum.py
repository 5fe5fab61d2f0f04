"""Orders of ripple, found in the spectrum of a residual over position."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

from geodrake.diagnosis.position_spectrum import highest_peak
from geodrake.identification.logs.evidence import effective_samples
from geodrake.logs.filtering import design_filter

PERIOD, BANDWIDTH = 0.004, 12.0
LOW_PASS = design_filter(PERIOD, BANDWIDTH)


def motion(rng, seconds=40.0, reach=1.2):
    """Positions and velocities of a smooth random motion, at the log's rate."""
    time = np.arange(0.0, seconds, PERIOD)[:, None]
    rate = 2 * np.pi * rng.uniform(0.05, 0.6, 6)
    phase, size = rng.uniform(0, 2 * np.pi, 6), rng.uniform(0.3, 1.0, 6)
    angle = rate * time + phase
    q, v = (size * np.sin(angle)).sum(1), (size * rate * np.cos(angle)).sum(1)
    return reach * q / np.abs(q).max(), reach * v / np.abs(q).max()


def peak_of(q, v, effort):
    """The peak of an effort that was logged along a motion."""
    at = LOW_PASS.output_indices(len(q))
    residual = LOW_PASS.apply(effort)
    return highest_peak(
        (q[at], v[at]),
        residual,
        effective=effective_samples([residual]),
        gain=LOW_PASS.response,
        bandwidth=LOW_PASS.bandwidth,
    )


def alarm(peak):
    return peak.tried * chi2.sf(peak.height, 2)


@pytest.mark.parametrize(("order", "seed"), [(9.0, 1), (16.5, 2), (60.0, 3), (101.3, 1)])
def test_order_is_found(order, seed):
    rng = np.random.default_rng(seed)
    q, v = motion(rng)
    effort = 0.5 * np.cos(order * q + 1.0) + 0.6 * rng.normal(size=len(q))
    peak = peak_of(q, v, effort)
    assert alarm(peak) < 1e-6
    assert peak.order == pytest.approx(order, abs=0.25 * peak.resolution)
    assert peak.resolution == pytest.approx(2 * np.pi / np.ptp(q), rel=0.05)


def test_share_is_that_of_the_waves():
    rng = np.random.default_rng(4)
    q, v = motion(rng)
    wave, noise = np.cos(20.0 * q), rng.normal(size=len(q))
    power = [np.square(LOW_PASS.apply(part)).mean() for part in (wave, noise)]
    assert peak_of(q, v, wave + noise).share == pytest.approx(power[0] / sum(power), abs=0.07)


@pytest.mark.parametrize(("colour", "most"), [(0.0, 0.01), (0.99, 0.06)])
def test_noise_rarely_looks_like_waves(colour, most):
    """The threshold is 0.001; what is left is for the held-out evidence to refuse."""
    alarms = []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        q, v = motion(rng, seconds=20.0)
        noise = lfilter([1.0], [1.0, -colour], rng.normal(size=len(q)))
        alarms.append(alarm(peak_of(q, v, noise)))
    assert np.mean(np.array(alarms) < 1e-3) <= most


def test_motions_that_show_nothing():
    still, q = np.zeros(500), np.linspace(0.0, 200.0, 500)  # so fast that no wave passes the filter
    way = {"effective": 10.0, "gain": LOW_PASS.response, "bandwidth": BANDWIDTH}
    assert highest_peak((still, still), still, **way) is None
    assert highest_peak((1e-3 * q, q + 1.0), q, **way) is None
