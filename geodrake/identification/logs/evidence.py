"""Evidence for an effect that is valid for coloured residuals.

Residuals of robots are not white, so samples are counted by how many independent ones they are
worth, and errors are always those of data that the fit did not see.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import chdtrc, ndtr

Array = NDArray[np.float64]

_HARDLY, _NO_RISE = 0.01, 0.05  # of a fold's loss, and of the mean one
_MOST = 0.5  # of a loss, or of the folds: more than this share
_FEW = 2  # folds
_ENOUGH, _EXACT = 5, 10  # folds: for ranks, and of which every pattern of signs is counted
_UNCORRELATED = 0.02  # autocorrelation from which on there is none


def effective_samples(blocks: Sequence[Array]) -> float:
    """Return how many independent samples a coloured residual of blocks (K_i,) is worth."""
    return float(effective_samples_of_each([blocks])[0])


def effective_samples_of_each(series: Sequence[Sequence[Array]]) -> Array:
    """Return (J,) how many independent samples each of J coloured residuals is worth.

    The blocks (K_i,) of each residual are stretches without gaps.
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
    """Return the effective number of n samples with an autocovariance: n / (1 + 2 Σ ρ_k).

    The autocorrelation ρ is summed up to its first value below 0.02. The numbers (…) are between 1
    and n, and n where nothing is known of ρ. Covariances (…, L) are sums of r_t r_{t+k} over t, for
    k = 0, 1, …; `samples` (…) are the numbers n.
    """
    power = covariance[..., 0]
    correlation = covariance[..., 1:] / np.where(power > 0.0, power, 1.0)[..., None]
    counted = ~np.logical_or.accumulate(correlation < _UNCORRELATED, axis=-1)
    total = np.sum(correlation, axis=-1, where=counted)
    return np.where(power > 0.0, np.maximum(1.0, samples / (1.0 + 2.0 * total)), samples)


def false_alarm_probability(gain: float, parameters: int, tried: int) -> float:
    """Return the chance that the best of `tried` irrelevant candidates would gain as much.

    The gain is twice the held-out log-likelihood ratio (smaller than the in-sample one: cautious),
    by linear and shape parameters; candidates are counted as by Bonferroni.
    """
    return min(1.0, tried * chi2_tail(gain, parameters))


def chi2_tail(gain: float, degrees: int) -> float:
    """Return the chance that χ² is larger than a gain; certain below zero."""
    return float(chdtrc(degrees, max(gain, 0.0)))


def fold_agreement(before: Array, after: Array) -> float:
    """Return the share of the folds whose loss falls.

    Play, for example, shows only in the folds where a load changes its sign. Where the loss falls
    clearly in more than half of the folds, one in which it hardly changes therefore counts half, as
    in a sign test; and where it is halved in two or more, each predicted by the others, only those
    count against it in which it rises, by a notable share of what folds lose in the mean. Losses
    are (F,); folds without samples have none before.
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
    """Return the chance that b is truly no worse than a, from the paired losses of the folds.

    Folds differ by orders of magnitude, as those of slow and fast motion do, and what varies with
    time shows in few of them: the ranks of the differences tell more than their mean. It is the
    one-sided p-value of Wilcoxon's signed-rank test among the folds that differ by more than
    hardly, of the paired t-test where these are too few for ranks; one half where none does.
    Losses (F,) are held-out ones of the better hypothesis and of the other, per fold.
    """
    from scipy.stats import rankdata, ttest_1samp  # half a second, for those who need it

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
    # Of differences without a sign of their own, the sum has this mean and this variance.
    mean, variance = 0.5 * ranks.sum(), 0.25 * np.square(ranks).sum()
    return float(ndtr(-(positive - mean - 0.5) / np.sqrt(variance)))
