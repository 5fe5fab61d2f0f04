"""Reports: one self-contained HTML page for a comparison, a diagnosis or an explanation."""

from __future__ import annotations

import hashlib
import importlib.metadata
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from matplotlib.figure import Figure

from geodrake.boundary.escaping import path_part
from geodrake.boundary.whole_files import write_together
from geodrake.diagnosis.results import Diagnosis, Explanation
from geodrake.errors import OutputError
from geodrake.identification.logs.model_errors import Comparison
from geodrake.report import sections, style, words
from geodrake.report.effort_chart import AFTER, BEFORE, effort_chart, explanation_chart
from geodrake.report.figures import (
    candidate_figure,
    joint_error_figure,
    step_figure,
    step_stages,
)
from geodrake.report.numbers import Units, number, percent
from geodrake.report.page import Page, Section, Tile, picture, render, without_empty
from geodrake.report.series_figures import effort_figure, residual_figure
from geodrake.report.tables import error_stages

_CAPTIONS = {
    "steps": "The error on held-out data falling with each step, on a logarithmic axis.",
    "candidates": "The error on held-out data that each candidate would leave.",
    "joint_errors": "RMS error of each joint over the standard deviation of its effort, on a "
    "logarithmic axis.",
}


def render_comparison(
    comparison: Comparison,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
    links: Mapping[str, str] | None = None,
) -> str:
    """The report of a comparison.

    Args:
        comparison: The result of `geodrake.identification.logs.compare.compare`.
        title: Title of the page.
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
        Tile("error", number(errors.nrms), "nrms: error over std of the effort"),
        sections.worst_tile(errors),
        sections.noise_tile(errors),
        *sections.removable_tiles(errors, "of the squared error"),
    )
    joints = sections.joints_section({"RMS": errors}, units)
    parts = (
        with_picture(joints, "joint_errors", joint_error_figure(errors)),
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


def render_diagnosis(
    diagnosis: Diagnosis,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
    links: Mapping[str, str] | None = None,
) -> str:
    """The report of a diagnosis; arguments as for `render_comparison`.

    Args:
        diagnosis: The result of `geodrake.diagnosis.diagnose`.
        title: Title of the page.
        model_name: What the model is called.
        log_names: What the logs are called.
        units: Units of the joints, `Units.of(model)`; those of revolute joints by default.
        links: Words -> address of further pages, such as a recording; none by default.
    """
    units = units or Units()
    start, comparison = diagnosis.start, diagnosis.comparison
    best = diagnosis.candidates[0].error_after if diagnosis.candidates else diagnosis.refitted.nrms
    tiles = (
        Tile("as it stands", number(start.nrms), "nrms: error over std of the effort"),
        Tile("refitted", number(diagnosis.refitted.nrms), "its own parameters, held-out data"),
        *([Tile("with the effect", number(best), "held-out data")] if diagnosis.candidates else []),
        sections.worst_tile(start),
        sections.noise_tile(start),
    )
    ranking = sections.candidates_section(diagnosis, units)
    if diagnosis.candidates:
        ranking = with_picture(ranking, "candidates", candidate_figure(diagnosis))
    joints = sections.joints_section({"RMS": start}, units)
    parts = (
        ranking,
        with_picture(joints, "joint_errors", joint_error_figure(start)),
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
    """The report of an explanation; arguments as for `render_comparison`.

    Units are those of the explanation's own model; `advice` are paragraphs that end the verdict.

    Args:
        explanation: The result of `geodrake.diagnosis.explain` or `add`; units are those of its
            model.
        title: Title of the page.
        model_name: What the model is called.
        log_names: What the logs are called.
        more: Further sections, after those of the explanation.
        advice: Paragraphs that end the verdict.
        links: Words -> address of further pages, such as a recording; none by default.
    """
    units = Units.of(explanation.model)
    joints = sections.joints_section(error_stages(explanation), units)
    before, after = explanation.before, explanation.after if explanation.steps else None
    steps = sections.steps_section(explanation, units)
    if explanation.steps:
        steps = with_picture(steps, "steps", step_figure(explanation))
    bars = joint_error_figure(explanation.start, step_stages(explanation))
    charts = [explanation_chart(explanation, units)]
    models = {BEFORE: before} if after is None else {BEFORE: before, AFTER: after}
    parts = (
        steps,
        sections.failing_section(before, after, charts=charts),
        sections.parameters_section(explanation, units),
        sections.bodies_section(explanation),
        sections.signals_section(explanation.model.effort_signals, units),
        with_picture(joints, "joint_errors", bars),
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
        _explanation_tiles(explanation),
        without_empty(parts),
        footer(explanation.before),
        links or {},
    )
    return render(page)


def comparison_figures(comparison: Comparison, *, units: Units | None = None) -> dict[str, Figure]:
    """The figures of a comparison's report, by name.

    Args:
        comparison: The comparison.
        units: Units of the joints; those of revolute joints by default.
    """
    return {
        "efforts": effort_figure(comparison, units=units),
        "residuals_before": residual_figure(comparison, units=units),
        "joint_errors": joint_error_figure(comparison.errors),
    }


def diagnosis_figures(diagnosis: Diagnosis, *, units: Units | None = None) -> dict[str, Figure]:
    """The figures of a diagnosis' report, by name.

    Args:
        diagnosis: The diagnosis.
        units: Units of the joints; those of revolute joints by default.
    """
    figures = comparison_figures(diagnosis.comparison, units=units)
    if diagnosis.candidates:
        figures["candidates"] = candidate_figure(diagnosis)
    return figures


def report_figures(explanation: Explanation) -> dict[str, Figure]:
    """The figures of an explanation's report, by name."""
    units = Units.of(explanation.model)
    before, after = explanation.before, explanation.after
    if not explanation.steps:
        return comparison_figures(before, units=units)
    return {
        "steps": step_figure(explanation),
        "joint_errors": joint_error_figure(explanation.start, step_stages(explanation)),
        "efforts": effort_figure(before, after=after, units=units),
        "residuals_before": residual_figure(before, units=units),
        "residuals_after": residual_figure(after, color=style.AFTER, units=units),
    }


def save_figures(figures: Mapping[str, Figure], folder: str | Path) -> tuple[Path, ...]:
    """Write figures as PNG files, all of them or none.

    Args:
        figures: Name -> figure, such as `report_figures` gives.
        folder: Where `<name>.png` goes; made if it does not exist.

    Raises:
        OutputError: A file cannot be written.
    """
    folder = Path(folder)
    paths = {name: folder / f"{path_part(name)}.png" for name in figures}
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"Cannot write to {folder}: {error.strerror}.",
            advice="Choose another place.",
            path=folder,
        ) from error
    write_together({paths[name]: style.png(figure) for name, figure in figures.items()})
    return tuple(paths.values())


def _explanation_tiles(explanation: Explanation) -> tuple[Tile, ...]:
    start, end = explanation.start, explanation.end
    gone = words.explained_share(start.nrms, end.nrms)
    now = Tile("now", number(end.nrms), "nrms on held-out data")
    explained = Tile("explained", percent(gone) if gone > 0 else "none", "of the squared error")
    return (
        Tile("as it stands", number(start.nrms), "nrms: error over std of the effort"),
        *([now] if explanation.steps else []),
        sections.worst_tile(start, end if explanation.steps else None),
        sections.noise_tile(end),
        *([explained] if explanation.steps else []),
        *sections.removable_tiles(end, "of the squared error left"),
    )


def with_picture(section: Section, name: str, figure: Figure) -> Section:
    """A section with one figure more, and its caption.

    Args:
        section: The section without it.
        name: Name of the figure, which decides its caption.
        figure: The figure.
    """
    return replace(section, pictures=(*section.pictures, picture(figure, _CAPTIONS[name])))


def subject(model_name: str, log_names: Sequence[str]) -> str:
    """What was compared with what, in words.

    Args:
        model_name: What the model is called.
        log_names: What the logs are called.
    """
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
