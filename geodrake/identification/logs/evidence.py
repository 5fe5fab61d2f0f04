"""Evidence for an effect under coloured residuals.

Residuals of robots are not white: evidence uses effective sample sizes and held-out errors.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import chdtrc, ndtr

Array = NDArray[np.float64]

_HARDLY = 0.01  # negligible change, relative to the fold's loss
_NO_RISE = 0.05  # negligible rise, relative to the mean loss of the folds
_MOST = 0.5  # share of a loss, or of the folds
_FEW = 2  # folds
_ENOUGH, _EXACT = 5, 10  # folds: least for ranks, most for exact enumeration of signs
_UNCORRELATED = 0.02  # negligible autocorrelation


def effective_samples(blocks: Sequence[Array]) -> float:
    """Return the effective number of samples of a coloured residual in blocks (K_i,)."""
    return float(effective_samples_of_each([blocks])[0])


def effective_samples_of_each(series: Sequence[Sequence[Array]]) -> Array:
    """Return the effective numbers (J,) of samples of J coloured residuals.

    The blocks (K_i,) of a residual have no gaps inside.
    """
    longest = max(len(block) for blocks in series for block in blocks)
    size = next_fast_len(2 * longest, real=True)
    spectra = np.zeros((len(series), size // 2 + 1))
    for j, blocks in enumerate(series):
        for block in blocks:
            transform = rfft(block, size)
            spectra[j] += np.square(transform.real) + np.square(transform.imag)
    samples = np.array([float(sum(map(len, blocks))) for blocks in series])
    return effective_by_covariance(irfft(spectra, size)[:, :longest], samples)


def effective_by_covariance(covariance: Array, samples: ArrayLike) -> Array:
    """Return the effective numbers n / (1 + 2 Σ ρ_k) of n samples from their autocovariance.

    The autocorrelation ρ is summed up to its first value below 0.02. Results (…) are between 1 and
    n, and n for zero power. Covariances (…, L) are sums of r_t r_{t+k} over t, for k = 0, 1, …;
    `samples` (…) are the numbers n.
    """
    power = covariance[..., 0]
    correlation = covariance[..., 1:] / np.where(power > 0.0, power, 1.0)[..., None]
    counted = ~np.logical_or.accumulate(correlation < _UNCORRELATED, axis=-1)
    total = np.sum(correlation, axis=-1, where=counted)
    return np.where(power > 0.0, np.maximum(1.0, samples / (1.0 + 2.0 * total)), samples)


def false_alarm_probability(gain: float, parameters: int, tried: int) -> float:
    """Return the probability that the best of `tried` irrelevant candidates gains as much.

    The gain is twice the held-out log-likelihood ratio of the linear and shape `parameters`, which
    is conservative; candidates enter by Bonferroni's correction.
    """
    return min(1.0, tried * chi2_tail(gain, parameters))


def chi2_tail(gain: float, degrees: int) -> float:
    """Return the probability that χ² exceeds the gain; 1 for negative gains."""
    return float(chdtrc(degrees, max(gain, 0.0)))


def fold_agreement(before: Array, after: Array) -> float:
    """Return the share of folds whose loss decreases, for losses (F,) before and after.

    Backlash, for example, shows only in folds in which a load changes its sign. If the loss falls
    clearly in more than half of the folds, a fold with a negligible change therefore counts half,
    as in a sign test. If it is halved in two or more folds, only folds in which it rises by more
    than 5 % of the mean loss count against. Folds without samples have a zero loss before.
    """
    seen = before > 0.0
    if not seen.any():
        return 0.0
    change = (after - before)[seen] / before[seen]
    if np.sum(change < -_MOST) >= _FEW:
        return float(np.mean((after - before)[seen] < _NO_RISE * before[seen].mean()))
    if np.mean(change < -_HARDLY) <= _MOST:
        return float(np.mean(change < 0.0))
    return float(np.mean(np.where(np.abs(change) > _HARDLY, change < 0.0, 0.5)))


def tie_probability(loss_a: Array, loss_b: Array) -> float:
    """Return the probability that b is no worse than a, from held-out losses (F,) of the folds.

    Losses of folds differ by orders of magnitude, as slow and fast motion do, so that ranks of the
    differences are more robust than their mean. Return the one-sided p-value of Wilcoxon's
    signed-rank test over folds with a notable difference, or of the paired t-test if these are too
    few for ranks, or ½ if there are fewer than two.
    """
    from scipy.stats import rankdata, ttest_1samp  # takes half a second to import

    difference = loss_b - loss_a
    difference = difference[np.abs(difference) > _HARDLY * np.maximum(loss_a, loss_b)]
    if len(difference) < 2:
        return 0.5
    if len(difference) < _ENOUGH:
        if np.ptp(difference) == 0.0:
            return float(difference[0] < 0.0)
        return float(ttest_1samp(difference, 0.0, alternative="greater").pvalue)
    ranks = rankdata(np.abs(difference))
    positive = ranks[difference > 0.0].sum()
    if len(difference) <= _EXACT:
        signs = np.arange(2 ** len(difference))[:, None] >> np.arange(len(difference)) & 1
        return float(np.mean(signs @ ranks >= positive - 1e-9))
    # Mean and variance of the rank sum under random signs.
    mean, variance = 0.5 * ranks.sum(), 0.25 * np.square(ranks).sum()
    return float(ndtr(-(positive - mean - 0.5) / np.sqrt(variance)))
