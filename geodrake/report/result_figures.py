"""Figures of results by name, and the way to PNG files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib.figure import Figure

from geodrake.boundary.arguments import typed
from geodrake.boundary.escaping import path_part
from geodrake.boundary.whole_files import made_folder, write_together
from geodrake.diagnosis.results import Diagnosis, Explanation
from geodrake.identification.logs.model_errors import Comparison
from geodrake.report import style
from geodrake.report.figures import (
    candidate_figure,
    joint_error_figure,
    step_figure,
    step_stages,
)
from geodrake.report.numbers import Units
from geodrake.report.series_figures import effort_figure, residual_figure


@typed
def comparison_figures(comparison: Comparison, *, units: Units | None = None) -> dict[str, Figure]:
    """Return the figures of a comparison's report, by name.

    Args:
        units: Units of the joints; those of revolute joints by default.
    """
    return {
        "efforts": effort_figure(comparison, units=units),
        "residuals_before": residual_figure(comparison, units=units),
        "joint_errors": joint_error_figure(comparison.errors),
    }


@typed
def diagnosis_figures(diagnosis: Diagnosis, *, units: Units | None = None) -> dict[str, Figure]:
    """Return the figures of a diagnosis' report, by name.

    Args:
        units: Units of the joints; those of revolute joints by default.
    """
    figures = comparison_figures(diagnosis.comparison, units=units)
    if diagnosis.candidates:
        figures["candidates"] = candidate_figure(diagnosis)
    return figures


@typed
def report_figures(explanation: Explanation) -> dict[str, Figure]:
    """Return the figures of an explanation's report, by name."""
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


@typed
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
    with made_folder(folder):
        write_together({paths[name]: style.png(figure) for name, figure in figures.items()})
    return tuple(paths.values())
