"""Signs of elastic and of loose joints in residuals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.proposal import Proposal
from geodrake.diagnosis.residuals import JointResidual, filtered_columns
from geodrake.effects import Effect
from geodrake.effects.deflection import DeflectionEffect
from geodrake.effects.robot_motion import RobotMotion
from geodrake.effects.role import Proposer
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.evidence import chi2_tail
from geodrake.logs.motion import Motion
from geodrake.logs.smoothing import Segment
from geodrake.model.carried_payloads import carrying

Array = NDArray[np.float64]

_LEAST_REVERSALS = 4
_NEAR = ((0.3, 1.3, 1), (0.1, 1.6, 20), (0.05, 2.0, 20))
"""Near zero load, play makes itself felt. Three ways to see it, any of which will do.

Each is: loads below this share of their RMS count as near zero; the squared error there is more
than so many times that elsewhere; at least so many samples are near zero.
"""
_SAMPLES = 5_000  # of a segment that are looked at


def elastic_joints(
    case: Case, joints: Sequence[JointResidual], motion: Sequence[tuple[int, Segment]]
) -> Iterator[Proposal]:
    """Elasticity of every joint, with what it explains of all residuals together.

    Args:
        case: The case.
        joints: Residuals of all joints.
        motion: `full_motion` of the case.
    """
    motion = _looked_at(motion)
    moving = [j.joint for j in joints if j.joint in case.model.single_joints and np.ptp(j.q) > 0.0]
    found = []
    for name in moving:
        for effect in _shapes(case, Proposer.BENDING, name):
            columns = _columns(case, effect, motion)
            filtered = [
                filtered_columns(case, motion, joint, [column[:, i] for column in columns])
                for i, joint in enumerate(joints)
            ]
            found.append(_proposal(effect, joints, filtered))
    # Elastic joints are easily taken for one another: all are offered, or none.
    most = max((proposal.share for proposal in found), default=0.0)
    yield from (replace(proposal, share=most) for proposal in found)


def loose_joints(
    case: Case, joints: Sequence[JointResidual], motion: Sequence[tuple[int, Segment]]
) -> Iterator[Proposal]:
    """Backlash of every joint whose load changes its sign, by what it does at the joint itself.

    Args:
        case: The case.
        joints: Residuals of all joints.
        motion: `full_motion` of the case.
    """
    motion = _looked_at(motion)
    seen = _motions(case, motion)
    for name in case.model.single_joints:
        at = case.model.joints.index(name)
        joint, loads = joints[at], [each.load[:, at, None] for each in seen]
        reversals = sum(int(np.sum(np.diff(np.sign(load[:, 0])) != 0)) for load in loads)
        if reversals < _LEAST_REVERSALS or np.ptp(joint.q) <= 0.0:
            continue
        load = filtered_columns(case, motion, joint, loads)[:, 0]
        if not _errs_near_zero(joint, load):
            continue
        shapes = _shapes(case, Proposer.PLAY, name)
        tried = []
        for shape in shapes:
            columns = [column[:, at] for column in _columns(case, shape, motion)]
            found = filtered_columns(case, motion, joint, columns)
            tried.append(_proposal(shape, [joint], [found]))
        best = min(tried, key=lambda proposal: proposal.alarm)
        yield Proposal(shapes, best.share, min(1.0, len(shapes) * best.alarm))


def _shapes(case: Case, proposer: Proposer, joint: str) -> tuple[DeflectionEffect, ...]:
    """The effects with a proposer at a joint, in all shapes to try."""
    return tuple(
        shape
        for kind in case.effect_classes
        if issubclass(kind, DeflectionEffect) and kind.proposer is proposer
        for shape in kind.shaped(joint)
    )


def _errs_near_zero(joint: JointResidual, load: Array) -> bool:
    """Whether a joint errs more where its load (K,) changes its sign than elsewhere."""
    known = np.isfinite(load)
    if not known.any():
        return False
    squares, size = np.square(joint.residual), np.abs(load)
    rms = np.sqrt(np.mean(np.square(load[known])))
    for share, excess, enough in _NEAR:
        near, far = known & (size < share * rms), known & (size >= share * rms)
        seen = near.sum() >= enough and far.any()
        if seen and squares[near].mean() > excess * squares[far].mean():
            return True
    return False


def _looked_at(motion: Sequence[tuple[int, Segment]]) -> list[tuple[int, Segment]]:
    """The first samples of every segment, with the index of its log."""
    return [(log, segment[:_SAMPLES]) for log, segment in motion]


def _motions(case: Case, motion: Sequence[tuple[int, Segment]]) -> list[RobotMotion]:
    """The motion of every segment, computed once a case."""
    if not case.kept.seen:
        case.kept.seen += [_motion(case, *each) for each in motion]
    return case.kept.seen


def _motion(case: Case, log: int, segment: Segment) -> RobotMotion:
    q, time = case.model.positions(segment.position), segment.time
    robot = carrying(case.load_model, case.trajectories[log].payloads)
    return robot.motion(Motion(q, segment.velocity, segment.acceleration, time))


def _columns(
    case: Case, effect: DeflectionEffect, motion: Sequence[tuple[int, Segment]]
) -> list[Array]:
    """Of every segment, the effect's column at every joint (N, nv, 1), computed once a case."""
    columns = case.kept.columns
    if effect not in columns:
        columns[effect] = [effect.column(each)[..., None] for each in _motions(case, motion)]
    return columns[effect]


def _proposal(
    effect: Effect, joints: Sequence[JointResidual], columns: Sequence[Array]
) -> Proposal:
    """The one parameter that suits the residuals of all joints, each as good as its error says."""
    parts: list[tuple[Array, Array, float]] = []
    for joint, column in zip(joints, columns, strict=True):
        rows = np.asarray(np.isfinite(column[:, 0]))
        size = float(np.sqrt(np.mean(np.square(joint.residual)))) if len(joint.residual) else 0.0
        if rows.any() and size > 0.0:
            here = joint.part(rows)
            base = np.stack([here.sign_v, here.v, np.ones_like(here.v)], 1)
            both = np.stack([here.residual, column[rows, 0]], 1) / size
            left = both - base @ np.linalg.lstsq(base, both, rcond=1e-9)[0]
            parts.append((left[:, 0], left[:, 1], here.effective / len(here.v)))
    power = sum(weight * float(a @ a) for _, a, weight in parts)
    value = sum(weight * float(r @ a) for r, a, weight in parts) / power if power > 0.0 else 0.0
    if value <= 0.0:
        return Proposal((effect,), 0.0, 1.0)
    share, gain = 0.0, 0.0
    for residual, a, weight in parts:
        before, after = np.square(residual).sum(), np.square(residual - value * a).sum()
        if before > 0.0:
            share = max(share, float(1.0 - after / before))
            gain += weight * len(a) * float(np.log(before / max(after, 1e-9 * before)))
    return Proposal((effect,), share, min(1.0, len(joints) * chi2_tail(gain, 1)))
