"""Reports: one self-contained HTML page for a comparison, a diagnosis or an explanation."""

from __future__ import annotations

import hashlib
import importlib.metadata
from collections.abc import Mapping, Sequence
from dataclasses import replace

from geodrake.boundary.arguments import typed
from geodrake.diagnosis.results import Diagnosis, Explanation
from geodrake.identification.logs.model_errors import Comparison
from geodrake.report import sections, words
from geodrake.report.bars import Bars, candidate_bars, joint_bars, step_bars, step_joint_bars
from geodrake.report.effort_chart import AFTER, BEFORE, effort_chart, explanation_chart
from geodrake.report.numbers import Units, number, percent
from geodrake.report.page import Page, Section, Tile, render, without_empty
from geodrake.report.tables import error_stages


@typed
def render_comparison(
    comparison: Comparison,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
    links: Mapping[str, str] | None = None,
) -> str:
    """Return the report of a comparison.

    Args:
        model_name: What the model is called.
        log_names: What the logs are called.
        units: Units of the joints, `Units.of(model)`; those of revolute joints by default.
        links: Words -> address of further pages, such as a recording; none by default.

    Returns:
        One HTML page that loads nothing from elsewhere.
    """
    units = units or Units()
    errors = comparison.errors
    tiles = (
        sections.error_tile("error", errors, units),
        sections.worst_tile(errors),
        sections.noise_tile(errors),
        *sections.removable_tiles(errors, "of the squared error"),
    )
    joints = sections.joints_section({"RMS": errors}, units)
    parts = (
        with_bars(joints, joint_bars(errors)),
        sections.failing_section(comparison, charts=[effort_chart(comparison, units=units)]),
        sections.dependence_section({BEFORE: comparison}, units),
        sections.method_section(comparison, refitted=False),
        sections.notes_section(comparison.notes),
    )
    page = Page(
        title,
        subject(model_name, log_names),
        "compared",
        "compared",
        words.comparison_headline(comparison),
        words.comparison_lead(comparison),
        tiles,
        without_empty(parts),
        footer(comparison),
        links or {},
    )
    return render(page)


@typed
def render_diagnosis(
    diagnosis: Diagnosis,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
    links: Mapping[str, str] | None = None,
) -> str:
    """Return the report of a diagnosis; arguments as for `render_comparison`.

    Args:
        model_name: What the model is called.
        log_names: What the logs are called.
        units: Units of the joints, `Units.of(model)`; those of revolute joints by default.
        links: Words -> address of further pages, such as a recording; none by default.
    """
    units = units or Units()
    start, comparison = diagnosis.start, diagnosis.comparison
    best = diagnosis.candidates[0].error_after if diagnosis.candidates else diagnosis.refitted.nrms
    tiles = (
        sections.error_tile("as it stands", start, units),
        sections.error_tile("refitted", diagnosis.refitted, units, "held-out data"),
        *(
            [Tile("with the effect", number(best), "nrms: held-out data")]
            if diagnosis.candidates
            else []
        ),
        sections.worst_tile(start),
        sections.noise_tile(start),
    )
    ranking = sections.candidates_section(diagnosis, units)
    if diagnosis.candidates:
        ranking = with_bars(ranking, candidate_bars(diagnosis))
    joints = sections.joints_section({"RMS": start}, units)
    parts = (
        ranking,
        with_bars(joints, joint_bars(start)),
        sections.failing_section(comparison, charts=[effort_chart(comparison, units=units)]),
        sections.dependence_section({BEFORE: comparison}, units),
        sections.method_section(comparison, refitted=True),
        sections.notes_section(diagnosis.notes),
    )
    page = Page(
        title,
        subject(model_name, log_names),
        diagnosis.verdict,
        "effect found" if diagnosis.candidates else diagnosis.verdict,
        words.diagnosis_headline(diagnosis),
        words.diagnosis_lead(diagnosis),
        tiles,
        without_empty(parts),
        footer(comparison),
        links or {},
    )
    return render(page)


@typed
def render_explanation(
    explanation: Explanation,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    more: Sequence[Section] = (),
    advice: Sequence[str] = (),
    links: Mapping[str, str] | None = None,
) -> str:
    """Return the report of an explanation; arguments as for `render_comparison`.

    Units are those of the explanation's own model; `advice` are paragraphs that end the verdict.

    Args:
        explanation: The result of `geodrake.diagnosis.explain` or `add`; units are those of its
            model.
        model_name: What the model is called.
        log_names: What the logs are called.
        links: Words -> address of further pages, such as a recording; none by default.
    """
    units = Units.of(explanation.model)
    joints = sections.joints_section(error_stages(explanation), units)
    before, after = explanation.before, explanation.after if explanation.steps else None
    steps = sections.steps_section(explanation, units)
    if explanation.steps:
        steps = with_bars(steps, step_bars(explanation))
    charts = [explanation_chart(explanation, units)]
    models = {BEFORE: before} if after is None else {BEFORE: before, AFTER: after}
    parts = (
        steps,
        sections.failing_section(before, after, charts=charts),
        sections.parameters_section(explanation, units),
        sections.bodies_section(explanation),
        sections.signals_section(explanation.model.effort_signals, units),
        sections.limits_section(explanation.model.effort_signals, units),
        with_bars(joints, step_joint_bars(explanation)),
        *more,
        sections.dependence_section(models, units),
        sections.method_section(explanation.after, refitted=True),
        sections.notes_section(explanation.notes),
    )
    page = Page(
        title,
        subject(model_name, log_names),
        explanation.verdict,
        words.explanation_mark(explanation),
        words.explanation_headline(explanation),
        (*words.explanation_lead(explanation), *advice),
        _explanation_tiles(explanation, units),
        without_empty(parts),
        footer(explanation.before),
        links or {},
    )
    return render(page)


def _explanation_tiles(explanation: Explanation, units: Units) -> tuple[Tile, ...]:
    start, end = explanation.start, explanation.end
    gone = words.explained_share(start.nrms, end.nrms)
    now = sections.error_tile("now", end, units, "held-out data")
    explained = Tile("explained", percent(gone) if gone > 0 else "none", "of the squared error")
    return (
        sections.error_tile("as it stands", start, units),
        *([now] if explanation.steps else []),
        sections.worst_tile(start, end if explanation.steps else None),
        sections.noise_tile(end),
        *([explained] if explanation.steps else []),
        *sections.removable_tiles(end, "of the squared error left"),
    )


def with_bars(section: Section, bars: Bars) -> Section:
    """Return a section with one figure of bars more."""
    return replace(section, bars=(*section.bars, bars))


def subject(model_name: str, log_names: Sequence[str]) -> str:
    """Return what was compared with what, in words."""
    return f"{model_name} against {', '.join(log_names)}"


def footer(comparison: Comparison) -> str:
    """Versions of geodrake and of the data."""
    try:
        version = importlib.metadata.version("geodrake")
    except importlib.metadata.PackageNotFoundError:
        version = "(not installed)"
    digest = hashlib.sha256()
    for series in comparison.series:
        digest.update(f"{series.joint}\n{series.block}\n".encode(errors="surrogateescape"))
        for values in (series.time, series.position, series.measured):
            digest.update(values.round(9).tobytes())
    samples = sum(len(series.time) for series in comparison.series)
    return (
        f"Made by geodrake {version}. Data: {samples} prepared samples of effort with fingerprint "
        f"{digest.hexdigest()[:12]}; the same logs, prepared in the same way, have the same one."
    )
