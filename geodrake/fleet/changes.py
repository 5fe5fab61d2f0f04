"""Detection of changes of one robot, with rival explanations, and of all robots of a type.

For each robot, each hypothesis is tested as a step and a ramp at each day.

With z ~ N(0, s² 𝟙), the evidence for a change f(t) D z is the ratio of marginal likelihoods

    log E = ½ gᵀ (S + s⁻² 𝟙)⁻¹ g − ½ log det(𝟙 + s² S),   S = Dᵀ (Q − Cᵀ N⁻¹ C) D,

with Q = Σ f² M_t, C = Σ f L_tᵀ M_t and N of the robot's parameters. The mean of these ratios over
hypotheses, forms, days and scales s has expectation 1 without changes. By Markov's inequality it
exceeds 1/α with probability at most α, whatever the number and correlation of hypotheses.

T times that mean is a sum of T ratios, each a martingale with expectation 1 as logs arrive. By
Doob's inequality it exceeds T_max/α before T_max with probability at most α. Testing a history
again with each new log is thus as safe as testing it once (exactly for steps and known scales;
sizes of ramps refer to the last log).
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
from geodrake.fleet.workers import THIS_PROCESS, Workers
from geodrake.identification.logs.dataset import Indices
from geodrake.inertia import Array

UNTIL = "until"
FORMS = (STEP, UNTIL, RAMP)
"""Forms of changes: a step, a reversed step, and a ramp."""


def kind_of(form: str) -> str:
    """Return the kind of change of a form."""
    return STEP if form == UNTIL else form


@dataclass(frozen=True, eq=False)
class Profiles(Short):
    """The K steps or ramps that can start at a robot's logs.

    A step is 0 before the log and 1 from it on, or the reverse. A ramp is 0 up to the log and then
    rises in proportion to time, to 1 at the last log.
    """

    form: str
    first: Indices  # (K,) log at which each starts
    days: Array  # (T,) days of the logs

    @classmethod
    def of(cls, form: str, days: Array) -> Profiles:
        """Return all profiles of a form for ascending days (T,)."""
        starts = np.unique(days, return_index=True)[1]  # logs of a day are equivalent
        return cls(form, starts[:-1] if form == RAMP else starts[1:], days)

    @cached_property
    def values(self) -> Array:
        """(K, T) values."""
        after = np.arange(len(self.days)) >= self.first[:, None]
        if self.form == UNTIL:
            return np.logical_not(after).astype(float)
        if self.form == STEP:
            return after.astype(float)
        start = self.days[self.first][:, None]
        return np.asarray(after * (self.days - start) / (self.days[-1] - start))

    def sums(self, per_log: Array) -> Array:
        """Return (K, ...) sums Σ_t f_k(t) X_t."""
        return np.tensordot(self.values, per_log, 1)

    def squares(self, per_log: Array) -> Array:
        """Return (K, ...) sums Σ_t f_k(t)² X_t."""
        return np.tensordot(self.values**2, per_log, 1)


SCALES = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Scales s of changes, relative to the typical one of their hypothesis."""


@dataclass(frozen=True)
class ChangePlace:
    """A change, by index of its hypothesis, form, and index of its first log."""

    hypothesis: int
    form: str
    first: int


@dataclass(frozen=True, eq=False)
class ChangeEvidence(Short):
    """Evidence of a robot's logs for each change."""

    profiles: tuple[Profiles, ...]
    # (h, K) of each form: log of the mean ratio over scales; −∞ for kinds that a hypothesis lacks.
    ratio: tuple[Array, ...]
    prior: tuple[Array, ...]  # (h, K) of each form: log prior probabilities, which sum to 1

    @property
    def total(self) -> float:
        """Logarithm of the mean ratio, an E-value."""
        return float(logsumexp(self._joint))

    def posterior(self) -> tuple[Array, ...]:
        """Return (h, K) probabilities for each form, given that there is one change."""
        ends = np.cumsum([ratio.size for ratio in self.ratio])[:-1]
        parts = np.split(np.exp(self._joint - self.total), ends)
        return tuple(p.reshape(r.shape) for p, r in zip(parts, self.ratio, strict=True))

    def joint(self, place: ChangePlace) -> float:
        """Return the logarithm of a change's ratio times its prior probability."""
        form, entry = self._entry(place)
        return float(self.ratio[form][entry] + self.prior[form][entry])

    def log_prior(self, place: ChangePlace) -> float:
        """Return the logarithm of a change's prior probability."""
        form, entry = self._entry(place)
        return float(self.prior[form][entry])

    def _entry(self, place: ChangePlace) -> tuple[int, tuple[int, int]]:
        form = [profiles.form for profiles in self.profiles].index(place.form)
        day = int(np.flatnonzero(self.profiles[form].first == place.first)[0])
        return form, (place.hypothesis, day)

    @property
    def _joint(self) -> Array:
        pairs = zip(self.ratio, self.prior, strict=True)
        return np.concatenate([(ratio + prior).ravel() for ratio, prior in pairs])


def calc_change_evidence(
    fit: RobotFit, days: Array, hypotheses: Sequence[ChangeHypothesis], scale: Array
) -> ChangeEvidence:
    """Return the evidence for each change, given days (T,) and units (p,) of relative columns."""
    has_days = np.unique(days).size > 1
    profiles = tuple(Profiles.of(form, days) for form in FORMS) if has_days else ()
    ratios = [np.full((len(hypotheses), len(p.first)), -np.inf) for p in profiles]
    priors = [ratio.copy() for ratio in ratios]
    sizes = np.array([h.factor.shape[1] for h in hypotheses])
    for size in np.unique(sizes).tolist():
        for of_form, ratio, prior in zip(profiles, ratios, priors, strict=True):
            same_size = np.flatnonzero(sizes == size).tolist()
            kind = kind_of(of_form.form)
            tested = [h for h in same_size if kind in hypotheses[h].kinds]
            if not tested:
                continue
            factor = scale[:, None] * np.hstack([hypotheses[h].factor for h in tested])
            ratio[tested] = _ratios(fit, of_form, factor, size)
            forms = np.array([len(hypotheses[h].kinds) for h in tested])
            forms *= 2 if kind == STEP else 1
            prior[tested] = -np.log(len(hypotheses) * len(of_form.first) * forms)[:, None]
    return ChangeEvidence(profiles, tuple(ratios), tuple(priors))


def _ratios(fit: RobotFit, profiles: Profiles, factor: Array, size: int) -> Array:
    """Return (h, K) log ratios of hypotheses (p, h · size) with the same number of columns."""
    count, T = factor.shape[1] // size, len(profiles.days)
    cross, side = profiles.sums(fit.cross_with(factor)), profiles.sums(fit.score @ factor)
    K, n = cross.shape[:2]
    solved = fit.solve(cross.transpose(1, 0, 2).reshape(n, -1)).reshape(n, K, -1)
    blocks = cross.reshape(K, n, count, size).transpose(0, 2, 3, 1)
    explained = blocks @ solved.transpose(1, 0, 2).reshape(K, n, count, size).transpose(0, 2, 1, 3)
    products = (fit.information @ factor).reshape(T, -1, count, size).transpose(0, 2, 1, 3)
    transposed = factor.reshape(-1, count, size).transpose(1, 2, 0)
    information = profiles.squares(transposed @ products) - explained
    return calc_log_ratio(information, side.reshape(K, count, size)).T


def calc_log_ratio(information: Array, score: Array) -> Array:
    """Return (...) logs of mean ratios of marginal likelihoods over `SCALES`.

    Args:
        information: (..., d, d) information on z, with all other parameters free.
        score: (..., d) derivative of the log-likelihood at z = 0.
    """
    if score.shape[-1] == 1:
        values, squares = information[..., 0], score**2
    else:
        values, vectors = np.linalg.eigh(information)
        squares = np.einsum("...de,...d->...e", vectors, score) ** 2
    values = np.maximum(values, 0.0)
    gains = [
        0.5 * (s**2 * squares / (1.0 + s**2 * values) - np.log1p(s**2 * values)).sum(axis=-1)
        for s in SCALES
    ]
    return np.asarray(np.logaddexp.reduce(gains, axis=0) - np.log(len(SCALES)))


R = TypeVar("R")

MONTH = 30.0
"""Days."""

RIVAL = 0.05
"""Minimum probability of reported rivals."""

ODD_SHARE = 0.01
"""Prior probability that a log is unrelated: another tool, a wrong file, a failed sensor."""

_MOST_CHANGES = 6
_MOST_EXCHANGES = 4
_INTERVAL_PROBABILITY = 0.95
_TINY = 1e-300
_PRIOR_SCALE = 30.0  # of changes that were found, relative to the typical one
_CACHED_STATES = 4
_FIRST_ROUNDS, _LATER_ROUNDS = 12, 4  # of learning the type
_REFITS = 2  # of a robot, for its gains and excess scatter


@dataclass(frozen=True, eq=False)
class SearchState(Short):
    """Fit of a robot's logs with some changes."""

    logs: LogEquations
    excess: Array  # (T, K) excess scatter of the logs
    cost: float  # of the excess scatter
    fit: RobotFit


@dataclass(frozen=True, eq=False)
class RobotSearch(Short):
    """Search for changes in one robot's logs.

    The last few states, which are large, are cached during a search or report.
    """

    model: TypeModel
    source: RobotHistory  # its logs, with initial reference parameters of gains
    hypotheses: Sequence[ChangeHypothesis]
    level: float = 0.01
    _states: dict[tuple[ChangePlace, ...], SearchState] = field(default_factory=dict, init=False)

    @cached_property
    def history(self) -> RobotHistory:
        """Logs of the robot."""
        return self.source.read()

    def state(self, places: Sequence[ChangePlace]) -> SearchState:
        """Return the fit with some changes, with gains relative to the parameters at each log."""
        key = tuple(places)
        if key not in self._states:
            if len(self._states) >= _CACHED_STATES:
                self._states.pop(next(iter(self._states)))
            self._states[key] = self._fitted(places)
        return self._states[key]

    def _fitted(self, places: Sequence[ChangePlace]) -> SearchState:
        changes, excess = self.design(places), self.model.excess[0]
        reference = self.source.reference
        for _ in range(_REFITS):
            logs = self._equations(reference)
            fit = self.model.fit(0, logs, changes, excess)
            excess, cost = self.model.updated_excess(self.model.log_scores(0, fit), excess)
            reference = self.model.parameters(0, logs, fit)
        logs = self._equations(reference)
        fit = self.model.fit(0, logs, changes, excess)
        return SearchState(logs, excess, float(cost.sum()), fit)

    def _equations(self, reference: Array | None) -> LogEquations:
        gains = self.model.columns.gains
        return replace(self.history, reference=reference if gains else None).equations()

    def fitted_parameters(self, places: Sequence[ChangePlace]) -> tuple[Array, Array]:
        """Return (T, p) parameters at each log with some changes, and (T, K) excess scatter."""
        state = self._fitted(places)
        return self.model.parameters(0, state.logs, state.fit), state.excess

    def evidence(self, state: SearchState) -> ChangeEvidence:
        """Return the evidence for another change in addition to those of a state."""
        scale = self.model.scale(0)
        return calc_change_evidence(state.fit, self.history.days, self.hypotheses, scale)

    def replacement_evidence(
        self, state: SearchState, others: Sequence[ChangePlace]
    ) -> ChangeEvidence:
        """Return the evidence for a change beside `others`, with the excess scatter of a state."""
        fit = self.model.with_changes(state.fit, self.design(others))
        return self.evidence(replace(state, fit=fit))

    def design(self, places: Sequence[ChangePlace]) -> Array:
        """Return (T, p, m) the design matrix of some changes, with a wide prior."""
        days, scale = self.history.days, _PRIOR_SCALE * self.model.scale(0)[:, None]
        parts = [np.zeros((len(days), len(scale), 0))]
        for place in places:
            values = Profiles(place.form, np.array([place.first]), days).values[0]
            factor = self.hypotheses[place.hypothesis].factor
            parts.append(values[:, None, None] * (scale * factor))
        return np.concatenate(parts, axis=2)

    def find(self) -> list[ChangePlace]:
        """Return the significant changes, in the order of detection."""
        places: list[ChangePlace] = []
        while len(places) < _MOST_CHANGES:
            candidates = sorted(self._candidates(places), key=lambda c: self.state(c).cost)
            refined = (self._exchanged(c, -np.log(self.level)) for c in candidates)
            extended = next((changes for changes in refined if len(changes) > len(places)), None)
            if extended is None:
                break
            places = extended
        self._states.clear()
        return places

    def _candidates(self, places: list[ChangePlace]) -> list[list[ChangePlace]]:
        """Return the best additional changes, with and without down-weighting of outlying logs.

        Before a large change is found, the logs after it are outliers, and down-weighting may hide
        it. Without down-weighting, a single outlying log may be mistaken for a change.
        """
        state = self.state(places)
        fit = self.model.fit(0, state.logs, self.design(places), np.zeros_like(state.excess))
        evidence = [self.evidence(state), self.evidence(replace(state, fit=fit))]
        best = dict.fromkeys(best_place(e) for e in evidence if e.profiles)
        return [[*places, place] for place in best if place not in places]

    def _exchanged(self, places: list[ChangePlace], threshold: float) -> list[ChangePlace]:
        """Replace each change by the best one given the others; drop those below the threshold."""
        for _ in range(_MOST_EXCHANGES):
            previous = list(places)
            for k in range(len(places) - 1, -1, -1):
                others = places[:k] + places[k + 1 :]
                state = self.state(places)
                best = best_place(self.replacement_evidence(state, others))
                exchanged = [*places[:k], best, *places[k + 1 :]]
                is_kept = best not in others and self.support(exchanged, k) >= threshold
                places = exchanged if is_kept else others
            if places == previous:
                break
        return places

    def support(self, places: Sequence[ChangePlace], index: int) -> float:
        """Return the logarithm of the E-value of one of some changes, given the others.

        It is the larger of two values: that of all possible changes, with the outlying logs without
        the change; and that of this change, plus the cost of these outliers. Its upper bound is the
        alternative that all logs on one side of the change are unrelated to the robot, each with
        probability `ODD_SHARE`.
        """
        place, others = places[index], [*places[:index], *places[index + 1 :]]
        without = self.state(others)
        evidence = self.evidence(without)
        outlier_cost = without.cost - self.state(places).cost
        before = len(self.history.days) if place.form == RAMP else place.first
        fewer = min(before, len(self.history.days) - place.first)
        bound = evidence.log_prior(place) - fewer * np.log(ODD_SHARE)
        return float(min(max(evidence.total, evidence.joint(place) + outlier_cost), bound))

    def findings(self, places: Sequence[ChangePlace]) -> tuple[FleetFinding, ...]:
        """Return changes with size, date and evidence."""
        state = self.state(places)
        end, findings = state.fit.size, []
        for k in range(len(places) - 1, -1, -1):
            place, others = places[k], [*places[:k], *places[k + 1 :]]
            hypothesis = self.hypotheses[place.hypothesis]
            part = slice(end - hypothesis.factor.shape[1], end)
            end = part.start
            sign = -_PRIOR_SCALE if place.form == UNTIL else _PRIOR_SCALE
            z, covariance = sign * state.fit.theta[part], state.fit.covariance[part, part]
            evidence, kind = self.replacement_evidence(state, others), kind_of(place.form)
            shares = kind_shares(evidence)
            chance = np.exp(min(0.0, -self.support(places, k)))
            finding = FleetFinding(
                self.history.robot,
                hypothesis.effect,
                hypothesis.where,
                kind,
                float(self.history.days[place.first]) * DAY,
                self._interval(evidence, place),
                self._changed(hypothesis, z, _PRIOR_SCALE**2 * covariance),
                shares.pop((place.hypothesis, kind)),
                self._rivals(shares),
                float(chance),
            )
            findings.append(finding)
        self._states.clear()
        return tuple(findings[::-1])

    def _changed(
        self, hypothesis: ChangeHypothesis, z: Array, covariance: Array
    ) -> tuple[ChangedParameter, ...]:
        """Return the changes of parameters; of a ramp up to the last log.

        If logs do not determine some combination, its change is the smallest possible one, with a
        correspondingly large standard deviation.
        """
        changed = np.flatnonzero(hypothesis.factor.any(axis=1))
        scale, relative = self.model.scale(0)[changed], self.model.columns.relative[changed]
        rows = scale[:, None] * hypothesis.factor[changed]
        if hypothesis.rows is not None:
            rows, scale, relative = hypothesis.rows, np.ones(1), np.zeros(1, bool)
        size, variance = rows @ z, np.einsum("pd,de,pe->p", rows, covariance, rows)
        share = np.where(relative, size / scale, np.nan)
        numbers = np.stack([size, np.sqrt(np.maximum(variance, 0.0)), share], axis=1)
        pairs = zip(hypothesis.names, numbers.tolist(), strict=True)
        return tuple(ChangedParameter(*name, *values) for name, values in pairs)

    def _interval(self, evidence: ChangeEvidence, place: ChangePlace) -> tuple[float, float]:
        """Return the interval around a change's date with the required probability, s."""
        first, weights = _starts(evidence, place.hypothesis, kind_of(place.form))
        weights = weights / max(weights.sum(), _TINY)
        low = high = int(np.flatnonzero(first == place.first)[0])
        last = len(weights) - 1
        while weights[low : high + 1].sum() < _INTERVAL_PROBABILITY and (low > 0 or high < last):
            before = weights[low - 1] if low > 0 else -1.0
            after = weights[high + 1] if high < last else -1.0
            low, high = (low - 1, high) if before > after else (low, high + 1)
        dates = self.history.days[first] * DAY
        return float(dates[low]), float(dates[high])

    def _rivals(self, shares: dict[tuple[int, str], float]) -> tuple[ChangeRival, ...]:
        rivals = [
            ChangeRival(self.hypotheses[h].effect, self.hypotheses[h].where, kind, share)
            for (h, kind), share in shares.items()
            if share >= RIVAL
        ]
        return tuple(sorted(rivals, key=lambda rival: -rival.probability))


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
    first, weights = _starts(evidence, hypothesis, kind)
    start = int(first[weights.argmax()])
    places = [
        ChangePlace(hypothesis, profiles.form, start)
        for profiles in evidence.profiles
        if kind_of(profiles.form) == kind
    ]
    return max(places, key=evidence.joint)


def _starts(evidence: ChangeEvidence, hypothesis: int, kind: str) -> tuple[Indices, Array]:
    """Return (K,) logs at which a kind of change may start, and their probabilities."""
    pairs = zip(evidence.profiles, evidence.posterior(), strict=True)
    of_kind = [(p.first, weights[hypothesis]) for p, weights in pairs if kind_of(p.form) == kind]
    return of_kind[0][0], np.sum([weights for _, weights in of_kind], axis=0)


def find_changes(
    histories: Sequence[RobotHistory],
    columns: TypeColumns,
    hypotheses: Sequence[ChangeHypothesis],
    report: Callable[[RobotSearch], R],
    *,
    false_alarms: float = 0.01,
    passes: int = 3,
    team: Workers = THIS_PROCESS,
) -> tuple[TypeModel, list[R]]:
    """Return the model of a type, and the result of `report` for each robot's search for changes.

    The type model is learnt with the changes found so far, and changes are searched with the type
    model, in several passes. Among robots without changes, at most `false_alarms` are reported per
    robot-month.
    """
    # Gains initially refer to the mean of all robots.
    mean = least_squares(*pooled(team, [replace(h, reference=None) for h in histories]))
    references: list[Array] = [mean] * len(histories)

    def logs() -> list[RobotHistory]:
        pairs = zip(histories, references, strict=True)
        return [replace(h, reference=x if columns.gains else None) for h, x in pairs]

    def searches() -> list[RobotSearch]:
        months = [float(h.days[-1] - h.days[0] + 1.0) / MONTH for h in histories]
        levels = [min(1.0, false_alarms * duration) for duration in months]
        rows = enumerate(zip(logs(), levels, strict=True))
        return [
            RobotSearch(model.for_robot(r), history, hypotheses, level)
            for r, (history, level) in rows
        ]

    model = learn_type(logs(), columns, rounds=_FIRST_ROUNDS, team=team)
    for _ in range(passes - 1):
        inputs = team.in_order(_learning_input, searches())
        references, designs, excess = map(list, zip(*inputs, strict=True))
        start = replace(model, excess=tuple(excess))
        model = learn_type(
            logs(), columns, changes=designs, start=start, rounds=_LATER_ROUNDS, team=team
        )
    return model, team.in_order(report, searches())


def _learning_input(search: RobotSearch) -> tuple[Array, Array, Array]:
    """Return a robot's input for learning: parameters, design of changes, and excess scatter."""
    places = search.find()
    reference, excess = search.fitted_parameters(places)
    return reference, search.design(places), excess
