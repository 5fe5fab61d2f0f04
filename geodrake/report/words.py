"""Sentences about results, and labels of effects, parameters and places."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from geodrake.boundary.escaping import printable
from geodrake.diagnosis.drafting import Correlate
from geodrake.diagnosis.results import Diagnosis, Explanation, Step
from geodrake.diagnosis.search_progress import FoundStep
from geodrake.effects import catalogue
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, Failing, JointError
from geodrake.report.numbers import Units, estimate, number, percent

MOST_NAMED = 4
_MOST_VALUES = 2  # places whose values are listed one by one
_LIKELY = 0.01  # least probability of a rival that is named
_NEARLY_ALL = 0.9995
_NOTABLE = 0.05  # share of a joint's remaining squared error that its motion predicts
_MOST_PLACES = 3
_PRACTICAL = 1.5  # multiple of the noise that still counts as noise in practice
_PROPER_NAMES = {"coulomb": "Coulomb", "stribeck": "Stribeck", "com": "CoM"}
NOTHING = {
    "adequate": "No effect is worth adding.",
    "undecided": "No effect is worth adding; the logs cannot tell whether one is missing.",
    "unexplained": "No known effect explains the error.",
}


def listed(names: Sequence[str], last: str = "and") -> str:
    """Return `a`, `a and b`, `a, b and c`."""
    head, tail = ", ".join(names[:-1]), "".join(names[-1:])
    return f"{head} {last} {tail}" if head else tail


def capitalized(words: str) -> str:
    """Return words with a capital first letter."""
    return words[:1].upper() + words[1:]


def in_words(share: float) -> str:
    """Return a share in percent, for use in a sentence."""
    return percent(share).replace(">", "more than").replace("<", "less than")


def effect_label(name: str) -> str:
    """Return the name of an effect or a parameter in words, such as "Coulomb friction"."""
    labels = {effect.name: effect.label for effect in catalogue() if effect.label}
    parts = [labels.get(part) or printable(part).replace("_", " ") for part in name.split(" + ")]
    return " ".join(_PROPER_NAMES.get(word, word) for word in " + ".join(parts).split(" "))


def places_label(where: Sequence[str], joints: Collection[str], *, most: int | None = None) -> str:
    """Return the places of an effect, such as "a and b", "5 of 6 joints" or "the whole robot".

    `joints` are all at which it may act. More than `most` places are counted rather than named.
    """
    if not where:
        return "the whole robot"
    if len(joints) > 2 and set(where) == set(joints):
        return f"all {len(joints)} joints"
    if most is not None and len(where) > most:
        named = set(where) <= set(joints)
        return f"{len(where)} of {len(joints)} joints" if named else f"{len(where)} links"
    return listed(where)


def step_place(step: Step, joints: Collection[str], *, most: int | None = None) -> str:
    """Return the places of a step, with times if it acts in part of a log; see `places_label`."""
    timed = [p for p in step.parameters if any(p.startswith(f"{name}, ") for name in step.where)]
    return listed(timed) if timed else places_label(step.where, joints, most=most)


def parameter_value(step: Step, place: str, name: str, units: Units) -> str:
    """Return a parameter of a step with its standard deviation, in the displayed unit."""
    tables = step.parameters, step.deviations, step.systematic
    values = (table.get(place, {}).get(name, np.nan) for table in tables)
    return estimate(*(units.shown(step.effect, name, value) for value in values))


def ordered_places(step: Step) -> list[str]:
    """Return the places of a step's parameters, in the order of the step."""
    rank = {place: i for i, place in enumerate(step.where)}
    return sorted(step.parameters, key=lambda place: rank.get(place, len(rank)))


def step_parameters(step: Step, units: Units) -> tuple[str, ...]:
    """Return a line for each parameter of a step: its values at few places, or their range."""
    values = _by_name(step)
    summary = units.effects[step.effect].summary if step.effect in units.effects else ""
    if summary in values:
        values = {summary: values[summary]}
    return tuple(f"{name} {_amount(step, name, units)}" for name in values)


def is_summarized(step: Step) -> bool:
    """Return whether `step_parameters` gives ranges over places, not the value at each."""
    return any(len(values) > _MOST_VALUES for values in _by_name(step).values())


def _amount(step: Step, name: str, units: Units) -> str:
    """Return values of one parameter with their unit."""
    values = _by_name(step)[name]
    unit = units.parameter(step.effect, name, next(iter(values)))
    if len(values) > _MOST_VALUES:
        rounding = 1e-9 * max(map(abs, values.values()))  # at a bound
        known = [0.0 if abs(value) <= rounding else value for value in values.values()]
        low, high = (number(units.shown(step.effect, name, end(known))) for end in (min, max))
        text = low if low == high else f"{low} … {high}"
    else:
        text = ", ".join(parameter_value(step, place, name, units) for place in values)
    return f"{text} {unit}" if unit else text


def _by_name(step: Step) -> Mapping[str, Mapping[str, float]]:
    """Return parameter name -> place -> value, places in the order of the step."""
    values: dict[str, dict[str, float]] = {}
    for place in ordered_places(step):
        for name, value in step.parameters[place].items():
            values.setdefault(name, {})[place] = value
    return values


def finding(step: Step, units: Units) -> str:
    """Return the finding of a step, such as `payload (wrist_3_link, 3.08 ± 0.04 kg)`."""
    words, values = step_place(step, units.driven, most=MOST_NAMED), _by_name(step)
    name = "mass" if "mass" in values else next(iter(values), "")
    if name == "mass" or (len(values) == 1 and not is_summarized(step)):
        words += f", {_amount(step, name, units)}"
    return f"{effect_label(step.effect)} ({words})"


def found_words(step: FoundStep) -> str:
    """Return a step of the search: `payload on flange: nrms 0.703 -> 0.266`."""
    names, more = step.where[:_MOST_PLACES], len(step.where) - _MOST_PLACES
    where = listed([*names, f"{more} more"]) if more > 0 else places_label(names, ())
    change = step.effect or f"without {listed(step.instead_of)}"
    if step.where:
        change += f" on {where}"
    if step.effect and step.instead_of:
        change += f", instead of {listed(step.instead_of)}"
    return f"{change}: nrms {number(step.before)} -> {number(step.after)}"


def lowers_error(step: Step) -> bool:
    """Return whether a step lowers the held-out error; a requested effect need not."""
    return step.error_after < step.error_before


def is_convincing(step: Step) -> bool:
    """Return whether a step lowers held-out errors and is more probable than none or unknown."""
    doubt = step.false_alarm_probability + step.unknown_probability
    return lowers_error(step) and step.probability > doubt


def rivals(step: Step) -> str:
    """Return the rivals of a step with their probabilities: `viscous friction 3 %`."""
    likely = []
    for rival, share in zip(step.rivals, step.probabilities_of_rivals, strict=True):
        where = f" at {listed(rival.where)}" if rival.effect == step.effect and rival.where else ""
        if share >= _LIKELY:
            likely.append(f"{effect_label(rival.effect)}{where} {percent(share)}")
    if step.unknown_probability >= _LIKELY:
        likely.append(f"something unknown {percent(step.unknown_probability)}")
    return ", ".join(likely)


def worst_joint(errors: ErrorTable) -> JointError:
    """Return the joint of largest nrms; NaN counts as the largest."""
    return max(errors.joints, key=lambda joint: np.nan_to_num(joint.nrms, nan=np.inf))


def failing_words(case: Failing) -> str:
    """Return where the error of a joint is largest, in a sentence."""
    return (
        f"{case.joint}: largest {case.circumstance}, RMS {number(case.rms)} {case.unit} there and "
        f"{number(case.elsewhere)} elsewhere ({in_words(case.share)} of the squared error in "
        f"{in_words(case.time)} of the samples)."
    )


def failing_list(comparison: Comparison) -> tuple[str, ...]:
    """Return where a model fails, in sentences that always include the worst joint."""
    words = tuple(map(failing_words, comparison.failing))
    worst = worst_joint(comparison.errors)
    named = {case.joint for case in comparison.failing}
    if len(comparison.errors.joints) < 2 or worst.is_noise or worst.joint in named:
        return words
    nrms = number(worst.nrms)
    return (f"{worst.joint}: the largest nrms of all joints ({nrms}), throughout.", *words)


def correlate_words(found: Correlate) -> str:
    """Return a correlate of a joint's remaining error, in a sentence."""
    return (
        f"{found.joint}: {in_words(found.share)} of the remaining error varies with {found.words}."
    )


def explained_share(before: float, after: float) -> float:
    """Return the share of the squared error that a change of nrms removes; negative if it grows."""
    return 1.0 - (after / before) ** 2 if before > 0 else 0.0


def removable_share(errors: ErrorTable) -> float:
    """Return the share of the squared error, summed as in nrms, that is not sensor noise.

    NaN where the logs show no noise.
    """
    if not errors.shows_noise:
        return math.nan
    return max(0.0, explained_share(errors.nrms, errors.floor_nrms))


def explanation_mark(explanation: Explanation, *, added: bool = False) -> str:
    """Return the verdict of an explanation in a few words."""
    end, steps = explanation.end, explanation.steps
    if added or (steps and not any(map(lowers_error, steps))):
        return "added"
    if explanation.verdict != "unexplained" or not steps:
        return explanation.verdict
    is_practical = end.shows_noise and end.nrms <= _PRACTICAL * end.floor_nrms
    return "explained to practical noise" if is_practical else "explained in part"


def explanation_headline(explanation: Explanation, units: Units, *, added: bool = False) -> str:
    """Return the answer of an explanation in a sentence or two."""
    steps = explanation.steps
    if not steps:
        return NOTHING[explanation.verdict]
    if added:
        return f"Added: {listed([finding(step, units) for step in steps])}."
    certain = [step for step in steps if is_convincing(step)]
    doubtful = [step for step in steps if not is_convincing(step)]
    parts = [f"Missing: {_findings(certain, units)}."] if certain else []
    if doubtful:
        parts.append(f"Less certain: {_findings(doubtful, units)}.")
    return " ".join(parts)


def _findings(steps: Sequence[Step], units: Units) -> str:
    """Return effects with their places, or without them if that would be long."""
    groups: dict[tuple[str, ...], list[Step]] = {}
    for step in steps:
        groups.setdefault(step.where, []).append(step)
    if len(groups) > _MOST_PLACES:
        return listed([effect_label(step.effect) for step in steps])
    return "; ".join(
        finding(group[0], units)
        if len(group) == 1
        else f"{listed([effect_label(step.effect) for step in group])} "
        f"({step_place(group[0], units.driven, most=MOST_NAMED)})"
        for group in groups.values()
    )


def explanation_lead(explanation: Explanation, *, advised: bool) -> tuple[str, ...]:
    """Return paragraphs that interpret an explanation, with advice on the remaining error."""
    start, end = explanation.start, explanation.end
    if not explanation.steps:
        first = f"The error of the model as it stands is {error_size(start)}."
    else:
        first = f"{_nrms_change(start.nrms, end.nrms)}."
        worse = [step for step in explanation.steps if not lowers_error(step)]
        if worse:
            names = listed([effect_label(step.effect) for step in worse])
            ends = f"nrms {number(worse[0].error_before)} -> {number(worse[0].error_after)}"
            first += f" {capitalized(names)} did not lower it ({ends})."
    if explanation.is_interrupted:
        first += " The search was interrupted: more may be missing."
    if explanation.verdict != "unexplained":
        return first, f"{capitalized(_error_cause(explanation))}."
    advice = "--draft-effect my_effect.py searches for a formula of the remaining error."
    rest = " ".join((*_remaining_error(end), *_motion_shares(explanation)))
    return (first, rest, advice) if advised else (first, rest)


def _error_cause(explanation: Explanation) -> str:
    """Return the cause of the remaining error if no effect is missing."""
    end, calibrated = explanation.end, explanation.at_found_gains
    if end.is_noise or explanation.verdict == "undecided":
        return noise_alone(end)
    error = f"the remaining error, nrms {number(end.nrms)}, comes from"
    noise = f"sensor noise is {number(end.floor_nrms)}"
    if calibrated is not None and calibrated.is_noise:
        fitted = f"with gains fitted to the logs it is {number(calibrated.nrms)}"
        return f"{error} the effort gains: {fitted}; {noise}"
    gains = "" if calibrated is None else ", and from the effort gains"
    return f"{error} reversals, where the logs do not show the direction of motion{gains}; {noise}"


def _nrms_change(before: float, after: float) -> str:
    """Return the change of an error on held-out data, in words."""
    removed = explained_share(before, after)
    share = in_words(removed) if removed > 0 else "none"
    return (
        f"nrms on held-out data {number(before)} → {number(after)} ({share} of the squared error "
        "removed)"
    )


def _remaining_error(end: ErrorTable) -> tuple[str, ...]:
    if not end.shows_noise:
        return ("The logs show no noise to compare the remaining error with.",)
    return (
        f"The remaining error is {_times(end)}; a better model could remove "
        f"{_at_most(removable_share(end))} of its square.",
    )


def _motion_shares(explanation: Explanation) -> tuple[str, ...]:
    """Return the shares of the remaining error that the motion predicts, in a sentence."""
    shares = sorted(explanation.of_motion.items(), key=lambda joint: -joint[1])
    if not shares:
        return ()
    notable = [f"{percent(share)} at {joint}" for joint, share in shares if share >= _NOTABLE]
    if not notable:
        return (
            f"Positions and velocities predict less than {percent(_NOTABLE)} of it: it is coloured "
            "noise, or depends on something else, such as temperature or time.",
        )
    shown, more = notable[:MOST_NAMED], len(notable) - MOST_NAMED
    shown += [f"less at {more} more"] if more > 0 else []
    return (f"Positions and velocities predict {listed(shown)}.",)


def diagnosis_lead(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return paragraphs that interpret a diagnosis."""
    if not diagnosis.candidates:
        first = f"The error of the model as it stands is {error_size(diagnosis.start)}."
        if diagnosis.verdict != "unexplained":
            return first, f"{capitalized(noise_alone(diagnosis.refitted))}."
        return (first, *_remaining_error(diagnosis.refitted))
    best, *others = diagnosis.candidates
    first = f"With it, {_nrms_change(best.error_before, best.error_after)}."
    tied = [effect_label(e) for e in dict.fromkeys(o.effect for o in others if o.tied)]
    tied = [effect for effect in tied if effect != effect_label(best.effect)]
    if tied:
        return first, f"It may be {listed(tied, 'or')} instead."
    return first, f"No other candidate {'does as well' if others else 'is convincing'}."


def comparison_lead(comparison: Comparison) -> tuple[str, ...]:
    """Return paragraphs that interpret a comparison."""
    errors, worst = comparison.errors, worst_joint(comparison.errors)
    first = f"The worst joint is {worst.joint} (nrms {number(worst.nrms)})."
    if errors.shows_noise and not errors.knows_noise and errors.is_noise:
        first = f"{capitalized(noise_alone(errors))}. {first}"
    elif errors.shows_noise:
        share = _at_most(removable_share(errors))
        first = f"A better model could remove {share} of the squared error. {first}"
    return (first,)


def error_size(errors: ErrorTable) -> str:
    """Return the size of an error relative to the efforts and to the noise."""
    words = (
        f"{in_words(errors.nrms)} of the standard deviation of the measured efforts "
        f"(nrms {number(errors.nrms)})"
    )
    return (
        f"{words}, {_times(errors)}" if errors.shows_noise else f"{words}; the logs show no noise"
    )


def _times(errors: ErrorTable) -> str:
    """Return an error as a multiple of the noise, and the joints that stand out."""
    words = f"{number(errors.nrms / errors.floor_nrms)} times the sensor noise"
    words += f" ({number(errors.floor_nrms)})"
    outliers = [
        f"{joint.joint} {number(joint.rms / joint.floor)} times its own"
        for joint in errors.above_noise
        if joint.floor > 0
    ]
    # If the total is noise, these joints alone account for the verdict.
    return f"{words}, at {listed(outliers)}" if outliers and errors.whole_is_noise else words


def noise_alone(errors: ErrorTable) -> str:
    """Return the statement that an error is noise, or that the noise is too large or unknown."""
    if errors.is_mostly_noise:
        return (
            f"the sensor noise (nrms {number(errors.floor_nrms)}) is as large as the explained "
            "effort, so nothing can be concluded"
        )
    if not errors.knows_noise:
        joints = listed([joint.joint for joint in errors.joints if not joint.knows_noise])
        return (
            f"the noise of {joints} cannot be separated from the model error (nrms "
            f"{number(errors.nrms)}), so more may be missing: efforts were filtered before, or "
            "their noise is not white"
        )
    nrms, floor = number(errors.nrms), number(errors.floor_nrms)
    return f"the remaining error, nrms {nrms}, is sensor noise ({floor})"


def _at_most(share: float) -> str:
    if share <= 0:
        return "none"
    return "nearly all" if share >= _NEARLY_ALL else f"up to {in_words(share)}"
