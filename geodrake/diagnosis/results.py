"""What comparing, diagnosing and explaining give: plain frozen dataclasses."""

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
    """What the error that is left at a joint varies with.

    Attributes:
        words: Such as "its direction of motion times the position of wrist_1_joint".
        share: Share of the joint's squared held-out error that varies with it.
    """

    joint: str
    words: str
    share: float


@dataclass(frozen=True, eq=False)
class Candidate(Short):
    """An effect that could be missing.

    Attributes:
        effect: Name; two names joined by " + " for effects found together.
        error_after: Held-out nrms with it, everything that may move refitted.
        evidence: Twice the logarithm of how much more probable it makes the model, alone; 0 for
            what stands in the place of the first one.
        false_alarm_probability: How probable it is that it is not needed.
        tied: Whether it is the first one, or stands in its place in other explanations.
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
    """What is missing in a model, best candidate first.

    Attributes:
        verdict: "adequate" if nothing convinces and only noise is left, "unexplained" if nothing
            convinces and more is left, "undecided" if nothing convinces and noise is not known,
            "explained" if there is a candidate.
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


@dataclass(frozen=True)
class FittedRival:
    """What stands in the place of a finding in other explanations of the logs."""

    effect: str  # name; two names joined by " + " for effects found together
    where: tuple[str, ...]  # joints or bodies
    instead_of: tuple[str, ...]  # names of the effects that were added
    # The nrms with the rival, everything that may move refitted, beside all else that was found.
    error: float
    error_of_choice: float  # the same with what was added
    tie_probability: float  # how probable the rival is, if it is either that or what was added
    odds: float = 1.0  # odds of the rival against what was added

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of its effects."""
        return tuple(self.effect.split(" + "))


@dataclass(frozen=True, eq=False)
class Step(Short):
    """One effect added to a model.

    Attributes:
        where: Joints or bodies it was added at.
        parameters: Place -> parameter name -> value, SI units.
        deviations: The same for the standard deviations.
        indistinguishable_from: Effects that stand in its place in other explanations, of a
            probability above 1 %.
        false_alarm_probability: How probable it is that nothing is in its place.
        agreement: Share of the held-out blocks in which it lowers the error where it acts; one
            that hardly changes may count half.
        rms_before: Joint -> held-out RMS before, N·m or N.
        rms_after: Joint -> held-out RMS after, N·m or N.
        rivals: These effects with their places, the most probable first.
        unknown_probability: How probable it is that it is a part of something that no effect
            describes: it takes little away beside the error that is left in the end.
        systematic: As `deviations`, those that more data do not narrow: from the gains of the
            efforts, known to the logs' `effort_uncertainty` only, and from what stays unexplained.
        series: What is measured and predicted after it, on held-out data; none for the last step,
            after which it is the explanation's `after`.
        model: The model after it; None for the last step, after which it is the explanation's.
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
        """Return its probability: the sum over all explanations that have it.

        With what stands in its place in others, something unknown, and nothing, it adds up to one.
        """
        odds = sum(rival.odds for rival in self.rivals)
        return (1.0 - self.false_alarm_probability - self.unknown_probability) / (1.0 + odds)

    @property
    def probabilities_of_rivals(self) -> tuple[float, ...]:
        """Return how probable each of `rivals` is."""
        return tuple(rival.odds * self.probability for rival in self.rivals)


@dataclass(frozen=True, eq=False)
class Explanation(Shown):
    """The loop of comparing, diagnosing and adding, to the floor or to where nothing helps.

    Attributes:
        verdict: "adequate" or "explained" if only noise is left, "unexplained" if more is, and
            "undecided" if the noise is not known, or hides everything.
        steps: The effects added, in order.
        start: Errors of the model as it stands.
        refitted: Held-out errors with the parameters refitted within their prior, before any step.
        end: Held-out errors of the final model; without a step, those of the model as it stands.
        model: The final, physically consistent model; without a step, the model as it stands.
        before: Comparison with the model as it stands.
        after: Comparison with held-out predictions of the final model.
        notes: What was done to the logs and noticed about the model.
        bodies: What the final fit made of the model's bodies, the farthest change first; none
            where the model stays as it is.
        of_motion: Joint -> share of its squared error that varies with the motion: that a smooth
            function of positions and velocities predicts on held-out data. Of the final model;
            without a step, of the model refitted within its prior.
        is_interrupted: Whether the search was stopped before its end.
        certificate: What the MathematicalProgram of the final fit says of it; None where the model
            stays as it is.
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
