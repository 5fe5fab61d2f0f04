"""Candidates from the residual: effects whose shape is looked for there, not tried on a grid."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from geodrake.diagnosis.case import Case, error_table
from geodrake.diagnosis.coupled import coupled_joints
from geodrake.diagnosis.elastic import elastic_joints, loose_joints
from geodrake.diagnosis.hypothesis import Hypothesis
from geodrake.diagnosis.position_spectrum import LEAST_WAVES, highest_peak
from geodrake.diagnosis.proposal import Proposal
from geodrake.diagnosis.residuals import (
    JointResidual,
    filtered_columns,
    full_motion,
    joint_residuals,
)
from geodrake.effects import (
    FrictionDrift,
    GravityCompensator,
    Hysteresis,
    JointElasticity,
    JointSpring,
    TorqueRipple,
)
from geodrake.effects.base import Effect
from geodrake.motion import Segment

Array = NDArray[np.float64]

DOMINANT = 0.3
"""Share of a joint's squared error from which on a suggestion comes before all other candidates."""

_ALARM = 3e-5  # of one joint and kind, about 40 a log; what is offered must still convince
_ALARM_OF_MUCH = 0.01  # where the error is made mostly of it: noise never has so large a share
_HIDDEN_SHARE = 0.1  # of a joint's squared error that bristles must explain to be tried anyway
_TIME_CONSTANTS = (0.1, 0.3, 1.0, 3.0)  # of drift, as shares of the longest log
_BREAKAWAY_ANGLES = (0.003, 0.01, 0.03, 0.1, 0.3)  # as shares of the range of motion
_FEW = 5.0  # waves in the range of motion
_FEW_WAVES = (-0.6, -0.3, 0.0, 0.3)  # distances of the orders tried, in units of those told apart
_MANY_WAVES = (-0.15, 0.0, 0.15)
_SMOOTH = (JointSpring.name, GravityCompensator.name)
_WAVES_BESIDE = 2.5
"""Waves that the range of motion must hold beside a spring: with fewer, the two together stand for
any smooth function of the position."""
_WHOLE = 0.25  # distance from a whole order within which that is tried, in the same units


def suggested(
    case: Case,
    hypothesis: Hypothesis,
    known: Collection[Effect],
    *,
    least_share: float = 0.0,
    hidden: bool = False,
) -> tuple[Effect, ...]:
    """Effects that the residual suggests, with the shapes to try.

    Args:
        case: The case.
        hypothesis: What is known so far.
        known: Effects that have columns; what is among them, or in the model, comes no more.
        least_share: Share of the squared error at its joint that an effect must explain.
        hidden: Whether effects that others may hide are among them where more than noise is left:
            only a fit with both tells.
    """
    taken = {(e.name, e.where) for e in (*known, *hypothesis.unknowns.effects)}
    hidden = hidden and not error_table(case.dataset, hypothesis.held_out).is_noise
    return tuple(
        effect
        for proposal in proposals(case, hypothesis)
        if (_is_clear(proposal) and proposal.share >= least_share)
        or (hidden and _may_be_hidden(proposal))
        for effect in proposal.effects
        if (effect.name, effect.where) not in taken
    )


def suggested_of(case: Case, hypothesis: Hypothesis, name: str) -> tuple[Effect, ...]:
    """The shapes that the residual suggests for one effect, at every place where it stands out.

    Args:
        case: The case.
        hypothesis: What is known so far.
        name: Name of the effect.

    Returns:
        The effects; where it stands out nowhere, those at all places.
    """
    taken = {(e.name, e.where) for e in hypothesis.unknowns.effects}
    found = [p for p in proposals(case, hypothesis) if p.effects[0].name == name]
    found = [p for p in found if (name, p.effects[0].where) not in taken]
    clear = [p for p in found if _is_clear(p)] or found
    return tuple(effect for proposal in clear for effect in proposal.effects)


def _is_clear(proposal: Proposal) -> bool:
    """Whether what the residual shows is more than chance, as many as are looked for."""
    return proposal.alarm <= (_ALARM_OF_MUCH if proposal.share >= DOMINANT else _ALARM)


def _may_be_hidden(proposal: Proposal) -> bool:
    """Whether inertias may hide what is proposed, or other friction all but a good part of it."""
    effect = proposal.effects[0]
    bristles = isinstance(effect, Hysteresis) and proposal.share >= _HIDDEN_SHARE
    return bristles or isinstance(effect, JointElasticity)


def proposals(case: Case, hypothesis: Hypothesis) -> Iterator[Proposal]:
    """What the residual suggests at every place, whatever the evidence for it."""
    motion, joints = full_motion(case), joint_residuals(case, hypothesis)
    yield from elastic_joints(case, joints, motion)
    yield from loose_joints(case, joints, motion)
    yield from coupled_joints(case, joints, motion)
    for joint in joints:
        if joint.joint in case.model.single_joints and np.ptp(joint.q) > 0.0:
            yield from _ripples(case, joint, hypothesis.unknowns.effects)
            yield from _drifts(joint)
            yield from _bristles(case, joint, motion)


def _ripples(case: Case, joint: JointResidual, known: Collection[Effect]) -> Iterator[Proposal]:
    low_pass = case.trajectories[0].filter
    beside = any(e.where == (joint.joint,) and e.name in _SMOOTH for e in known)
    peak = highest_peak(
        (joint.q, joint.v),
        joint.residual,
        effective=joint.effective,
        gain=low_pass.response,
        bandwidth=low_pass.bandwidth,
        least_waves=_WAVES_BESIDE if beside else LEAST_WAVES,
    )
    if peak is not None:
        step, whole = peak.resolution, round(peak.order)
        order = float(whole) if abs(peak.order - whole) < _WHOLE * step else peak.order
        # What gravity and springs take away of the slowest waves pushes their peak aside.
        offsets = _FEW_WAVES if order < _FEW * step else _MANY_WAVES
        orders = [order + x * step for x in offsets]
        least = _WAVES_BESIDE * step if beside else 0.0
        ripples = tuple(TorqueRipple(joint.joint, n) for n in orders if n >= least)
        alarm = min(1.0, peak.tried * float(chi2.sf(peak.height, 2)))
        yield Proposal(ripples, peak.share, alarm)


def _drifts(joint: JointResidual) -> Iterator[Proposal]:
    longest = float(joint.time.max())
    shapes = tuple(FrictionDrift(joint.joint, share * longest) for share in _TIME_CONSTANTS)
    friction = [joint.sign_v, joint.v]
    tried = []
    for shape in shapes:
        left = np.exp(-joint.time / shape.time_constant)
        tried.append(joint.improvement(friction, [left * column for column in friction]))
    share, gain = max(tried, key=lambda found: found[1])
    yield Proposal(shapes, share, min(1.0, len(shapes) * float(chi2.sf(gain, 2))))


def _bristles(
    case: Case, joint: JointResidual, motion: Sequence[tuple[int, Segment]]
) -> Iterator[Proposal]:
    at, reach = case.model.joints.index(joint.joint), float(np.ptp(joint.q))
    shapes = tuple(Hysteresis(joint.joint, share * reach) for share in _BREAKAWAY_ANGLES)

    def columns(segment: Segment) -> Array:
        q, v = segment.position[:, at], segment.velocity[:, at]
        return np.stack([joint.direction(v), v, *(shape.bend(q) for shape in shapes)], 1)

    found = filtered_columns(case, motion, joint, columns)
    seen = np.asarray(np.isfinite(found).all(axis=1))
    if not seen.any():
        return
    here, (sign_v, v, *bends) = joint.part(seen), found[seen].T
    tried = [here.improvement([sign_v, v, np.ones_like(v)], [bend]) for bend in bends]
    share, gain = max(tried, key=lambda one: one[1])
    yield Proposal(shapes, share, min(1.0, len(shapes) * float(chi2.sf(gain, 1))))
