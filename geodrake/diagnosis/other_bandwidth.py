"""Another bandwidth for a log: a higher one where play shows, a lower one where soft joints do.

The blows with which play strikes where a load changes its sign are short, and small where a joint
bears little: below the bandwidth that suits a motion hardly anything may be left of them. A soft
joint, on the other hand, swings where a motion begins or ends abruptly, as from point to point. How
it does so the log hardly shows: the link's lag has the motion's accelerations in it, and its own
acceleration, from their second derivatives, is known only up to a few hertz.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from geodrake.diagnosis.elastic import elastic_joints, loose_joints
from geodrake.diagnosis.further_columns import convincing_ones
from geodrake.diagnosis.residuals import full_motion, joint_residuals
from geodrake.effects import Effect, Role
from geodrake.effects.role import Proposer
from geodrake.errors import LogError
from geodrake.identification.logs.case import Case, at_bandwidth, error_table, reduced
from geodrake.identification.logs.coherent_bandwidth import coherent_bandwidth
from geodrake.identification.logs.criteria import MOST, Criteria
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.identification.logs.model_errors import ErrorTable
from geodrake.logs.filtering import HIGHEST_BANDWIDTH

_PROPOSERS = {Proposer.PLAY: loose_joints, Proposer.BENDING: elastic_joints}

_HIGHEST = 30.0
"""Play is looked for up to this bandwidth, Hz: samples cost time, and blows show below it."""


@dataclass(frozen=True, eq=False)
class OtherBandwidth:
    """A bandwidth at which an effect shows that does not at that of the log.

    Attributes:
        bandwidth: The bandwidth, Hz.
        effect: The effect.
        known: Errors there of what was found without it.
    """

    bandwidth: float
    effect: type[Effect]
    known: ErrorTable

    def explains(self, errors: ErrorTable) -> bool:
        """Whether errors at this bandwidth leave noise alone, or clearly less than what is known.

        Args:
            errors: Those with the effect.
        """
        return errors.is_noise or errors.nrms <= MOST * self.known.nrms


def other_bandwidths(
    case: Case, end: Hypothesis, criteria: Criteria, *, explained: bool
) -> Iterator[OtherBandwidth]:
    """Other bandwidths at which a joint turns out to be loose or soft.

    Play is looked for only where all else is explained, as what is unknown would pass for it, and
    soft joints only where it is not. A bandwidth that was asked for stays, and that of a log with
    contacts, whose pieces were dealt out to the folds.

    Args:
        case: The case with what was found.
        end: What was found, on that case.
        criteria: When an effect counts as found.
        explained: Whether nothing but noise is left of it.
    """
    present, own = end.unknowns.effects, case.trajectories[0].filter.bandwidth
    if case.asked.bandwidth is not None or any(e.role is Role.EPISODE for e in present):
        return
    for effect in case.effect_classes:
        if any(isinstance(each, effect) for each in present):
            continue
        factors = [f for f in effect.other_bandwidths if (f > 1.0) == explained]
        for bandwidth in (factor * own for factor in factors):
            there = _opened(case, bandwidth)
            if there is not None:
                known = end.moved(there.dataset, delay=0)
                other = OtherBandwidth(bandwidth, effect, errors_of(known))
                shown = _shown(effect, there, known, criteria)
                if shown and (explained or other.explains(errors_of(_with(there, known, shown)))):
                    yield other


def errors_of(hypothesis: Hypothesis) -> ErrorTable:
    """Held-out errors of a hypothesis."""
    return error_table(hypothesis.dataset, hypothesis.held_out)


def errors_at(case: Case, end: Hypothesis, bandwidth: float) -> ErrorTable:
    """Held-out errors at another bandwidth of what was found, refitted.

    Args:
        case: The case with what was found.
        end: What was found, on that case.
        bandwidth: Bandwidth of the filter, Hz.
    """
    there = at_bandwidth(case, bandwidth, candidates=False, how="to compare")
    return errors_of(end.moved(there.dataset, delay=0))


def _opened(case: Case, bandwidth: float) -> Case | None:
    """The case at another bandwidth, if logs are fast, long and clear enough for it."""
    highest = HIGHEST_BANDWIDTH / max(t.filter.period for t in case.trajectories)
    if bandwidth > min(highest, _HIGHEST):
        return None
    try:
        there = at_bandwidth(case, bandwidth, candidates=False, how="to compare")
    except LogError:  # too few samples would be left
        return None
    return there if coherent_bandwidth(case.model, there.trajectories) is None else None


def _shown(
    effect: type[Effect], case: Case, end: Hypothesis, criteria: Criteria
) -> tuple[Effect, ...]:
    """An effect at all joints where it convinces beside what was found, in all its shapes."""
    propose = _PROPOSERS.get(effect.proposer) if effect.proposer else None
    if propose is None:
        return ()
    proposals = propose(case, joint_residuals(case, end), full_motion(case))
    effects = [e for proposal in proposals for e in proposal.effects if isinstance(e, effect)]
    return convincing_ones(case, end, effects, criteria) if effects else ()


def _with(case: Case, end: Hypothesis, effects: tuple[Effect, ...]) -> Hypothesis:
    """What was found and further effects, which need no columns yet."""
    dataset = reduced(case, [*end.unknowns.effects, *effects])
    return end.moved(dataset, delay=0).with_effects(effects)
