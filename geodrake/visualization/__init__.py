"""What results look like: matplotlib figures, and reports as self-contained HTML pages."""

from __future__ import annotations

from geodrake.visualization.adaptation_view import AdaptationView, save_recording
from geodrake.visualization.draft import draft_figure, render_drafted, render_explained
from geodrake.visualization.excitation import (
    eigenvalue_figure,
    motion_figure,
    render_excitation,
)
from geodrake.visualization.figures import (
    candidate_figure,
    joint_error_figure,
    step_figure,
    step_stages,
)
from geodrake.visualization.identifiable import identifiable_figure, render_identifiable
from geodrake.visualization.identification_page import render_identification
from geodrake.visualization.report import (
    comparison_figures,
    diagnosis_figures,
    render_comparison,
    render_diagnosis,
    render_explanation,
    report_figures,
    save_figures,
)
from geodrake.visualization.rollout import render_rollout, rollout_figure
from geodrake.visualization.series_figures import effort_figure, residual_figure
from geodrake.visualization.units import Units

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
    "motion_figure",
    "render_comparison",
    "render_diagnosis",
    "render_drafted",
    "render_excitation",
    "render_explained",
    "render_explanation",
    "render_identifiable",
    "render_identification",
    "render_rollout",
    "report_figures",
    "residual_figure",
    "rollout_figure",
    "save_figures",
    "save_recording",
    "step_figure",
    "step_stages",
]
