"""Tables of results as plain data, for a terminal and for a page alike."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from geodrake.control.rollout import Rollout, RolloutFit
from geodrake.diagnosis.drafting import Draft
from geodrake.diagnosis.drafting.results import DraftedEffect
from geodrake.diagnosis.results import Diagnosis, Explanation, Step
from geodrake.identification.logs.model_errors import ErrorTable
from geodrake.model.effort_signal import COMMAND, EffortSignal
from geodrake.report.numbers import (
    UNKNOWN,
    Units,
    chance,
    number,
    percent,
    with_deviation,
)
from geodrake.report.words import (
    departure,
    effect_label,
    effect_signature,
    ordered_places,
    parameter_value,
    places_label,
    removable_share,
    removed_share,
    rivals,
    short_rivals,
    step_parameters,
    step_place,
)


@dataclass(frozen=True)
class Cell:
    """An entry of a table.

    Attributes:
        text: What it says, in lines.
        note: What stands under it in small letters on a page.
        bar: Share in [0, 1] that a page draws as a bar beside the text; None for no bar.
        typed: How commands call it, which a terminal shows in place of the text.
    """

    text: str
    note: str = ""
    bar: float | None = None
    typed: str = ""


@dataclass(frozen=True)
class Table:
    """A table of words and numbers.

    Attributes:
        rows: The rows, as long as the head.
        words: How many columns from the left hold words; the others hold numbers.
        total: How many of the last rows sum the others up.
    """

    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    words: int = 1
    title: str = ""
    total: int = 0


def cells(*texts: str | Cell) -> tuple[Cell, ...]:
    """Return a row of a table."""
    return tuple(text if isinstance(text, Cell) else Cell(text) for text in texts)


def errors_table(stages: Mapping[str, ErrorTable], units: Units) -> Table:
    """Errors of every joint, the noise floor, and the share that is removable in the end.

    Errors in N·m or N come first, and what they are of the effort's deviation after them. Where the
    logs show no noise, it and what is removable are unknown.

    Args:
        stages: Title -> errors of a model, from the first to the last.
    """
    *_, last = stages.values()
    mixed = " or " in units.effort([joint.joint for joint in last.joints])
    rows = [
        cells(
            f"{after.joint}, {units.effort([after.joint])}" if mixed else after.joint,
            *(number(errors.joints[j].rms) for errors in stages.values()),
            number(after.floor) if after.shows_noise else UNKNOWN,
            number(after.std),
            number(after.nrms),
            _share(after.removable),
        )
        for j, after in enumerate(last.joints)
    ]
    pooled = cells(
        "RMS of all joints",
        *(number(errors.pooled_rms) for errors in stages.values()),
        number(last.pooled_floor) if last.shows_noise else UNKNOWN,
        *[""] * 3,
    )
    relative = cells(
        "nrms of all joints",
        *(number(errors.nrms) for errors in stages.values()),
        number(last.floor_nrms) if last.shows_noise else UNKNOWN,
        "",
        number(last.nrms),
        _share(removable_share(last)),
    )
    totals = (relative,) if mixed else (pooled, relative)
    head = ("joint", *stages, "noise", "std", "nrms", "removable")
    return Table(head, (*rows, *totals), total=len(totals))


def error_stages(explanation: Explanation) -> dict[str, ErrorTable]:
    """Return the errors of an explanation from the start to the end, by title."""
    start, refitted, end = explanation.start, explanation.refitted, explanation.end
    return {"start": start, "refitted": refitted, "end": end}


def candidates_table(diagnosis: Diagnosis, units: Units) -> Table:
    """Return the candidates that convince, the chosen one first; = marks those that are as good."""
    joints = [joint.joint for joint in diagnosis.start.joints]
    rows = tuple(
        cells(
            "=" if candidate.tied and count > 1 else str(count),
            effect_cell(candidate.effect, units),
            places_label(candidate.where, joints),
            number(candidate.error_before),
            number(candidate.error_after),
            number(candidate.evidence),
            chance(candidate.false_alarm_probability),
        )
        for count, candidate in enumerate(diagnosis.candidates, 1)
    )
    head = ("", "effect", "where", "before", "after", "evidence", "chance")
    return Table(head, rows, words=3)


def steps_table(explanation: Explanation, units: Units) -> Table:
    """Return the steps: effect, where, rivals, errors before and after, how sure it is."""
    joints = [joint.joint for joint in explanation.start.joints]
    rows = tuple(
        cells(
            str(count),
            effect_cell(step.effect, units),
            step_place(step, joints),
            ", ".join(rivals(step, label=True)) or UNKNOWN,
            number(step.error_before),
            number(step.error_after),
            removed_share(step),
            percent(step.agreement),
            percent(step.probability),
            chance(step.false_alarm_probability),
        )
        for count, step in enumerate(explanation.steps, 1)
    )
    head = (
        "", "missing effect", "where", "or instead", "nrms before", "after",
        "squared error gone", "blocks better", "probability",
        "nothing there",
    )  # fmt: skip
    return Table(head, rows, words=4)


def short_steps_table(explanation: Explanation, units: Units, *, details: bool = True) -> Table:
    """Return the steps with what was found, narrow enough for a terminal."""
    start, refitted = explanation.start.nrms, explanation.refitted.nrms
    rows = [cells("", "as it stands", "", "", number(start), "", "")]
    if explanation.steps:
        values = number(start), number(refitted)
        rows.append(cells("", "refitted", "its own parameters", *values, "", ""))
    for count, step in enumerate(explanation.steps, 1):
        lines = [
            step_place(step, units.joints),
            *(_details(step, units) if details else ()),
        ]
        rows.append(
            cells(
                str(count),
                step.effect,
                "\n".join(lines),
                number(step.error_before),
                number(step.error_after),
                percent(step.agreement),
                percent(step.probability),
            )
        )
    where = "where, how much" if details else "where"
    head = ("", "effect", where, "before", "after", "blocks better", "probability")
    return Table(head, tuple(rows), words=3)


def step_details(explanation: Explanation, units: Units) -> list[str]:
    """Parameters and rivals of each step, a line each."""
    steps = ((step.effect, _details(step, units)) for step in explanation.steps)
    return [f"{effect}: {'; '.join(lines)}" for effect, lines in steps if lines]


def _details(step: Step, units: Units) -> list[str]:
    lines = [*step_parameters(step, units)]
    others = short_rivals(step)
    return [*lines, f"instead: {others}"] if others else lines


def parameters_table(step: Step, units: Units) -> Table:
    """Places by parameters; a column's unit stands in its head where all places share it."""
    names = list(dict.fromkeys(name for values in step.parameters.values() for name in values))
    places = ordered_places(step)
    head, columns = ["where"], []
    for name in names:
        found = [units.parameter(step.effect, name, place) for place in places]
        shared = len(set(found)) == 1
        title = effect_label(name)
        head.append(f"{title}, {found[0]}" if shared and found[0] else title)
        column = [parameter_value(step, place, name, units) for place in places]
        if not shared:
            column = [f"{text} {unit}" for text, unit in zip(column, found, strict=True)]
        columns.append(column)
    rows = tuple(cells(place, *texts) for place, *texts in zip(places, *columns, strict=True))
    title = effect_label(step.effect)
    return Table(tuple(head), rows, title=title[:1].upper() + title[1:])


def signals_table(signals: Sequence[EffortSignal], units: Units) -> Table:
    """Return what makes efforts of the currents, voltages and commands of logs.

    Args:
        signals: Those of a model, without those of motors that are asked for efforts.
    """
    rows, served = [], any(signal.kind == COMMAND for signal in signals)
    summed = any(signal.integral for signal in signals)
    limited = any(signal.limit < math.inf for signal in signals)
    for signal in signals:
        gain = with_deviation(signal.gain, signal.deviation)
        row = [signal.joint, signal.kind, gain, units.at(signal.joint, signal.unit)]
        if served:
            damping = with_deviation(signal.damping, signal.damping_deviation)
            rate = units.at(signal.joint, "N·m·s/rad")
            row += [f"{damping} {rate}" if signal.damping else UNKNOWN]
            row += [f"{1e3 * signal.delay:.2g} ms"]
        if summed:
            integral = with_deviation(signal.integral, signal.integral_deviation)
            unit = units.at(signal.joint, "N·m/(rad·s)")
            row += [f"{integral} {unit}" if signal.integral else UNKNOWN]
        if limited:
            row += [_limit(signal, units)]
        rows.append(cells(*row))
    more = ("damping", "late by") if served else ()
    more = (*more, *(["integral"] if summed else []), *(["limit"] if limited else []))
    head = ("joint", "in place of efforts", "gain", "unit", *more)
    return Table(head, tuple(rows), words=2)


def limits_table(signals: Sequence[EffortSignal], units: Units) -> Table:
    """Return what motors give of the efforts that they are asked for."""
    rows = [cells(signal.joint, _limit(signal, units)) for signal in signals]
    return Table(("joint", "limit"), tuple(rows), words=1)


def _limit(signal: EffortSignal, units: Units) -> str:
    """Return the largest effort of a joint, and the speed at which there is none."""
    if signal.limit == math.inf:
        return UNKNOWN
    most = f"{number(signal.limit)} {units.at(signal.joint, 'N·m')}"
    if signal.no_load_speed == math.inf:
        return most
    return f"{most}, none at {number(signal.no_load_speed)} {units.at(signal.joint, 'rad/s')}"


def formulas_table(draft: Draft) -> Table:
    """Drafted effects with their coefficients."""
    rows = tuple(
        cells(
            Cell(effect.formula.joint, typed=draft.names[effect.formula.joint]),
            "\n".join((effect.formula.words(), *_coefficients(effect))),
            number(effect.rms_before),
            number(effect.rms_after),
            number(effect.floor),
            chance(effect.false_alarm_probability),
        )
        for effect in draft.effects
    )
    head = ("joint", "formula", "RMS before", "after", "noise", "false alarm")
    return Table(head, rows, words=2)


def departures_table(
    after: Rollout, before: Rollout | None, units: Units, between: Sequence[Rollout] = ()
) -> Table:
    """Return how far every joint departs from its measured motion.

    Args:
        before: A rollout of the same passages with another model; None for none.
    """
    others = (before, *between) if before else ()
    rows = []
    for j, joint in enumerate(after.joints):
        log, instant = joint.worst
        rows.append(
            cells(
                f"{joint.joint}, {units.at(joint.joint, 'rad')}",
                number(joint.moved),
                *(number(other.joints[j].rms) for other in others),
                number(joint.rms),
                departure(joint.relative),
                f"{log} {instant:.1f} s",
            )
        )
    steps = [f"after step {k + 1}" for k in range(len(between))]
    ends = ("before", *steps, "after") if before else ("departure",)
    return Table(("joint", "moved", *ends, "share of motion", "worst at"), tuple(rows))


def rollout_values_table(found: RolloutFit, units: Units) -> Table:
    """Return what a fit of rollouts found, before and after."""
    rows = []
    for value in found.values:
        unit = units.parameter(value.effect, value.name, value.joint)
        before, after, deviation = (
            units.shown(value.effect, value.name, size)
            for size in (value.before, value.after, value.deviation)
        )
        rows.append(
            cells(
                effect_label(value.effect),
                value.joint,
                f"{effect_label(value.name)}, {unit}" if unit else effect_label(value.name),
                number(before),
                with_deviation(after, deviation),
            )
        )
    return Table(("effect", "joint", "value", "before", "fitted"), tuple(rows), words=3)


def rollout_fit_table(found: RolloutFit, units: Units) -> Table:
    """Departures of every joint before and after a fit, in the windows it saw and in the others."""
    stages = (*found.fitted, *found.held_out)
    rows = [
        cells(
            f"{joint.joint}, {units.at(joint.joint, 'rad')}",
            *(number(stage.joints[j].rms) for stage in stages),
            *(departure(stage.joints[j].relative) for stage in stages[2:]),
        )
        for j, joint in enumerate(found.before.joints)
    ]
    total = cells("of all joints", *[""] * 4, *(departure(stage.relative) for stage in stages[2:]))
    head = ("joint", "fitted before", "after", "held out before", "after", "of motion", "after")
    return Table(head, (*rows, total), total=1)


def _share(share: float) -> Cell:
    return Cell(percent(share), bar=share if math.isfinite(share) else None)


def effect_cell(name: str, units: Units) -> Cell:
    """Return an effect, or two that were found together, by name.

    Args:
        name: Name of the effect, or two joined by " + ".
    """
    label, typed = effect_label(name), name.replace(" + ", "\n+ ")
    return Cell(label, effect_signature(name, units), typed=typed)


def _coefficients(effect: DraftedEffect) -> list[str]:
    values = zip(effect.formula.parameters, effect.coefficients, effect.deviations, strict=True)
    return [
        f"{p.name} = {with_deviation(float(c), float(d))} {p.unit}".removesuffix(" 1")
        for p, c, d in values
    ]
