"""Results of comparing, diagnosing and explaining, as frozen dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from geodrake.boundary.showing import Short, Shown
from geodrake.identification.fit import Certificate
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, Series
from geodrake.identification.models.results import BodyChange
from geodrake.model.robot_model import RobotModel

Verdict = Literal["adequate", "explained", "unexplained", "undecided"]


@dataclass(frozen=True)
class Correlate:
    """A signal with which the remaining error of a joint varies.

    Attributes:
        words: Such as "its direction of motion times the position of wrist_1_joint".
        share: Share of the joint's squared held-out error that varies with it.
    """

    joint: str
    words: str
    share: float


@dataclass(frozen=True, eq=False)
class Candidate(Short):
    """Effect that may be missing.

    Attributes:
        effect: Name; names joined by " + " for effects found together.
        error_after: Held-out nrms with it, with all parameters refitted.
        evidence: Twice the log posterior odds of the model with only this effect; 0 for
            alternatives to the first candidate.
        false_alarm_probability: Probability that it is not needed.
        tied: Whether it is the first candidate, or an alternative to it in other explanations.
    """

    effect: str
    where: tuple[str, ...]
    error_before: float
    error_after: float
    evidence: float
    false_alarm_probability: float
    tied: bool


@dataclass(frozen=True, eq=False)
class Diagnosis(Shown):
    """Effects that may be missing in a model, best candidate first.

    Attributes:
        verdict: "explained" if there is a candidate; otherwise "adequate" if only noise and errors
            of effort gains are left, "unexplained" if the error is larger, and "undecided" if the
            noise is unknown.
        candidates: Convincing candidates, the chosen one first.
        start: Errors of the unchanged model.
        refitted: Held-out errors of the model with its parameters refitted within their prior.
        comparison: Comparison with the unchanged model.
        notes: Notes on the preparation of the logs and on the model.
        at_found_gains: Errors like `refitted`, but with effort gains as the logs show, within their
            uncertainty; None if these are negligible, or with a candidate.
    """

    verdict: Verdict
    candidates: tuple[Candidate, ...]
    start: ErrorTable
    refitted: ErrorTable
    comparison: Comparison
    notes: tuple[str, ...]
    at_found_gains: ErrorTable | None = None


@dataclass(frozen=True)
class FittedRival:
    """An alternative to a finding in other explanations of the logs."""

    effect: str  # name; names joined by " + " for effects found together
    where: tuple[str, ...]  # joints or bodies
    instead_of: tuple[str, ...]  # names of the effects that were added
    # The nrms with the rival and all other findings, with all parameters refitted.
    error: float
    error_of_choice: float  # the same with the added effects
    tie_probability: float  # probability of the rival, if it or the added effects are right
    odds: float = 1.0  # odds of the rival against the added effects

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of its effects."""
        return tuple(self.effect.split(" + "))


@dataclass(frozen=True, eq=False)
class Step(Short):
    """Effect added to a model.

    Attributes:
        where: Joints or bodies at which it was added.
        parameters: Place -> parameter name -> value, SI units.
        deviations: The same for the standard deviations.
        indistinguishable_from: Alternatives in other explanations with probabilities above 1 %.
        false_alarm_probability: Probability that no effect is needed there.
        agreement: Share of the held-out blocks in which it lowers the error where it acts; a block
            with hardly any change may count half.
        rms_before: Joint -> held-out RMS before, N·m or N.
        rms_after: Joint -> held-out RMS after, N·m or N.
        rivals: The alternatives with their places, the most probable first.
        unknown_probability: Probability that it is part of an effect outside the catalogue, as it
            removes little compared with the remaining error.
        systematic: Further deviations that more data do not reduce: by effort gains, known to the
            logs' `effort_uncertainty`, and by unexplained errors.
        series: Measured and predicted efforts after it, on held-out data; empty for the last step,
            for which the explanation's `after` contains them.
        model: The model after it; None for the last step, for which it is the explanation's.
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
    rivals: tuple[FittedRival, ...] = ()
    unknown_probability: float = 0.0
    systematic: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    series: tuple[Series, ...] = field(default=(), repr=False)
    model: RobotModel | None = field(default=None, repr=False)

    @property
    def probability(self) -> float:
        """Return its probability: the sum over all explanations that contain it.

        Together with its rivals, something unknown, and no effect, it adds up to one.
        """
        odds = sum(rival.odds for rival in self.rivals)
        return (1.0 - self.false_alarm_probability - self.unknown_probability) / (1.0 + odds)

    @property
    def probabilities_of_rivals(self) -> tuple[float, ...]:
        """Return the probability of each of `rivals`."""
        return tuple(rival.odds * self.probability for rival in self.rivals)


@dataclass(frozen=True, eq=False)
class Explanation(Shown):
    """Effects added to a model until only noise is left, or nothing explains the rest.

    Attributes:
        verdict: "adequate" or "explained" if only noise and errors of effort gains are left;
            "unexplained" if more is left; "undecided" if the noise is unknown, or hides everything.
        steps: The added effects, in order.
        start: Errors of the unchanged model.
        refitted: Held-out errors with the parameters refitted within their prior, before any step.
        end: Held-out errors of the final model; without a step, those of the unchanged model.
        model: The final, physically consistent model; without a step, the unchanged model.
        before: Comparison with the unchanged model.
        after: Comparison with held-out predictions of the final model.
        notes: Notes on the preparation of the logs, the model and the fit.
        bodies: Changes of the model's bodies, the largest first; empty if the model is unchanged.
        of_motion: Joint -> share of its squared error that a smooth function of positions and
            velocities predicts on held-out data, for the final model; without a step, for the model
            refitted within its prior.
        is_interrupted: Whether the search was stopped before its end.
        certificate: Certificate of the final fit by its MathematicalProgram; None if the model is
            unchanged.
        at_found_gains: Errors like `end`, but with effort gains as the logs show, within their
            uncertainty; None if these are negligible.
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
    bodies: tuple[BodyChange, ...] = ()
    of_motion: Mapping[str, float] = field(default_factory=dict)
    is_interrupted: bool = False
    certificate: Certificate | None = None
    at_found_gains: ErrorTable | None = None

    @property
    def at_found_gains_nrms(self) -> float | None:
        """Return the nrms of `at_found_gains`."""
        return None if self.at_found_gains is None else self.at_found_gains.nrms
