"""Figures of the AMBIDEX study, like 3.7, 3.8 and 3.9 of the source."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from diagrams.studies.ambidex.arm import Arm
from diagrams.studies.ambidex.draws import (
    NAMES,
    Plan,
    compared,
    fit,
    full_friction,
    prior_of,
    training_data,
    zmp,
)
from diagrams.studies.ambidex.measurements import PERIOD, Measurements
from geodrake.errors import IdentificationError
from geodrake.inertia import PARAMETERS_PER_BODY
from geodrake.report import style
from geodrake.report.ellipsoid_figure import ellipsoid_figure
from geodrake.report.ellipsoids import EllipsoidSet

COLORS = {
    "euclidean": "#c8442f",
    "point_mass_euclidean": "#e08a3c",
    "point_mass_kl": "#b9a03a",
    "pullback": "#3f9c6b",
    "entropic": "#1b6ca8",
    "riemannian": "#7b5aa6",
}
LABELS = {
    "euclidean": "Euclidean",
    "point_mass_euclidean": "Euclidean, point masses",
    "point_mass_kl": "KL, point masses",
    "pullback": "constant pullback",
    "entropic": "entropic",
    "riemannian": "Riemannian",
}
MILLI = 1e3
SHOWN = 400  # samples of the ZMP, 4 s
EXAMPLE = 30  # training samples of the fits that are drawn
TRUTH, PRIOR = "true bodies", "prior"


def write_figures(
    folder: Path, summary: Sequence[dict[str, Any]], plan: Plan, made: tuple[Arm, Measurements]
) -> None:
    """Write all figures of a run into a folder as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    arm, measured = made
    models = example(measured, plan)
    figures = {
        "ambidex_errors": error_figure(summary, plan),
        "ambidex_zmp": zmp_figure(measured, models),
        "ambidex_ellipsoids": link_figure(arm, models),
    }
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png")


def error_figure(summary: Sequence[dict[str, Any]], plan: Plan) -> Figure:
    """Errors against the number of training samples, like figure 3.7 of the source."""
    figure = style.new_figure(7.4)
    panels = {
        "training": "Motor torques, training samples: RMS error, mN·m",
        "test": "Motor torques, test samples: RMS error, mN·m",
        "rigid": "Torques of the true bodies on test motions: RMS error, mN·m",
        "distance": "Geodesic distance of the links from the true ones",
    }
    axes = figure.subplots(2, 2).ravel()
    for ax, (column, title) in zip(axes, panels.items(), strict=True):
        style.polish(ax).set_title(title, loc="left", **style.plain(fontweight="bold"))
        scale = 1.0 if column == "distance" else MILLI
        _draw_errors(ax, summary, column, scale)
        ax.set_xscale("log")
        ax.set_xticks(plan.counts, [str(count) for count in plan.counts])
        ax.minorticks_off()
        ax.set_xlabel("training samples, at 100 Hz", **style.plain(style.SMALL, style.QUIET))
    style.log_scale(axes[3], "y")
    handles = [
        Line2D([], [], color=COLORS[name], marker="o", markersize=4, label=LABELS[name])
        for name in NAMES
    ]
    handles.append(Line2D([], [], color=style.QUIET, linestyle="--", label="prior"))
    handles.append(Line2D([], [], color="black", linewidth=2, label="entropic, all samples"))
    style.legend_above(figure, handles, columns=4)
    style.note_below(
        figure,
        f"Means and standard deviations over {plan.draws} draws of prior and samples; all at the "
        f"training residual of the entropic divergence with γ = {plan.gamma:g} (N·m)², the "
        "Riemannian distance at its γ.",
    )
    return figure


def _draw_errors(ax: Axes, summary: Sequence[dict[str, Any]], column: str, scale: float) -> None:
    """One line a regularizer, side by side at each number of samples."""
    for k, name in enumerate(NAMES):
        lines = [line for line in summary if line["regularizer"] == name]
        count = np.array([line["samples"] for line in lines]) * 1.06 ** (k - len(NAMES) / 2)
        mean = scale * np.array([line[column] for line in lines])
        deviation = scale * np.array([line[f"{column}_deviation"] for line in lines])
        if column == "distance":  # whose axis is logarithmic
            deviation = np.minimum(deviation, 0.9 * mean)
        ax.errorbar(
            count,
            mean,
            deviation,
            color=COLORS[name],
            marker="o",
            markersize=3.5,
            linewidth=1.2,
            elinewidth=0.9,
            capsize=2,
        )
    prior = next(line for line in summary if line["regularizer"] == "prior")
    entropic = [line for line in summary if line["regularizer"] == "entropic"]
    if column in prior:
        ax.axhline(scale * prior[column], color=style.QUIET, linestyle="--", linewidth=1.4)
        last = max(entropic, key=lambda line: line["samples"])
        ax.axhline(scale * last[column], color="black", linewidth=1.8, zorder=0.5)


def zmp_figure(measured: Measurements, models: Sequence[EllipsoidSet]) -> Figure:
    """Zero-moment points on the ground, like figure 3.9 of the source."""
    points = {one.name: 100.0 * zmp(measured, one.phi)[: SHOWN // 5] for one in models}
    colors = {one.name: one.color for one in models}
    time = 5 * PERIOD * np.arange(SHOWN // 5)
    figure = style.new_figure(4.6)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.6, 1.0))
    axes = [figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])]
    plane = figure.add_subplot(grid[:, 1])
    for name, at in points.items():
        look = {
            "color": colors[name],
            "linewidth": 2.4 if name == TRUTH else 1.2,
            "linestyle": "--" if name == PRIOR else "-",
            "label": name,
        }
        for ax, values in zip(axes, at.T, strict=True):
            ax.plot(time, values, **look)
        plane.plot(at[:, 0], at[:, 1], **look)
    for ax, name in zip(axes, "xy", strict=True):
        style.polish(ax).set_ylabel(f"{name}, cm", **style.plain())
    axes[1].set_xlabel("time, s", **style.plain())
    style.polish(plane).set_xlabel("x, cm", **style.plain())
    plane.set_ylabel("y, cm", **style.plain())
    plane.set_aspect("equal", adjustable="datalim")
    style.legend_above(figure, plane.get_legend_handles_labels()[0])
    style.note_below(
        figure,
        "Zero-moment point of the arm alone on the ground, 1 m below its shoulder; test motions, "
        "one draw, 30 training samples.",
    )
    return figure


def link_figure(arm: Arm, models: Sequence[EllipsoidSet]) -> Figure:
    """The links as ellipsoids, like figure 3.8 of the source."""
    links = [replace(one, phi=one.phi[:10], at_boundary=one.at_boundary[:10]) for one in models]
    context = arm.plant.CreateDefaultContext()
    turns = np.array([[0.3, -0.5, 0.2, 1.2, 0.0, 0.4, 0.0]])
    arm.plant.SetPositions(context, arm.transmission.joint_positions(arm.motors(turns))[0])
    return ellipsoid_figure(arm.plant, links, context=context)


def example(measured: Measurements, plan: Plan) -> list[EllipsoidSet]:
    """Truth, prior, and fits to 30 samples of the first draw, as far as there are solutions."""
    _, prior = prior_of(0, plan, measured)
    friction = full_friction(prior, plan, measured)
    data = training_data(0, EXAMPLE, friction, plan, measured)
    entropic = fit(data, prior, "entropic", measured, gamma=plan.gamma)
    fits = {"entropic": entropic}
    with suppress(IdentificationError):
        found = compared(data, prior, "euclidean", measured, entropic)
        fits = {"euclidean": found, **fits}
    models = [
        EllipsoidSet.of(TRUTH, measured.truth, color=style.INK),
        EllipsoidSet.of(PRIOR, prior, color=style.QUIET),
    ]
    for name, one in fits.items():
        flat = [column // PARAMETERS_PER_BODY for column in one.active_blocks]
        models.append(EllipsoidSet.of(LABELS[name], one.phi, color=COLORS[name], at_boundary=flat))
    return models
