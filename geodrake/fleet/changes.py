"""Changes of one robot: found one after another, exchanged for better ones, with their rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.fleet.change_evidence import SCALES, ChangeEvidence, calc_change_evidence
from geodrake.fleet.history import RobotHistory
from geodrake.fleet.hypotheses import ChangeHypothesis
from geodrake.fleet.profiles import Profiles
from geodrake.fleet.type_model import TypeModel

Array = NDArray[np.float64]

MONTH = 30.0
"""Days."""

RIVAL = 0.05
"""Least probability of a rival that is told."""

_MOST_CHANGES = 6
_MOST_EXCHANGES = 4
_WITHIN = 0.95  # probability of an interval of days
_TINY = 1e-300


@dataclass(frozen=True)
class ChangeRival:
    """What may have changed in the place of a finding.

    Attributes:
        effect: Name of the effect.
        where: Joint or body.
        kind: "step" or "ramp".
        probability: Its probability.
    """

    effect: str
    where: str
    kind: str
    probability: float


@dataclass(frozen=True, eq=False)
class RobotChange(Short):
    """A change of a robot.

    Attributes:
        robot: Name of the robot.
        effect: Name of the effect that changed.
        where: Its joint or body.
        kind: "step", or "ramp" for what goes on changing.
        day: First day after the step, or on which the ramp begins.
        interval: Days within which that is with a probability of 95 %.
        size: (p,) change of the robot's parameters; of a ramp up to the last log.
        deviation: (p,) its standard deviation.
        share: (p,) the size in shares of the robot's own values, for relative columns.
        probability: Probability of the effect, joint and kind, given that something changed.
        rivals: What else it may be, most probable first.
        false_alarm_probability: At most by what chance logs of a robot in which nothing more
            changed say so much for a change.
    """

    robot: str
    effect: str
    where: str
    kind: str
    day: float
    interval: tuple[float, float]
    size: Array
    deviation: Array
    share: Array
    probability: float
    rivals: tuple[ChangeRival, ...]
    false_alarm_probability: float


@dataclass(frozen=True)
class ChangePlace:
    """A change in the space of all: hypothesis, kind and day, by their numbers.

    Attributes:
        hypothesis: Number of the hypothesis.
        kind: "step" or "ramp".
        first: Log at which it begins.
    """

    hypothesis: int
    kind: str
    first: int


@dataclass(frozen=True, eq=False)
class RobotSearch(Short):
    """One robot's logs, and what may have changed in it.

    Attributes:
        model: What is known of its type.
        robot: Its number.
        history: Its logs.
        hypotheses: What may have changed.
    """

    model: TypeModel
    robot: int
    history: RobotHistory
    hypotheses: Sequence[ChangeHypothesis]

    def evidence(self, places: Sequence[ChangePlace]) -> ChangeEvidence:
        """What logs say for a further change beside some."""
        fit = self.model.fit(self.robot, self.history, self.design(places))
        scale = self.model.scale(self.robot)
        return calc_change_evidence(fit, self.history.days, self.hypotheses, scale)

    def design(self, places: Sequence[ChangePlace]) -> Array | None:
        """(T, p, m) parameters of some changes, of the largest size that is thought of."""
        scale, days = self.model.scale(self.robot), self.history.days
        parts = []
        for place in places:
            values = Profiles(place.kind, np.array([place.first]), days).values[0]
            factor = SCALES[-1] * scale[:, None] * self.hypotheses[place.hypothesis].factor
            parts.append(values[:, None, None] * factor)
        return np.concatenate(parts, axis=2) if parts else None

    def find(self, level: float) -> list[ChangePlace]:
        """Changes that hardly come by chance, in the order in which they were found.

        Args:
            level: Probability of a false alarm in the time of all logs.
        """
        places: list[ChangePlace] = []
        least = -np.log(level)
        while len(places) < _MOST_CHANGES:
            evidence = self.evidence(places)
            if not evidence.profiles or evidence.total < least:
                break
            places.append(best_place(evidence))
            places = self._exchanged(places, least)
        return places

    def _exchanged(self, places: list[ChangePlace], least: float) -> list[ChangePlace]:
        """The same number of changes, or fewer, each the best beside the others."""
        for _ in range(_MOST_EXCHANGES):
            before = list(places)
            for at in range(len(places) - 1, -1, -1) if len(places) > 1 else ():
                others = places[:at] + places[at + 1 :]
                evidence = self.evidence(others)
                best = [] if evidence.total < least else [best_place(evidence)]
                places = places[:at] + best + places[at + 1 :]
            if places == before:
                break
        return places

    def told(self, places: Sequence[ChangePlace]) -> tuple[RobotChange, ...]:
        """What there is to say of some changes."""
        fit = self.model.fit(self.robot, self.history, self.design(places))
        end, found = fit.design.shape[2], []
        for at in range(len(places) - 1, -1, -1):
            place = places[at]
            hypothesis = self.hypotheses[place.hypothesis]
            evidence = self.evidence([*places[:at], *places[at + 1 :]])
            factor = SCALES[-1] * self.model.scale(self.robot)[:, None] * hypothesis.factor
            part = slice(end - factor.shape[1], end)
            end = part.start
            variance = np.einsum("pd,de,pe->p", factor, fit.covariance[part, part], factor)
            size = factor @ fit.theta[part]
            shares = kind_shares(evidence)
            found.append(
                RobotChange(
                    self.history.robot,
                    hypothesis.effect,
                    hypothesis.where,
                    place.kind,
                    float(self.history.days[place.first]),
                    self._interval(evidence, place),
                    size,
                    np.sqrt(variance),
                    size / self.model.scale(self.robot),
                    shares[place.hypothesis, place.kind],
                    self._rivals(shares, place),
                    float(np.exp(min(0.0, -evidence.total))),
                )
            )
        return tuple(found[::-1])

    def _interval(self, evidence: ChangeEvidence, place: ChangePlace) -> tuple[float, float]:
        """Shortest days around that of a finding that hold the probability of an interval."""
        kinds = [each.kind for each in evidence.profiles]
        profiles = evidence.profiles[kinds.index(place.kind)]
        share = evidence.posterior()[kinds.index(place.kind)][place.hypothesis]
        share = share / max(share.sum(), _TINY)
        low = high = int(np.flatnonzero(profiles.first == place.first)[0])
        while share[low : high + 1].sum() < _WITHIN and (low > 0 or high < len(share) - 1):
            before = share[low - 1] if low > 0 else -1.0
            after = share[high + 1] if high < len(share) - 1 else -1.0
            low, high = (low - 1, high) if before > after else (low, high + 1)
        days = self.history.days[profiles.first]
        return float(days[low]), float(days[high])

    def _rivals(
        self, shares: dict[tuple[int, str], float], place: ChangePlace
    ) -> tuple[ChangeRival, ...]:
        told = [
            ChangeRival(self.hypotheses[h].effect, self.hypotheses[h].where, kind, share)
            for (h, kind), share in shares.items()
            if share >= RIVAL and (h, kind) != (place.hypothesis, place.kind)
        ]
        return tuple(sorted(told, key=lambda rival: -rival.probability))


def kind_shares(evidence: ChangeEvidence) -> dict[tuple[int, str], float]:
    """Probability of each hypothesis and kind, over all days."""
    return {
        (h, profiles.kind): float(share)
        for profiles, posterior in zip(evidence.profiles, evidence.posterior(), strict=True)
        for h, share in enumerate(posterior.sum(axis=1))
    }


def best_place(evidence: ChangeEvidence) -> ChangePlace:
    """The most probable hypothesis and kind over all days, on its most probable day."""
    shares = kind_shares(evidence)
    hypothesis, kind = max(shares, key=lambda key: shares[key])
    at = [each.kind for each in evidence.profiles].index(kind)
    day = int(evidence.posterior()[at][hypothesis].argmax())
    return ChangePlace(hypothesis, kind, int(evidence.profiles[at].first[day]))


def months(history: RobotHistory) -> float:
    """Months of a robot's logs; a day more than from the first to the last."""
    return float(history.days[-1] - history.days[0] + 1.0) / MONTH
