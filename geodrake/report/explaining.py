"""Pages of `compare`, `diagnose`, `add`, `explain` and `identify`."""

from __future__ import annotations

import hashlib
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geodrake.boundary.version import version
from geodrake.diagnosis.ambiguity import distinguishing_commands
from geodrake.diagnosis.drafting import Correlate, Draft
from geodrake.diagnosis.results import Diagnosis, Explanation, Step
from geodrake.effects import Role
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, Series
from geodrake.identification.models.results import BodyChange, ModelIdentification
from geodrake.inertia import Array
from geodrake.inertia.parameters import PARAMETER_NAMES
from geodrake.model.effort_signal import COMMAND, EFFORT, EffortSignal
from geodrake.report import words
from geodrake.report.charts import Bars, Chart, Panel, Plot, Stage
from geodrake.report.error_charts import (
    AFTER,
    BEFORE,
    GAP,
    candidate_bars,
    effort_chart,
    joint_bars,
    residual_chart,
    step_bars,
    step_joint_bars,
    step_stages,
)
from geodrake.report.json_output import picked, record
from geodrake.report.numbers import (
    UNKNOWN,
    Units,
    chance,
    estimate,
    if_known,
    number,
    percent,
    with_deviation,
)
from geodrake.report.page import (
    About,
    Cell,
    Page,
    Records,
    Section,
    Table,
    Tile,
    View,
    cells,
)
from geodrake.report.views import comparison_series

if TYPE_CHECKING:
    from geodrake.control.rollout import Rollout

REST = "What the remaining error varies with"
_EVEN = "No joint has a much larger error under any one condition."
_IDENTIFIED = Stage("identified", "after")
_RESIDUAL = Stage("residual without it", "measured", look="wide")
_FORMULA = Stage("formula on held-out data", "after")
_SCATTER = Stage("residual over formula", "after", look="dots")
_MOST_DOTS = 400
_MOST_LISTED, _MOST_TYPED = 7, 2  # places that pages and terminals name rather than count
_MILLIMETRES = 1e3
_FAR = 1e6  # mm; larger deviations are printed with a power of ten
_NOTICED = (
    "A second ± is from uncertain effort gains and unexplained errors. More data do not reduce it; "
    "a log with a payload of known mass does (--known-payload)."
)
_COLUMNS = (
    "Each nrms is that of the model with this effect and those above it, on held-out data.\n"
    "Probability is the sum over all explanations of the logs that have the effect. The others "
    "have another effect, an unknown one or none in its place; by chance is the probability of "
    "none.\n"
    "Blocks better is the share of held-out blocks in which the error falls at the joints of the "
    "effect."
)


@dataclass(frozen=True, eq=False)
class Explained(Explanation):
    """An explanation, and results that only its command computes."""

    correlates: Sequence[Correlate] = ()  # signals that correlate with the remaining error
    # Rollouts under commands before the first step, between steps and after the last, if any.
    motions: Sequence[Rollout] | None = None
    draft: Draft | None = None  # formulas for the remaining error, if requested
    added: bool = False  # whether the effect was named by the user

    @classmethod
    def of(cls, explanation: Explanation, **more: Any) -> Explained:
        """Return an explanation with further fields."""
        return cls(**{f.name: getattr(explanation, f.name) for f in fields(Explanation)} | more)


@dataclass(frozen=True, eq=False)
class _Errors:
    """Errors of one or several models on the same logs."""

    stages: Mapping[str, ErrorTable]  # title -> errors of a model, from the first to the last
    models: Mapping[Stage, Comparison]  # stage -> comparison of its model with the logs
    units: Units
    bars: Bars
    # Intermediate models and their predictions.
    between: Mapping[Stage, Sequence[Series]] = field(default_factory=dict)

    @property
    def last(self) -> ErrorTable:
        """Return the errors of the last model."""
        return list(self.stages.values())[-1]

    def sections(self) -> tuple[Section, Section]:
        """Return the errors of all joints, and where they are concentrated."""
        chart = effort_chart(self.models, self.units, self.between)
        several = len(self.models) > 1
        labels = [words.capitalized(stage.label) * several for stage in self.models]
        failing = list(map(failing_table, self.models.values(), labels))
        return (
            Section(
                "Joint by joint",
                f"RMS of measured − predicted effort in {_unit(self.last, self.units)}; nrms is "
                "RMS / std, the standard deviation of the measured effort.",
                "Noise is what no model can remove. Removable is the share of the squared error "
                "above it, which a better model may explain, though perhaps not by positions and "
                "velocities alone.",
                (self.bars,),
                (errors_table(self.stages, self.units),),
                deep=len(self.stages) > 2,
            ),
            Section(
                "Where it fails",
                "The condition under which the error of a joint is largest, and its RMS there.",
                tables=tuple(failing),
                items=tuple(f"{t.title}. {_EVEN}".lstrip(". ") for t in failing if not t.rows),
                charts=(chart,),
                deep=True,
            ),
        )

    def page(
        self,
        about: About,
        verdict: str,
        headline: str,
        sections: Sequence[Section],
        *,
        tiles: Sequence[Tile],
        notes: Sequence[str],
        removable: str = "",
        deep: bool = False,
        **more: Any,
    ) -> Page:
        """Return a page that ends with residuals, how errors were measured, and notes.

        Args:
            tiles: The first tiles, before those of the worst joint and of noise.
            removable: Unit of the removable share; "" to omit that tile.
            deep: Whether terminals show notes only with details.
            more: Further fields of the page.
        """
        comparison, (start, *_) = next(iter(self.models.values())), self.stages.values()
        ends = [self.last] if start.nrms == self.last.nrms else [start, self.last]
        worst = words.worst_joint(self.last).joint
        nrms = [next(j.nrms for j in table.joints if j.joint == worst) for table in ends]
        tiles = [
            *tiles,
            Tile("worst joint", worst, f"nrms {' → '.join(map(number, nrms))}", words=True),
            Tile("sensor noise", number(self.last.floor_nrms), "the nrms of a perfect model"),
        ]
        if not self.last.shows_noise:
            tiles[-1] = Tile("sensor noise", "unknown", "the logs show none")
        elif removable:
            share = percent(words.removable_share(self.last))
            tiles.append(Tile("removable", share, removable))
        folds = list(dict.fromkeys(series.block for series in comparison.series))
        method = (
            f"Errors of refitted models are on held-out data: each of the {len(folds)} folds (long "
            "blocks with gaps between them, or whole logs) was predicted with parameters fitted to "
            "the others. The model as it stands was not refitted."
            if verdict != "compared"
            else "Nothing was refitted, so all data are held-out data, unless the model was fitted "
            "to these logs before."
        )
        closing = (
            Section(
                "What the error varies with",
                charts=(residual_chart(self.models, self.units),),
                detailed=True,
            ),
            Section(
                "How errors were measured",
                method,
                "Measured and predicted efforts passed through the same zero-phase filter, and "
                "were then decimated to the rate that its bandwidth allows. The noise floor is "
                "estimated from the measured efforts.",
                items=(f"Folds: {', '.join(folds)}.",),
                detailed=True,
            ),
            replace(notes_section(notes, comparison.first), deep=deep),
        )
        more.setdefault("compared", {stage.label: model for stage, model in self.models.items()})
        return Page(
            about,
            headline,
            (*sections, *closing),
            verdict=verdict,
            tiles=tuple(tiles),
            footer=_footer(comparison),
            first=(first_section(comparison.first),),
            **more,
        )


def comparison_page(comparison: Comparison, about: About) -> Page:
    """Return the page of a comparison."""
    errors, units = comparison.errors, about.units
    shown = _Errors({"RMS": errors}, {BEFORE: comparison}, units, joint_bars(errors))
    joints, failing = shown.sections()
    return shown.page(
        about,
        "compared",
        f"The error is {words.error_size(errors)}.",
        (joints, replace(failing, deep=False)),
        tiles=[_error_tile("error", errors, units)],
        notes=comparison.notes,
        removable="of the squared error",
        facts=words.comparison_facts(comparison),
    )


def diagnosis_page(diagnosis: Diagnosis, about: About) -> Page:
    """Return the page of a diagnosis."""
    start, comparison, units = diagnosis.start, diagnosis.comparison, about.units
    if not units.joints:
        units = Units(tuple(joint.joint for joint in start.joints))
    shown = _Errors({"RMS": start}, {BEFORE: comparison}, units, joint_bars(start))
    best = diagnosis.candidates[0].error_after if diagnosis.candidates else None
    ranking = Section(
        "Candidates",
        f"nrms on held-out data with each effect alone; {number(diagnosis.refitted.nrms)} without. "
        "The first is the first step of the most probable explanation.",
        "Everything is refitted with each effect. Evidence is twice the log posterior odds of the "
        "model with the effect. = marks alternatives to the first candidate. By chance is the "
        "probability that the effect is not needed there.",
        (candidate_bars(diagnosis, units.driven),) if diagnosis.candidates else (),
        (candidates_table(diagnosis, units),),
    )
    headline = words.NOTHING.get(diagnosis.verdict, "")
    if diagnosis.candidates:
        first = diagnosis.candidates[0]
        where = words.places_label(first.where, units.driven, most=words.MOST_NAMED)
        verb = "are" if " + " in first.effect else "is"
        label = words.capitalized(words.effect_label(first.effect))
        headline = f"{label} ({where}) {verb} missing."
    joints, failing = shown.sections()
    effect_tiles = [] if best is None else [Tile("with the effect", number(best), "held-out nrms")]
    return shown.page(
        about,
        diagnosis.verdict,
        headline,
        (ranking, settling_section(diagnosis, about), replace(joints, deep=True), failing),
        tiles=[
            _error_tile("as it stands", start, units),
            _error_tile("refitted", diagnosis.refitted, units, "held-out data"),
            *effect_tiles,
        ],
        notes=diagnosis.notes,
        deep=True,
        facts=words.diagnosis_facts(diagnosis),
    )


def explanation_page(found: Explanation, about: About) -> Page:
    """Return the page of an explanation; units are those of its deviations model."""
    explanation = found if isinstance(found, Explained) else Explained.of(found)
    units = Units.of(found.model, [*about.units.effects.values()])
    start, end, steps = explanation.start, explanation.end, explanation.steps
    removed, draft = words.explained_share(start.nrms, end.nrms), explanation.draft
    correlates = draft.correlates if draft else explanation.correlates
    signals = explanation.model.effort_signals
    parameters = tuple(parameters_table(step, units) for step in steps if step.parameters)
    entries = [cell.text for table in parameters for row in table.rows for cell in row]
    has_systematic = any(text.count("±") > 1 for text in entries)
    shown = _Errors(
        {"start": start, "refitted": explanation.refitted, "end": end},
        {BEFORE: explanation.before, **({AFTER: explanation.after} if steps else {})},
        units,
        step_joint_bars(explanation),
        step_stages(explanation),
    )
    tiles = [_error_tile("as it stands", start, units)]
    if steps:
        share = percent(removed) if removed > 0 else "none"
        tiles += [
            _error_tile("now", end, units, "held-out data"),
            Tile("explained", share, "of the squared error"),
        ]
    joints, failing = shown.sections()
    return shown.page(
        about,
        explanation.verdict,
        words.explanation_headline(explanation, added=explanation.added),
        (
            Section(
                "What is missing",
                f"{words.NRMS}.",
                _COLUMNS,
                (step_bars(explanation, units.driven),) if steps else (),
                (steps_table(explanation, units),) if steps else (),
                tuple(
                    f"{words.effect_label(step.effect)}, or {words.rivals(step)}"
                    for step in steps
                    if words.has_rivals(step)
                ),
            ),
            settling_section(explanation, about),
            Section(
                "Parameters",
                f"Value ± standard deviation. {_NOTICED if has_systematic else ''}".rstrip(),
                tables=parameters,
                deep=True,
            ),
            Section(
                REST,
                "Signals that predict a share of the remaining squared error of a joint.",
                tables=(correlates_table(correlates),),
                deep=draft is None,
            ),
            *([_draft_section(draft, units)] if draft else []),
            _motions_section(explanation.motions, units),
            failing,
            joints,
            Section(
                "Bodies",
                "Mass in kg and centre of mass in mm before and after, largest change first; ± is "
                "from noise alone.",
                "Centres of mass are in the body frame. Payloads are listed with the parameters.",
                tables=(bodies_table(explanation.bodies),) if explanation.bodies else (),
                deep=True,
            ),
            gains_section(signals, units),
            limits_section(signals, units),
        ),
        tiles=tiles,
        removable="of the squared error left",
        notes=explanation.notes,
        deep=True,
        facts=words.explanation_facts(
            explanation,
            units,
            added=explanation.added,
            advised=not (draft or explanation.added),
        ),
    )


def identification_page(found: ModelIdentification, about: About) -> Page:
    """Return the page of an identification."""
    units = Units.of(found.model, [*about.units.effects.values()])
    before, after = found.before, found.after
    shown = _Errors(
        {"before": before, "after": after},
        {_IDENTIFIED: found.comparison},
        units,
        joint_bars(before, [("identified", after.by_joint())]),
    )
    joints, failing = shown.sections()
    gamma = _gamma(found.gamma)
    gamma += f", chosen by held-out error from {len(found.sweep)}" if found.sweep else ""
    facts = {"Remaining error": words.error_size(after)}
    facts["Regularizer"] = f"{found.regularizer}, gamma {gamma}"
    if found.at_boundary:
        facts["At the boundary"] = (
            f"{words.listed(found.at_boundary)}; the data alone would give invalid inertias"
        )
    return shown.page(
        about,
        "identified",
        f"Identified, {words.nrms_change(before.nrms, after.nrms)}.",
        (
            joints,
            Section(
                "Bodies",
                "Mass in kg and centre of mass in mm in the body frame, ± standard deviation.",
                "A body at the boundary would have invalid inertias if fitted to the data alone.",
                tables=(bodies_table(found.bodies),),
            ),
            Section("Effects", tables=(_effects_table(found, units),)),
            Section(
                "Regularizers at the same training residual", tables=(_regularizers_table(found),)
            ),
            failing,
        ),
        tiles=[
            _error_tile("as it stands", before, units),
            _error_tile("identified", after, units, "held-out data"),
        ],
        removable="of the squared error left",
        notes=found.notes,
        compared={
            BEFORE.label: replace(found.comparison, errors=before),
            _IDENTIFIED.label: found.comparison,
        },
        facts=facts,
    )


def settling_section(found: Diagnosis | Explanation, about: About) -> Section:
    """Return commands to design motions that tell ambiguous effects apart."""
    commands = tuple(
        f"{command.replace('MODEL', shlex.quote(about.saved))} --save motion_{k}.csv"
        for k, command in enumerate(distinguishing_commands(found), 1)
    )
    return Section(
        "To tell these effects apart",
        "Record such a motion, and pass its log together with the others.",
        commands=commands,
    )


def _motions_section(motions: Sequence[Rollout] | None, units: Units) -> Section:
    """Return the position errors under the logged commands; empty without commands."""
    title = "Motion error under the logged commands"
    if motions is None:
        return Section(title)
    from geodrake.report.rollouts import departures_table, stages_table  # slow to import

    before, after = motions[0], motions[-1]
    return Section(
        title,
        f"RMS in windows of {after.horizon:g} s that start at the measured state.",
        "The model with the same servos is simulated under the logged commands, before the first "
        "and after each step, and its motion compared with the measured one.",
        tables=(
            departures_table(after, before, units),
            *([stages_table(motions, units)] if len(motions) > 2 else []),
        ),
    )


def _draft_section(draft: Draft, units: Units) -> Section:
    """Return the formulas, their errors, and the effects that they replace."""
    title = "Formulas for the remaining error"
    if not draft.effects:
        verdict = "No formula removes a significant share of the error; no file was written."
        return Section(title, items=(verdict,))
    nrms = f"{number(draft.before.nrms)} -> {number(draft.after.nrms)}"
    needless = [f"{e.name} of {', '.join(e.where)}" for e in draft.needless]
    return Section(
        title,
        f"Held-out nrms {nrms}, sensor noise {number(draft.after.floor_nrms)}. A formula that fits "
        "need not be the cause.",
        "Sums of products of simple functions of the motion, found by a sparse search and "
        "validated on held-out data. Use the file with --effects; the saved model does not include "
        "it.",
        tables=(formulas_table(draft),),
        items=(f"No longer needed with the formulas: {', '.join(needless)}",) if needless else (),
        charts=(draft_chart(draft, units),),
    )


def draft_chart(draft: Draft, units: Units) -> Chart:
    """Return the efforts of formulas over time, and against the residuals without them."""
    panels = []
    for effect in draft.effects:
        joint, unit = effect.formula.joint, units.effort([effect.formula.joint])
        steps = np.diff(effect.time)
        period = np.median(np.abs(steps)) if len(steps) else 1.0
        breaks = 1 + np.flatnonzero((steps > GAP * period) | (steps < 0))
        index = np.insert(np.arange(len(effect.time), dtype=float), breaks, breaks - 0.5)
        residual, formula = (np.insert(x, breaks, np.nan) for x in (effect.residual, effect.effort))
        kept = np.linspace(0, len(effect.effort) - 1, min(_MOST_DOTS, len(effect.effort)))
        order = np.argsort(effect.effort, kind="stable")[kept.astype(int)]
        plots = (
            Plot(
                f"effort, {unit}",
                {_RESIDUAL: residual, _FORMULA: formula},
                floor=effect.floor,
                over=index,
                axis="samples, block after block",
            ),
            Plot(
                "residual without it",
                {_SCATTER: effect.residual[order]},
                over=effect.effort[order],
                axis=f"formula, {unit}",
            ),
        )
        change = f"RMS {number(effect.rms_before)} → {number(effect.rms_after)} {unit}"
        panels.append(Panel(joint, change, np.array([]), plots))
    caption = (
        "Residual of each joint without the formula, and the effort of the formula: over time, "
        "and plotted against each other."
    )
    return Chart("draft", caption, tuple(panels), abreast=True)


def _unit(errors: ErrorTable, units: Units) -> str:
    return units.effort([joint.joint for joint in errors.joints])


def _error_tile(title: str, errors: ErrorTable, units: Units, where: str = "all joints") -> Tile:
    """Return a tile with an RMS error and its nrms; only the nrms where units are mixed."""
    unit, nrms = _unit(errors, units), number(errors.nrms)
    if " or " in unit:
        return Tile(title, nrms, f"nrms: error over std of the effort, {where}")
    return Tile(title, f"{number(errors.pooled_rms)} {unit}", f"RMS, nrms {nrms}: {where}")


def gains_section(signals: Sequence[EffortSignal], units: Units) -> Section:
    """Return the gains from currents, voltages and commands to efforts; empty without any."""
    return Section(
        "Gains",
        "Efforts of these joints were not measured; they are gains times the logged signals.",
        "The effort of a servo is its stiffness times the position error, its damping times the "
        "velocity error, and its integral gain times the integral of the position error. The gains "
        "scale with the model's inertias; a model fitted to measured efforts or a gain from a data "
        "sheet (--gain) makes them more accurate.",
        tables=(signals_table([each for each in signals if each.kind != EFFORT], units),),
    )


def limits_section(signals: Sequence[EffortSignal], units: Units) -> Section:
    """Return the effort limits of motors; empty if there are none."""
    rows = [cells(each.joint, _limit(each, units)) for each in signals if each.kind == EFFORT]
    return Section(
        "Limits of motors",
        "The motors of these joints saturate at the limit; logged efforts are commands.",
        tables=(Table(("joint", "limit"), rows),),
    )


def first_section(words: Sequence[str]) -> Section:
    """Return the section on doubtful logs and omitted data, which comes first."""
    return Section("Check first: the logs", items=tuple(words))


def notes_section(notes: Sequence[str], first: Sequence[str] = ()) -> Section:
    """Return notes on logs and model, without those in the first section."""
    return Section("Notes", items=tuple(note for note in notes if note not in first))


def _footer(comparison: Comparison) -> str:
    """Return the version of geodrake and the fingerprint of the data."""
    digest = hashlib.sha256()
    for series in comparison.series:
        digest.update(f"{series.joint}\n{series.block}\n".encode(errors="surrogateescape"))
        for values in (series.time, series.position, series.measured):
            digest.update(values.round(9).tobytes())
    samples = sum(len(series.time) for series in comparison.series)
    return (
        f"Made by geodrake {version()}. Data: {samples} prepared samples of effort with "
        f"fingerprint {digest.hexdigest()[:12]}; the same logs, prepared in the same way, have the "
        "same fingerprint."
    )


def errors_table(stages: Mapping[str, ErrorTable], units: Units) -> Table:
    """Return errors and noise of all joints, and the share that a better model could remove.

    Without noise in the logs, the noise floor and the removable share are unknown.
    """
    *_, last = stages.values()
    mixed = " or " in _unit(last, units)
    rows = []
    for j, after in enumerate(last.joints):
        name = f"{after.joint}, {units.effort([after.joint])}" if mixed else after.joint
        rms = (errors.joints[j].rms for errors in stages.values())
        floor = after.floor if after.shows_noise else math.nan
        rows.append(cells(name, *rms, after.std, after.nrms, floor, _share(after.removable)))
    pooled = ["" if mixed else errors.pooled_rms for errors in stages.values()]
    floor = last.pooled_floor if last.shows_noise else math.nan
    share = _share(words.removable_share(last))
    total = cells("all joints", *pooled, "", last.nrms, "" if mixed else floor, share)
    head = ("joint", *stages, "std", "nrms", "noise", "removable")
    return Table(head, (*rows, total), total=1, deep=("removable",))


def _share(share: float) -> Cell:
    return Cell(percent(share), bar=share if math.isfinite(share) else None)


def candidates_table(diagnosis: Diagnosis, units: Units) -> Table:
    """Return the convincing candidates, the chosen one first; = marks equally good ones."""
    rows = [
        cells(
            "=" if candidate.tied and count > 1 else count,
            effect_cell(candidate.effect, units),
            Cell(
                words.places_label(candidate.where, units.driven, most=_MOST_LISTED),
                typed=words.places_label(candidate.where, units.driven, most=_MOST_TYPED),
            ),
            *(candidate.error_after, candidate.evidence),
            chance(candidate.false_alarm_probability),
        )
        for count, candidate in enumerate(diagnosis.candidates, 1)
    ]
    head = ("", "effect", "where", "nrms", "evidence", "by chance")
    return Table(head, rows, words=3, deep=("by chance",))


def failing_table(comparison: Comparison, title: str = "") -> Table:
    """Return where a model fails; rows always include the worst joint."""
    rows = [
        cells(
            *(case.joint, case.circumstance),
            *(f"{number(rms)} {case.unit}" for rms in (case.rms, case.elsewhere)),
            *map(percent, (case.share, case.time)),
        )
        for case in comparison.failing
    ]
    worst = words.worst_joint(comparison.errors)
    is_named = worst.joint in {case.joint for case in comparison.failing}
    if len(comparison.errors.joints) > 1 and not (is_named or worst.is_noise):
        rows.insert(0, cells(worst.joint, f"throughout: nrms {number(worst.nrms)}", *[""] * 4))
    head = ("joint", "largest error", "RMS there", "elsewhere", "of squared error", "of samples")
    return Table(head, rows, words=2, title=title, deep=("of squared error", "of samples"))


def correlates_table(correlates: Sequence[Correlate]) -> Table:
    """Return the signals with which the remaining error varies."""
    rows = [cells(each.joint, each.words, percent(each.share)) for each in correlates]
    return Table(("joint", "varies with", "share"), rows, words=2)


def steps_table(explanation: Explanation, units: Units) -> Table:
    """Return the steps with places, parameters, errors and probabilities."""
    rest = [""] * 4
    rows = [
        cells("the model as it stands", "", "", explanation.start.nrms, *rest),
        cells("refitted, nothing added", "", "", explanation.refitted.nrms, *rest),
    ]
    for step in explanation.steps:
        rows.append(
            cells(
                effect_cell(step.effect, units),
                Cell(
                    words.step_place(step, units.driven, most=_MOST_LISTED),
                    typed=words.step_place(step, units.driven, most=_MOST_TYPED),
                ),
                "\n".join(words.step_parameters(step, units)),
                step.error_after,
                *map(percent, (step.probability, step.unknown_probability)),
                chance(step.false_alarm_probability),
                percent(step.agreement),
            )
        )
    deep = ("unknown", "by chance", "blocks better")
    return Table(("effect", "where", "value", "nrms", "probability", *deep), rows, 3, deep=deep)


def effect_cell(name: str, units: Units) -> Cell:
    """Return the cell of an effect, or of two added together."""
    kinds = [units.effects[part] for part in name.split(" + ") if part in units.effects]
    signature = words.listed([kind.signature for kind in kinds if kind.signature])
    return Cell(words.effect_label(name), signature, typed=name.replace(" + ", "\n+ "))


def parameters_table(step: Step, units: Units) -> Table:
    """Return parameters by place; units are in the head where all places share them."""
    names = list(dict.fromkeys(name for values in step.parameters.values() for name in values))
    places = words.ordered_places(step)
    head, columns = ["where"], []
    for name in names:
        place_units = [units.parameter(step.effect, name, place) for place in places]
        shared = len(set(place_units)) == 1
        title = words.effect_label(name)
        head.append(f"{title}, {place_units[0]}" if shared and place_units[0] else title)
        column = [words.parameter_value(step, place, name, units) for place in places]
        if not shared:
            column = [f"{text} {unit}" for text, unit in zip(column, place_units, strict=True)]
        columns.append(column)
    rows = [cells(*row) for row in zip(places, *columns, strict=True)]
    title = words.capitalized(words.effect_label(step.effect))
    return Table(tuple(head), rows, title=title)


def signals_table(signals: Sequence[EffortSignal], units: Units) -> Table:
    """Return the gains from currents, voltages and commands to efforts."""
    has_servo = any(signal.kind == COMMAND for signal in signals)
    has_integral = any(signal.integral for signal in signals)
    has_limit = any(signal.limit < math.inf for signal in signals)
    has_dead_band = any(signal.dead_band for signal in signals)
    rows = []
    for signal in signals:
        joint, gain = signal.joint, if_known(signal.gain, signal.deviation)
        row = {"joint": joint, "logged signal": signal.kind, "gain": gain}
        row["unit"] = units.at(joint, signal.unit)
        if has_servo:
            damping = if_known(signal.damping, signal.damping_deviation)
            rate = units.at(joint, "N·m·s/rad")
            of = f", of {signal.rate_share:.2g} dc/dt − v" if signal.rate_share < 1.0 else ""
            row["damping"] = f"{damping} {rate}{of}" if signal.damping else UNKNOWN
            row["delay"] = f"{1e3 * signal.delay:.2g} ms"
        if has_integral:
            integral = if_known(signal.integral, signal.integral_deviation)
            unit = units.at(joint, "N·m/(rad·s)")
            row["integral"] = f"{integral} {unit}" if signal.integral else UNKNOWN
        if has_limit:
            row["limit"] = _limit(signal, units)
        if has_dead_band:
            band = if_known(signal.dead_band, signal.dead_band_deviation)
            unit = units.at(joint, "rad")
            row["dead band"] = f"{band} {unit}" if signal.dead_band else UNKNOWN
        rows.append(row)
    head = tuple(rows[0]) if rows else ()
    return Table(head, [cells(*row.values()) for row in rows], words=2)


def _limit(signal: EffortSignal, units: Units) -> str:
    """Return the effort limit of a joint, and its no-load speed."""
    if signal.limit == math.inf:
        return UNKNOWN
    limit = f"{number(signal.limit)} {units.at(signal.joint, 'N·m')}"
    if signal.no_load_speed == math.inf:
        return limit
    return f"{limit}, 0 at {number(signal.no_load_speed)} {units.at(signal.joint, 'rad/s')}"


def formulas_table(draft: Draft) -> Table:
    """Return drafted effects with their coefficients."""
    rows = []
    for effect in draft.effects:
        values = zip(effect.formula.parameters, effect.coefficients, effect.deviations, strict=True)
        coefficients = (
            f"{p.name} = {with_deviation(float(c), float(d))} {p.unit}".removesuffix(" 1")
            for p, c, d in values
        )
        joint = Cell(effect.formula.joint, typed=draft.names[effect.formula.joint])
        formula = "\n".join((effect.formula.words(), *coefficients))
        errors = effect.rms_before, effect.rms_after, effect.floor
        rows.append(cells(joint, formula, *errors, chance(effect.false_alarm_probability)))
    head = ("joint", "formula", "RMS before", "after", "noise", "false alarm")
    return Table(head, rows, words=2)


def bodies_table(bodies: Sequence[BodyChange]) -> Table:
    """Return mass and centre of mass of every body before and after, in kg and mm."""
    rows = [
        cells(
            *(body.name, body.mass[0], with_deviation(body.mass[1], body.mass_deviation)),
            *(_place(body.com[0]), _centre(body), "at the boundary" * body.at_boundary),
        )
        for body in bodies
    ]
    masses = [sum(body.mass[k] for body in bodies) for k in (0, 1)]
    head = ("body", "mass", "identified", "centre of mass", "identified", "")
    return Table(head, (*rows, cells("total", *masses, "", "", "")), total=1)


def _place(com: Array) -> str:
    """Return a point in whole millimetres."""
    return ", ".join(f"{x:.0f}".replace("-", "−") for x in np.round(_MILLIMETRES * com) + 0.0)


def _centre(body: BodyChange) -> Cell:
    """Return a centre of mass, and each coordinate with its deviation."""
    com, deviation = _MILLIMETRES * body.com[1], _MILLIMETRES * body.com_deviation
    pairs = zip(com.tolist(), deviation.tolist(), strict=True)
    coordinates = ", ".join(with_deviation(x, sigma) for x, sigma in pairs)
    size = float(np.linalg.norm(deviation))
    text = f"{size:.0f}" if size < _FAR else number(size)
    return Cell(f"{_place(body.com[1])} ± {text}", note=coordinates)


def _effects_table(found: ModelIdentification, units: Units) -> Table:
    """Return parameters of the fitted effects, except payloads, which are bodies."""
    rows = []
    for fitted in (each for each in found.model.effects if each.effect.role is not Role.BODY):
        where, name, deviations = fitted.effect.where, fitted.effect.name, fitted.deviations
        place = words.places_label(where, units.driven)
        label = Cell(words.effect_label(name), typed=name), place
        for k, parameter in enumerate(fitted.effect.parameters):
            deviation = math.nan if deviations is None else float(deviations[k])
            value = estimate(float(fitted.parameters[k]), deviation)
            unit = units.parameter(name, parameter.name, " & ".join(where))
            rows.append(cells(*(("", "") if k else label), parameter.name, value, unit))
    return Table(("effect", "where", "parameter", "value", "unit"), rows, words=3)


def _regularizers_table(found: ModelIdentification) -> Table:
    """Return the results of all regularizers."""
    rows = [
        cells(
            *(other.regularizer, ", ".join(other.at_boundary) or UNKNOWN, _gamma(other.gamma)),
            *(number(other.residual, 6), number(other.errors.nrms, 4)),
        )
        for other in found.alternatives
    ]
    head = ("regularizer", "at the boundary", "gamma", "training residual", "held-out nrms")
    return Table(head, rows, words=2)


def _gamma(value: float) -> str:
    """Return a regularizer's weight, which is unbounded under a loose residual bound."""
    return number(value) if math.isfinite(value) else "unbounded"


def _explanation_values(found: Explanation) -> dict[str, Any]:
    """Return the steps with their rivals, and the results that only the command computes."""
    steps = [
        record(
            "Step",
            step,
            rivals=[
                record("Rival", rival, probability=share)
                for rival, share in zip(step.rivals, step.probabilities_of_rivals, strict=True)
            ],
        )
        for step in found.steps
    ]
    values: dict[str, Any] = {"steps": steps}
    if not isinstance(found, Explained) or (found.added and found.draft is None):
        return values
    if found.draft is None:
        return {**values, "correlates": found.correlates, **motion_values(found.motions)}
    effects = []
    for effect in found.draft.effects:
        numbers = zip(
            effect.formula.parameters, effect.coefficients, effect.deviations, strict=True
        )
        coefficients = {p.name: (c, d, p.unit) for p, c, d in numbers}
        name = found.draft.names[effect.formula.joint]
        effects.append(record("DraftedEffect", effect, name=name, coefficients=coefficients))
    return {**values, "draft": record("Draft", found.draft, effects=effects)}


def motion_values(motions: Sequence[Rollout] | None) -> dict[str, Any]:
    """Return rollouts under commands before, after and between steps; empty without any."""
    if motions is None:
        return {}
    before, *between, after = motions
    return {"motion": {"before": before, "after": after, "steps": between}}


def _identification_values(found: ModelIdentification) -> dict[str, Any]:
    """Return the bodies of an identified model, and its effects with parameters."""
    model = found.model
    bodies = zip(model.bodies, model.phi, strict=True)
    return {
        "inertial_parameters": {
            body: dict(zip(PARAMETER_NAMES, phi, strict=True)) for body, phi in bodies
        },
        "effects": [fitted for fitted in model.effects if len(fitted.parameters)],
    }


def _step_records(found: Explanation) -> Records:
    """Return a row for each parameter of each step."""
    return [
        {
            "effect": step.effect,
            "where": where,
            "parameter": name,
            "value": value,
            "deviation": step.deviations.get(where, {}).get(name),
            **picked(step, "error_before", "error_after", "probability"),
        }
        for step in found.steps
        for where, values in step.parameters.items()
        for name, value in values.items()
    ]


def _body_records(found: ModelIdentification) -> Records:
    """Return a row for each body."""
    return [
        {
            "body": body.name,
            "mass_before": body.mass[0],
            "mass": body.mass[1],
            "mass_deviation": body.mass_deviation,
            **{f"com_{axis}_before": float(body.com[0][i]) for i, axis in enumerate("xyz")},
            **{f"com_{axis}": float(body.com[1][i]) for i, axis in enumerate("xyz")},
        }
        for body in found.bodies
    ]


VIEWS = {
    Comparison: View(
        comparison_page,
        "Comparison",
        records=lambda found: [
            picked(joint, "joint", "std", "rms", "floor", "nrms", "removable")
            for joint in found.errors.joints
        ],
        samples=comparison_series,
        figure="efforts",
    ),
    Diagnosis: View(
        diagnosis_page,
        "Diagnosis",
        records=lambda found: list(map(asdict, found.candidates)),
        samples=lambda found: comparison_series(found.comparison),
        figure="candidates",
    ),
    Explanation: View(
        explanation_page,
        "Explanation",
        _explanation_values,
        records=_step_records,
        samples=lambda found: comparison_series(found.after, found.before),
        figure="efforts",
    ),
    ModelIdentification: View(
        identification_page,
        "Identification",
        _identification_values,
        records=_body_records,
        samples=lambda found: comparison_series(found.comparison),
        figure="efforts",
    ),
}
"""Type of result -> its view."""
