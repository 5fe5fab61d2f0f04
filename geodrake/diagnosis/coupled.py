"""Evidence for actuators that move two joints which are not neighbours."""

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
"""Signs with which an actuator adds the speeds of two joints."""
_OWN = 4
"""Number of columns of a joint's own friction, rotor inertia and offset."""


@dataclass(frozen=True, eq=False)
class _Sharing:
    """Products of a joint's residual with columns that it may share with m partners.

    A joint's own friction and rotor are projected out of residual and columns, and the residual is
    scaled to unit length.
    """

    cross: Array  # (m, 2, k) products of the residual with the columns, by partner and sign
    gram: Array  # (m, 2, k, k) products of the columns
    effective: float  # effective sample size of the residual

    def left(self, at: int, sizes: Array) -> Array:
        """Return (2,) shares of squared error left by one partner's parameters (2, k), by sign."""
        explained = 2.0 * np.einsum("sk,sk->s", self.cross[at], sizes)
        return np.asarray(1.0 - explained + np.einsum("skl,sk,sl->s", self.gram[at], sizes, sizes))


def coupled_joints(
    case: Case, joints: Sequence[JointResidual], motion: Sequence[tuple[int, Segment]]
) -> Iterator[Proposal]:
    """Yield friction and rotors shared by joints that are not in `RobotModel.joint_pairs`.

    Both joints must show them with the same parameters, beyond friction and a rotor of their own;
    the evidence is that of the weaker one. Pairs that never move at the same time are left out, as
    their logs cannot show sharing.
    """
    pairs = other_pairs(case.model, [j.joint for j in joints if np.ptp(j.q) > 0.0])
    at_once, index = moving_together(case.trajectories), case.model.joints.index
    pairs = [(first, second) for first, second in pairs if at_once[index(first), index(second)]]
    partners = {
        joint.joint: [a if b == joint.joint else b for a, b in pairs if joint.joint in (a, b)]
        for joint in joints
    }
    for effect in case.effect_classes:
        if not issubclass(effect, SharedActuatorEffect):
            continue
        sharing = {
            joint.joint: _sharing(case, joint, partners[joint.joint], motion, effect)
            for joint in joints
            if partners[joint.joint]
        }
        for first, second in pairs:
            places = (first, partners[first].index(second)), (second, partners[second].index(first))
            share, gain = _together([(sharing[joint], at) for joint, at in places])
            chance = chi2_tail(gain, len(effect.parameters))
            alarm = min(1.0, len(pairs) * len(_SIGNS) * chance)
            yield Proposal(tuple(effect.candidates((first, second))), share, alarm)


def other_pairs(model: RobotModel, moving: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs of moving joints of one type that are not neighbours."""
    single = [joint for joint in model.single_joints if joint in moving]
    return [
        (one, other)
        for one, other in combinations(single, 2)
        if (one in model.sliding_joints) == (other in model.sliding_joints)
        and not {(one, other), (other, one)}.intersection(model.joint_pairs)
    ]


def _sharing(
    case: Case,
    joint: JointResidual,
    partners: Sequence[str],
    motion: Sequence[tuple[int, Segment]],
    effect: type[SharedActuatorEffect],
) -> _Sharing:
    """Return the products of a joint's residual with columns that it shares with partners."""
    index = case.model.joints.index(joint.joint)
    others = [case.model.joints.index(name) for name in partners]

    def columns(segment: Segment) -> Array:
        v, a = segment.velocity[:, index], segment.acceleration[:, index]
        turned_v, turned_a = (
            np.multiply.outer(each[:, others], _SIGNS)
            for each in (segment.velocity, segment.acceleration)
        )
        shared = effect.shared(v[:, None, None], turned_v, turned_a, joint.direction)
        shared = shared.reshape(len(v), -1)
        return np.column_stack([joint.direction(v), v, a, np.ones_like(v), shared])

    values = filtered_columns(case, motion, joint, (columns(segment) for _, segment in motion))
    valid = np.asarray(np.isfinite(values).all(axis=1))
    base, shared = np.split(values[valid], [_OWN], axis=1)
    signals = np.column_stack([joint.residual[valid], shared])
    signals -= base @ np.linalg.lstsq(base, signals, rcond=1e-9)[0]
    signals /= float(np.linalg.norm(signals[:, 0])) or 1.0
    residual = signals[:, 0]
    shared = signals[:, 1:].reshape(len(signals), len(partners), len(_SIGNS), -1)
    return _Sharing(
        np.einsum("t,tmsk->msk", residual, shared),
        np.einsum("tmsk,tmsl->mskl", shared, shared),
        joint.part(valid).effective,
    )


def _together(places: Sequence[tuple[_Sharing, int]]) -> tuple[float, float]:
    """Return the evidence for one actuator at both of its joints, with the better sign.

    `places` are the products of either joint, and the index of the other among its partners. The
    result is the mean share of squared error that it explains, and at the weaker joint a statistic
    of about χ² with one degree of freedom per parameter.
    """
    cross = np.sum([sharing.effective * sharing.cross[at] for sharing, at in places], axis=0)
    gram = np.sum([sharing.effective * sharing.gram[at] for sharing, at in places], axis=0)
    sizes = np.array([_least_squares(*sign) for sign in zip(gram, cross, strict=True)])
    remainder = np.array([sharing.left(at, sizes) for sharing, at in places])
    effective = np.array([[sharing.effective] for sharing, _ in places])
    gains = -effective * np.log(np.maximum(remainder, 1e-9))
    best = int(gains.sum(axis=0).argmax())
    return float(1.0 - remainder[:, best].mean()), max(0.0, float(gains[:, best].min()))


def _least_squares(gram: Array, cross: Array) -> Array:
    """Return the (k,) nonnegative solution of the normal equations of one or two columns."""
    single = np.maximum(cross, 0.0) / np.maximum(np.diag(gram), np.finfo(float).tiny)
    both = np.linalg.lstsq(gram, cross, rcond=1e-9)[0]
    candidates = [*np.diag(single), *([both] if np.all(both >= 0.0) else [])]
    return max(candidates, key=lambda x: float(2.0 * cross @ x - x @ gram @ x))
