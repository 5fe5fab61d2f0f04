"""Sections of reports: tables of steps, parameters, joints and candidates, and remarks."""

from __future__ import annotations

import math
from collections.abc import Sequence

from geodrake.diagnosis.ambiguity import telling_commands
from geodrake.diagnosis.results import (
    Candidate,
    Comparison,
    Diagnosis,
    ErrorTable,
    Explanation,
    Step,
)
from geodrake.visualization.numbers import UNKNOWN, chance, number, percent, with_deviation
from geodrake.visualization.page import Cell, Section, Table, cells
from geodrake.visualization.units import Units, effect_label, listed, places_label
from geodrake.visualization.words import removable_share, step_sentence

_MILLISECONDS = 1e3


def steps_section(explanation: Explanation, units: Units) -> Section:
    """The steps: effect, where, error before and after, rivals, chance of a false alarm."""
    joints = [joint.joint for joint in explanation.start.joints]
    head = (
        "", "missing effect", "where", "cannot be told from", "nrms before", "after",
        "squared error gone", "blocks better", "false alarm",
    )  # fmt: skip
    rows = [
        cells(
            str(count),
            Cell(effect_label(step.effect), units.signature(step.effect)),
            places_label(step.where, joints),
            ", ".join(_rivals(step)) or UNKNOWN,
            number(step.error_before),
            number(step.error_after),
            step_sentence(step),
            percent(step.agreement),
            chance(step.false_alarm_probability),
        )
        for count, step in enumerate(explanation.steps, 1)
    ]
    if not rows:
        text = "No effect takes away enough of the error on held-out data to be believed."
        return Section("What is missing", (text,))
    text = (
        "Effects in the order of what they take away. After each, everything that may move was "
        "refitted. Blocks better is the share of the stretches of data held out from the fit in "
        "which the error falls where the effect acts: a finding to rely on lowers it in most. The "
        "false alarm is the chance that an effect that is not there gains as much."
    )
    if any(step.rivals for step in explanation.steps):
        text += (
            " Beside what an effect cannot be told from stands the nrms with that in its place, "
            "against the one with the effect itself when it was chosen."
        )
    table = Table(head, tuple(rows), words=4)
    return Section("What is missing", (text, *telling(explanation)), (table,))


def _rivals(step: Step) -> list[str]:
    """What a step cannot be told from, with the nrms instead of its own where both are known."""
    fitted = [
        f"{effect_label(rival.effect)} ({number(rival.error)} against "
        f"{number(rival.error_of_choice)})"
        for rival in step.rivals
    ]
    return [*fitted, *map(effect_label, step.unfitted_rivals)]


def parameters_section(explanation: Explanation, units: Units) -> Section:
    """The parameters that were found, with their standard deviations and units."""
    tables = [_parameters(step, units) for step in explanation.steps if step.parameters]
    text = ("Value ± standard deviation, where the fit knows one.",) if tables else ()
    return Section("Parameters found", text, tuple(tables), abreast=True)


def joints_section(start: ErrorTable, end: ErrorTable | None, units: Units) -> Section:
    """Errors of every joint: as it stands, at the end, the noise floor, the share removable.

    Args:
        start: Errors of the model as it stands.
        end: Those of the final model, if there is one.
        units: Units of the joints.
    """
    last = end or start
    unit = units.effort([joint.joint for joint in start.joints])
    mixed = " or " in unit
    ends = ("end",) if end else ()
    head = (
        "joint", "std", *(("start", *ends) if end else ("RMS error",)), "sensor noise", "nrms",
        "removable",
    )  # fmt: skip
    rows = []
    for before, after in zip(start.joints, last.joints, strict=True):
        name = f"{after.joint}, {units.effort([after.joint])}" if mixed else after.joint
        rows.append(
            cells(
                name,
                number(after.std),
                *(number(joint.rms) for joint in ((before, after) if end else (after,))),
                number(after.floor),
                number(after.nrms),
                Cell(percent(after.removable), bar=after.removable),
            )
        )
    total = [f"{number(table.nrms)}" for table in ((start, last) if end else (last,))]
    rows.append(
        cells(
            "nrms of all joints", "", *total, number(last.floor_nrms), number(last.nrms),
            Cell(percent(removable_share(last)), bar=removable_share(last)),
        )
    )  # fmt: skip
    text = (
        f"RMS of measured − predicted effort in {unit}, beside the standard deviation of the "
        "measured effort (std). nrms is error over std. Removable is the share of the squared "
        "error that some model could still take away: the rest is sensor noise."
    )
    return Section("Joint by joint", (text,), (Table(head, tuple(rows), total=True),))


def candidates_section(diagnosis: Diagnosis, units: Units) -> Section:
    """The candidates that convince, the chosen one first."""
    joints = [joint.joint for joint in diagnosis.start.joints]
    if not diagnosis.candidates:
        text = "No effect takes away enough of the error on held-out data to be believed."
        return Section("Candidates", (text,))
    head = ("", "effect", "where", "", "nrms before", "after", "evidence", "false alarm")
    rows = [
        cells(
            str(count),
            Cell(effect_label(candidate.effect), _signature(candidate, units)),
            places_label(candidate.where, joints),
            _standing(count, candidate),
            number(candidate.error_before),
            number(candidate.error_after),
            number(candidate.evidence),
            chance(candidate.false_alarm_probability),
        )
        for count, candidate in enumerate(diagnosis.candidates, 1)
    ]
    text = (
        "Each was added alone to the model, and everything that may move refitted. Evidence is "
        "twice the log-likelihood ratio on held-out data, less the price of the parameters; the "
        "chosen candidate is the simplest of those that the logs cannot tell from the best."
    )
    table = Table(head, tuple(rows), words=4)
    return Section("Candidates", (text, *telling(diagnosis)), (table,))


def telling(found: Diagnosis | Explanation) -> tuple[str, ...]:
    """A sentence with the commands that design motions which would settle what is ambiguous."""
    commands = telling_commands(found)
    if not commands:
        return ()
    return (f"Motions that would tell apart what the logs cannot: {'; '.join(commands)}.",)


def failing_section(comparison: Comparison) -> Section:
    """Where the error is concentrated, in words."""
    title = "Where it fails"
    if not comparison.failing:
        return Section(title, ("No joint errs much more under some circumstance than elsewhere.",))
    return Section(title, items=tuple(str(case) for case in comparison.failing))


def method_section(comparison: Comparison, *, refitted: bool) -> Section:
    """How the errors were measured.

    Args:
        comparison: The comparison whose series name the folds.
        refitted: Whether models were refitted, with the folds held out.
    """
    folds = list(dict.fromkeys(series.block for series in comparison.series))
    text = [
        "Efforts and everything they are compared with passed through the same zero-phase filter, "
        "and were then reduced to the rate that its bandwidth allows. The noise floor is "
        "estimated from the efforts themselves."
    ]
    if refitted:
        text.append(
            f"Every error of a refitted model is of data held out from the fit: each of the "
            f"{len(folds)} folds, long blocks with gaps between them or whole logs, was predicted "
            "with parameters fitted to the others. The model as it stands was not refitted."
        )
    else:
        text.append(
            "The model was taken as it stands and nothing was refitted: all data are held out, "
            "provided that the model was not fitted to these logs before."
        )
    return Section("How errors were measured", tuple(text), items=(f"Folds: {', '.join(folds)}.",))


def notes_section(notes: Sequence[str]) -> Section:
    """What was done to the logs and noticed about the model."""
    return Section("Notes on logs and model", items=tuple(notes))


def _parameters(step: Step, units: Units) -> Table:
    """Places by parameters; a column's unit stands in its head where all places share it."""
    names = list(dict.fromkeys(name for values in step.parameters.values() for name in values))
    order = {place: i for i, place in enumerate(step.where)}
    places = sorted(step.parameters, key=lambda place: order.get(place, len(order)))
    head, columns = ["where"], []
    for name in names:
        found = [units.parameter(step.effect, name, place) for place in places]
        scale = _MILLISECONDS if found[0] == "s" else 1.0
        found = ["ms" if unit == "s" else unit for unit in found]
        shared = len(set(found)) == 1
        title = effect_label(name)
        head.append(f"{title}, {found[0]}" if shared and found[0] else title)
        column = [_value(step, place, name, scale) for place in places]
        if not shared:
            column = [f"{text} {unit}" for text, unit in zip(column, found, strict=True)]
        columns.append(column)
    rows = [cells(place, *texts) for place, *texts in zip(places, *columns, strict=True)]
    return Table(tuple(head), tuple(rows), title=_sentence_case(effect_label(step.effect)))


def _value(step: Step, place: str, name: str, scale: float) -> str:
    value = step.parameters[place].get(name, math.nan)
    deviation = step.deviations.get(place, {}).get(name, math.nan)
    if math.isfinite(deviation):
        return with_deviation(scale * value, scale * deviation)
    text = number(scale * value, 4)  # a shape parameter, such as an exponent
    return text.rstrip("0").rstrip(".") if "." in text and "·" not in text else text


def _sentence_case(text: str) -> str:
    return text[:1].upper() + text[1:]


def _signature(candidate: Candidate, units: Units) -> str:
    parts = (units.signature(name) for name in candidate.effect.split(" + "))
    return listed([part for part in parts if part])


def _standing(rank: int, candidate: Candidate) -> str:
    if rank == 1:
        return "chosen"
    return "as good, as far as the logs tell" if candidate.tied else ""
