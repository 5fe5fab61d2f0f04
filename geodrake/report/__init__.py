"""What results look like: matplotlib figures, and reports as self-contained HTML pages."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geodrake.report.adaptation_view import AdaptationView, save_recording
    from geodrake.report.draft import draft_figure, render_drafted
    from geodrake.report.excitation import (
        eigenvalue_figure,
        render_excitation,
    )
    from geodrake.report.explained import render_explained
    from geodrake.report.export_page import render_export
    from geodrake.report.figures import (
        candidate_figure,
        joint_error_figure,
        step_figure,
        step_stages,
    )
    from geodrake.report.identifiable import identifiable_figure, render_identifiable
    from geodrake.report.identification_page import render_identification
    from geodrake.report.numbers import Units
    from geodrake.report.report import render_comparison, render_diagnosis, render_explanation
    from geodrake.report.result_figures import (
        comparison_figures,
        diagnosis_figures,
        report_figures,
        save_figures,
    )
    from geodrake.report.rollout import render_rollout
    from geodrake.report.rollout_fit import render_rollout_fit
    from geodrake.report.series_figures import effort_figure, residual_figure

__all__ = [
    "AdaptationView",
    "Units",
    "candidate_figure",
    "comparison_figures",
    "diagnosis_figures",
    "draft_figure",
    "effort_figure",
    "eigenvalue_figure",
    "identifiable_figure",
    "joint_error_figure",
    "render_comparison",
    "render_diagnosis",
    "render_drafted",
    "render_excitation",
    "render_explained",
    "render_explanation",
    "render_export",
    "render_identifiable",
    "render_identification",
    "render_rollout",
    "render_rollout_fit",
    "report_figures",
    "residual_figure",
    "save_figures",
    "save_recording",
    "step_figure",
    "step_stages",
]

_MODULES = (
    "numbers",
    "report",
    "explained",
    "result_figures",
    "draft",
    "excitation",
    "export_page",
    "figures",
    "identifiable",
    "identification_page",
    "rollout",
    "rollout_fit",
    "series_figures",
    "adaptation_view",
)


def __getattr__(name: str) -> Any:
    """Import matplotlib when a figure is first asked for; words and most pages need none."""
    if name in __all__:
        for module in _MODULES:
            found = vars(import_module(f"geodrake.report.{module}"))
            if name in found:
                return found[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
