"""Play that shows only above the bandwidth of a log.

The blows with which play strikes where a load changes its sign are short, and small where a joint
bears little: below the bandwidth that suits a motion hardly anything may be left of them.
"""

from __future__ import annotations

from geodrake.diagnosis.case import Case, at_bandwidth, error_table
from geodrake.diagnosis.columns import convincing_ones
from geodrake.diagnosis.elastic import loose_joints
from geodrake.diagnosis.evidence import Criteria
from geodrake.diagnosis.hypothesis import Hypothesis
from geodrake.diagnosis.residuals import full_motion, joint_residuals
from geodrake.effects import Backlash
from geodrake.filtering import HIGHEST_BANDWIDTH
from geodrake.identification.coherent_bandwidth import coherent_bandwidth

WHERE_PLAY_SHOWS = "at which play shows"
"""How the bandwidth was chosen, in words."""

_HIGHER = 2.5
"""Bandwidth at which play is looked for, over that of the log; the motion's is three times that."""


def bandwidth_of_play(case: Case, end: Hypothesis, criteria: Criteria) -> float | None:
    """A higher bandwidth at which play shows that does not show at that of the case, Hz.

    It is looked for only where all else is explained, as what is unknown would pass for it, and
    only if the bandwidth was chosen from the data.

    Args:
        case: The case with what was found.
        end: What was found, on that case.
        criteria: When an effect counts as found.

    Returns:
        The bandwidth; None if nothing shows there either.
    """
    loose = any(isinstance(effect, Backlash) for effect in end.unknowns.effects)
    explained = error_table(case.dataset, end.held_out).is_noise
    if loose or not explained or case.asked.bandwidth is not None:
        return None
    highest = HIGHEST_BANDWIDTH / max(t.filter.period for t in case.trajectories)
    bandwidth = min(_HIGHER * case.trajectories[0].filter.bandwidth, highest)
    sharp = at_bandwidth(case, bandwidth, candidates=False, how=WHERE_PLAY_SHOWS)
    if coherent_bandwidth(case.model, sharp.trajectories) is not None:
        return None
    there = end.moved(sharp.dataset, delay=0)
    proposals = loose_joints(sharp, joint_residuals(sharp, there), full_motion(sharp))
    effects = [effect for proposal in proposals for effect in proposal.effects]
    shown = bool(effects) and bool(convincing_ones(sharp, there, effects, criteria))
    return bandwidth if shown else None
