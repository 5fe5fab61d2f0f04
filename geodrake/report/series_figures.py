"""Figures of what was measured and predicted: against time, velocity, position and load."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator
from numpy.typing import NDArray

from geodrake.boundary.arguments import typed
from geodrake.identification.logs.model_errors import Comparison, JointError, Series
from geodrake.report import style
from geodrake.report.numbers import Units, number
from geodrake.report.timeline import Timeline
from geodrake.report.worst_joints import MOST_JOINTS, of_worst, worst_joints

Array = NDArray[np.float64]

_MOST_DOTS = 2500
_BINS = 20
_LABELS_AT = -0.05  # of the width of the axes
_CUT = 3.0
"""The earlier residual is cut off at this many times the largest of the later one."""


@style.own_look()
@typed
def effort_figure(
    comparison: Comparison,
    *,
    after: Comparison | None = None,
    most: int = MOST_JOINTS,
    units: Units | None = None,
) -> Figure:
    """Measured and predicted efforts, and the residual, against time.

    Args:
        after: The final model on the same logs, if there is one.
        most: Largest number of joints to show: those of largest nrms.
        units: Units of the joints; those of revolute joints by default.

    Returns:
        Two axes for each joint shown: efforts, and under them measured − predicted. Gaps between
        blocks stay gaps; several logs follow each other, each with its own time.
    """
    units = units or Units()
    joints = worst_joints(comparison.errors, most)
    timeline = Timeline.of(comparison.series)
    figure = style.new_figure(0.7 + 2.25 * len(joints))
    grid = figure.subplots(
        2 * len(joints), 1, sharex=True, squeeze=False, height_ratios=[2, 1] * len(joints)
    )
    final = after or comparison
    for row, joint in enumerate(joints):
        efforts, residuals = style.polish(grid[2 * row, 0]), style.polish(grid[2 * row + 1, 0])
        _draw_efforts(efforts, timeline, _of(comparison, joint), _of(final, joint), after)
        _draw_residuals(residuals, timeline, _of(comparison, joint), _of(final, joint), after)
        unit = units.effort([joint])
        style.joint_title(efforts, joint, _change(comparison, after, joint, unit))
        efforts.set_ylabel(f"effort, {unit}", **style.plain(style.SMALL, style.QUIET))
        residuals.set_ylabel("residual", **style.plain(style.SMALL, style.QUIET))
        _label(timeline, efforts)
        _label(timeline, residuals)
    _name_logs(timeline, grid[0, 0])
    for ax in grid[:, 0]:  # in a column; to align them by their ticks takes seconds
        ax.yaxis.set_label_coords(_LABELS_AT, 0.5)
    grid[-1, 0].set_xlabel("time in the log, s", **style.plain(style.SMALL, style.QUIET))
    style.note_below(figure, of_worst(len(joints), len(comparison.errors.joints)))
    style.legend_above(figure, _effort_legend(after is not None))
    return figure


@style.own_look()
@typed
def residual_figure(
    comparison: Comparison,
    *,
    color: str = style.BEFORE,
    most: int = MOST_JOINTS,
    units: Units | None = None,
) -> Figure:
    """Residual against velocity, position and load, with its mean and RMS in bins.

    Args:
        comparison: The model as it stands, or the final one.
        most: Largest number of joints to show: those of largest nrms.
        units: Units of the joints; those of revolute joints by default.

    Returns:
        Three axes for each joint shown. Load is the predicted effort. Bins hold equal numbers of
        samples.
    """
    units = units or Units()
    joints = worst_joints(comparison.errors, most)
    figure = style.new_figure(0.9 + 1.55 * len(joints))
    grid = figure.subplots(len(joints), 3, squeeze=False, sharey="row")
    entries = {entry.joint: entry for entry in comparison.errors.joints}
    for row, joint in zip(grid, joints, strict=True):
        own = _of(comparison, joint)
        residual = np.concatenate([s.residual for s in own])
        signals = (
            ("velocity", "velocity", "rad/s"),
            ("position", "position", "rad"),
            ("predicted", "load (predicted effort)", "N·m"),
        )
        for ax, (name, words, unit) in zip(row, signals, strict=True):
            values = np.concatenate([getattr(s, name) for s in own])
            _draw_dependence(style.polish(ax), values, residual, entries[joint], color)
            label = f"{words}, {units.at(joint, unit)}"
            ax.set_xlabel(label, labelpad=2, **style.plain(7.5, style.QUIET))
        style.joint_title(row[0], joint)
        quiet = style.plain(style.SMALL, style.QUIET)
        row[0].set_ylabel(f"residual, {units.effort([joint])}", **quiet)
        row[2].set_title(f"RMS {number(entries[joint].rms)}", loc="right", pad=4, **quiet)
    style.note_below(figure, of_worst(len(joints), len(comparison.errors.joints)))
    style.legend_above(
        figure,
        (
            Line2D([], [], marker="o", linestyle="", color=color, alpha=0.5, label="samples"),
            Line2D([], [], color=style.INK, linewidth=1.8, label="mean in bins"),
            Line2D([], [], color=style.INK, linewidth=1, linestyle="--", label="RMS in bins"),
            Patch(color=style.FLOOR, alpha=0.25, label="± sensor noise"),
        ),
    )
    return figure


def _label(timeline: Timeline, ax: Axes) -> None:
    """Ticks with each log's own time, and lines where a log begins."""
    places: list[float] = []
    words: list[str] = []
    for log, (low, high) in timeline.spans.items():
        share = (high - low) / timeline.length if timeline.length else 1.0
        count = int(np.clip(10 * share, 1, 10))
        locator = MaxNLocator(count, steps=[1, 2, 5, 10])
        ticks = np.array(locator.tick_values(low, high))
        inside = ticks[(ticks >= low - 1e-9) & (ticks <= high)]
        places += (inside + timeline.shifts[log]).tolist()
        words += [f"{tick:g}" for tick in inside]
    names = dict(zip(places, words, strict=True))
    ax.xaxis.set_major_locator(FixedLocator(places))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: names.get(x, "")))
    ax.set_xlim(-0.01 * timeline.length, 1.01 * timeline.length or 1.0)
    for log in list(timeline.spans)[1:]:
        start = timeline.spans[log][0] + timeline.shifts[log] - 0.01 * timeline.length
        ax.axvline(start, color=style.QUIET, linewidth=0.7, linestyle=(0, (4, 3)))


def _name_logs(timeline: Timeline, ax: Axes) -> None:
    """Puts the logs' names inside the top of axes, where there are several."""
    if len(timeline.spans) < 2:
        return
    low_effort, high_effort = ax.get_ylim()
    ax.set_ylim(top=high_effort + 0.15 * (high_effort - low_effort))
    for log, (low, high) in timeline.spans.items():
        fits = int(100 * (high - low) / timeline.length) if timeline.length else 0
        if fits >= 4:
            at = low + timeline.shifts[log]
            ax.annotate(
                style.label(log, fits), (at, 1.0), (2, -1), xycoords=("data", "axes fraction"),
                textcoords="offset points", va="top", **style.plain(7, style.QUIET),
            )  # fmt: skip


def _of(comparison: Comparison, joint: str) -> list[Series]:
    return [s for s in comparison.series if s.joint == joint and len(s.time)]


def _draw_efforts(
    ax: Axes,
    timeline: Timeline,
    before: Sequence[Series],
    final: Sequence[Series],
    after: Comparison | None,
) -> None:
    ax.plot(*timeline.broken(final, "measured"), color=style.MEASURED, linewidth=3.2)
    ax.plot(*timeline.broken(before, "predicted"), color=style.BEFORE, linewidth=1.1)
    if after is not None:
        ax.plot(*timeline.broken(final, "predicted"), color=style.AFTER, linewidth=1.1)


def _draw_residuals(
    ax: Axes,
    timeline: Timeline,
    before: Sequence[Series],
    final: Sequence[Series],
    after: Comparison | None,
) -> None:
    ax.axhline(0.0, color=style.QUIET, linewidth=0.6)
    early = timeline.broken(before, "residual")
    ax.plot(*early, color=style.BEFORE, linewidth=0.9, alpha=1.0 if after is None else 0.75)
    peak = _peak(early[1])
    if after is not None:
        late = timeline.broken(final, "residual")
        ax.plot(*late, color=style.AFTER, linewidth=1.1)
        peak = max(_peak(late[1]), min(peak, _CUT * _peak(late[1])))
    ax.set_ylim(-1.1 * peak or -1.0, 1.1 * peak or 1.0)
    ax.yaxis.set_major_locator(MaxNLocator(3, symmetric=True))


def _peak(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(np.abs(finite).max(initial=0.0))


def _change(before: Comparison, after: Comparison | None, joint: str, unit: str) -> str:
    """Return how a joint's RMS changes, in words."""
    words = f"RMS {number(before.errors.by_joint()[joint])}"
    if after is not None:
        words += f" → {number(after.errors.by_joint()[joint])}"
    return f"{words} {unit}"


def _effort_legend(two: bool) -> list[Line2D]:
    handles = [Line2D([], [], color=style.MEASURED, linewidth=3.2, label="measured")]
    first = "as it stands (residual cut off where large)" if two else "predicted, residual"
    handles.append(Line2D([], [], color=style.BEFORE, linewidth=1.4, label=first))
    if two:
        last = "final model on held-out data"
        handles.append(Line2D([], [], color=style.AFTER, linewidth=1.6, label=last))
    return handles


def _draw_dependence(
    ax: Axes, values: Array, residual: Array, entry: JointError, color: str
) -> None:
    """Samples of a residual over a signal, its mean and RMS in bins, and the noise."""
    ax.axhline(0.0, color=style.QUIET, linewidth=0.6)
    ax.axhspan(-entry.floor, entry.floor, color=style.FLOOR, alpha=0.25, linewidth=0)
    finite = np.isfinite(values) & np.isfinite(residual)
    values, residual = values[finite], residual[finite]
    dots = slice(None, None, 1 + len(values) // _MOST_DOTS)
    ax.scatter(
        values[dots], residual[dots], s=5, color=color, alpha=0.35, linewidth=0, rasterized=True
    )
    if len(values) >= 2:
        order = np.argsort(values, kind="stable")
        bins = np.array_split(order, min(_BINS, max(1, len(order) // 8)))
        middle = [values[b].mean() for b in bins]
        ax.plot(middle, [residual[b].mean() for b in bins], color=style.INK, linewidth=1.6)
        rms = [np.sqrt((residual[b] ** 2).mean()) for b in bins]
        ax.plot(middle, rms, color=style.INK, linewidth=0.9, linestyle="--")
    ax.xaxis.set_major_locator(MaxNLocator(5))
    ax.yaxis.set_major_locator(MaxNLocator(4))
