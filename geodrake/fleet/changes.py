"""Changes of one robot, with their rivals, and of all robots of a type.

A robot is looked at for every hypothesis, as steps and a ramp, on every day.

With z ~ N(0, s² 𝟙), what logs say for a change f(t) D z is the ratio of marginal likelihoods

    log E = ½ gᵀ (S + s⁻² 𝟙)⁻¹ g − ½ log det(𝟙 + s² S),   S = Dᵀ (Q − Cᵀ N⁻¹ C) D,

with Q = Σ f² M_t, C = Σ f L_tᵀ M_t and N of the robot's own parameters. A mean of such ratios over
hypotheses, forms, days and scales s has the expectation 1 where nothing changed. By Markov's
inequality it is above 1/α with a probability of at most α, whatever the number of hypotheses and
however alike they are.

T times that mean is a sum of T ratios, each of which goes on with the expectation 1 as logs come:
by Doob's inequality it is above T_max/α before T_max with a probability of at most α. A history
that is looked at anew with each log is thus as safe as one that is looked at once (exactly for
steps and known scales; the sizes of ramps are those up to the last log).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from scipy.special import logsumexp

from geodrake.boundary.showing import Short
from geodrake.fleet.fleet_result import ChangedParameter, ChangeRival, FleetFinding
from geodrake.fleet.history import DAY, LogEquations, RobotHistory
from geodrake.fleet.type_columns import RAMP, STEP, ChangeHypothesis, TypeColumns
from geodrake.fleet.type_learning import learn_type, least_squares, pooled
from geodrake.fleet.type_model import RobotFit, TypeModel
from geodrake.fleet.workers import HERE, Workers
from geodrake.identification.logs.dataset import Indices
from geodrake.inertia import Array

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

    @cached_property
    def values(self) -> Array:
        """Return the (K, T) values."""
        after = np.arange(len(self.days)) >= self.first[:, None]
        if self.form == UNTIL:
            return np.logical_not(after).astype(float)
        if self.form == STEP:
            return after.astype(float)
        begun = self.days[self.first][:, None]
        return np.asarray(after * (self.days - begun) / (self.days[-1] - begun))

    def sums(self, per_log: Array) -> Array:
        """Return (K, ...) sums Σ_t f_k(t) X_t."""
        return np.tensordot(self.values, per_log, 1)

    def squares(self, per_log: Array) -> Array:
        """Return (K, ...) sums Σ_t f_k(t)² X_t."""
        return np.tensordot(self.values**2, per_log, 1)


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
    """Evidence of the logs of a robot for each change."""

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
    """Return the evidence of logs of days (T,) for each change; scales (p,) are those of shares."""
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


R = TypeVar("R")

MONTH = 30.0
"""Days."""

RIVAL = 0.05
"""Least probability at which a rival is reported."""

ODD_SHARE = 0.01
"""Share of logs that say nothing about the robot: another tool, a wrong file, a failed sensor."""

_MOST_CHANGES = 6
_MOST_EXCHANGES = 4
_WITHIN = 0.95  # probability of an interval of days
_TINY = 1e-300
_WIDE = 30.0  # scale of changes that were found, over the usual one
_KEPT = 4  # states of a robot
_FIRST, _LATER = 12, 4  # rounds of learning what robots share
_REFITS = 2  # of a robot, until its gains and odd logs are settled


@dataclass(frozen=True, eq=False)
class SearchState(Short):
    """A robot's logs, given some changes."""

    logs: LogEquations
    odd: Array  # (T, K) how odd they are
    cost: float
    fit: RobotFit


@dataclass(frozen=True, eq=False)
class RobotSearch(Short):
    """One robot's logs, and the changes to be considered.

    The last few states are kept while changes are sought or told, and no longer: they are large.
    """

    model: TypeModel
    source: RobotHistory  # its logs, with the parameters that gains refer to at first
    hypotheses: Sequence[ChangeHypothesis]
    level: float = 0.01
    _states: dict[tuple[ChangePlace, ...], SearchState] = field(default_factory=dict, init=False)

    @cached_property
    def history(self) -> RobotHistory:
        """Logs of the robot."""
        return self.source.read()

    def state(self, places: Sequence[ChangePlace]) -> SearchState:
        """Return the logs given some changes, with gains relative to the parameters of the day."""
        key = tuple(places)
        if key not in self._states:
            if len(self._states) >= _KEPT:
                self._states.pop(next(iter(self._states)))
            self._states[key] = self._fitted(places)
        return self._states[key]

    def _fitted(self, places: Sequence[ChangePlace]) -> SearchState:
        changes, odd = self.design(places), self.model.odd[0]
        reference = self.source.reference
        for _ in range(_REFITS):
            logs = self._equations(reference)
            fit = self.model.fit(0, logs, changes, odd)
            odd, cost = self.model.oddness(self.model.log_scores(0, fit), odd)
            reference = self.model.parameters(0, logs, fit)
        logs = self._equations(reference)
        fit = self.model.fit(0, logs, changes, odd)
        return SearchState(logs, odd, float(cost.sum()), fit)

    def _equations(self, reference: Array | None) -> LogEquations:
        gains = self.model.columns.gains
        return replace(self.history, reference=reference if gains else None).equations()

    def settled(self, places: Sequence[ChangePlace]) -> tuple[Array, Array]:
        """Return (T, p) parameters of the day given some changes, and (T, K) how odd logs are."""
        state = self._fitted(places)
        return self.model.parameters(0, state.logs, state.fit), state.odd

    def evidence(self, state: SearchState) -> ChangeEvidence:
        """Return the evidence for a further change, given those of a state."""
        scale = self.model.scale(0)
        return calc_change_evidence(state.fit, self.history.days, self.hypotheses, scale)

    def instead(self, state: SearchState, others: Sequence[ChangePlace]) -> ChangeEvidence:
        """Return the evidence for a change in place of one of a state's, given its odd logs."""
        fit = self.model.with_changes(state.fit, self.design(others))
        return self.evidence(replace(state, fit=fit))

    def design(self, places: Sequence[ChangePlace]) -> Array:
        """Return (T, p, m) the design matrix of some changes, with hardly limited sizes."""
        days, wide = self.history.days, _WIDE * self.model.scale(0)[:, None]
        parts = [np.zeros((len(days), len(wide), 0))]
        for place in places:
            values = Profiles(place.form, np.array([place.first]), days).values[0]
            factor = self.hypotheses[place.hypothesis].factor
            parts.append(values[:, None, None] * (wide * factor))
        return np.concatenate(parts, axis=2)

    def find(self) -> list[ChangePlace]:
        """Find changes that chance hardly explains, in the order in which they are found."""
        places: list[ChangePlace] = []
        while len(places) < _MOST_CHANGES:
            tried = sorted(self._candidates(places), key=lambda each: self.state(each).cost)
            added = (self._exchanged(each, -np.log(self.level)) for each in tried)
            better = next((each for each in added if len(each) > len(places)), None)
            if better is None:
                break  # it was too little, or made another one needless, and would again
            places = better
        self._states.clear()
        return places

    def _candidates(self, places: list[ChangePlace]) -> list[list[ChangePlace]]:
        """Return one change more: the best where odd logs count less, and where all count the same.

        Logs after a large change are odd as long as it is not known: the first may miss what it is.
        A single log that is odd misleads the second.
        """
        state = self.state(places)
        equal = np.zeros_like(state.odd)
        fit = self.model.fit(0, state.logs, self.design(places), equal)
        every = [self.evidence(state), self.evidence(replace(state, fit=fit))]
        found = dict.fromkeys(best_place(each) for each in every if each.profiles)
        return [[*places, place] for place in found if place not in places]

    def _exchanged(self, places: list[ChangePlace], least: float) -> list[ChangePlace]:
        """Return at most as many changes, each the best given the others."""
        for _ in range(_MOST_EXCHANGES):
            before = list(places)
            for at in range(len(places) - 1, -1, -1):
                others = places[:at] + places[at + 1 :]
                state = self.state(places)
                best = best_place(self.instead(state, others))
                exchanged = [*places[:at], best, *places[at + 1 :]]
                keep = best not in others and self.support(exchanged, at) >= least
                places = exchanged if keep else others
            if places == before:
                break
        return places

    def support(self, places: Sequence[ChangePlace], at: int) -> float:
        """Return the logarithm of the E-value of one of some changes, given the others.

        Either that of all changes that there may be, with logs that are odd without one; or that of
        this very one, and what such logs lose without it. It is never more than if all logs on one
        side of the change were something else, of which one in so many is: `ODD_SHARE`.
        """
        others = [*places[:at], *places[at + 1 :]]
        without = self.state(others)
        evidence = self.evidence(without)
        lost = without.cost - self.state(places).cost
        few = len(self.history.days) if places[at].form == RAMP else places[at].first
        few = min(few, len(self.history.days) - places[at].first)
        most = evidence.log_prior(places[at]) - few * np.log(ODD_SHARE)
        return float(min(max(evidence.total, evidence.joint(places[at]) + lost), most))

    def told(self, places: Sequence[ChangePlace]) -> tuple[FleetFinding, ...]:
        """Return the changes at some places, each with its size, date and evidence."""
        state = self.state(places)
        end, found = state.fit.size, []
        for at in range(len(places) - 1, -1, -1):
            place, others = places[at], [*places[:at], *places[at + 1 :]]
            hypothesis = self.hypotheses[place.hypothesis]
            part = slice(end - hypothesis.factor.shape[1], end)
            end = part.start
            sign = -_WIDE if place.form == UNTIL else _WIDE
            z, covariance = sign * state.fit.theta[part], state.fit.covariance[part, part]
            evidence, kind = self.instead(state, others), kind_of(place.form)
            shares = kind_shares(evidence)
            chance = np.exp(min(0.0, -self.support(places, at)))
            finding = FleetFinding(
                self.history.robot,
                hypothesis.effect,
                hypothesis.where,
                kind,
                float(self.history.days[place.first]) * DAY,
                self._interval(evidence, place),
                self._changed(hypothesis, z, _WIDE**2 * covariance),
                shares.pop((place.hypothesis, kind)),
                self._rivals(shares),
                float(chance),
            )
            found.append(finding)
        self._states.clear()
        return tuple(found[::-1])

    def _changed(
        self, hypothesis: ChangeHypothesis, z: Array, covariance: Array
    ) -> tuple[ChangedParameter, ...]:
        """Return by how much parameters changed; of a ramp up to the last log.

        Of what logs do not tell apart, the least change is told, and a deviation that says so.
        """
        moved = np.flatnonzero(hypothesis.factor.any(axis=1))
        scale, relative = self.model.scale(0)[moved], self.model.columns.relative[moved]
        rows = scale[:, None] * hypothesis.factor[moved]
        if hypothesis.rows is not None:
            rows, scale, relative = hypothesis.rows, np.ones(1), np.zeros(1, bool)
        size, variance = rows @ z, np.einsum("pd,de,pe->p", rows, covariance, rows)
        share = np.where(relative, size / scale, np.nan)
        numbers = np.stack([size, np.sqrt(np.maximum(variance, 0.0)), share], axis=1)
        pairs = zip(hypothesis.names, numbers.tolist(), strict=True)
        return tuple(ChangedParameter(*name, *own) for name, own in pairs)

    def _interval(self, evidence: ChangeEvidence, place: ChangePlace) -> tuple[float, float]:
        """Return the shortest time around a finding's of the probability of an interval, s."""
        first, share = _beginnings(evidence, place.hypothesis, kind_of(place.form))
        share = share / max(share.sum(), _TINY)
        low = high = int(np.flatnonzero(first == place.first)[0])
        while share[low : high + 1].sum() < _WITHIN and (low > 0 or high < len(share) - 1):
            before = share[low - 1] if low > 0 else -1.0
            after = share[high + 1] if high < len(share) - 1 else -1.0
            low, high = (low - 1, high) if before > after else (low, high + 1)
        dates = self.history.days[first] * DAY
        return float(dates[low]), float(dates[high])

    def _rivals(self, shares: dict[tuple[int, str], float]) -> tuple[ChangeRival, ...]:
        told = [
            ChangeRival(self.hypotheses[h].effect, self.hypotheses[h].where, kind, share)
            for (h, kind), share in shares.items()
            if share >= RIVAL
        ]
        return tuple(sorted(told, key=lambda rival: -rival.probability))


def kind_shares(evidence: ChangeEvidence) -> dict[tuple[int, str], float]:
    """Return the probability of each hypothesis and kind, over all days."""
    shares: dict[tuple[int, str], float] = {}
    for profiles, posterior in zip(evidence.profiles, evidence.posterior(), strict=True):
        for h, share in enumerate(posterior.sum(axis=1).tolist()):
            key = h, kind_of(profiles.form)
            shares[key] = shares.get(key, 0.0) + share
    return shares


def best_place(evidence: ChangeEvidence) -> ChangePlace:
    """Return the most probable hypothesis and kind over all days, on its most probable day."""
    shares = kind_shares(evidence)
    hypothesis, kind = max(shares, key=lambda key: shares[key])
    first, share = _beginnings(evidence, hypothesis, kind)
    begins = int(first[share.argmax()])
    places = [
        ChangePlace(hypothesis, profiles.form, begins)
        for profiles in evidence.profiles
        if kind_of(profiles.form) == kind
    ]
    return max(places, key=evidence.joint)


def _beginnings(evidence: ChangeEvidence, hypothesis: int, kind: str) -> tuple[Indices, Array]:
    """Return (K,) logs at which a kind of change may begin, and how probable each is."""
    pairs = zip(evidence.profiles, evidence.posterior(), strict=True)
    same = [(each.first, p[hypothesis]) for each, p in pairs if kind_of(each.form) == kind]
    return same[0][0], np.sum([share for _, share in same], axis=0)


def find_changes(
    histories: Sequence[RobotHistory],
    columns: TypeColumns,
    hypotheses: Sequence[ChangeHypothesis],
    tell: Callable[[RobotSearch], R],
    *,
    false_alarms: float = 0.01,
    passes: int = 3,
    team: Workers = HERE,
) -> tuple[TypeModel, list[R]]:
    """Find which robots of a type changed, at which joint or body, by which effect, since when.

    What all share, the scatter of logs and the common course are learnt with the changes that were
    found, and changes are sought with these, several times. At most `false_alarms` robots a
    robot-month are named in which nothing changed. Returns the type, and what `tell` makes of each
    search.
    """
    # What gains refer to at first is what all robots are in the mean.
    first = least_squares(*pooled(team, [replace(each, reference=None) for each in histories]))
    references: list[Array] = [first] * len(histories)

    def logs() -> list[RobotHistory]:
        pairs = zip(histories, references, strict=True)
        return [replace(h, reference=each if columns.gains else None) for h, each in pairs]

    def searches() -> list[RobotSearch]:
        months = [float(each.days[-1] - each.days[0] + 1.0) / MONTH for each in histories]
        levels = [min(1.0, false_alarms * each) for each in months]
        every = enumerate(zip(logs(), levels, strict=True))
        return [RobotSearch(model.of(r), own, hypotheses, level) for r, (own, level) in every]

    model = learn_type(logs(), columns, rounds=_FIRST, team=team)
    for _ in range(passes - 1):
        settled = team.in_order(_settled, searches())
        references, designs, odd = map(list, zip(*settled, strict=True))
        start = replace(model, odd=tuple(odd))
        model = learn_type(logs(), columns, changes=designs, start=start, rounds=_LATER, team=team)
    return model, team.in_order(tell, searches())


def _settled(search: RobotSearch) -> tuple[Array, Array, Array]:
    """Return a robot's input to the learning: parameters of the day, changes, how odd logs are."""
    places = search.find()
    reference, odd = search.settled(places)
    return reference, search.design(places), odd
