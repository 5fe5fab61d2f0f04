"""What comparing, diagnosing and explaining give: plain frozen dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.rival import Rival
from geodrake.model import RobotModel

Array = NDArray[np.float64]
Verdict = Literal["adequate", "explained", "unexplained"]

NOISE_MARGIN = 1.25
"""Errors of all joints together, up to this many times the noise floor, count as noise."""

JOINT_MARGIN = 1.6
"""The same of each joint by itself, whose floor is known less well.

The others' noise must not cover up one joint at which most of the squared error is something else.
"""


@dataclass(frozen=True)
class JointError:
    """Error of one joint's effort.

    Attributes:
        joint: Name of the joint.
        rms: RMS of measured − predicted effort, N·m or N.
        std: Standard deviation of the measured effort, N·m or N.
        floor: Estimated RMS of the sensor noise, N·m or N.
    """

    joint: str
    rms: float
    std: float
    floor: float

    @property
    def nrms(self) -> float:
        """RMS over standard deviation."""
        return self.rms / self.std

    @property
    def removable(self) -> float:
        """Share of the squared error that some model could still remove."""
        return max(0.0, 1.0 - (self.floor / self.rms) ** 2) if self.rms > 0 else 0.0


@dataclass(frozen=True)
class ErrorTable:
    """Errors of all joints.

    Attributes:
        joints: One entry per joint.
    """

    joints: tuple[JointError, ...]

    @property
    def nrms(self) -> float:
        """Root mean square over joints of rms / std."""
        return float(np.sqrt(np.mean([joint.nrms**2 for joint in self.joints])))

    @property
    def floor_nrms(self) -> float:
        """The nrms of the noise floor."""
        return float(np.sqrt(np.mean([(joint.floor / joint.std) ** 2 for joint in self.joints])))

    @property
    def is_noise(self) -> bool:
        """Whether no more than sensor noise is left, on the whole and at every joint."""
        return not self.above_noise and self.nrms <= NOISE_MARGIN * self.floor_nrms

    @property
    def above_noise(self) -> tuple[JointError, ...]:
        """Joints that err by more than noise, whatever the others do."""
        return tuple(joint for joint in self.joints if joint.rms > JOINT_MARGIN * joint.floor)

    @property
    def pooled_rms(self) -> float:
        """Root mean square over joints of the RMS, N·m or N."""
        return float(np.sqrt(np.mean([joint.rms**2 for joint in self.joints])))

    def by_joint(self) -> dict[str, float]:
        """RMS of each joint by name."""
        return {joint.joint: joint.rms for joint in self.joints}


@dataclass(frozen=True, eq=False)
class Series:
    """One joint over one block, filtered and decimated: what figures show.

    Attributes:
        joint: Name of the joint.
        block: Name of the fold.
        time: (K,) instants, s.
        position: (K,) rad or m.
        velocity: (K,) rad/s or m/s.
        acceleration: (K,) rad/s² or m/s².
        measured: (K,) effort, N·m or N.
        predicted: (K,) effort, N·m or N.
    """

    joint: str
    block: str
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    measured: Array
    predicted: Array

    @property
    def residual(self) -> Array:
        """(K,) measured − predicted."""
        return self.measured - self.predicted


@dataclass(frozen=True)
class Failing:
    """A circumstance in which a joint's error is larger than elsewhere.

    Attributes:
        joint: Name of the joint.
        circumstance: In words, such as "at speeds below 0.05 rad/s".
        rms: RMS of the error there, N·m or N.
        elsewhere: RMS of the error otherwise, N·m or N.
        share: Share of the joint's squared error that is made there.
        time: Share of the samples that are there.
    """

    joint: str
    circumstance: str
    rms: float
    elsewhere: float
    share: float
    time: float

    def __str__(self) -> str:
        return (
            f"{self.joint} errs most {self.circumstance}: RMS {self.rms:.3g} there, "
            f"{self.elsewhere:.3g} otherwise ({100 * self.share:.0f} % of its squared error in "
            f"{100 * self.time:.0f} % of the samples)."
        )


@dataclass(frozen=True, eq=False)
class Comparison:
    """How far a model is from logs, and where.

    Attributes:
        errors: Errors of every joint.
        failing: Where the error is concentrated, worst first.
        series: What was measured and predicted.
        notes: What was done to the logs and noticed about the model.
    """

    errors: ErrorTable
    failing: tuple[Failing, ...]
    series: tuple[Series, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect that could be missing.

    Attributes:
        effect: Name; two names joined by " + " for effects found together.
        where: Joints or bodies.
        error_before: Held-out nrms without it.
        error_after: Held-out nrms with it, everything that may move refitted.
        evidence: Twice the held-out log-likelihood ratio, less the price of its parameters.
        false_alarm_probability: Chance that an irrelevant candidate looks as good.
        tied: Whether the log cannot tell it from the best candidate.
    """

    effect: str
    where: tuple[str, ...]
    error_before: float
    error_after: float
    evidence: float
    false_alarm_probability: float
    tied: bool


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What is missing in a model, best candidate first.

    Attributes:
        verdict: "adequate" if nothing convinces and only noise is left, "unexplained" if nothing
            convinces and more is left, "explained" if there is a candidate.
        candidates: Convincing candidates, the chosen one first.
        start: The model as it stands.
        refitted: Held-out errors of the model with its parameters refitted within their prior.
        comparison: Comparison with the model as it stands.
        notes: What was done to the logs and noticed about the model.
    """

    verdict: Verdict
    candidates: tuple[Candidate, ...]
    start: ErrorTable
    refitted: ErrorTable
    comparison: Comparison
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Step:
    """One effect added to a model.

    Attributes:
        effect: Name of the effect.
        where: Joints or bodies it was added at.
        error_before: Held-out nrms before.
        error_after: Held-out nrms after.
        parameters: Place -> parameter name -> value, SI units.
        deviations: The same for the standard deviations.
        indistinguishable_from: Effects that the log could not tell from this one.
        false_alarm_probability: Chance that an irrelevant effect gains as much.
        agreement: Share of the held-out blocks in which it lowers the error where it acts; one
            that hardly changes may count half.
        rms_before: Joint -> held-out RMS before, N·m or N.
        rms_after: Joint -> held-out RMS after, N·m or N.
        rivals: Those of these effects that were fitted when this one was chosen, best first; the
            others follow from what is known of the effects.
    """

    effect: str
    where: tuple[str, ...]
    error_before: float
    error_after: float
    parameters: Mapping[str, Mapping[str, float]]
    deviations: Mapping[str, Mapping[str, float]]
    indistinguishable_from: tuple[str, ...]
    false_alarm_probability: float
    agreement: float
    rms_before: Mapping[str, float]
    rms_after: Mapping[str, float]
    rivals: tuple[Rival, ...] = ()

    @property
    def unfitted_rivals(self) -> tuple[str, ...]:
        """Those of `indistinguishable_from` of which `rivals` has no numbers."""
        fitted = {name for rival in self.rivals for name in rival.names}
        return tuple(name for name in self.indistinguishable_from if name not in fitted)


@dataclass(frozen=True, eq=False)
class Explanation:
    """The loop of comparing, diagnosing and adding, to the floor or to where nothing helps.

    Attributes:
        verdict: "adequate", "explained" or "unexplained".
        steps: The effects added, in order.
        start: Errors of the model as it stands.
        refitted: Held-out errors with the parameters refitted within their prior, before any step.
        end: Held-out errors of the final model; without a step, those of the model as it stands.
        model: The final, physically consistent model; without a step, the model as it stands.
        before: Comparison with the model as it stands.
        after: Comparison with held-out predictions of the final model.
        notes: What was done to the logs and noticed about the model.
    """

    verdict: Verdict
    steps: tuple[Step, ...]
    start: ErrorTable
    refitted: ErrorTable
    end: ErrorTable
    model: RobotModel
    before: Comparison
    after: Comparison
    notes: tuple[str, ...]
