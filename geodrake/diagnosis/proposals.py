"""Effects whose shapes are found in the residual instead of on a grid."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from geodrake.diagnosis.coupled import coupled_joints
from geodrake.diagnosis.handling import handled_payloads
from geodrake.diagnosis.log_model import Fit, LogModel
from geodrake.diagnosis.position_spectrum import LEAST_WAVES, highest_peak
from geodrake.diagnosis.residuals import JointResidual, Proposal, full_motion, joint_residuals
from geodrake.effects.base import Effect, Proposer
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.evidence import chi2_tail

_FEW = 5.0  # waves in the range of motion
_FEW_WAVES = (-0.6, -0.3, 0.0, 0.3)  # distances of the orders tried, in resolutions
_MANY_WAVES = (-0.15, 0.0, 0.15)
_WAVES_BESIDE = 2.5
"""Least number of waves in the range of motion of a joint with a spring.

With fewer, the two together fit any smooth function of the position.
"""
_WHOLE = 0.25  # distance from a whole order within which it is used, in the same units
_CHANCE, _NOTABLE = 0.01, 0.1
"""An effect is tried if noise alone suggests it with at most this probability, or if it explains
this share of a joint's squared error; the search then judges it."""


def proposed(case: Case, model: LogModel, fit: Fit) -> list[Effect]:
    """Return effects that the residual of a fit suggests, with the shapes to try."""
    residuals, motion = joint_residuals(case, model.hypothesis(fit)), full_motion(case)
    joints = [item for item in residuals if item.joint not in case.model.base_joints]
    known = [term.effect for term in fit.terms if term.effect is not None]
    proposals = [*coupled_joints(case, joints, motion), *_ripples(case, joints, known)]
    likely = [item for item in proposals if item.alarm <= _CHANCE or item.share >= _NOTABLE]
    suggested = [effect for item in likely for effect in item.effects]
    return [*suggested, *handled_payloads(case, model, fit)]


def _ripples(
    case: Case, joints: Sequence[JointResidual], known: Sequence[Effect]
) -> Iterator[Proposal]:
    """Yield ripples of every joint, at the highest peak of the residual's spectrum."""
    kinds = [kind for kind in case.effect_classes if kind.proposer is Proposer.WAVES]
    low_pass = case.trajectories[0].filter
    # Functions of the position only other than waves, such as springs.
    smooth = {e.where for e in known if e.depends_on == {"q"} and e.proposer is not Proposer.WAVES}
    for joint in joints:
        if joint.joint not in case.model.single_joints or np.ptp(joint.q) <= 0.0:
            continue
        has_spring = (joint.joint,) in smooth
        peak = highest_peak(
            (joint.q, joint.v),
            joint.residual,
            effective=joint.effective,
            gain=low_pass.response,
            bandwidth=low_pass.bandwidth,
            least_waves=_WAVES_BESIDE if has_spring else LEAST_WAVES,
        )
        if peak is None:
            continue
        step, whole = peak.resolution, round(peak.order)
        order = float(whole) if abs(peak.order - whole) < _WHOLE * step else peak.order
        # Gravity and springs absorb part of the slowest waves, which shifts their peak.
        offsets = _FEW_WAVES if order < _FEW * step else _MANY_WAVES
        orders = [order + x * step for x in offsets]
        least = _WAVES_BESIDE * step if has_spring else 0.0
        alarm = min(1.0, peak.tried * chi2_tail(peak.height, 2))
        for kind in kinds:
            make: Callable[..., Effect] = kind
            waves = tuple(make(joint.joint, n) for n in orders if n >= least)
            yield Proposal(waves, peak.share, alarm)
