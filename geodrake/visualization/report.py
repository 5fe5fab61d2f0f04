"""Reports: one self-contained HTML page for a comparison, a diagnosis or an explanation."""

from __future__ import annotations

import hashlib
import importlib.metadata
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from geodrake.diagnosis.results import Comparison, Diagnosis, Explanation
from geodrake.errors import OutputError
from geodrake.escaping import path_part
from geodrake.visualization import sections, style, words
from geodrake.visualization.figures import (
    candidate_figure,
    joint_error_figure,
    step_figure,
    step_stages,
)
from geodrake.visualization.numbers import number, percent
from geodrake.visualization.page import Page, Section, Tile, pictures, render, without_empty
from geodrake.visualization.series_figures import effort_figure, residual_figure
from geodrake.visualization.units import Units
from geodrake.whole_files import write_together

_CAPTIONS = {
    "steps": "The error on held-out data falling with each step, on a logarithmic axis.",
    "candidates": "The error on held-out data that each candidate would leave.",
    "joint_errors": "RMS error of each joint over the standard deviation of its effort, on a "
    "logarithmic axis.",
    "efforts": "Measured and predicted efforts, and under them measured − predicted. Lines break "
    "where samples were left out.",
    "residuals_before": "What the model as it stands gets wrong: measured − predicted effort "
    "against velocity, position and load.",
    "residuals_after": "What the final model still gets wrong, each joint on its own scale.",
}


def render_comparison(
    comparison: Comparison,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
    more: Sequence[Section] = (),
) -> str:
    """The report of a comparison.

    Args:
        comparison: The result of `geodrake.diagnosis.compare.compare`.
        title: Title of the page.
        model_name: What the model is called.
        log_names: What the logs are called.
        units: Units of the joints, `Units.of(model)`; those of revolute joints by default.
        more: Further sections, after those of the errors.

    Returns:
        One HTML page that loads nothing from elsewhere.
    """
    units = units or Units()
    errors = comparison.errors
    figures = comparison_figures(comparison, units=units)
    tiles = (
        Tile("error", number(errors.nrms), "nrms: error over std of the effort"),
        Tile("sensor noise", number(errors.floor_nrms), "the nrms of a perfect model"),
        Tile("removable", percent(words.removable_share(errors)), "of the squared error"),
    )
    parts = (
        _with_pictures(sections.joints_section(errors, None, units), figures, "joint_errors"),
        sections.failing_section(comparison),
        _figures_section(figures, without=("joint_errors",)),
        *more,
        sections.method_section(comparison, refitted=False),
        sections.notes_section(comparison.notes),
    )
    page = Page(
        title,
        _subject(model_name, log_names),
        "compared",
        "compared",
        words.comparison_headline(comparison),
        words.comparison_lead(comparison),
        tiles,
        without_empty(parts),
        _footer(comparison),
    )
    return render(page)


def render_diagnosis(
    diagnosis: Diagnosis,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
) -> str:
    """The report of a diagnosis; arguments as for `render_comparison`."""
    units = units or Units()
    start, comparison = diagnosis.start, diagnosis.comparison
    best = diagnosis.candidates[0].error_after if diagnosis.candidates else diagnosis.refitted.nrms
    tiles = (
        Tile("as it stands", number(start.nrms), "nrms: error over std of the effort"),
        Tile("refitted", number(diagnosis.refitted.nrms), "its own parameters, held-out data"),
        *([Tile("with the effect", number(best), "held-out data")] if diagnosis.candidates else []),
        Tile("sensor noise", number(start.floor_nrms), "the nrms of a perfect model"),
    )
    figures = diagnosis_figures(diagnosis, units=units)
    ranking = sections.candidates_section(diagnosis, units)
    parts = (
        _with_pictures(ranking, figures, "candidates"),
        _with_pictures(sections.joints_section(start, None, units), figures, "joint_errors"),
        sections.failing_section(comparison),
        _figures_section(figures, without=("candidates", "joint_errors")),
        sections.method_section(comparison, refitted=True),
        sections.notes_section(diagnosis.notes),
    )
    page = Page(
        title,
        _subject(model_name, log_names),
        diagnosis.verdict,
        "effect found" if diagnosis.candidates else diagnosis.verdict,
        words.diagnosis_headline(diagnosis),
        words.diagnosis_lead(diagnosis),
        tiles,
        without_empty(parts),
        _footer(comparison),
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
) -> str:
    """The report of an explanation; arguments as for `render_comparison`.

    Units are those of the explanation's own model; `advice` are paragraphs that end the verdict.
    """
    units = Units.of(explanation.model)
    start, end = explanation.start, explanation.end
    joints = sections.joints_section(start, end if explanation.steps else None, units)
    figures = report_figures(explanation)
    parts = (
        _with_pictures(sections.steps_section(explanation, units), figures, "steps"),
        sections.parameters_section(explanation, units),
        _with_pictures(joints, figures, "joint_errors"),
        sections.failing_section(explanation.after),
        *more,
        _figures_section(figures, without=("steps", "joint_errors")),
        sections.method_section(explanation.after, refitted=True),
        sections.notes_section(explanation.notes),
    )
    page = Page(
        title,
        _subject(model_name, log_names),
        explanation.verdict,
        words.explanation_mark(explanation),
        words.explanation_headline(explanation),
        (*words.explanation_lead(explanation), *advice),
        _explanation_tiles(explanation),
        without_empty(parts),
        _footer(explanation.before),
    )
    return render(page)


def comparison_figures(comparison: Comparison, *, units: Units | None = None) -> dict[str, Figure]:
    """The figures of a comparison's report, by name."""
    return {
        "efforts": effort_figure(comparison, units=units),
        "residuals_before": residual_figure(comparison, units=units),
        "joint_errors": joint_error_figure(comparison.errors),
    }


def diagnosis_figures(diagnosis: Diagnosis, *, units: Units | None = None) -> dict[str, Figure]:
    """The figures of a diagnosis' report, by name."""
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
    explained = Tile("explained", percent(gone), "of the squared error")
    return (
        Tile("as it stands", number(start.nrms), "nrms: error over std of the effort"),
        *([now] if explanation.steps else []),
        Tile("sensor noise", number(end.floor_nrms), "the nrms of a perfect model"),
        *([explained] if explanation.steps else []),
        Tile("removable", percent(words.removable_share(end)), "of the squared error left"),
    )


def _figures_section(figures: Mapping[str, Figure], without: Sequence[str] = ()) -> Section:
    captions = {name: text for name, text in _CAPTIONS.items() if name not in without}
    return Section("Measured and predicted", pictures=pictures(figures, captions))


def _with_pictures(section: Section, figures: Mapping[str, Figure], *names: str) -> Section:
    captions = {name: _CAPTIONS[name] for name in names}
    return Section(
        section.title, section.text, section.tables, section.items, pictures(figures, captions)
    )


def _subject(model_name: str, log_names: Sequence[str]) -> str:
    return f"{model_name} against {', '.join(log_names)}"


def _footer(comparison: Comparison) -> str:
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
