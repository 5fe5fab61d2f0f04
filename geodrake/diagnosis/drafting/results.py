"""Results of a search for formulas, as frozen dataclasses."""

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
    """A formula for what is missing at a joint."""

    formula: Formula
    coefficients: Array  # (k,) fitted coefficients, in the units of `formula.parameters`
    deviations: Array  # (k,) their standard deviations
    rms_before: float  # held-out RMS of the joint without it, N·m or N
    rms_after: float  # held-out RMS of the joint with it, N·m or N
    floor: float  # RMS of the joint's sensor noise, N·m or N
    # How probable it is that there is no formula, if it is this one or none.
    false_alarm_probability: float
    # Formulas of no more terms, in words, from which the logs cannot distinguish it.
    rivals: tuple[str, ...]
    time: Array  # (K,) instants of filtered samples, s, block after block
    residual: Array  # (K,) effort that everything else leaves there, N·m or N
    effort: Array  # (K,) effort of the formula there, N·m or N


@dataclass(frozen=True, eq=False)
class Draft(Short):
    """Formulas for the error that a model leaves.

    Attributes:
        effects: One for each joint where a formula convinces, in the order found.
        correlates: What the error left varies with, joint by joint, most first.
        needless: Effects that the explanation had, and that the formulas make needless.
        before: Held-out errors without the formulas, everything that may move refitted.
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
