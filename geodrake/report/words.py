"""Sentences about results, and labels of effects, parameters and places."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from geodrake.boundary.escaping import printable
from geodrake.diagnosis.results import Diagnosis, Explanation, Step
from geodrake.diagnosis.search_progress import FoundStep
from geodrake.effects import catalogue
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, JointError
from geodrake.report.numbers import Units, estimate, number, percent

MOST_NAMED = 4
_MOST_VALUES = 2  # places whose values are listed rather than summarized as a range
_LIKELY = 0.01  # least probability of a rival that is named
_NOTABLE = 0.05  # share of a joint's remaining squared error that its motion predicts
_MOST_PLACES = 3
_PRACTICAL = 1.5  # multiple of the noise that still counts as noise in practice
_PROPER_NAMES = {"coulomb": "Coulomb", "stribeck": "Stribeck", "com": "CoM"}
NOTHING = {
    "adequate": "Adequate. No effect is worth adding.",
    "undecided": "Undecided. The logs cannot tell whether an effect is missing.",
    "unexplained": "Unexplained. No known effect explains the error.",
}
NRMS = "nrms is the RMS error / standard deviation of the measured effort"


def listed(names: Sequence[str], last: str = "and") -> str:
    """Return `a`, `a and b`, `a, b and c`."""
    head, tail = ", ".join(names[:-1]), "".join(names[-1:])
    return f"{head} {last} {tail}" if head else tail


def capitalized(words: str) -> str:
    """Return words with a capital first letter."""
    return words[:1].upper() + words[1:]


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
    """Return a line for each parameter of a step: its value, or its values at several places.

    A deviation includes the systematic one. Shapes that no search varies are omitted, and so are
    names that the effect's name contains.
    """
    values, effect = _by_name(step), units.effects.get(step.effect)
    known = {name for table in step.deviations.values() for name in table if table[name] > 0}
    if effect is not None:
        known |= {shape.name for shape in effect.shapes if shape.is_searched}
    if effect is not None and effect.summary in values:
        known = {effect.summary}
    values = {name: values[name] for name in values if name in known} or values
    is_clear = {name: len(values) == 1 or name in step.effect for name in values}
    return tuple(
        _amount(step, name, units) if is_clear[name] else f"{name} {_amount(step, name, units)}"
        for name in values
    )


def _amount(step: Step, name: str, units: Units) -> str:
    """Return values of one parameter with their unit."""
    values = _by_name(step)[name]
    unit = units.parameter(step.effect, name, next(iter(values)))
    rounding = 1e-9 * max(map(abs, values.values()))  # at a bound
    known = [0.0 if abs(value) <= rounding else value for value in values.values()]
    if len(values) == 1:
        (place,) = values
        tables = step.deviations, step.systematic
        deviation, systematic = (t.get(place, {}).get(name, np.nan) for t in tables)
        total = math.hypot(deviation, systematic if math.isfinite(systematic) else 0.0)
        text = estimate(*(units.shown(step.effect, name, x) for x in (values[place], total)))
    elif len(values) <= _MOST_VALUES:
        text = ", ".join(number(units.shown(step.effect, name, value)) for value in known)
    else:
        low, high = (number(units.shown(step.effect, name, end(known))) for end in (min, max))
        text = low if low == high else f"{low} … {high}"
    return f"{text} {unit}" if unit else text


def _by_name(step: Step) -> Mapping[str, Mapping[str, float]]:
    """Return parameter name -> place -> value, places in the order of the step."""
    values: dict[str, dict[str, float]] = {}
    for place in ordered_places(step):
        for name, value in step.parameters[place].items():
            values.setdefault(name, {})[place] = value
    return values


def finding(step: Step, units: Units) -> str:
    """Return the finding of a step, such as `payload (wrist_3_link)`."""
    place = step_place(step, units.driven, most=MOST_NAMED)
    return f"{effect_label(step.effect)} ({place})"


def found_words(step: FoundStep) -> str:
    """Return a step of the search and the error after it: `payload on flange: nrms 0.266`."""
    names, more = step.where[:_MOST_PLACES], len(step.where) - _MOST_PLACES
    where = listed([*names, f"{more} more"]) if more > 0 else places_label(names, ())
    change = step.effect or f"without {listed(step.instead_of)}"
    if step.where:
        change += f" on {where}"
    if step.effect and step.instead_of:
        change += f", instead of {listed(step.instead_of)}"
    return f"{change}: nrms {number(step.after)}"


def lowers_error(step: Step) -> bool:
    """Return whether a step lowers the held-out error; a requested effect need not."""
    return step.error_after < step.error_before


def is_convincing(step: Step) -> bool:
    """Return whether a step lowers held-out errors and is more probable than none or unknown."""
    doubt = step.false_alarm_probability + step.unknown_probability
    return lowers_error(step) and step.probability > doubt


def has_rivals(step: Step) -> bool:
    """Return whether a step has a named rival, or is less probable than something unknown."""
    is_doubtful = step.unknown_probability > step.probability
    return is_doubtful or any(share >= _LIKELY for share in step.probabilities_of_rivals)


def rivals(step: Step) -> str:
    """Return what may be in place of a step, with probabilities: `viscous friction 3 %`."""
    likely = []
    for rival, share in zip(step.rivals, step.probabilities_of_rivals, strict=True):
        where = f" at {listed(rival.where)}" if rival.effect == step.effect and rival.where else ""
        if share >= _LIKELY:
            likely.append(f"{effect_label(rival.effect)}{where} {percent(share)}")
    if step.unknown_probability >= _LIKELY:
        likely.append(f"something unknown {percent(step.unknown_probability)}")
    return listed(likely, "or")


def worst_joint(errors: ErrorTable) -> JointError:
    """Return the joint of largest nrms; NaN counts as the largest."""
    return max(errors.joints, key=lambda joint: np.nan_to_num(joint.nrms, nan=np.inf))


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


def explanation_headline(explanation: Explanation, *, added: bool = False) -> str:
    """Return the verdict on an explanation and the change of its error, in a short sentence."""
    start, end, steps = explanation.start, explanation.end, explanation.steps
    if not steps:
        return NOTHING[explanation.verdict]
    mark: str = explanation.verdict
    if added or not any(map(lowers_error, steps)):
        mark = "added"
    elif mark == "unexplained":
        is_practical = end.shows_noise and end.nrms <= _PRACTICAL * end.floor_nrms
        mark = "explained to practical noise" if is_practical else "explained in part"
    return f"{capitalized(mark)}, {nrms_change(start.nrms, end.nrms)}."


def _findings(steps: Sequence[Step], units: Units) -> str:
    """Return effects; one that is alone, or named twice, with its place."""
    names = [step.effect for step in steps]
    return ", ".join(
        finding(step, units)
        if len(steps) == 1 or names.count(step.effect) > 1
        else effect_label(step.effect)
        for step in steps
    )


def _doubtful(step: Step, units: Units) -> str:
    """Return a finding with its probability, and what is more probable."""
    others = (
        (step.unknown_probability, "something unknown"),
        (step.false_alarm_probability, "nothing"),
    )
    share, other = max(others)
    likelier = f" ({other} is more likely)" if share > step.probability else ""
    return f"{finding(step, units)}, {percent(step.probability)}{likelier}"


def explanation_facts(
    explanation: Explanation, units: Units, *, added: bool, advised: bool
) -> dict[str, str]:
    """Return the findings, what is left, and advice on it."""
    steps = explanation.steps
    certain = [step for step in steps if added or is_convincing(step)]
    worse = [
        f"{effect_label(step.effect)} (nrms {number(step.error_before)} → "
        f"{number(step.error_after)})"
        for step in steps
        if not lowers_error(step)
    ]
    facts = {
        "Effect" if added else "Missing": _findings(certain, units),
        "Less certain": "; ".join(_doubtful(step, units) for step in steps if step not in certain),
        "Did not help": listed(worse),
        "Interrupted": "more may be missing" * explanation.is_interrupted,
    }
    if explanation.verdict != "unexplained":
        facts["Remaining error"] = _error_cause(
            explanation.verdict, explanation.end, explanation.at_found_gains
        )
    else:
        facts["Remaining error"] = error_size(explanation.end)
        facts["Depends on"] = _motion_shares(explanation)
        facts["Next"] = (
            "--draft-effect my_effect.py searches for a formula of the remaining error" * advised
        )
    return facts


def _error_cause(verdict: str, end: ErrorTable, calibrated: ErrorTable | None) -> str:
    """Return the cause of an error if no effect is missing, and what it is at found gains."""
    if end.is_noise or verdict == "undecided":
        return noise_alone(end)
    if calibrated is not None and calibrated.is_noise:
        fitted = f"nrms {number(calibrated.nrms)} with gains fitted to the logs"
        return f"{error_size(end)}, from the effort gains ({fitted})"
    gains = "" if calibrated is None else ", and from the effort gains"
    return (
        f"{error_size(end)}, from reversals, where the logs do not show the direction of "
        f"motion{gains}"
    )


def nrms_change(before: float, after: float) -> str:
    """Return the change of an error on held-out data."""
    return f"nrms {number(before)} → {number(after)} on held-out data"


def _motion_shares(explanation: Explanation) -> str:
    """Return the shares of the remaining error that the motion predicts."""
    shares = sorted(explanation.of_motion.items(), key=lambda joint: -joint[1])
    if not shares:
        return ""
    notable = [f"{percent(share)} at {joint}" for joint, share in shares if share >= _NOTABLE]
    if not notable:
        return "neither positions nor velocities; perhaps temperature or time, or coloured noise"
    shown, more = notable[:MOST_NAMED], len(notable) - MOST_NAMED
    shown += [f"less at {more} more"] if more > 0 else []
    return f"positions and velocities, {listed(shown)}"


def diagnosis_facts(diagnosis: Diagnosis) -> dict[str, str]:
    """Return the error of the best candidate and its alternatives, or what is left."""
    if not diagnosis.candidates:
        verdict, left = diagnosis.verdict, diagnosis.refitted
        if verdict == "unexplained":
            return {"Remaining error": error_size(left)}
        return {"Remaining error": _error_cause(verdict, left, diagnosis.at_found_gains)}
    best, *others = diagnosis.candidates
    tied = [effect_label(e) for e in dict.fromkeys(o.effect for o in others if o.tied)]
    return {
        "Error with it": nrms_change(best.error_before, best.error_after),
        "Alternatives": listed([e for e in tied if e != effect_label(best.effect)], "or"),
        "Next": "geodrake explain finds all that is missing",
    }


def comparison_facts(comparison: Comparison) -> dict[str, str]:
    """Return the noise, the worst joint, and advice."""
    errors, worst = comparison.errors, worst_joint(comparison.errors)
    is_doubtful = errors.shows_noise and not errors.knows_noise and errors.is_noise
    return {
        "Noise": noise_alone(errors) if is_doubtful else "",
        "Worst joint": f"{worst.joint} (nrms {number(worst.nrms)})",
        "Next": "geodrake explain finds what is missing" * (not errors.is_noise),
    }


def error_size(errors: ErrorTable) -> str:
    """Return an error as a multiple of the noise, with the joints that stand out."""
    nrms = f"nrms {number(errors.nrms)}"
    if not errors.shows_noise:
        return f"{nrms}; the logs show no noise"
    ratio, floor = number(errors.nrms / errors.floor_nrms), number(errors.floor_nrms)
    size = f"{ratio} times the sensor noise ({nrms}, noise floor {floor})"
    outliers = [
        f"{joint.joint} {number(joint.rms / joint.floor)} times its own"
        for joint in errors.above_noise
        if joint.floor > 0
    ]
    # If the total is noise, these joints alone account for the verdict.
    return f"{size}; {listed(outliers)}" if outliers and errors.whole_is_noise else size


def noise_alone(errors: ErrorTable) -> str:
    """Return the statement that an error is noise, or that the noise is too large or unknown."""
    if errors.is_mostly_noise:
        return (
            f"unknown: the sensor noise (nrms {number(errors.floor_nrms)}) is as large as the "
            "explained effort"
        )
    if not errors.knows_noise:
        joints = listed([joint.joint for joint in errors.joints if not joint.knows_noise])
        return (
            f"nrms {number(errors.nrms)}, inseparable from the noise of {joints}: efforts were "
            "filtered before, or their noise is not white"
        )
    return f"sensor noise (nrms {number(errors.nrms)}, noise floor {number(errors.floor_nrms)})"
