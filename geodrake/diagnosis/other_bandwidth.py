"""Another bandwidth for a log: a higher one where play shows, a lower one where soft joints do.

The blows with which play strikes where a load changes its sign are short, and small where a joint
bears little: below the bandwidth that suits a motion hardly anything may be left of them. A soft
joint, on the other hand, swings where a motion begins or ends abruptly, as from point to point. How
it does so the log hardly tells: the link's lag has the motion's accelerations in it, and its own
acceleration, from their second derivatives, is known only up to a few hertz.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from geodrake.diagnosis.case import Case, at_bandwidth, error_table, reduced
from geodrake.diagnosis.columns import convincing_ones
from geodrake.diagnosis.elastic import elastic_joints, loose_joints
from geodrake.diagnosis.evidence import Criteria
from geodrake.diagnosis.hypothesis import Hypothesis
from geodrake.diagnosis.residuals import full_motion, joint_residuals
from geodrake.diagnosis.results import ErrorTable
from geodrake.effects import Backlash, JointElasticity
from geodrake.effects.deflection import DeflectionEffect
from geodrake.errors import LogError
from geodrake.filtering import HIGHEST_BANDWIDTH
from geodrake.identification.coherent_bandwidth import coherent_bandwidth

_HIGHER = (2.5, 6.0)
"""Bandwidths at which play is looked for, over that of the log."""

_LOWER = (0.5,)
"""The same for soft joints."""

_CLEARLY_LESS = 0.5
"""Of how many times its floor an error was, that it must be at another bandwidth."""


@dataclass(frozen=True)
class OtherBandwidth:
    """A bandwidth at which an effect shows that does not at that of the log.

    Attributes:
        bandwidth: The bandwidth, Hz.
        effect: The effect.
    """

    bandwidth: float
    effect: type[DeflectionEffect]

    @property
    def how(self) -> str:
        """Where the bandwidth comes from, for the notes."""
        return f"at which {self.effect.name} shows"


def other_bandwidths(case: Case, end: Hypothesis, criteria: Criteria) -> Iterator[OtherBandwidth]:
    """Other bandwidths at which a joint turns out to be loose or soft.

    Play is looked for only where all else is explained, as what is unknown would pass for it, and
    soft joints only where it is not. A bandwidth that was asked for stays.

    Args:
        case: The case with what was found.
        end: What was found, on that case.
        criteria: When an effect counts as found.
    """
    explained = error_table(case.dataset, end.held_out).is_noise
    effect, factors = (Backlash, _HIGHER) if explained else (JointElasticity, _LOWER)
    found = any(isinstance(each, effect) for each in end.unknowns.effects)
    if case.asked.bandwidth is not None or (found and explained):
        return
    own = case.trajectories[0].filter.bandwidth
    for other in (OtherBandwidth(factor * own, effect) for factor in factors):
        there = _opened(case, other)
        if there is not None:
            known = end.moved(there.dataset, delay=0)
            after = known if found else _with_shown(effect, there, known, criteria)
            if after is not None and (explained or comes_closer(_errors(end), _errors(after))):
                yield other


def _opened(case: Case, other: OtherBandwidth) -> Case | None:
    """The case at another bandwidth, if logs are fast, long and clear enough for it."""
    highest = HIGHEST_BANDWIDTH / max(t.filter.period for t in case.trajectories)
    if other.bandwidth > highest:
        return None
    try:
        there = at_bandwidth(case, other.bandwidth, candidates=False, how=other.how)
    except LogError:  # too few samples would be left
        return None
    return there if coherent_bandwidth(case.model, there.trajectories) is None else None


def comes_closer(before: ErrorTable, after: ErrorTable) -> bool:
    """Whether nothing but noise is left, or half as many times as much of it as before.

    Args:
        before: Errors that are not noise.
        after: Errors at another bandwidth.
    """
    was, left = (each.nrms / each.floor_nrms for each in (before, after))
    return after.is_noise or left <= _CLEARLY_LESS * was


def _errors(hypothesis: Hypothesis) -> ErrorTable:
    return error_table(hypothesis.dataset, hypothesis.held_out)


def _with_shown(
    effect: type[DeflectionEffect], case: Case, end: Hypothesis, criteria: Criteria
) -> Hypothesis | None:
    """What was found with an effect at all joints where it convinces; None if it does nowhere."""
    look = loose_joints if effect is Backlash else elastic_joints
    proposals = look(case, joint_residuals(case, end), full_motion(case))
    effects = [each for proposal in proposals for each in proposal.effects]
    shown = convincing_ones(case, end, effects, criteria) if effects else ()
    if not shown:
        return None
    dataset = reduced(case, [*end.unknowns.effects, *shown])
    return end.moved(dataset, delay=0).with_effects(shown)
