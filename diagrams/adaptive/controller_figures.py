"""Figure of adaptive computed torque and passivity-based control."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from adaptive.laws import COLORS
from adaptive.wam_figures import legend
from geodrake.visualization import style

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
                found = [x for x in summary if _cell(x) == cell and x["rms"] is not None]
                if found:
                    x, error = (
                        at + WIDTH * (k - 1),
                        min(found[0]["deviation"], 0.9 * found[0]["rms"]),
                    )
                    look = {"color": COLORS[law], "ecolor": style.INK, "capsize": 1.5}
                    ax.bar(x, found[0]["rms"], 0.9 * WIDTH, yerr=error, **look)
        ax.set_xticks(np.arange(len(NAMES)), NAMES.values())
        title = f"Velocity noise {noise:g} rad/s" if noise else "Exact velocity"
        style.polish(ax, grid="y").set_title(title, loc="left", **style.plain(fontweight="bold"))
    style.log_scale(axes[0], "y")
    axes[0].set_ylabel(f"tracking error at σ = {sigma:g}: RMS, degrees", **style.plain())
    style.legend_above(figure, legend(laws))
    lost = sum(x["lost"] for x in summary if x["sigma"] == sigma)
    style.note_below(figure, f"{lost} unstable loops are left out." if lost else "")
    return figure


def _cell(line: dict[str, Any]) -> tuple[Any, ...]:
    return line["noise"], line["sigma"], line["controller"], line["law"]
