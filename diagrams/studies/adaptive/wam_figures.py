"""Figures of adaptation of the whole WAM-like arm, like 5.4 and 5.5 of the source."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from diagrams.studies.adaptive.laws import COLORS, LABELS, NONE
from geodrake.report import style

SPREAD = 0.16  # between the bars of laws, of the distance between groups


def write_adaptation_figures(folder: Path, summary: Sequence[dict[str, Any]]) -> None:
    """Write all figures of a run into a folder as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = {part: [x for x in summary if x["part"] == part] for part in _names(summary, "part")}
    error_figure(parts["noise"]).savefig(folder / "wam_initial_error.png")
    rounds_figure(parts["rounds"]).savefig(folder / "wam_rounds.png")
    step_figure(parts["steps"]).savefig(folder / "wam_time_steps.png")


def error_figure(lines: Sequence[dict[str, Any]]) -> Figure:
    """Tracking error and unphysical time over the error of the first estimate."""
    figure = style.new_figure(4.2)
    left, right = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    sigmas = _names(lines, "sigma")
    _bars(left, lines, ("sigma", sigmas), "rms")
    _title(left, "Tracking error of all joints: RMS, degrees")
    style.log_scale(left, "y")
    for k, law in enumerate(_names(lines, "law")[1:]):
        share = [100.0 * _line(lines, sigma=s, law=law)["unphysical"] for s in sigmas]
        right.plot(sigmas, share, color=COLORS[law], marker="o", markersize=7 - 1.5 * k)
    _title(right, "Time with a body that cannot exist, %")
    right.set_ylim(-4.0, 104.0)
    for ax in (left, right):
        ax.set_xlabel("σ of the first estimate", **style.plain(style.SMALL, style.QUIET))
    style.legend_above(figure, legend(_names(lines, "law")))
    draws = max(line["draws"] for line in lines)
    text = f"Means of {draws} draws a law and σ; whiskers are standard deviations."
    lost = sum(line["lost"] for line in lines)
    text += f" {lost} unstable loops are left out." if lost else ""
    style.note_below(figure, f"{text} {speed_note(lines)}")
    return figure


def rounds_figure(lines: Sequence[dict[str, Any]]) -> Figure:
    """Tracking error of every round of growing amplitude."""
    figure = style.new_figure(3.4)
    ax = figure.subplots()
    for k, line in enumerate(lines):
        if line["rounds"]:
            rounds = 1 + np.arange(len(line["rounds"]))
            look = {"color": COLORS[line["law"]], "marker": "o", "markersize": 7 - 1.5 * k}
            ax.plot(rounds, line["rounds"], **look)
    _title(ax, "Tracking error of all joints in rounds of growing amplitude: RMS, degrees")
    ax.set_xticks(rounds)
    ax.set_xlabel("round", **style.plain(style.SMALL, style.QUIET))
    style.log_scale(ax, "y")
    style.legend_above(figure, legend(_names(lines, "law")))
    style.note_below(figure, speed_note(lines))
    return figure


def step_figure(lines: Sequence[dict[str, Any]]) -> Figure:
    """Tracking error and unphysical time over the time step of control and adaptation."""
    figure = style.new_figure(3.6)
    left, right = figure.subplots(1, 2)
    steps = _names(lines, "step")
    _bars(left, lines, ("step", steps), "rms")
    _title(left, "Tracking error of all joints: RMS, degrees")
    _bars(right, lines, ("step", steps), "unphysical", scale=100.0)
    _title(right, "Time with a body that cannot exist, %")
    right.set_ylim(0.0, 104.0)
    for ax in (left, right):
        ax.set_xlabel("time step, s", **style.plain(style.SMALL, style.QUIET))
    style.legend_above(figure, legend(_names(lines, "law")))
    style.note_below(figure, speed_note(lines))
    return figure


def legend(laws: Sequence[str]) -> list[Line2D]:
    """One entry a law."""
    return [
        Line2D([], [], color=COLORS[law], marker="o", markersize=4, label=LABELS[law])
        for law in laws
    ]


def speed_note(lines: Sequence[dict[str, Any]]) -> str:
    """How fast every law adapts."""
    speeds = dict.fromkeys((x["law"], x["speed"]) for x in lines if x["law"] != NONE)
    return "Speeds γ⁻¹: " + ", ".join(f"{LABELS[law]} {speed:g}" for law, speed in speeds) + "."


def _bars(
    ax: Axes,
    lines: Sequence[dict[str, Any]],
    groups: tuple[str, Sequence[Any]],
    column: str,
    scale: float = 1.0,
) -> None:
    """Bars of the laws, side by side in every group."""
    name, values = groups
    laws = _names(lines, "law")
    for k, law in enumerate(laws):
        found = [_line(lines, law=law, **{name: value}) for value in values]
        height = [np.nan if x[column] is None else scale * x[column] for x in found]
        at = np.arange(len(values)) + SPREAD * (k - 0.5 * (len(laws) - 1))
        error = None
        if column == "rms":
            error = np.array([x["deviation"] or 0.0 for x in found])
            error = np.stack([np.minimum(error, 0.9 * np.array(height)), error])
        look = {"ecolor": style.INK, "error_kw": {"elinewidth": 0.8, "capsize": 1.5}}
        ax.bar(at, height, 0.9 * SPREAD, color=COLORS[law], yerr=error, **look)
    ax.set_xticks(range(len(values)), [f"{value:g}" for value in values])


def _title(ax: Axes, text: str) -> None:
    style.polish(ax, grid="y").set_title(text, loc="left", **style.plain(fontweight="bold"))


def _names(lines: Sequence[dict[str, Any]], column: str) -> list[Any]:
    return list(dict.fromkeys(line[column] for line in lines))


def _line(lines: Sequence[dict[str, Any]], **cell: Any) -> dict[str, Any]:
    return next(x for x in lines if all(x[name] == value for name, value in cell.items()))
