"""What held-out errors say of a formula: one that was searched among thousands.

An effect of the catalogue is weighed by its evidence and its prior odds. A formula has neither: its
terms were picked for what they leave, so that data judge it which its fit did not see.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.effects.base import Effect
from geodrake.identification.logs.criteria import ALARM, LEAST_NOISE, PENALTY, TIE
from geodrake.identification.logs.evidence import (
    false_alarm_probability,
    fold_agreement,
    log_likelihood_gain,
    tie_probability,
)
from geodrake.identification.logs.hypothesis import Hypothesis

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_REDUCTION = 0.05
"""At least this share of the squared error at its joint must go with a formula."""

_AGREEMENT = 0.7  # of the folds, at least, must have a smaller error
_SEVERAL = 4.0  # times the squared error is never a tie


@dataclass(frozen=True, eq=False)
class Judgement:
    """What held-out errors say of a hypothesis against another one.

    Attributes:
        gain: Twice the held-out log-likelihood ratio.
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
        """Return the gain less the penalty of the parameters."""
        return self.gain - PENALTY * self.parameters

    @property
    def is_better(self) -> bool:
        """Return whether it gains more than the penalty of its parameters, at least of one."""
        return self.gain > PENALTY * max(self.parameters, 1)

    @property
    def alarm(self) -> float:
        """Return the probability of a false alarm, all candidates counted."""
        return false_alarm_probability(self.gain, self.parameters, self.tried)

    @property
    def left(self) -> float:
        """Return the share of the squared error that remains."""
        return float(self.after.sum() / self.before.sum())

    @property
    def reduction(self) -> float:
        """Return the share of the squared error that the hypothesis removes."""
        return 1.0 - self.left

    @property
    def agreement(self) -> float:
        """Return the share of the folds in which the error fell."""
        return fold_agreement(self.before, self.after)

    @property
    def is_tie(self) -> bool:
        """Return whether the other one may do as well: never with several times the error."""
        return self.left > 1.0 / _SEVERAL and tie_probability(self.after, self.before) > TIE

    @property
    def convinces(self) -> bool:
        """Return whether it is significant, large enough, and found in most folds."""
        return (
            self.alarm <= ALARM
            and self.reduction >= LEAST_REDUCTION
            and self.agreement >= _AGREEMENT
        )


def judge(
    before: Hypothesis,
    after: Hypothesis,
    *,
    joints: Mask | None = None,
    parameters: int | None = None,
    tried: int = 1,
) -> Judgement:
    """Compare a hypothesis with another one of the same prior of bodies by held-out errors.

    Args:
        before: The other hypothesis.
        after: The hypothesis judged, whose residuals say how many samples count.
        joints: (nv,) joints at which errors are compared fold by fold; all by default.
        parameters: How many parameters it has more; those of its effects by default.
        tried: Of how many candidates it is the best.
    """
    if parameters is None:
        parameters = _parameters(after.unknowns.effects) - _parameters(before.unknowns.effects)
    one, other = before.held_out, after.held_out
    gain = float(log_likelihood_gain(one.mse, other.mse, after.effective).sum())
    least = np.square(LEAST_NOISE * before.dataset.effort_std)
    weight = (1.0 if joints is None else joints) / np.maximum(one.mse, least)
    return Judgement(gain, parameters, one.sse @ weight, other.sse @ weight, tried)


def _parameters(effects: Sequence[Effect]) -> int:
    """Count linear parameters of effects, and one for every shape tried on a grid."""
    return sum(len(effect.parameters) + effect.free_shapes for effect in effects)
