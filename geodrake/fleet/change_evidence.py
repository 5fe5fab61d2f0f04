"""Evidence of a change in one robot: every hypothesis, as steps and a ramp, on every day.

With z ~ N(0, s² 𝟙), what logs say for a change f(t) D z is the ratio of marginal likelihoods

    log E = ½ gᵀ (S + s⁻² 𝟙)⁻¹ g − ½ log det(𝟙 + s² S),   S = Dᵀ (Q − Cᵀ N⁻¹ C) D,

with Q = Σ f² M_t, C = Σ f L_tᵀ M_t and N of the robot's own parameters, all of cumulative sums over
days. A mean of such ratios over hypotheses, forms, days and scales s has the expectation 1 where
nothing changed. By Markov's inequality it is above 1/α with a probability of at most α, whatever
the number of hypotheses and however alike they are.

T times that mean is a sum of T ratios, each of which goes on with the expectation 1 as logs come:
by Doob's inequality it is above T_max/α before T_max with a probability of at most α. A history
that is looked at anew with each log is thus as safe as one that is looked at once (exactly for
steps and known scales; the sizes of ramps are those up to the last log).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from geodrake.boundary.showing import Short
from geodrake.fleet.type_columns import RAMP, STEP, ChangeHypothesis
from geodrake.fleet.type_model import RobotFit
from geodrake.inertia import Array

Indices = NDArray[np.intp]

UNTIL = "until"
FORMS = (STEP, UNTIL, RAMP)
"""A step, what was there until a step, and a ramp."""


def kind_of(form: str) -> str:
    """Return the kind of change that a form is of."""
    return STEP if form == UNTIL else form


@dataclass(frozen=True, eq=False)
class Profiles(Short):
    """The steps or ramps that may begin at any of a robot's logs.

    A step is 0 before the log and 1 from it on, or 1 until the log and 0 from it on. A ramp is 0 up
    to the log and then rises in proportion to the days, to 1 at the last log.
    """

    form: str
    first: Indices  # (K,) log at which each begins
    days: Array  # (T,) days of the logs

    @classmethod
    def of(cls, form: str, days: Array) -> Profiles:
        """Return all that ascending days (T,) of a robot's logs can show."""
        starts = np.unique(days, return_index=True)[1]  # logs of one day are not told apart
        return cls(form, starts[:-1] if form == RAMP else starts[1:], days)

    @property
    def values(self) -> Array:
        """(K, T) values."""
        after = np.arange(len(self.days)) >= self.first[:, None]
        if self.form == UNTIL:
            return np.logical_not(after).astype(float)
        if self.form == STEP:
            return after.astype(float)
        begun = self.days[self.first][:, None]
        return np.asarray(after * (self.days - begun) / (self.days[-1] - begun))

    def sums(self, per_log: Array) -> Array:
        """Return (K, ...) sums Σ_t f_k(t) X_t, of cumulative sums."""
        if self.form == UNTIL:
            return np.asarray(np.cumsum(per_log, axis=0)[self.first - 1])
        zeroth = _tail_sums(per_log)[self.first]
        if self.form == STEP:
            return zeroth
        left, span = self._ramp(per_log)
        return np.asarray(zeroth - _tail_sums(left * per_log)[self.first] / span)

    def squares(self, per_log: Array) -> Array:
        """Return (K, ...) sums Σ_t f_k(t)² X_t, of cumulative sums."""
        if self.form != RAMP:
            return self.sums(per_log)
        left, span = self._ramp(per_log)
        zeroth, first, second = (
            _tail_sums(each)[self.first] for each in (per_log, left * per_log, left**2 * per_log)
        )
        return np.asarray(zeroth - 2.0 * first / span + second / span**2)

    def _ramp(self, per_log: Array) -> tuple[Array, Array]:
        """Return days that are left after logs, and those of whole ramps, shaped to go with X.

        A ramp is 1 − left / span. Counted from the last log, no sum is more than its parts.
        """
        left = (self.days[-1] - self.days).reshape(-1, *(1,) * (per_log.ndim - 1))
        return left, left[self.first]


def _tail_sums(per_log: Array) -> Array:
    """Return (T, ...) sums over each log and all later ones."""
    return np.cumsum(per_log[::-1], axis=0)[::-1]


SCALES = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Sizes s of changes, over the usual one of their hypothesis, that are thought of."""


@dataclass(frozen=True)
class ChangePlace:
    """A change in the space of all: hypothesis, form and day, by their numbers."""

    hypothesis: int
    form: str
    first: int


@dataclass(frozen=True, eq=False)
class ChangeEvidence(Short):
    """What logs of a robot say for a change."""

    profiles: tuple[Profiles, ...]
    # For each of them, (h, K) logarithms of ratios of each hypothesis and day, means over sizes; −∞
    # for a hypothesis that is not of its kind.
    ratio: tuple[Array, ...]
    prior: tuple[Array, ...]  # (h, K) logarithms of their prior probabilities, which sum to 1

    @property
    def total(self) -> float:
        """Logarithm of the mean ratio, whose exponential is an E-value."""
        return float(logsumexp(self._joint))

    def posterior(self) -> tuple[Array, ...]:
        """Return (h, K) probabilities of each form, given that there is one change."""
        sizes = np.cumsum([each.size for each in self.ratio])[:-1]
        shares = np.exp(self._joint - self.total)
        parts = np.split(shares, sizes)
        return tuple(p.reshape(r.shape) for p, r in zip(parts, self.ratio, strict=True))

    def joint(self, place: ChangePlace) -> float:
        """Return the logarithm of one change's ratio times its prior probability."""
        at, chosen = self._chosen(place)
        return float(self.ratio[at][chosen] + self.prior[at][chosen])

    def log_prior(self, place: ChangePlace) -> float:
        """Return the logarithm of one change's prior probability."""
        at, chosen = self._chosen(place)
        return float(self.prior[at][chosen])

    def _chosen(self, place: ChangePlace) -> tuple[int, tuple[int, int]]:
        at = [each.form for each in self.profiles].index(place.form)
        day = int(np.flatnonzero(self.profiles[at].first == place.first)[0])
        return at, (place.hypothesis, day)

    @property
    def _joint(self) -> Array:
        pairs = zip(self.ratio, self.prior, strict=True)
        return np.concatenate([(ratio + prior).ravel() for ratio, prior in pairs])


def calc_change_evidence(
    fit: RobotFit, days: Array, hypotheses: Sequence[ChangeHypothesis], scale: Array
) -> ChangeEvidence:
    """Return what logs of some days (T,) say for each change; scales (p,) are those of shares."""
    usable = np.unique(days).size > 1
    profiles = tuple(Profiles.of(form, days) for form in FORMS) if usable else ()
    ratios = [np.full((len(hypotheses), len(each.first)), -np.inf) for each in profiles]
    priors = [ratio.copy() for ratio in ratios]
    sizes = np.array([h.factor.shape[1] for h in hypotheses])
    for size in np.unique(sizes).tolist():
        for each, ratio, prior in zip(profiles, ratios, priors, strict=True):
            same = np.flatnonzero(sizes == size).tolist()
            kind = kind_of(each.form)
            tried = [h for h in same if kind in hypotheses[h].kinds]
            if not tried:
                continue
            factor = scale[:, None] * np.hstack([hypotheses[h].factor for h in tried])
            ratio[tried] = _ratios(fit, each, factor, size)
            ways = np.array([len(hypotheses[h].kinds) for h in tried]) * (2 if kind == STEP else 1)
            prior[tried] = -np.log(len(hypotheses) * len(each.first) * ways)[:, None]
    return ChangeEvidence(profiles, tuple(ratios), tuple(priors))


def _ratios(fit: RobotFit, profiles: Profiles, factor: Array, size: int) -> Array:
    """Return (h, K) log ratios of hypotheses (p, h · size) that have as many columns each."""
    count, T = factor.shape[1] // size, len(profiles.days)
    cross, side = profiles.sums(fit.seen_along(factor)), profiles.sums(fit.score @ factor)
    K, n = cross.shape[:2]
    solved = fit.solve(cross.transpose(1, 0, 2).reshape(n, -1)).reshape(n, K, -1)
    blocks = cross.reshape(K, n, count, size).transpose(0, 2, 3, 1)
    seen = blocks @ solved.transpose(1, 0, 2).reshape(K, n, count, size).transpose(0, 2, 1, 3)
    along = (fit.information @ factor).reshape(T, -1, count, size).transpose(0, 2, 1, 3)
    each = factor.reshape(-1, count, size).transpose(1, 2, 0)
    information = profiles.squares(each @ along) - seen
    return calc_log_ratio(information, side.reshape(K, count, size)).T


def calc_log_ratio(information: Array, score: Array) -> Array:
    """Return (...) logs of mean ratios of marginal likelihoods over the sizes considered.

    Of z, information (..., d, d) is what is known with all else let go, and the score (..., d) is
    the slope of the log-likelihood at z = 0.
    """
    if score.shape[-1] == 1:
        values, along = information[..., 0], score**2
    else:
        values, vectors = np.linalg.eigh(information)
        along = np.einsum("...de,...d->...e", vectors, score) ** 2
    values = np.maximum(values, 0.0)
    gains = [
        0.5 * (s**2 * along / (1.0 + s**2 * values) - np.log1p(s**2 * values)).sum(axis=-1)
        for s in SCALES
    ]
    return np.asarray(np.logaddexp.reduce(gains, axis=0) - np.log(len(SCALES)))
