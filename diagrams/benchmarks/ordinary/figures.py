"""The figure of the calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from diagrams.benchmarks.ordinary.lines import BINS, calibration
from geodrake.report import style


def write_figures(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the figure into a folder as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    calibration_figure(rows).savefig(folder / "ordinary_calibration.png")


def calibration_figure(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """How many of the things said with a probability are true, against that probability.

    Probabilities are those of the odds' logarithm, so that 0.9 and 0.99 stand apart.
    """
    figure = style.new_figure(4.2)
    axes = figure.subplots()
    steps = [step for row in rows for step in row["steps"]]
    ideal = np.linspace(0.5, 0.9995, 400)
    axes.plot(_place(ideal), 100 * ideal, color=style.FLOOR, linewidth=1.2, label="as said")
    for (low, high), line in zip(BINS, calibration(rows), strict=True):
        said = [step["probability"] for step in steps if low < step["probability"] <= high]
        if line.value is None:
            continue
        at = float(_place(np.mean(said)))
        axes.plot([at, at], [100 * line.low, 100 * line.high], color=style.AFTER, alpha=0.35, lw=5)
        axes.plot(at, 100 * line.value, "o", color=style.AFTER)
        axes.annotate(
            f"{sum(step['right'] for step in steps if low < step['probability'] <= high)}"
            f" of {line.logs}",
            (at, 100 * line.value),
            xytext=(8, -4),
            textcoords="offset points",
            **style.plain(style.SMALL, style.QUIET),
        )
    ticks = np.array([0.5, 0.7, 0.9, 0.97, 0.99, 0.999])
    axes.set_xticks(_place(ticks), [f"{100 * tick:g} %" for tick in ticks])
    edges = np.array([low for low, _ in BINS[1:]])
    for edge in _place(edges):
        axes.axvline(edge, color=style.RULE, linewidth=1.0)
    axes.set_ylim(0.0, 103.0)
    axes.set_xlabel("probability that was said, mean of the bin", **style.plain())
    axes.set_ylabel("of these true, %", **style.plain())
    style.polish(axes, grid="y")
    axes.set_title(
        f"What was said of {len(rows)} robots: how much of it is true (95 % interval)",
        loc="left",
        **style.plain(fontweight="bold"),
    )
    style.note_below(figure, "Green: as many as said. Grey: the bins' edges.")
    return figure


def _place(probability: Any) -> Any:
    """Where a probability stands: decades of its odds, at most as of 0.9995."""
    p = np.minimum(probability, 0.9995)
    return np.log10(p / (1.0 - p))
