"""Figures of the studies of adaptive control."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from diagrams.harness import draw_bars, draw_lines, panels
from diagrams.studies.adaptive.laws import COLORS, EUCLIDEAN, LABELS, NATURAL, NONE, PULLBACK
from geodrake.report import style

Rows = Sequence[dict[str, Any]]
ERROR = "Tracking error of all joints: RMS, degrees"
UNPHYSICAL = "Time with a body that cannot exist, %"


def adaptation_figures(summary: Rows) -> dict[str, Figure]:
    """Return figures 5.4 and 5.5 of the source, and one of time steps."""
    parts = {part: [x for x in summary if x["part"] == part] for part in _names(summary, "part")}
    return {
        "wam_initial_error": error_figure(parts["noise"]),
        "wam_rounds": rounds_figure(parts["rounds"]),
        "wam_time_steps": step_figure(parts["steps"]),
    }


def error_figure(lines: Rows) -> Figure:
    """Return tracking error and unphysical time over the error of the first estimate."""
    how = {"x": "σ of the first estimate", "grid": "y", "width_ratios": (1.6, 1.0)}
    figure, (left, right) = panels(4.2, (ERROR, UNPHYSICAL), **how)
    _bars(left, lines, "sigma", "rms")
    style.log_scale(left, "y")
    for k, law in enumerate(_names(lines, "law")[1:]):
        own = [line for line in lines if line["law"] == law]
        share = {law: ([x["sigma"] for x in own], [100.0 * x["unphysical"] for x in own])}
        draw_lines(right, share, COLORS, marker="o", markersize=7 - 1.5 * k)
    right.set_ylim(-4.0, 104.0)
    draws = max(line["draws"] for line in lines)
    text = f"Means of {draws} draws a law and σ; whiskers are standard deviations. "
    return _finished(figure, lines, text)


def rounds_figure(lines: Rows) -> Figure:
    """Return tracking error of every round of growing amplitude."""
    title = "Tracking error of all joints in rounds of growing amplitude: RMS, degrees"
    figure, (ax,) = panels(3.4, (title,), x="round", grid="y")
    for k, line in enumerate(line for line in lines if line["rounds"]):
        rounds = 1 + np.arange(len(line["rounds"]))
        drawn = {line["law"]: (rounds, line["rounds"])}
        draw_lines(ax, drawn, COLORS, marker="o", markersize=7 - 1.5 * k)
        ax.set_xticks(rounds)
    style.log_scale(ax, "y")
    return _finished(figure, lines)


def step_figure(lines: Rows) -> Figure:
    """Return tracking error and unphysical time over the time step of control and adaptation."""
    figure, (left, right) = panels(3.6, (ERROR, UNPHYSICAL), x="time step, s", grid="y")
    _bars(left, lines, "step", "rms")
    _bars(right, lines, "step", "unphysical", 100.0)
    right.set_ylim(0.0, 104.0)
    return _finished(figure, lines)


def controller_figure(summary: Rows) -> Figure:
    """Return errors at the greatest σ, without and with noise."""
    sigma = max(line["sigma"] for line in summary)
    lines = [line for line in summary if line["sigma"] == sigma]
    noises = sorted(_names(lines, "noise"))
    titles = [f"Velocity noise {x:g} rad/s" if x else "Exact velocity" for x in noises]
    y = f"tracking error at σ = {sigma:g}: RMS, degrees"
    figure, axes = panels(3.8, titles, y=y, grid="y", sharey=True)
    for ax, noise in zip(axes, noises, strict=True):
        _bars(ax, [line for line in lines if line["noise"] == noise], "controller", "rms")
    style.log_scale(axes[0], "y")
    return _finished(figure, lines)


def load_figure(rows: Rows, period: float) -> Figure:
    """Return errors of every round above, and over time below, one column a load."""
    loads = _names(rows, "load")
    figure = style.new_figure(5.2)
    axes = figure.subplots(2, len(loads), sharey="row", squeeze=False)
    for (above, below), load in zip(axes.T, loads, strict=True):
        own = {row["law"]: row for row in rows if row["load"] == load}
        done = {law: row["rounds"] for law, row in own.items()}
        count = max(map(len, done.values()))
        whole = {law: [*x, *[None] * (count - len(x))] for law, x in done.items()}
        draw_bars(above, [f"{k + 1}" for k in range(count)], whole, COLORS)
        _series(below, own.values(), period, 1e-3)
        style.polish(above).set_title(f"{load}: rounds", loc="left", **style.plain())
    for ax, name in zip(axes[:, 0], ("of each round", "of all joints"), strict=True):
        style.log_scale(ax, "y")
        ax.set_ylabel(f"RMS {name}, degrees", **style.plain())
    return _finished(figure, rows)


def sandbag_figure(rows: Rows, period: float) -> Figure:
    """Return errors of every case, and over time in the first one."""
    first = rows[0]["case"]
    titles = "Tracking error of the turns: RMS", f"Its course with sandbags at {first}, degrees"
    figure, (left, right) = panels(3.8, titles, y="degrees", width_ratios=(1.0, 1.5))
    _bars(left, rows, "case", "rms")
    style.log_scale(left, "y")
    _series(right, [row for row in rows if row["case"] == first], period, 1e-2)
    style.log_scale(right, "y")
    right.set_ylim(bottom=0.02)
    return _finished(figure, rows)


def _series(ax: Axes, rows: Any, period: float, least: float) -> None:
    """Errors over time by law."""
    lines = {
        row["law"]: (period * np.arange(len(row["series"])), np.maximum(row["series"], least))
        for row in rows
    }
    draw_lines(ax, lines, COLORS, linewidth=1.1)
    style.polish(ax).set_xlabel("time, s", **style.plain(style.SMALL, style.QUIET))


def _bars(ax: Axes, lines: Rows, group: str, column: str, scale: float = 1.0) -> None:
    """Bars of the laws, side by side in every group, with deviations where there are some."""
    groups, laws = _names(lines, group), _names(lines, "law")
    cells = {(x["law"], x[group]): x for x in lines}

    def values(name: str, scale: float) -> dict[str, list[float | None]]:
        found = {law: [cells.get((law, value), {}).get(name) for value in groups] for law in laws}
        return {law: [None if x is None else scale * x for x in own] for law, own in found.items()}

    errors = values("deviation", scale) if column == "rms" and "deviation" in lines[0] else None
    names = [each if isinstance(each, str) else f"{each:g}" for each in groups]
    draw_bars(ax, names, values(column, scale), COLORS, errors)


def _finished(figure: Figure, lines: Rows, text: str = "") -> Figure:
    """Add the laws, how fast each adapts, and how many loops were lost."""
    laws = [
        Line2D([], [], color=COLORS[law], marker="o", markersize=4, label=LABELS[law])
        for law in _names(lines, "law")
    ]
    style.legend_above(figure, laws)
    lost = sum(line["lost"] for line in lines)
    speeds = dict.fromkeys((x["law"], x["speed"]) for x in lines if x["law"] != NONE)
    told = ", ".join(f"{LABELS[law]} {speed:g}" for law, speed in speeds)
    unstable = f"{lost} unstable loops. " if lost else ""
    style.note_below(figure, f"{text}{unstable}Speeds γ⁻¹: {told}.")
    return figure


def _names(lines: Rows, column: str) -> list[Any]:
    return list(dict.fromkeys(line[column] for line in lines))


SHADES = {"passivity": NATURAL, "computed torque": PULLBACK, "unguarded": EUCLIDEAN}


def soak_figure(rows: Rows) -> Figure:
    """Return distances and errors over time, faults as ticks."""
    titles, colors = ("distance", "error"), {n: COLORS[law] for n, law in SHADES.items()}
    figure, axes = panels(4.0, ("Distance from the truth", "Tracking error, °"), x="minutes")
    for ax, what in zip(axes, titles, strict=True):
        lines = {row["controller"]: (np.array(row["time"]) / 60.0, row[what]) for row in rows}
        draw_lines(ax, lines, colors, linewidth=0.8)
        style.log_scale(ax, "y")
        for start in rows[0]["starts"]:
            ax.axvline(start / 60.0, color="#d5dae0", linewidth=0.5, zorder=0)
    style.legend_above(figure, axes[0].get_legend_handles_labels()[0])
    return figure


LOG_COLORS = {"ur10e_free_b": "#6b7683", "ur10e_free_c": "#a9b4c0", "ur10e_changed": "#1b6ca8"}


def mass_figure(rows: Rows, mass: float) -> Figure:
    """Return estimated mass over time, one panel a way to learn the arm."""
    ways, y = _names(rows, "way"), "estimated mass of the payload, kg"
    titles = [f"Arm learned {way}" for way in ways]
    figure, axes = panels(3.6, titles, x="time, s", y=y, sharey=True)
    for ax, way in zip(axes, ways, strict=True):
        own = [row for row in rows if row["way"] == way]
        draw_lines(ax, {r["log"]: (r["time"], r["mass_over_time"]) for r in own}, LOG_COLORS)
        ax.axhline(mass, color=style.FLOOR, linestyle="--", linewidth=1.2, label="by explain")
    top = max(np.quantile(row["mass_over_time"], 0.98) for row in rows)
    axes[0].set_ylim(0.0, max(1.2 * top, 1.5 * mass))
    style.legend_above(figure, axes[0].get_legend_handles_labels()[0])
    return figure
