"""Results of the search for formulas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.escaping import identifiers
from geodrake.boundary.showing import Short
from geodrake.diagnosis.drafting.formula import Formula
from geodrake.diagnosis.results import Correlate
from geodrake.effects import Effect
from geodrake.identification.logs.model_errors import ErrorTable

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DraftedEffect(Short):
    """Formula for the missing effort at a joint."""

    formula: Formula
    coefficients: Array  # (k,) fitted coefficients, in the units of `formula.parameters`
    deviations: Array  # (k,) their standard deviations
    rms_before: float  # held-out RMS of the joint without it, N·m or N
    rms_after: float  # held-out RMS of the joint with it, N·m or N
    floor: float  # RMS of the joint's sensor noise, N·m or N
    # Probability that no formula is needed, if the alternative is this one.
    false_alarm_probability: float
    # Formulas of at most as many terms, in words, that the logs cannot distinguish from it.
    rivals: tuple[str, ...]
    time: Array  # (K,) instants of filtered samples, s, block after block
    residual: Array  # (K,) held-out residual without the formula, N·m or N
    effort: Array  # (K,) effort of the formula, N·m or N


@dataclass(frozen=True, eq=False)
class Draft(Short):
    """Formulas for the remaining error of a model.

    Attributes:
        effects: One for each joint with a convincing formula, in the order found.
        correlates: Signals with which the remaining error varies, by joint, strongest first.
        needless: Effects of the explanation that the formulas make unnecessary.
        before: Held-out errors without the formulas, all parameters refitted.
    """

    effects: tuple[DraftedEffect, ...]
    correlates: tuple[Correlate, ...]
    needless: tuple[Effect, ...]
    before: ErrorTable
    after: ErrorTable
    logs: tuple[str, ...]

    @property
    def names(self) -> dict[str, str]:
        """Joint -> name of its effect, such as "elbow_joint_draft"."""
        joints = identifiers(effect.formula.joint for effect in self.effects)
        return {joint: f"{name}_draft" for joint, name in joints.items()}
