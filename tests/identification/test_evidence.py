"""Evidence: effective samples against theory, and false alarms and ties counted by simulation."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import wilcoxon

from geodrake.identification.logs.evidence import (
    effective_samples,
    false_alarm_probability,
    fold_agreement,
    tie_probability,
)
from geodrake.identification.logs.model_errors import ErrorTable, JointError


def autoregressive(rng, n, rho):
    """Stationary AR(1) series of unit variance."""
    drive = np.sqrt(1 - rho**2) * rng.normal(size=n)
    drive[0] = rng.normal()
    return lfilter([1.0], [1.0, -rho], drive)


def test_effective_samples_of_blocks_of_all_lengths():
    """By the sum itself: n / (1 + 2 Σ ρ) up to the first ρ below 0.02."""
    rng = np.random.default_rng(8)
    blocks = [autoregressive(rng, n, 0.8) for n in (400, *[7] * 30, 1)]
    products = [sum(b[: len(b) - k] @ b[k:] for b in blocks if k < len(b)) for k in range(400)]
    correlation = np.array(products[1:]) / products[0]
    last = int(np.argmax(correlation < 0.02))
    expected = sum(map(len, blocks)) / (1.0 + 2.0 * correlation[:last].sum())
    assert effective_samples(blocks) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("parameters", [1, 10])
def test_false_alarms_are_as_frequent_as_stated(parameters):
    """Of irrelevant regressors; training gains are the worst case."""
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
    """Paired losses that differ by chance only: the p-value is uniform, but for its steps."""
    rng, runs = np.random.default_rng(10), 1000
    pairs = 5.0 + rng.normal(size=(runs, 2, folds))
    p = np.array([tie_probability(a, b) for a, b in pairs])
    for level in (0.05, 0.5, 0.95):
        spread = np.sqrt(level * (1 - level) / runs)
        ways = np.pi * folds * (folds + 1) * (2 * folds + 1)
        step = np.sqrt(12.0 / ways) if folds > 4 else 0.0  # chance of the likeliest sum of ranks
        assert np.mean(p < level) == pytest.approx(level, abs=4 * spread + step)


@pytest.mark.parametrize("folds", [5, 10])
def test_ties_are_those_of_the_signed_rank_test(folds):
    rng = np.random.default_rng(12)
    for shift in (0.0, 0.05, 0.2):
        a = rng.uniform(1.0, 2.0, folds)
        b = a + np.sign(rng.normal(shift, 0.1, folds)) * rng.uniform(0.05, 0.5, folds)
        expected = wilcoxon(b - a, alternative="greater", method="exact").pvalue
        assert tie_probability(a, b) == pytest.approx(expected)


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


@pytest.mark.parametrize(
    ("over_floor", "is_noise"),
    [
        ([1.2] * 7, True),
        ([1.3] * 7, False),
        ([1.0] * 6 + [1.5], True),
        ([1.0] * 6 + [2.0], False),  # 1.2 times on the whole
    ],
)
def test_noise_of_other_joints_covers_nothing_up(over_floor, is_noise):
    """Seven joints with the same noise, in units of their own efforts."""
    sizes = np.geomspace(0.1, 100.0, 7)
    joints = zip("abcdefg", sizes, over_floor, strict=True)
    table = ErrorTable(tuple(JointError(j, f * 0.01 * s, s, 0.01 * s) for j, s, f in joints))
    assert table.is_noise == is_noise
