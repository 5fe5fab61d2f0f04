"""Evidence: effective samples against theory; false alarms and ties by simulation."""

import numpy as np
import pytest
from scipy.signal import lfilter

from geodrake.identification.logs.evidence import (
    effective_samples,
    false_alarm_probability,
    fold_agreement,
    tie_probability,
)


def autoregressive(rng, n, rho):
    """Return stationary AR(1) series of unit variance."""
    drive = np.sqrt(1 - rho**2) * rng.normal(size=n)
    drive[0] = rng.normal()
    return lfilter([1.0], [1.0, -rho], drive)


@pytest.mark.parametrize("parameters", [1, 10])
def test_false_alarms_are_as_frequent_as_stated(parameters):
    """Regressors are irrelevant; training gains are the worst case."""
    rng, runs, n = np.random.default_rng(6), 1000, 200
    stated = np.empty(runs)
    for i in range(runs):
        A, b = rng.normal(size=(n, parameters)), rng.normal(size=n)
        x = np.linalg.lstsq(A, b)[0]
        gain = n * np.log((b @ b) / np.square(b - A @ x).sum())
        stated[i] = false_alarm_probability(gain, parameters, 1)
    for level in (0.3, 0.05):
        spread = np.sqrt(level * (1 - level) / runs)
        assert np.mean(stated < level) == pytest.approx(level, abs=4 * spread)


def test_coloured_residuals_raise_no_false_alarms():
    """A smooth irrelevant regressor and residuals of lag-1 correlation 0.8."""
    rng, runs, n, rho = np.random.default_rng(9), 500, 400, 0.8
    naive, counted = np.empty((2, runs))
    for i in range(runs):
        a, b = autoregressive(rng, n, rho), autoregressive(rng, n, rho)
        residual = b - a * (a @ b) / (a @ a)
        ratio = np.mean(b**2) / np.mean(residual**2)
        naive[i] = false_alarm_probability(n * np.log(ratio), 1, 1)
        effective = effective_samples([residual])
        counted[i] = false_alarm_probability(effective * np.log(ratio), 1, 1)
    assert np.mean(naive < 0.05) > 0.25
    assert np.mean(counted < 0.05) < 0.08


@pytest.mark.parametrize("folds", [3, 8])
def test_ties_of_equals_are_evenly_spread(folds):
    """Paired losses differ by chance only, so the p-value is uniform up to its steps."""
    rng, runs = np.random.default_rng(10), 1000
    pairs = 5.0 + rng.normal(size=(runs, 2, folds))
    p = np.array([tie_probability(a, b) for a, b in pairs])
    for level in (0.05, 0.5, 0.95):
        spread = np.sqrt(level * (1 - level) / runs)
        ways = np.pi * folds * (folds + 1) * (2 * folds + 1)
        step = np.sqrt(12.0 / ways) if folds > 4 else 0.0  # chance of the likeliest sum of ranks
        assert np.mean(p < level) == pytest.approx(level, abs=4 * spread + step)


@pytest.mark.parametrize(
    ("after", "agreement"),
    [
        ([0.9, 0.9, 0.9, 1.1], 0.75),
        # Most fall; one that stays counts half.
        ([0.9, 0.9, 0.9, 1.001], 0.875),
        # Two are halved, each predicted by the others: those that hardly rise do not speak against.
        ([0.3, 0.3, 1.02, 1.02], 1.0),
        ([0.3, 0.3, 1.02, 1.2], 0.75),
        # One may be an accident, and one fold in which much is gone is no agreement.
        ([0.1, 1.02, 1.02, 1.02], 0.25),
        ([0.5] + [1.002] * 7, 1 / 8),
        ([0.5] * 5 + [1.002] * 3, 6.5 / 8),
        ([0.5] * 5 + [1.3] * 3, 5 / 8),
        ([0.5, 1.002], 0.5),
    ],
)
def test_agreement_of_folds(after, agreement):
    assert fold_agreement(np.ones(len(after)), np.array(after)) == agreement


def test_folds_without_errors_agree_to_nothing():
    before = np.array([1.0, 1.0, 0.0])
    assert fold_agreement(before, np.array([0.5, 0.5, 0.0])) == 1.0
    assert fold_agreement(np.zeros(2), np.zeros(2)) == 0.0
