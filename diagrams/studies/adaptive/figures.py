"""Figures of the studies of adaptive control."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from diagrams.harness import titled
from diagrams.studies.adaptive.laws import COLORS, EUCLIDEAN, LABELS, NATURAL, NONE, PULLBACK
from geodrake.report import style

SPREAD = 0.16  # between the bars of laws, of the distance between groups


def adaptation_figures(summary: Sequence[dict[str, Any]]) -> dict[str, Figure]:
    """Figures 5.4 and 5.5 of the source, and one of time steps."""
    parts = {part: [x for x in summary if x["part"] == part] for part in _names(summary, "part")}
    return {
        "wam_initial_error": error_figure(parts["noise"]),
        "wam_rounds": rounds_figure(parts["rounds"]),
        "wam_time_steps": step_figure(parts["steps"]),
    }


def error_figure(lines: Sequence[dict[str, Any]]) -> Figure:
    """Tracking error and unphysical time over the error of the first estimate."""
    figure = style.new_figure(4.2)
    left, right = figure.subplots(1, 2, width_ratios=(1.6, 1.0))
    sigmas = _names(lines, "sigma")
    _bars(left, lines, ("sigma", sigmas), "rms")
    titled(left, "Tracking error of all joints: RMS, degrees", grid="y")
    style.log_scale(left, "y")
    for k, law in enumerate(_names(lines, "law")[1:]):
        share = [100.0 * _line(lines, sigma=s, law=law)["unphysical"] for s in sigmas]
        right.plot(sigmas, share, color=COLORS[law], marker="o", markersize=7 - 1.5 * k)
    titled(right, "Time with a body that cannot exist, %", grid="y")
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
    titled(
        ax, "Tracking error of all joints in rounds of growing amplitude: RMS, degrees", grid="y"
    )
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
    titled(left, "Tracking error of all joints: RMS, degrees", grid="y")
    _bars(right, lines, ("step", steps), "unphysical", scale=100.0)
    titled(right, "Time with a body that cannot exist, %", grid="y")
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


def _names(lines: Sequence[dict[str, Any]], column: str) -> list[Any]:
    return list(dict.fromkeys(line[column] for line in lines))


def _line(lines: Sequence[dict[str, Any]], **cell: Any) -> dict[str, Any]:
    return next(x for x in lines if all(x[name] == value for name, value in cell.items()))


NAMES = {
    "passivity": "passivity-based",
    "acceleration": "computed torque,\nacceleration",
    "filtered": "computed torque,\nfiltered regressor",
}
WIDTH = 0.25


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
        titled(ax, title, grid="y")
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


def load_figure(rows: Sequence[dict[str, Any]], period: float) -> Figure:
    """Errors of every round above, and over time below, one column a load."""
    loads = list(dict.fromkeys(row["load"] for row in rows))
    laws = list(dict.fromkeys(row["law"] for row in rows))
    figure = style.new_figure(5.2)
    axes = figure.subplots(2, len(loads), sharey="row", squeeze=False)
    for (above, below), load in zip(axes.T, loads, strict=True):
        for k, law in enumerate(laws):
            row = next(row for row in rows if (row["load"], row["law"]) == (load, law))
            done = [np.nan if x is None else x for x in row["rounds"]]
            at = 1 + np.arange(len(done)) + SPREAD * (k - 0.5 * (len(laws) - 1))
            above.bar(at, done, 0.9 * SPREAD, color=COLORS[law])
            time = period * np.arange(len(row["series"]))
            below.plot(time, np.maximum(row["series"], 1e-3), color=COLORS[law], linewidth=1.1)
        titled(above, load)
        above.set_xlabel("round", **style.plain(style.SMALL, style.QUIET))
        above.set_xticks(1 + np.arange(max(len(row["rounds"]) for row in rows)))
        style.polish(below).set_xlabel("time, s", **style.plain(style.SMALL, style.QUIET))
    for ax, name in zip(axes[:, 0], ("of each round", "of all joints"), strict=True):
        style.log_scale(ax, "y")
        ax.set_ylabel(f"RMS {name}, degrees", **style.plain())
    style.legend_above(figure, legend(laws))
    style.note_below(figure, speed_note(rows))
    return figure


def sandbag_figure(rows: Sequence[dict[str, Any]], period: float) -> Figure:
    """Errors of every case, and over time in the first one."""
    cases = list(dict.fromkeys(row["case"] for row in rows))
    laws = list(dict.fromkeys(row["law"] for row in rows))
    figure = style.new_figure(3.8)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.5))
    for k, law in enumerate(laws):
        found = [row for row in rows if row["law"] == law]
        height = [np.nan if row["lost"] else row["rms"] for row in found]
        at = np.arange(len(cases)) + SPREAD * (k - 0.5 * (len(laws) - 1))
        left.bar(at, height, 0.9 * SPREAD, color=COLORS[law])
        series = next(row["series"] for row in found if row["case"] == cases[0])
        time = period * np.arange(len(series))
        right.plot(time, np.maximum(series, 1e-2), color=COLORS[law], linewidth=1.1)
    style.log_scale(left, "y")
    left.set_xticks(range(len(cases)), cases)
    title = "Tracking error of the turns: RMS, degrees"
    titled(left, title, grid="y")
    title = f"Its course with sandbags at {cases[0]}, degrees"
    titled(right, title)
    right.set_xlabel("time, s", **style.plain(style.SMALL, style.QUIET))
    style.log_scale(right, "y")
    right.set_ylim(bottom=0.02)
    style.legend_above(figure, legend(laws))
    lost = sum(row["lost"] for row in rows)
    style.note_below(figure, speed_note(rows) + (f" {lost} loops were lost." if lost else ""))
    return figure


SHADES = {"passivity": NATURAL, "computed torque": PULLBACK, "unguarded": EUCLIDEAN}


def soak_figure(rows: Sequence[dict[str, Any]]) -> Figure:
    """Distances and errors over time, faults as ticks."""
    figure = style.new_figure(5.0)
    top, bottom = figure.subplots(2, 1, sharex=True)
    for row in rows:
        minutes = [t / 60.0 for t in row["time"]]
        color = COLORS[SHADES[row["controller"]]]
        top.plot(minutes, row["distance"], color=color, linewidth=1.2, label=row["controller"])
        bottom.plot(minutes, row["error"], color=color, linewidth=0.6)
    for ax, name in ((top, "distance from the truth"), (bottom, "tracking error, degrees")):
        style.polish(ax, grid="y")
        style.log_scale(ax, "y")
        ax.set_ylabel(name, **style.plain())
        for start in rows[0]["starts"]:
            ax.axvline(start / 60.0, color="#d5dae0", linewidth=0.5, zorder=0)
    bottom.set_xlabel("minutes", **style.plain())
    style.legend_above(figure, top.get_legend_handles_labels()[0])
    return figure


LOG_COLORS = {"ur10e_free_b": "#6b7683", "ur10e_free_c": "#a9b4c0", "ur10e_changed": "#1b6ca8"}
TITLES = {"offline": "Arm identified offline", "online": "Arm learned online"}


def mass_figure(rows: Sequence[dict[str, Any]], mass: float) -> Figure:
    """Estimated mass over time, one panel a way to learn the arm."""
    figure = style.new_figure(3.6)
    ways = list(dict.fromkeys(row["way"] for row in rows))
    axes = figure.subplots(1, len(ways), sharey=True, squeeze=False)[0]
    for ax, way in zip(axes, ways, strict=True):
        for row in (row for row in rows if row["way"] == way):
            look = {"color": LOG_COLORS[row["log"]], "linewidth": 1.4, "label": row["log"]}
            ax.plot(row["time"], row["mass_over_time"], **look)
        ax.axhline(mass, color=style.FLOOR, linestyle="--", linewidth=1.2, label="by explain")
        titled(ax, TITLES[way])
        ax.set_xlabel("time, s", **style.plain(style.SMALL, style.QUIET))
    top = max(np.quantile(row["mass_over_time"], 0.98) for row in rows)
    axes[0].set_ylim(0.0, max(1.2 * top, 1.5 * mass))
    axes[0].set_ylabel("estimated mass of the payload, kg", **style.plain())
    style.legend_above(figure, axes[0].get_legend_handles_labels()[0])
    return figure
