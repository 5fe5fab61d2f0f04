"""Candidates from the residual: effects whose shape is looked for there, not tried on a grid."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.coupled import coupled_joints
from geodrake.diagnosis.elastic import elastic_joints, loose_joints
from geodrake.diagnosis.position_spectrum import LEAST_WAVES, highest_peak
from geodrake.diagnosis.proposal import Proposal
from geodrake.diagnosis.residuals import (
    JointResidual,
    filtered_columns,
    full_motion,
    joint_residuals,
)
from geodrake.effects import Effect
from geodrake.effects.role import Proposer
from geodrake.identification.logs.case import Case, error_table
from geodrake.identification.logs.criteria import DOMINANT, SUGGESTED, Criteria
from geodrake.identification.logs.evidence import chi2_tail
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.logs.smoothing import Segment

Array = NDArray[np.float64]

_FEW = 5.0  # waves in the range of motion
_FEW_WAVES = (-0.6, -0.3, 0.0, 0.3)  # distances of the orders tried, in resolutions
_MANY_WAVES = (-0.15, 0.0, 0.15)
_WAVES_BESIDE = 2.5
"""Beside a spring, the range of motion holds at least so many waves.

With fewer, the two together fit any smooth function of the position.
"""
_WHOLE = 0.25  # distance from a whole order within which that is tried, in the same units


def suggested(
    case: Case,
    hypothesis: Hypothesis,
    known: Collection[Effect],
    *,
    least_share: float = 0.0,
    hidden: bool = False,
    alarm: float = Criteria.alarm,
) -> tuple[Effect, ...]:
    """Effects that the residual suggests, with the shapes to try.

    Args:
        case: The case.
        hypothesis: What is known so far.
        known: Effects that have columns; what is among them, or in the model, comes no more.
        least_share: Share of the squared error at its joint that an effect must explain.
        hidden: Whether effects that others may hide are among them where more than noise is left:
            only a fit with both shows.
        alarm: Largest probability of a false alarm where the error is made mostly of an effect.
    """
    taken = {(e.name, e.where) for e in (*known, *hypothesis.unknowns.effects)}
    hidden = hidden and not error_table(case.dataset, hypothesis.held_out).is_noise
    return tuple(
        effect
        for proposal in proposals(case, hypothesis)
        if (_is_clear(proposal, alarm) and proposal.share >= least_share)
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
    clear = [p for p in found if _is_clear(p, Criteria.alarm)] or found
    return tuple(effect for proposal in clear for effect in proposal.effects)


def _is_clear(proposal: Proposal, alarm: float) -> bool:
    """Whether what the residual shows is more than chance, as many as are looked for."""
    return proposal.alarm <= (alarm if proposal.share >= DOMINANT else SUGGESTED)


def _may_be_hidden(proposal: Proposal) -> bool:
    """Whether inertias may hide what is proposed, or other friction all but a good part of it."""
    return proposal.share >= proposal.effects[0].hidden_share


def proposals(case: Case, hypothesis: Hypothesis) -> Iterator[Proposal]:
    """What the residual suggests at every place, whatever the evidence for it.

    Args:
        case: The case.
        hypothesis: What is found so far, with its residual.
    """
    motion, joints = full_motion(case), joint_residuals(case, hypothesis)
    yield from elastic_joints(case, joints, motion)
    yield from loose_joints(case, joints, motion)
    yield from coupled_joints(case, joints, motion)
    setting = _Setting(case, motion, hypothesis.unknowns.effects)
    for joint in joints:
        if joint.joint in case.model.single_joints and np.ptp(joint.q) > 0.0:
            for proposer, propose in _AT_A_JOINT.items():
                for kind in case.effect_classes:
                    if kind.proposer is proposer:
                        yield from propose(kind, setting, joint)


@dataclass(frozen=True, eq=False)
class _Setting:
    """What a proposer sees beside the residual of a joint.

    Attributes:
        case: The case.
        motion: `full_motion` of the case.
        known: Effects of the hypothesis.
    """

    case: Case
    motion: Sequence[tuple[int, Segment]]
    known: Collection[Effect]


_Propose = Callable[[type[Effect], _Setting, JointResidual], Iterator[Proposal]]


def _waves(kind: type[Effect], setting: _Setting, joint: JointResidual) -> Iterator[Proposal]:
    """The order of the highest peak in the residual's spectrum over position."""
    low_pass = setting.case.trajectories[0].filter
    beside = any(e.where == (joint.joint,) and _is_smooth(e) for e in setting.known)
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
        make: Callable[..., Effect] = kind
        waves = tuple(make(joint.joint, n) for n in orders if n >= least)
        alarm = min(1.0, peak.tried * chi2_tail(peak.height, 2))
        yield Proposal(waves, peak.share, alarm)


def _is_smooth(effect: Effect) -> bool:
    """Whether an effect is a function of the position alone that is no wave, such as a spring."""
    return effect.depends_on == {"q"} and effect.proposer is not Proposer.WAVES


def _warming(kind: type[Effect], setting: _Setting, joint: JointResidual) -> Iterator[Proposal]:
    """Friction that fades with the time since a log began."""
    del setting
    shapes = kind.shaped(joint.joint, duration=float(joint.time.max()))
    friction = [joint.sign_v, joint.v]
    tried = []
    for shape in shapes:
        left = shape.course(joint.time)
        tried.append(joint.improvement(friction, [left * column for column in friction]))
    yield _best_of(shapes, tried)


def _bristles(kind: type[Effect], setting: _Setting, joint: JointResidual) -> Iterator[Proposal]:
    """Dry friction that builds up along the positions of a joint."""
    case = setting.case
    at, reach = case.model.joints.index(joint.joint), float(np.ptp(joint.q))
    shapes = kind.shaped(joint.joint, reach=reach)

    def columns(segment: Segment) -> Array:
        q, v = segment.position[:, at], segment.velocity[:, at]
        return np.stack([joint.direction(v), v, *(shape.course(q) for shape in shapes)], 1)

    each = (columns(segment) for _, segment in setting.motion)
    found = filtered_columns(case, setting.motion, joint, each)
    seen = np.asarray(np.isfinite(found).all(axis=1))
    if not seen.any():
        return
    here, (sign_v, v, *bends) = joint.part(seen), found[seen].T
    tried = [here.improvement([sign_v, v, np.ones_like(v)], [bend]) for bend in bends]
    yield _best_of(shapes, tried)


def _best_of(shapes: tuple[Effect, ...], tried: Sequence[tuple[float, float]]) -> Proposal:
    """An effect by that of its shapes which explains most.

    Args:
        shapes: The effect with the shapes.
        tried: Of each, the share of the squared error that it explains, and about χ² of as many
            degrees of freedom as it has parameters.
    """
    share, gain = max(tried, key=lambda found: found[1])
    chance = chi2_tail(gain, len(shapes[0].parameters))
    return Proposal(shapes, share, min(1.0, len(shapes) * chance))


_AT_A_JOINT: Mapping[Proposer, _Propose] = {
    Proposer.WAVES: _waves,
    Proposer.WARMING: _warming,
    Proposer.BRISTLES: _bristles,
}
"""How the residual of one joint proposes the effects that name a proposer, in this order."""
