"""Figure of adaptive computed torque and passivity-based control."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from diagrams.studies.adaptive.laws import COLORS
from diagrams.studies.adaptive.wam_figures import legend
from geodrake.report import style

NAMES = {
    "passivity": "passivity-based",
    "acceleration": "computed torque,\nacceleration",
    "filtered": "computed torque,\nfiltered regressor",
}
WIDTH = 0.25


def write_controller_figure(folder: Path, summary: Sequence[dict[str, Any]]) -> None:
    """Write the figure into a folder as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    controller_figure(summary).savefig(folder / "computed_torque_or_passivity.png")


def controller_figure(summary: Sequence[dict[str, Any]]) -> Figure:
    """Errors at the greatest σ, without and with noise."""
    sigma = max(line["sigma"] for line in summary)
    noises = sorted({line["noise"] for line in summary})
    laws = list(dict.fromkeys(line["law"] for line in summary))
    figure = style.new_figure(3.8)
    axes = figure.subplots(1, len(noises), sharey=True, squeeze=False)[0]
    for ax, noise in zip(axes, noises, strict=True):
        for k, law in enumerate(laws):
            for at, controller in enumerate(NAMES):
                cell = (noise, sigma, controller, law)
                for line in (line for line in summary if _cell(line) == cell):
                    _draw_bar(ax, at + WIDTH * (k - 1), line)
        ax.set_xticks(np.arange(len(NAMES)), NAMES.values())
        title = f"Velocity noise {noise:g} rad/s" if noise else "Exact velocity"
        style.polish(ax, grid="y").set_title(title, loc="left", **style.plain(fontweight="bold"))
    style.log_scale(axes[0], "y")
    axes[0].set_ylabel(f"tracking error at σ = {sigma:g}: RMS, degrees", **style.plain())
    style.legend_above(figure, legend(laws))
    lost = sum(x["lost"] for x in summary if x["sigma"] == sigma)
    style.note_below(figure, f"{lost} unstable loops are left out." if lost else "")
    return figure


def _draw_bar(ax: Axes, x: float, line: dict[str, Any]) -> None:
    """The error of one controller and law, or that all its loops were unstable."""
    rms, color = line["rms"], COLORS[line["law"]]
    if rms is None:
        where = {"xy": (x, 0.02), "xycoords": ("data", "axes fraction"), "ha": "center"}
        ax.annotate("unstable", **where, rotation=90, **style.plain(style.SMALL, color))
        return
    error = min(line["deviation"], 0.9 * rms)
    ax.bar(x, rms, 0.9 * WIDTH, yerr=error or None, color=color, ecolor=style.INK, capsize=1.5)


def _cell(line: dict[str, Any]) -> tuple[Any, ...]:
    return line["noise"], line["sigma"], line["controller"], line["law"]
