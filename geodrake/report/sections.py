"""Sections of reports: tables with what they mean, and remarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from geodrake.diagnosis.ambiguity import distinguishing_commands
from geodrake.diagnosis.results import Diagnosis, Explanation, Step
from geodrake.identification.logs.model_errors import Comparison, ErrorTable
from geodrake.model.effort_signal import EFFORT, EffortSignal
from geodrake.report.charts import Chart, Stage
from geodrake.report.dependence import residual_dependence
from geodrake.report.effort_chart import AFTER, BEFORE
from geodrake.report.identification_tables import bodies_table
from geodrake.report.numbers import Units, is_noticed, number, percent
from geodrake.report.page import ColoredList, Section, Tile
from geodrake.report.tables import (
    candidates_table,
    errors_table,
    limits_table,
    parameters_table,
    signals_table,
    steps_table,
)
from geodrake.report.words import failing_list, removable_share, rivals, worst_joint

NOTHING_FOUND = "No effect takes away enough of the error on held-out data to be believed."


def error_tile(title: str, errors: ErrorTable, units: Units, where: str = "all joints") -> Tile:
    """Return how large an error is, in N·m first; only its nrms where units are mixed.

    Args:
        where: What the error is of, in words.
    """
    unit = units.effort([joint.joint for joint in errors.joints])
    if " or " in unit:
        return Tile(title, number(errors.nrms), f"nrms: error over std of the effort, {where}")
    nrms = number(errors.nrms)
    return Tile(title, f"{number(errors.pooled_rms)} {unit}", f"RMS, nrms {nrms}: {where}")


def noise_tile(errors: ErrorTable) -> Tile:
    """Return what sensor noise alone would make, if the logs show any."""
    if not errors.shows_noise:
        return Tile("sensor noise", "not seen", "nothing to compare the error with")
    return Tile("sensor noise", number(errors.floor_nrms), "the nrms of a perfect model")


def removable_tiles(errors: ErrorTable, of: str) -> tuple[Tile, ...]:
    """Return what a better model could remove; none where no noise is seen, as it is unknown then.

    Args:
        of: What the share is of, in words.
    """
    if not errors.shows_noise:
        return ()
    return (Tile("removable", percent(removable_share(errors)), of),)


def steps_section(explanation: Explanation, units: Units) -> Section:
    """The steps: effect, where, error before and after, what else may be there, how sure it is."""
    if not explanation.steps:
        return Section("What is missing", (NOTHING_FOUND,))
    text = (
        "Effects in the order of what they take away; after each, everything that may move was "
        "refitted. Blocks better is the share of the held-out blocks in which the error falls "
        "where the effect acts. Probability is that of all explanations of the logs that have the "
        "finding. In the others something else is in its place, something unknown, or nothing; "
        "all of them add up to one."
    )
    if any(map(rivals, explanation.steps)):
        text += " The nrms that is left with something else stands in brackets."
    table = steps_table(explanation, units)
    return Section("What is missing", (text, *distinguishing_motions(explanation)), (table,))


def parameters_section(explanation: Explanation, units: Units) -> Section:
    """Return the parameters that were found, with their standard deviations and units."""
    tables = [parameters_table(step, units) for step in explanation.steps if step.parameters]
    words = "Value ± standard deviation, where the fit knows one."
    if any(map(_has_noticed, explanation.steps)):
        words += (
            " A second deviation comes from the gains of the efforts, and from what stays "
            "unexplained. More data do not narrow it: a log with a payload of known mass does "
            "(--known-payload), and what explains the rest."
        )
    text = (words,) if tables else ()
    return Section("Parameters found", text, tuple(tables), abreast=True)


def _has_noticed(step: Step) -> bool:
    """Return whether a second deviation is shown of one of a step's parameters."""
    return any(
        is_noticed(step.deviations[place][name], systematic)
        for place, own in step.systematic.items()
        for name, systematic in own.items()
    )


def bodies_section(explanation: Explanation) -> Section:
    """Mass and centre of mass of the bodies before and after; empty if the model stays."""
    if not explanation.bodies:
        return Section("Bodies")
    text = (
        "Mass in kg and centre of mass in mm in the frame of the body, as the model had them and "
        "as they are fitted beside the effects, ± standard deviation from noise alone; the "
        "farthest change first. What is attached to a body as a payload stands among the "
        "parameters."
    )
    return Section("Bodies", (text,), (bodies_table(explanation.bodies),))


def signals_section(signals: Sequence[EffortSignal], units: Units) -> Section:
    """What makes efforts of currents, voltages and commands; empty where efforts were measured."""
    signals = [signal for signal in signals if signal.kind != EFFORT]
    if not signals:
        return Section("Gains")
    text = (
        "No efforts were measured at these joints. Efforts are the gains times what was measured, "
        "of servos the stiffness times how far the command is ahead, the damping times how much "
        "faster it is, and the integral gain times how far and how long it was "
        "ahead. The scale of the gains is that of the model's inertias; a model that was fitted "
        "to efforts, or a gain from a data sheet (--gain), tells it better."
    )
    return Section("Gains", (text,), (signals_table(signals, units),))


def limits_section(signals: Sequence[EffortSignal], units: Units) -> Section:
    """What motors give of the efforts that they are asked for; empty where that is not limited."""
    signals = [signal for signal in signals if signal.kind == EFFORT]
    if not signals:
        return Section("Limits of motors")
    text = (
        "Efforts of these joints are those that their motors are asked for; they give no more "
        "than the limit, which logs told."
    )
    return Section("Limits of motors", (text,), (limits_table(signals, units),))


def joints_section(stages: Mapping[str, ErrorTable], units: Units) -> Section:
    """Errors of every joint; see `errors_table`."""
    joints = [joint.joint for joint in next(iter(stages.values())).joints]
    text = (
        f"RMS of measured − predicted effort in {units.effort(joints)}, beside the standard "
        "deviation of the measured effort (std). nrms is error over std. Removable is the share "
        "of the squared error that some model could still take away: the rest is sensor noise."
    )
    return Section("Joint by joint", (text,), (errors_table(stages, units),))


def candidates_section(diagnosis: Diagnosis, units: Units) -> Section:
    """Return the candidates that convince, the chosen one first."""
    if not diagnosis.candidates:
        return Section("Candidates", (NOTHING_FOUND,))
    text = (
        "Each was added alone to the model, and everything that may move refitted; before and "
        "after are nrms. Evidence is twice the logarithm of how much likelier it makes the model, "
        "prior odds counted. The first is the first step of the most probable explanation; = marks "
        "what may stand in its place. Chance is how probable it is that it is not needed there."
    )
    table = candidates_table(diagnosis, units)
    return Section("Candidates", (text, *distinguishing_motions(diagnosis)), (table,))


def distinguishing_motions(found: Diagnosis | Explanation) -> tuple[str, ...]:
    """A sentence with the commands that design motions which would settle what is ambiguous."""
    commands = distinguishing_commands(found)
    if not commands:
        return ()
    return (f"Motions that would distinguish what the logs cannot: {'; '.join(commands)}.",)


_EVEN = "No joint errs much more under some circumstance than elsewhere."


def failing_section(
    before: Comparison,
    after: Comparison | None = None,
    *,
    charts: Sequence[Chart] = (),
    alone: Stage = BEFORE,
) -> Section:
    """Return where the error is concentrated, at first and in the end, in words and over time."""
    models = {alone: before} if after is None else {BEFORE: before, AFTER: after}
    lists = tuple(
        ColoredList(stage.label[:1].upper() + stage.label[1:], stage.color, words)
        for stage, comparison in models.items()
        for words in [failing_list(comparison) or (_EVEN,)]
    )
    return Section("Where it fails", lists=lists, charts=tuple(charts))


def dependence_section(models: Mapping[Stage, Comparison], units: Units) -> Section:
    """Residuals of models against velocity, position and load.

    Args:
        models: The models, the last of which is shown at first.
    """
    shown = tuple(residual_dependence(found, stage, units) for stage, found in models.items())
    return Section("What the error goes with", dependences=shown)


def worst_tile(before: ErrorTable, after: ErrorTable | None = None) -> Tile:
    """Return the joint that errs most, of the final model if there is one."""
    last = after or before
    worst = worst_joint(last).joint
    tables = [before] if after is None else [before, after]
    nrms = [next(j.nrms for j in table.joints if j.joint == worst) for table in tables]
    return Tile("worst joint", worst, f"nrms {' → '.join(map(number, nrms))}", words=True)


def method_section(comparison: Comparison, *, refitted: bool) -> Section:
    """Return how the errors were measured."""
    folds = list(dict.fromkeys(series.block for series in comparison.series))
    text = [
        "Efforts and everything they are compared with passed through the same zero-phase filter, "
        "and were then reduced to the rate that its bandwidth allows. The noise floor is "
        "estimated from the efforts themselves."
    ]
    if refitted:
        text.append(
            f"Every error of a refitted model is of held-out data: each of the {len(folds)} folds, "
            "long blocks with gaps between them or whole logs, was predicted with parameters "
            "fitted to the others. The model as it stands was not refitted."
        )
    else:
        text.append(
            "The model was taken as it stands and nothing was refitted: all data are held-out "
            "data, provided that the model was not fitted to these logs before."
        )
    return Section("How errors were measured", tuple(text), items=(f"Folds: {', '.join(folds)}.",))


def notes_section(notes: Sequence[str]) -> Section:
    """Return what was done to the logs and noticed about the model."""
    return Section("Notes on logs and model", items=tuple(notes))
