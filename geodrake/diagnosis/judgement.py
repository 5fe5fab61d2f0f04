"""One judgement: what held-out errors say of a hypothesis against another one.

Everything that decides between two explanations of the same logs reads it from here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.effects.base import Effect, Proposer
from geodrake.identification.logs.criteria import LEAST_NOISE, PENALTY, SEVERAL, Criteria
from geodrake.identification.logs.cross_validation import HeldOut
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.evidence import (
    false_alarm_probability,
    fold_agreement,
    log_likelihood_gain,
    tie_probability,
)
from geodrake.identification.logs.hypothesis import Hypothesis

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class Judgement:
    """What held-out errors say of a hypothesis against another one.

    Attributes:
        gain: Twice the held-out log-likelihood ratio, less what bodies pay that went farther, where
            they may leave the assumed prior.
        parameters: How many parameters it has more, shapes that were tried on a grid counted.
        before: (F,) squared error of the other one in every fold, each joint's over its mean.
        after: (F,) the same of the hypothesis, over the same means.
        tried: Of how many candidates it is the best.
    """

    gain: float
    parameters: int
    before: Array
    after: Array
    tried: int = 1

    @property
    def score(self) -> float:
        """Gain less the penalty of the parameters."""
        return self.gain - PENALTY * self.parameters

    @property
    def is_better(self) -> bool:
        """Whether it gains more than its parameters must, or than one must if it has no more."""
        return self.gain > PENALTY * max(self.parameters, 1)

    @property
    def alarm(self) -> float:
        """Probability of a false alarm, all candidates counted."""
        return false_alarm_probability(self.gain, self.parameters, self.tried)

    @property
    def left(self) -> float:
        """Share of the squared error that is left."""
        return float(self.after.sum() / self.before.sum())

    @property
    def reduction(self) -> float:
        """Share of the squared error that is gone."""
        return 1.0 - self.left

    @property
    def agreement(self) -> float:
        """Share of the folds in which the error fell."""
        return fold_agreement(self.before, self.after)

    @property
    def chance_of_other(self) -> float:
        """Chance that the other one is truly no worse, by how the folds differ."""
        return tie_probability(self.after, self.before)

    def is_tie(self, criteria: Criteria) -> bool:
        """Whether the other one may do as well: never with several times the error."""
        return self.left > 1.0 / SEVERAL and self.chance_of_other > criteria.tie

    def convinces(self, criteria: Criteria) -> bool:
        """Whether all criteria of something new are met."""
        return (
            self.alarm <= criteria.alarm
            and self.reduction >= criteria.reduction
            and self.agreement >= criteria.agreement
        )


def judge(
    before: Hypothesis,
    after: Hypothesis,
    *,
    joints: Mask | None = None,
    parameters: int | None = None,
    tried: int = 1,
) -> Judgement:
    """What held-out errors say of a hypothesis against another one.

    Args:
        before: The other hypothesis.
        after: The hypothesis judged, whose residuals say how many samples count.
        joints: (nv,) joints at which errors are compared fold by fold; by default those that
            feel what the hypotheses differ by.
        parameters: How many parameters it has more; those of its effects by default.
        tried: Of how many candidates it is the best.
    """
    more = parameters_of(after.unknowns.effects) - parameters_of(before.unknowns.effects)
    found = judge_errors(
        (before.held_out, after.held_out),
        after.effective,
        joints=_felt_at(before, after) if joints is None else joints,
        least=np.square(LEAST_NOISE * before.dataset.effort_std),
        parameters=more if parameters is None else parameters,
        tried=tried,
    )
    if max(before.looseness, after.looseness) <= 1.0:
        return found
    way = after.inertial_penalty - before.inertial_penalty
    return replace(found, gain=found.gain - way)


def judge_errors(
    errors: tuple[HeldOut, HeldOut],
    effective: Array,
    *,
    joints: Mask | None = None,
    parameters: int,
    tried: int = 1,
    least: Array | float = _TINY,
) -> Judgement:
    """What errors of the same held-out data say of a fit against another one; see `judge`.

    Args:
        errors: Held-out errors of the fit compared against, then of the fit judged.
        effective: (nv,) independent samples that the residuals are worth.
        joints: (nv,) joints at which errors are compared fold by fold; all by default.
        parameters: How many parameters the fit has more.
        tried: Of how many candidates it is the best.
        least: (nv,) mean squared errors below which none counts for more, (N·m)² or N².
    """
    before, after = errors
    gain = float(log_likelihood_gain(before.mse, after.mse, effective).sum())
    weight = (1.0 if joints is None else joints) / np.maximum(before.mse, least)
    return Judgement(gain, parameters, before.sse @ weight, after.sse @ weight, tried)


def _felt_at(before: Hypothesis, after: Hypothesis) -> Mask:
    """(nv,) joints that feel what two hypotheses differ by; all for other bodies."""
    every = np.ones(len(after.delay), bool)
    if before.looseness != after.looseness or before.released != after.released:
        return every
    joints = np.asarray(before.delay) != np.asarray(after.delay)
    for one, other in ((before, after), (after, before)):
        own = [e for e in one.unknowns.effects if e not in other.unknowns.effects]
        joints = joints | acted_upon(one.dataset, own) if own else joints
    return joints if joints.any() else every


def acted_upon(dataset: Dataset, effects: Sequence[Effect]) -> Mask:
    """(nv,) whether some effects act on a joint.

    Play is proposed at its joint alone: it reaches others too, but is lost there in larger errors.

    Args:
        dataset: The reduced logs.
        effects: The effects.
    """
    if all(effect.proposer is Proposer.PLAY for effect in effects):
        return np.isin(dataset.joints, [joint for effect in effects for joint in effect.where])
    felt = [dataset.felt(effect) for effect in effects]
    return felt[0] if len(felt) == 1 else np.logical_or.reduce(felt)


def gain_of(before: Hypothesis, after: Hypothesis) -> float:
    """Twice the held-out log-likelihood ratio of two hypotheses; see `judge`.

    Args:
        before: The one hypothesis.
        after: The other, with which the samples are counted.
    """
    return judge(before, after).gain


def parameters_of(effects: Sequence[Effect]) -> int:
    """Linear parameters of effects, and one for every shape that was tried on a grid.

    Args:
        effects: The effects.
    """
    return sum(len(effect.parameters) + effect.free_shapes for effect in effects)
