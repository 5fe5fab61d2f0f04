"""What a result means, in the words of a robot engineer."""

from __future__ import annotations

from collections.abc import Sequence

from geodrake.diagnosis.results import Comparison, Diagnosis, ErrorTable, Explanation, Step
from geodrake.visualization.numbers import number, percent
from geodrake.visualization.units import effect_label, listed, places_label

_MOST_NAMED = 4
_NEARLY_ALL = 0.9995
_MOST_PLACES = 3
_LIKELY_FALSE_ALARM = 0.05


def explained_share(before: float, after: float) -> float:
    """Share of the squared error that goes from one nrms to another; negative if it grows."""
    return 1.0 - (after / before) ** 2 if before > 0 else 0.0


def removable_share(errors: ErrorTable) -> float:
    """Share of the squared error, summed over joints as in nrms, that is not sensor noise."""
    return max(0.0, explained_share(errors.nrms, errors.floor_nrms))


def in_words(share: float) -> str:
    """A share as it stands in a sentence."""
    return percent(share).replace(">", "more than").replace("<", "less than")


def explanation_mark(explanation: Explanation) -> str:
    """The verdict of an explanation in a word or three."""
    partly = explanation.verdict == "unexplained" and explanation.steps
    return "explained in part" if partly else explanation.verdict


def explanation_headline(explanation: Explanation) -> str:
    """The answer of an explanation in a sentence."""
    if explanation.verdict == "adequate":
        return "The model is adequate: nothing worth adding is missing."
    if not explanation.steps:
        return "An error is left that no known effect explains."
    joints = [joint.joint for joint in explanation.start.joints]
    real = [step for step in explanation.steps if convincing(step)]
    doubtful = [step for step in explanation.steps if not convincing(step)]
    parts = [f"Missing: {_list(real, joints)}."] if real else []
    if doubtful:
        parts.append(f"Added without convincing evidence: {_list(doubtful, joints)}.")
    return " ".join(parts)


def explanation_lead(explanation: Explanation) -> tuple[str, ...]:
    """What an explanation means, in paragraphs."""
    start, end = explanation.start, explanation.end
    first = _as_it_stands(start)
    if explanation.steps:
        gone = explained_share(start.nrms, end.nrms)
        what = "this effect" if len(explanation.steps) == 1 else "these effects"
        first += (
            f" With {what} and everything refitted, it errs by {in_words(end.nrms)} on data held "
            f"out from the fit: {in_words(gone)} of the squared error is gone."
        )
    return first, _rest(explanation)


def diagnosis_headline(diagnosis: Diagnosis) -> str:
    """The answer of a diagnosis in a sentence."""
    if diagnosis.candidates:
        best = diagnosis.candidates[0]
        joints = [joint.joint for joint in diagnosis.start.joints]
        where = places_label(best.where, joints, most=_MOST_NAMED)
        return f"Missing: {effect_label(best.effect)} ({where})."
    if diagnosis.verdict == "adequate":
        return "The model is adequate: nothing worth adding is missing."
    return "An error is left that no known effect explains."


def diagnosis_lead(diagnosis: Diagnosis) -> tuple[str, ...]:
    """What a diagnosis means, in paragraphs."""
    first = _as_it_stands(diagnosis.start)
    if not diagnosis.candidates:
        return first, _noise(diagnosis.refitted)
    best, *others = diagnosis.candidates
    gone = explained_share(best.error_before, best.error_after)
    first += (
        f" Adding {effect_label(best.effect)} and refitting takes the error on held-out data to "
        f"{in_words(best.error_after)}: {in_words(gone)} of the squared error goes."
    )
    tied = dict.fromkeys(effect_label(c.effect) for c in others if c.tied)
    tied.pop(effect_label(best.effect), None)
    second = "No other candidate does as well."
    if tied:
        second = f"The logs cannot tell it from {listed(list(tied), 'or')}."
    elif not others:
        second = "No other candidate convinces."
    return first, second


def comparison_headline(comparison: Comparison) -> str:
    """The answer of a comparison in a sentence."""
    errors = comparison.errors
    return (
        f"The model errs by {in_words(errors.nrms)} of the efforts' standard deviation; sensor "
        f"noise alone would make {in_words(errors.floor_nrms)}."
    )


def comparison_lead(comparison: Comparison) -> tuple[str, ...]:
    """What a comparison means, in paragraphs."""
    worst = max(comparison.errors.joints, key=lambda joint: joint.nrms)
    share = _at_most(removable_share(comparison.errors))
    first = (
        f"A better model could remove {share} of the squared error. It is largest at "
        f"{worst.joint}: {in_words(worst.nrms)} of the standard deviation of the effort there."
    )
    return (first, *(str(case) for case in comparison.failing[:1]))


def convincing(step: Step) -> bool:
    """Whether a step lowers the held-out error, and more than chance would."""
    return (
        step.error_after < step.error_before and step.false_alarm_probability <= _LIKELY_FALSE_ALARM
    )


def step_sentence(step: Step) -> str:
    """What a step removes of the squared error: "94 %", or that it removes nothing."""
    share = explained_share(step.error_before, step.error_after)
    return percent(share) if share > 0 else f"none ({percent(share)})"


def _at_most(share: float) -> str:
    return "nearly all" if share >= _NEARLY_ALL else f"up to {in_words(share)}"


def _as_it_stands(start: ErrorTable) -> str:
    return (
        f"As it stands, the model errs by {in_words(start.nrms)} of the standard deviation of the "
        f"measured efforts (nrms {number(start.nrms)})."
    )


def _rest(explanation: Explanation) -> str:
    """What is left at the end of an explanation."""
    if explanation.verdict == "adequate":
        return f"What is left is sensor noise. {_noise(explanation.end)}"
    if explanation.verdict == "explained":
        return f"With that, only sensor noise is left. {_noise(explanation.end)}"
    left = "An error above the noise is left. " if explanation.steps else ""
    worst = f" {explanation.after.failing[0]}" if explanation.after.failing else ""
    return f"{left}{_noise(explanation.end)}{worst}"


def _noise(errors: ErrorTable) -> str:
    if errors.floor_nrms <= 0:
        return "The logs show no sensor noise to compare the error with."
    return (
        f"Sensor noise alone would make {in_words(errors.floor_nrms)}, so a better model could "
        f"still remove {_at_most(removable_share(errors))} of the squared error that is left."
    )


def _together(steps: Sequence[Step]) -> list[list[Step]]:
    """Steps at the same places side by side, in the order of the first of each."""
    groups: dict[tuple[str, ...], list[Step]] = {}
    for step in steps:
        groups.setdefault(step.where, []).append(step)
    return list(groups.values())


def _list(steps: Sequence[Step], joints: Sequence[str]) -> str:
    """Effects and their places, or the effects alone where that would be long."""
    groups = _together(steps)
    if len(groups) > _MOST_PLACES:
        return listed([effect_label(step.effect) for step in steps])
    return "; ".join(
        f"{listed([effect_label(step.effect) for step in group])} "
        f"({places_label(group[0].where, joints, most=_MOST_NAMED)})"
        for group in groups
    )
