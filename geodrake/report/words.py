"""Results in sentences: names as people read them, verdicts of a terminal, leads of a page."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from geodrake.boundary.escaping import printable
from geodrake.control.rollout import RolloutFit
from geodrake.diagnosis.drafting import Correlate
from geodrake.diagnosis.results import Diagnosis, Explanation, Step
from geodrake.diagnosis.search_progress import FoundStep
from geodrake.effects import catalogue
from geodrake.identification.logs.model_errors import (
    Comparison,
    ErrorTable,
    Failing,
    JointError,
)
from geodrake.report.numbers import Units, chance, estimate, number, percent

_MOST_NAMED = 4
_MOST_VALUES = 2  # places whose values are listed one by one
_LIKELY = 0.01  # probability from which on a rival is named
_NEARLY_ALL = 0.9995
_NOTABLE = 0.05  # share of what is left at a joint that goes with the motion
_MOST_PLACES = 3
_NOT_TOLD = "Nothing worth adding was found; whether more is missing, the logs cannot tell."
_PROPER_NAMES = {"coulomb": "Coulomb", "stribeck": "Stribeck", "com": "CoM"}


MOTIONS = "Departure from the motion under the commands"
"""What stands above rollouts under commands."""


def listed(names: Sequence[str], last: str = "and") -> str:
    """`a`, `a and b`, `a, b and c`."""
    head, tail = ", ".join(names[:-1]), "".join(names[-1:])
    return f"{head} {last} {tail}" if head else tail


def effect_label(name: str) -> str:
    """Return the name of an effect or a parameter in words, such as "Coulomb friction"."""
    labels = {effect.name: effect.label for effect in catalogue() if effect.label}
    return " + ".join(labels.get(part) or _spaced(part) for part in name.split(" + "))


def _spaced(name: str) -> str:
    words = printable(name).replace("_", " ").split(" ")
    return " ".join(_PROPER_NAMES.get(word, word) for word in words)


def effect_signature(effect: str, units: Units) -> str:
    """What an effect, or each of `a + b`, looks like, in words; "" where nothing is known of it.

    Args:
        effect: Name of the effect, or several joined by " + ".
    """
    known = [units.effects[name] for name in effect.split(" + ") if name in units.effects]
    return listed([kind.signature for kind in known if kind.signature])


def places_label(where: Sequence[str], joints: Collection[str], *, most: int | None = None) -> str:
    """Return where an effect acts, in words.

    Args:
        where: Names of joints or bodies; none for the whole robot.
        joints: Names of all joints of the robot.
        most: Largest number of names that are listed; more are counted.

    Returns:
        "all 6 joints", "the whole robot", "5 joints" or the names.
    """
    if not where:
        return "the whole robot"
    if len(joints) > 2 and set(where) == set(joints):
        return f"all {len(joints)} joints"
    if most is not None and len(where) > most:
        return f"{len(where)} {'joints' if set(where) <= set(joints) else 'links'}"
    return listed(where)


def step_place(step: Step, joints: Collection[str], *, most: int | None = None) -> str:
    """Return where a step acts, and when, if that is a part of a log only; see `places_label`."""
    timed = [p for p in step.parameters if any(p.startswith(f"{name}, ") for name in step.where)]
    return listed(timed) if timed else places_label(step.where, joints, most=most)


def parameter_value(step: Step, place: str, name: str, units: Units) -> str:
    """Return a parameter of a step with its standard deviation, in the unit that is shown."""
    value = step.parameters[place].get(name, np.nan)
    deviation = step.deviations.get(place, {}).get(name, np.nan)
    systematic = step.systematic.get(place, {}).get(name, np.nan)
    return estimate(
        *(units.shown(step.effect, name, each) for each in (value, deviation, systematic))
    )


def ordered_places(step: Step) -> list[str]:
    """Return the places of a step's parameters, in the order in which it acts there."""
    rank = {place: i for i, place in enumerate(step.where)}
    return sorted(step.parameters, key=lambda place: rank.get(place, len(rank)))


def step_parameters(step: Step, units: Units) -> tuple[str, ...]:
    """Return the parameters of a step, a line each: values at few places, or their range."""
    values = _by_name(step)
    summary = units.effects[step.effect].summary if step.effect in units.effects else ""
    if summary in values:
        values = {summary: values[summary]}
    return tuple(f"{name} {_amount(step, name, units)}" for name in values)


def finding(step: Step, units: Units) -> str:
    """`payload on wrist_3_link, 3.08 ± 0.04 kg, nrms 0.434 -> 0.048`."""
    words = f"{step.effect} on {step_place(step, units.joints)}"
    values = _by_name(step)
    if "mass" in values or len(values) == 1:
        name = "mass" if "mass" in values else next(iter(values))
        words += f", {_amount(step, name, units)}"
    errors = f"nrms {number(step.error_before)} -> {number(step.error_after)}"
    if not lowers_error(step):
        return f"{words}, though it does not lower the held-out error ({errors})"
    return f"{words}, {errors}"


def found_words(step: FoundStep) -> str:
    """Return a step of a search as it is taken: `payload on flange: nrms 0.703 -> 0.266`."""
    names, more = step.where[:_MOST_PLACES], len(step.where) - _MOST_PLACES
    where = listed([*names, f"{more} more"]) if more > 0 else places_label(names, ())
    what = f"{step.effect or 'without ' + listed(step.instead_of)}"
    if step.where:
        what += f" on {where}"
    if step.effect and step.instead_of:
        what += f", instead of {listed(step.instead_of)}"
    return f"{what}: nrms {number(step.before)} -> {number(step.after)}"


def lowers_error(step: Step) -> bool:
    """Return whether a step lowers the held-out error; an effect that was asked for need not."""
    return step.error_after < step.error_before


def rivals(step: Step, label: bool = False) -> list[str]:
    """Return what stands in a step's place in other explanations: `viscous_friction 3 % (0.0312)`.

    Their probability, and in brackets the nrms that is left with it.
    """
    named = effect_label if label else str
    known = [
        f"{named(rival.effect)} {percent(probability)} ({number(rival.error)})"
        for rival, probability in zip(step.rivals, step.probabilities_of_rivals, strict=True)
        if probability >= _LIKELY
    ]
    return [*known, *_something_unknown(step)]


def short_rivals(step: Step) -> str:
    """Return what may stand in a step's place, in few words: `viscous_friction 3 %`."""
    pairs = zip(step.rivals, step.probabilities_of_rivals, strict=True)
    likely = (f"{r.effect} {percent(share)}" for r, share in pairs if share >= _LIKELY)
    return ", ".join([*likely, *_something_unknown(step)])


def _something_unknown(step: Step) -> list[str]:
    """Return how likely something is that no effect describes, if that is likely at all."""
    chance = step.unknown_probability
    return [f"something unknown {percent(chance)}"] if chance >= _LIKELY else []


def is_summarized(step: Step) -> bool:
    """Return whether `step_parameters` gives ranges over places, not the value at each."""
    return any(len(values) > _MOST_VALUES for values in _by_name(step).values())


def worst_words(start: ErrorTable, end: ErrorTable | None = None, *, unit: str = "N·m") -> str:
    """Return which joint errs most for its effort, at first and at last, in a sentence."""
    if end is None:
        return f"{_worst_joint(start, unit)}."
    return f"at first {_worst_joint(start, unit)}; at last {_worst_joint(end, unit)}."


def _worst_joint(errors: ErrorTable, unit: str) -> str:
    worst = max(errors.joints, key=lambda joint: joint.nrms)
    return f"{worst.joint}, RMS {number(worst.rms)} {unit}, nrms {number(worst.nrms)}"


def explanation_verdict(explanation: Explanation, units: Units) -> str:
    """Return what an explanation amounts to, in a few sentences."""
    end, steps = explanation.end, explanation.steps
    if explanation.verdict == "adequate":
        return f"Adequate: no effect is worth adding; {_noise_alone(end)}."
    if explanation.verdict == "undecided" and not steps:
        return f"Undecided: no effect is worth adding, but {_noise_alone(end)}."
    found = "no effect that geodrake knows takes the error down"
    if len(steps) == 1:
        found = finding(steps[0], units)
    elif steps:
        found = (
            f"{listed([step.effect for step in steps])} take the held-out error from nrms "
            f"{number(steps[0].error_before)} to {number(end.nrms)}"
        )
    if explanation.verdict == "explained":
        return f"Explained: {found}; {_noise_alone(end)}."
    if explanation.verdict == "undecided":
        return f"Undecided: {found}, but {_noise_alone(end)}."
    rest = f"An error is left that nothing explains: {_against_noise(end)}."
    head = "Explained in part" if steps else "Unexplained"
    return f"{head}: {found}. {rest}{_worst(explanation)}{_of_motion(explanation)}"


def draft_advice(explanation: Explanation) -> str:
    """Return what to do where an error is left that nothing explains; else nothing."""
    if explanation.verdict != "unexplained":
        return ""
    return (
        "For a formula of what is left, run geodrake explain with --draft-effect my_effect.py: "
        "that searches what it goes with, and writes the formula as an effect."
    )


def addition_verdict(explanation: Explanation, units: Units) -> str:
    """Return what adding an effect changed, and what is left."""
    found = listed([finding(step, units) for step in explanation.steps]) or "nothing"
    if explanation.verdict != "unexplained":
        return f"Added {found}; {_noise_alone(explanation.end)}."
    left = f"{_against_noise(explanation.end)}.{_worst(explanation)}{_of_motion(explanation)}"
    return f"Added {found}. Left: {left}"


def diagnosis_verdict(diagnosis: Diagnosis, units: Units) -> str:
    """Return what a diagnosis amounts to, in a few sentences."""
    left = diagnosis.refitted
    if not diagnosis.candidates:
        if diagnosis.verdict == "adequate":
            return f"Adequate: nothing is missing; {_noise_alone(left)}."
        if diagnosis.verdict == "undecided":
            return f"Undecided: no effect is worth adding, but {_noise_alone(left)}."
        return (
            "Unexplained: no effect that geodrake knows takes the error down: "
            f"{_against_noise(left)}."
        )
    best = diagnosis.candidates[0]
    words = (
        f"Missing: {best.effect} on {places_label(best.where, units.joints)}; adding it takes the "
        f"held-out nrms from {number(best.error_before)} to {number(best.error_after)}."
    )
    tied = _tied(diagnosis)
    return f"{words} {_instead(tied)}" if tied else words


def comparison_verdict(comparison: Comparison) -> str:
    """Return what a comparison amounts to, in a sentence."""
    errors = comparison.errors
    if not errors.shows_noise:
        return f"{_against_noise(errors)}."
    if errors.is_noise and not errors.knows_noise:
        return f"{_against_noise(errors)}, but {_noise_alone(errors)}."
    return (
        f"{_against_noise(errors)}; a better model could remove "
        f"{percent(removable_share(errors))} of the squared error."
    )


def failing_words(case: Failing) -> str:
    """Return where a joint errs most, in a sentence."""
    return (
        f"{case.joint} errs most {case.circumstance}: RMS {number(case.rms)} {case.unit} "
        f"there, {number(case.elsewhere)} otherwise ({in_words(case.share)} of its squared error "
        f"in {in_words(case.time)} of the samples)."
    )


def failing_list(comparison: Comparison) -> tuple[str, ...]:
    """Where a model fails, in sentences; the worst joint is among them, even if it errs evenly."""
    joints, words = comparison.errors.joints, tuple(map(failing_words, comparison.failing))
    worst = worst_joint(comparison.errors)
    named = {case.joint for case in comparison.failing}
    if len(joints) < 2 or worst.is_noise or worst.joint in named:
        return words
    even = (
        f"{worst.joint} errs most of all joints (nrms {number(worst.nrms)}), and does throughout."
    )
    return (even, *words)


def worst_joint(errors: ErrorTable) -> JointError:
    """The joint of largest error over standard deviation; one that has no number is worst."""
    return max(errors.joints, key=lambda joint: np.nan_to_num(joint.nrms, nan=np.inf))


def correlate_words(found: Correlate) -> str:
    """Return what the error that is left at a joint goes with, in a sentence."""
    return f"{found.joint}: {in_words(found.share)} of what is left goes with {found.words}."


def explained_share(before: float, after: float) -> float:
    """Share of the squared error that goes from one nrms to another; negative if it grows."""
    return 1.0 - (after / before) ** 2 if before > 0 else 0.0


def removable_share(errors: ErrorTable) -> float:
    """Share of the squared error, summed over joints as in nrms, that is not sensor noise.

    NaN where the logs show no noise, as nobody knows then.
    """
    if not errors.shows_noise:
        return math.nan
    return max(0.0, explained_share(errors.nrms, errors.floor_nrms))


def in_words(share: float) -> str:
    """Return a share as it stands in a sentence."""
    return percent(share).replace(">", "more than").replace("<", "less than")


def explanation_mark(explanation: Explanation) -> str:
    """Return the verdict of an explanation in a word or three."""
    if explanation.steps and not any(map(lowers_error, explanation.steps)):
        return "added"
    partly = explanation.verdict == "unexplained" and explanation.steps
    return "explained in part" if partly else explanation.verdict


def explanation_headline(explanation: Explanation) -> str:
    """Return the answer of an explanation in a sentence."""
    if explanation.verdict == "adequate":
        return "The model is adequate: nothing worth adding is missing."
    if not explanation.steps and explanation.verdict == "undecided":
        return _NOT_TOLD
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
    """Return what an explanation means, in paragraphs."""
    start, end = explanation.start, explanation.end
    first = _as_it_stands(start)
    if explanation.steps:
        gone = explained_share(start.nrms, end.nrms)
        what = "this effect" if len(explanation.steps) == 1 else "these effects"
        first += (
            f" With {what} and everything refitted, it errs by {in_words(end.nrms)} on held-out "
            f"data: {in_words(gone) if gone > 0 else 'none'} of the squared error is gone."
        )
    return first, _rest(explanation)


def diagnosis_headline(diagnosis: Diagnosis) -> str:
    """Return the answer of a diagnosis in a sentence."""
    if diagnosis.candidates:
        best = diagnosis.candidates[0]
        joints = [joint.joint for joint in diagnosis.start.joints]
        where = places_label(best.where, joints, most=_MOST_NAMED)
        return f"Missing: {effect_label(best.effect)} ({where})."
    if diagnosis.verdict == "adequate":
        return "The model is adequate: nothing worth adding is missing."
    if diagnosis.verdict == "undecided":
        return _NOT_TOLD
    return "An error is left that no known effect explains."


def diagnosis_lead(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return what a diagnosis means, in paragraphs."""
    first = _as_it_stands(diagnosis.start)
    if not diagnosis.candidates:
        if diagnosis.verdict == "adequate":
            return first, f"What is left is sensor noise.{_noise_level(diagnosis.refitted)}"
        if diagnosis.verdict == "undecided":
            return first, f"{_capitalized(_noise_alone(diagnosis.refitted))}."
        return first, _noise(diagnosis.refitted)
    best, *others = diagnosis.candidates
    gone = explained_share(best.error_before, best.error_after)
    first += (
        f" Adding {effect_label(best.effect)} and refitting takes the error on held-out data to "
        f"{in_words(best.error_after)}: {in_words(gone)} of the squared error goes."
    )
    tied = [effect_label(effect) for effect in _tied(diagnosis)]
    if tied:
        return first, _instead(tied)
    return first, f"No other candidate {'does as well' if others else 'convinces'}."


def comparison_headline(comparison: Comparison) -> str:
    """Return the answer of a comparison in a sentence."""
    errors = comparison.errors
    words = f"The model errs by {in_words(errors.nrms)} of the efforts' standard deviation"
    if not errors.shows_noise:
        return f"{words}; the logs show no sensor noise."
    return f"{words}; sensor noise alone would make {in_words(errors.floor_nrms)}."


def comparison_lead(comparison: Comparison) -> tuple[str, ...]:
    """Return what a comparison means, in paragraphs."""
    errors, worst = comparison.errors, worst_joint(comparison.errors)
    first = (
        f"The error is largest at {worst.joint}: {in_words(worst.nrms)} of the standard deviation "
        "of the effort there."
    )
    if errors.shows_noise:
        share = _at_most(removable_share(errors))
        first = f"A better model could remove {share} of the squared error. {first}"
    return (first, *map(failing_words, comparison.failing[:1]))


def convincing(step: Step) -> bool:
    """Return whether a step lowers held-out errors and outweighs nothing or an unknown."""
    other = step.false_alarm_probability + step.unknown_probability
    return lowers_error(step) and step.probability > other


def removed_share(step: Step) -> str:
    """Return what a step removes of the squared error: "94 %", or that it removes nothing."""
    share = explained_share(step.error_before, step.error_after)
    return percent(share) if share > 0 else f"none ({percent(share)})"


def departure(share: float) -> str:
    """Return how far a simulation departs from the measured motion, as a share of that."""
    if not np.isfinite(share):
        return "more than can be simulated"
    return percent(share) if share < 10 else f"{number(share)} times the whole"


def rollout_fit_words(found: RolloutFit) -> str:
    """Return what a fit of rollouts comes to, in a sentence."""
    before, after = found.held_out
    shares = f"from {departure(before.relative)} to {departure(after.relative)} of the motion"
    if found.taken:
        return (
            f"what was fitted is taken: held-out windows depart less, {shares} (by chance with "
            f"probability {chance(found.chance)})."
        )
    chances = f"probability {chance(found.chance)}, {sum(found.tested)} windows"
    why = f"which chance may do as well ({chances}): further logs or more --windows tell more"
    if after.relative > before.relative:
        why = "which is more"
    return f"the model stays as it was: with what was fitted held-out windows go {shares}, {why}."


def _tied(diagnosis: Diagnosis) -> list[str]:
    """Effects that may stand in the place of the best candidate."""
    best, *others = diagnosis.candidates
    tied = dict.fromkeys(other.effect for other in others if other.tied)
    return [effect for effect in tied if effect != best.effect]


def _instead(effects: Sequence[str]) -> str:
    return f"In its place there may be {listed(effects, 'or')}."


def _amount(step: Step, name: str, units: Units) -> str:
    """Values of one parameter with their unit."""
    values = _by_name(step)[name]
    unit = units.parameter(step.effect, name, next(iter(values)))
    if len(values) > _MOST_VALUES:
        low, high = (number(units.shown(step.effect, name, f(values.values()))) for f in (min, max))
        text = low if low == high else f"{low} … {high}"
    else:
        text = ", ".join(parameter_value(step, place, name, units) for place in values)
    return f"{text} {unit}" if unit else text


def _by_name(step: Step) -> Mapping[str, Mapping[str, float]]:
    """Parameter name -> place -> value, places in the order of the step."""
    values: dict[str, dict[str, float]] = {}
    for place in ordered_places(step):
        for name, value in step.parameters[place].items():
            values.setdefault(name, {})[place] = value
    return values


def _against_noise(errors: ErrorTable) -> str:
    """Return how an error compares with the noise floor."""
    nrms, floor = errors.nrms, errors.floor_nrms
    if not errors.shows_noise:
        return f"nrms {number(nrms)}, without measurable sensor noise"
    words = f"nrms {number(nrms)}, {number(nrms / floor)} times the sensor noise of {number(floor)}"
    beyond = [
        f"{joint.joint} errs by {number(joint.rms / joint.floor)} times its own"
        for joint in errors.above_noise
        if joint.floor > 0
    ]
    # Where the whole is noise, those joints are why the verdict is another one.
    return f"{words}, and {listed(beyond)}" if beyond and errors.whole_is_noise else words


def _noise_alone(errors: ErrorTable) -> str:
    """That an error is no larger than the noise floor, or hardly, or that this cannot be told."""
    if errors.is_mostly_noise:
        return (
            f"noise is as large as what the model explains (its nrms is "
            f"{number(errors.floor_nrms)}), so that nothing can be told"
        )
    if not errors.knows_noise:
        joints = listed([joint.joint for joint in errors.joints if not joint.knows_noise])
        return (
            f"the noise of {joints} is not known apart from what the model leaves (nrms "
            f"{number(errors.nrms)}), so that more may be missing: efforts were filtered before, "
            "or their noise is not white"
        )
    return (
        f"what is left, nrms {number(errors.nrms)}, is sensor noise ({number(errors.floor_nrms)})"
    )


def _capitalized(words: str) -> str:
    return words[:1].upper() + words[1:]


def _worst(explanation: Explanation) -> str:
    """Return where the final model errs most, as a sentence after a space."""
    failing = explanation.after.failing
    return f" {failing_words(failing[0])}" if failing else ""


def _at_most(share: float) -> str:
    if share <= 0:
        return "none"
    return "nearly all" if share >= _NEARLY_ALL else f"up to {in_words(share)}"


def _as_it_stands(start: ErrorTable) -> str:
    return (
        f"As it stands, the model errs by {in_words(start.nrms)} of the standard deviation of the "
        f"measured efforts (nrms {number(start.nrms)})."
    )


def _rest(explanation: Explanation) -> str:
    """Return what is left at the end of an explanation."""
    if explanation.verdict == "adequate":
        return f"What is left is sensor noise.{_noise_level(explanation.end)}"
    if explanation.verdict == "undecided":
        return f"{_capitalized(_noise_alone(explanation.end))}."
    if explanation.verdict == "explained":
        return f"With that, only sensor noise is left.{_noise_level(explanation.end)}"
    left = "An error above the noise is left. " if explanation.steps else ""
    return f"{left}{_noise(explanation.end)}{_worst(explanation)}{_of_motion(explanation)}"


def _of_motion(explanation: Explanation) -> str:
    """Return how much of what is left goes with the motion, as a sentence after a space."""
    shares = sorted(explanation.of_motion.items(), key=lambda joint: -joint[1])
    if not shares:
        return ""
    notable = [f"{percent(share)} at {joint}" for joint, share in shares if share >= _NOTABLE]
    if not notable:
        return (
            " No smooth function of positions and velocities predicts a notable part of it: it is "
            "coloured noise, or depends on something else."
        )
    shown, more = notable[:_MOST_NAMED], len(notable) - _MOST_NAMED
    shown += [f"less at {more} more"] if more > 0 else []
    return (
        " Some function of positions and velocities could remove of the squared error that is left "
        f"{listed(shown)}."
    )


def _noise_level(errors: ErrorTable) -> str:
    """What noise alone makes, as a sentence after a space, where all that is left is noise."""
    if not errors.shows_noise:
        return ""
    return f" Sensor noise alone would make {in_words(errors.floor_nrms)}."


def _noise(errors: ErrorTable) -> str:
    if not errors.shows_noise:
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
        f"({step_place(group[0], joints, most=_MOST_NAMED)})"
        for group in groups
    )
