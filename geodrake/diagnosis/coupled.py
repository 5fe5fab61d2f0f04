"""Evidence for actuators that turn with two joints which are not neighbours."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.residuals import JointResidual, Proposal, filtered_columns
from geodrake.effects.friction import SharedActuatorEffect
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.evidence import chi2_tail
from geodrake.identification.logs.reduce import moving_together
from geodrake.logs.smoothing import Segment
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_SIGNS = (1.0, -1.0)
"""An actuator turns with the sum of two speeds or with their difference."""
_OWN = 4
"""Columns of a joint's own friction, rotor inertia and offset."""


@dataclass(frozen=True, eq=False)
class _Sharing:
    """How the residual of a joint depends on columns that it may share with m others.

    What friction and a rotor of its own explain is taken out of residual and columns, and both are
    scaled so that the residual is of length one.
    """

    cross: Array  # (m, 2, k) products of the residual with the columns, by partner and sign
    gram: Array  # (m, 2, k, k) products of the columns
    effective: float  # how many independent samples the residual is worth

    def left(self, at: int, sizes: Array) -> Array:
        """Return (2,) share of squared error left by one partner's parameters (2, k), by sign."""
        gone = 2.0 * np.einsum("sk,sk->s", self.cross[at], sizes)
        return np.asarray(1.0 - gone + np.einsum("skl,sk,sl->s", self.gram[at], sizes, sizes))


def coupled_joints(
    case: Case, joints: Sequence[JointResidual], motion: Sequence[tuple[int, Segment]]
) -> Iterator[Proposal]:
    """Yield friction and rotors shared by joints that are not in `RobotModel.joint_pairs`.

    Both joints must show them, with the same parameters and beyond friction and a rotor of their
    own: the evidence is that of the joint that shows them less. Pairs that
    never move at the same time are left out: a log cannot tell what they share.
    """
    pairs = other_pairs(case.model, [j.joint for j in joints if np.ptp(j.q) > 0.0])
    at_once, index = moving_together(case.trajectories), case.model.joints.index
    pairs = [(one, other) for one, other in pairs if at_once[index(one), index(other)]]
    partners = {
        joint.joint: [a if b == joint.joint else b for a, b in pairs if joint.joint in (a, b)]
        for joint in joints
    }
    for effect in case.effect_classes:
        if not issubclass(effect, SharedActuatorEffect):
            continue
        looks = {
            joint.joint: _look(case, joint, partners[joint.joint], motion, effect)
            for joint in joints
            if partners[joint.joint]
        }
        for one, other in pairs:
            places = (one, partners[one].index(other)), (other, partners[other].index(one))
            share, gain = _together([(looks[joint], at) for joint, at in places])
            chance = chi2_tail(gain, len(effect.parameters))
            alarm = min(1.0, len(pairs) * len(_SIGNS) * chance)
            yield Proposal(tuple(effect.candidates((one, other))), share, alarm)


def other_pairs(model: RobotModel, moving: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs of moving joints of one kind that are not neighbours."""
    single = [joint for joint in model.single_joints if joint in moving]
    return [
        (one, other)
        for one, other in combinations(single, 2)
        if (one in model.sliding_joints) == (other in model.sliding_joints)
        and not {(one, other), (other, one)}.intersection(model.joint_pairs)
    ]


def _look(
    case: Case,
    joint: JointResidual,
    partners: Sequence[str],
    motion: Sequence[tuple[int, Segment]],
    effect: type[SharedActuatorEffect],
) -> _Sharing:
    """Return the dependence of a joint's residual on columns that it shares with partners."""
    own = case.model.joints.index(joint.joint)
    others = [case.model.joints.index(name) for name in partners]

    def columns(segment: Segment) -> Array:
        v, a = segment.velocity[:, own], segment.acceleration[:, own]
        turned_v, turned_a = (
            np.multiply.outer(each[:, others], _SIGNS)
            for each in (segment.velocity, segment.acceleration)
        )
        shared = effect.shared(v[:, None, None], turned_v, turned_a, joint.direction)
        shared = shared.reshape(len(v), -1)
        return np.column_stack([joint.direction(v), v, a, np.ones_like(v), shared])

    found = filtered_columns(case, motion, joint, (columns(segment) for _, segment in motion))
    seen = np.asarray(np.isfinite(found).all(axis=1))
    base, shared = np.split(found[seen], [_OWN], axis=1)
    both = np.column_stack([joint.residual[seen], shared])
    both -= base @ np.linalg.lstsq(base, both, rcond=1e-9)[0]
    both /= float(np.linalg.norm(both[:, 0])) or 1.0
    residual = both[:, 0]
    shared = both[:, 1:].reshape(len(both), len(partners), len(_SIGNS), -1)
    return _Sharing(
        np.einsum("t,tmsk->msk", residual, shared),
        np.einsum("tmsk,tmsl->mskl", shared, shared),
        joint.part(seen).effective,
    )


def _together(places: Sequence[tuple[_Sharing, int]]) -> tuple[float, float]:
    """Return what one actuator explains at both of its joints, with the better sign.

    `places` are the look at either joint, and which of its partners the other one is. Returned are
    the share of the squared error that it takes away, in the mean of both joints, and about χ² of
    as many degrees of freedom as it has parameters at the joint that shows it less.
    """
    cross = np.sum([look.effective * look.cross[at] for look, at in places], axis=0)
    gram = np.sum([look.effective * look.gram[at] for look, at in places], axis=0)
    sizes = np.array([_least_squares(*sign) for sign in zip(gram, cross, strict=True)])
    left = np.array([look.left(at, sizes) for look, at in places])
    effective = np.array([[look.effective] for look, _ in places])
    gains = -effective * np.log(np.maximum(left, 1e-9))
    best = int(gains.sum(axis=0).argmax())
    return float(1.0 - left[:, best].mean()), max(0.0, float(gains[:, best].min()))


def _least_squares(gram: Array, cross: Array) -> Array:
    """Return the (k,) nonnegative solution of the normal equations of one or two columns."""
    alone = np.maximum(cross, 0.0) / np.maximum(np.diag(gram), np.finfo(float).tiny)
    both = np.linalg.lstsq(gram, cross, rcond=1e-9)[0]
    tried = [*np.diag(alone), *([both] if np.all(both >= 0.0) else [])]
    return max(tried, key=lambda x: float(2.0 * cross @ x - x @ gram @ x))
