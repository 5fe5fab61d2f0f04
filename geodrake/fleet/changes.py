"""Changes of one robot, with their rivals, and of all robots of a type."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.fleet.change_evidence import (
    UNTIL,
    ChangeEvidence,
    ChangePlace,
    Profiles,
    calc_change_evidence,
    kind_of,
)
from geodrake.fleet.fleet_result import ChangedParameter, ChangeRival, FleetFinding
from geodrake.fleet.history import DAY, LogEquations, RobotHistory
from geodrake.fleet.type_columns import RAMP, ChangeHypothesis, TypeColumns
from geodrake.fleet.type_learning import learn_type, least_squares, pooled
from geodrake.fleet.type_model import RobotFit, TypeModel
from geodrake.fleet.workers import HERE, Workers
from geodrake.inertia import Array

Indices = NDArray[np.intp]
R = TypeVar("R")

MONTH = 30.0
"""Days."""

RIVAL = 0.05
"""Least probability of a rival that is told."""

ODD_SHARE = 0.01
"""Share of logs that say nothing of the robot: another tool, a wrong file, a sensor that failed."""

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
    """A robot's logs, as they look with some changes."""

    logs: LogEquations
    odd: Array  # (T, K) how odd they are
    cost: float
    fit: RobotFit


@dataclass(frozen=True, eq=False)
class RobotSearch(Short):
    """One robot's logs, and what may have changed in it.

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
        """Return the logs with some changes, where gains refer to the parameters of the day."""
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
        """Return (T, p) parameters of the day with some changes, and (T, K) how odd logs are."""
        state = self._fitted(places)
        return self.model.parameters(0, state.logs, state.fit), state.odd

    def evidence(self, state: SearchState) -> ChangeEvidence:
        """Return what logs say for a further change beside those of a state."""
        scale = self.model.scale(0)
        return calc_change_evidence(state.fit, self.history.days, self.hypotheses, scale)

    def instead(self, state: SearchState, others: Sequence[ChangePlace]) -> ChangeEvidence:
        """Return the logs' evidence for a change beside some of a state's, with its odd logs."""
        fit = self.model.with_changes(state.fit, self.design(others))
        return self.evidence(replace(state, fit=fit))

    def design(self, places: Sequence[ChangePlace]) -> Array:
        """Return (T, p, m) parameters of some changes, of sizes that are hardly limited."""
        days, wide = self.history.days, _WIDE * self.model.scale(0)[:, None]
        parts = [np.zeros((len(days), len(wide), 0))]
        for place in places:
            values = Profiles(place.form, np.array([place.first]), days).values[0]
            factor = self.hypotheses[place.hypothesis].factor
            parts.append(values[:, None, None] * (wide * factor))
        return np.concatenate(parts, axis=2)

    def find(self) -> list[ChangePlace]:
        """Find changes that hardly come by chance, in the order in which they are found."""
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
        """Return the same number of changes, or fewer, each the best beside the others."""
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
        """Return the logarithm of the E-value of one of some changes, beside the others.

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
        """Shortest time around that of a finding that holds the probability of an interval, s."""
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
    """Find what learning needs of a robot: parameters of the day, changes, how odd logs are."""
    places = search.find()
    reference, odd = search.settled(places)
    return reference, search.design(places), odd
