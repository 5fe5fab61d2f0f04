"""Charts and bars as matplotlib figures and PNG files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from geodrake.boundary.arguments import typed
from geodrake.boundary.escaping import path_part
from geodrake.boundary.whole_files import made_folder, write_together
from geodrake.report import style
from geodrake.report.charts import CUT, MOST_PANELS, Bars, Chart, Panel, Plot, Stage
from geodrake.report.page import Page

_LABEL_OFFSET = -0.05  # of the width of the axes
_LOOKS: dict[str, dict[str, Any]] = {
    "line": {"linewidth": 1.1},
    "wide": {"linewidth": 3.2},
    "dots": {"linewidth": 0, "marker": ".", "markersize": 3},
}


def figures_of(page: Page) -> dict[str, Figure]:
    """Return the bars and charts of a page as figures, by their names."""
    sections = page.shown_sections
    bars = {bars.name: bars_figure(bars) for section in sections for bars in section.bars}
    return bars | {c.name: chart_figure(c) for section in sections for c in section.charts}


@typed
def save_figures(figures: Mapping[str, Figure], folder: str | Path) -> tuple[Path, ...]:
    """Write figures as PNG files, all of them or none.

    Args:
        figures: Name -> figure.
        folder: Folder of the files `<name>.png`; created if it does not exist.

    Raises:
        OutputError: A file cannot be written.
    """
    folder = Path(folder)
    paths = {name: folder / f"{path_part(name)}.png" for name in figures}
    with made_folder(folder):
        write_together(
            {paths[name]: style.figure_bytes(figure) for name, figure in figures.items()}
        )
    return tuple(paths.values())


@style.own_look()
def chart_figure(chart: Chart, most: int = MOST_PANELS) -> Figure:
    """Return a figure of the panels that a page shows first.

    Two plots of a panel are stacked; more, or those with their own axes, are side by side.
    """
    panels = [panel for panel in chart.panels if panel.shown][:most]
    stages = [stage for stage in chart.stages if stage.shown]
    count = max((len(panel.plots) for panel in panels), default=1)
    is_stacked = count == 2 and not chart.abreast
    rows, columns = (2 * len(panels), 1) if is_stacked else (len(panels), count)
    figure = style.new_figure(0.8 + (2.25 if is_stacked else 1.55) * len(panels))
    grid = figure.subplots(
        max(rows, 1), columns, squeeze=False, sharex=not chart.abreast,
        height_ratios=[2, 1] * len(panels) if is_stacked else None,
    )  # fmt: skip
    for k, panel in enumerate(panels):
        axes = grid[2 * k : 2 * k + 2, 0] if is_stacked else grid[k]
        name = style.label(panel.title, 48)
        axes[0].set_title(name, loc="left", pad=4, **style.plain(fontweight="bold"))
        if panel.detail:
            size = style.plain(style.SMALL, style.QUIET)
            axes[0].set_title(style.label(panel.detail), loc="right", pad=4, **size)
        for ax, plot in zip(axes, panel.plots, strict=False):
            _draw(style.polish(ax), chart, panel, plot, stages)
        if is_stacked:
            for ax in axes:  # automatic alignment takes seconds
                ax.yaxis.set_label_coords(_LABEL_OFFSET, 0.5)
    if not chart.abreast:
        for ax in grid[-1]:
            ax.set_xlabel(chart.axis, **style.plain(style.SMALL, style.QUIET))
    if len(panels) < len(chart.panels):
        style.note_below(figure, f"{len(panels)} of {len(chart.panels)}.")
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=style.COLORS[s.color], label=s.label, **_LOOKS[s.look]) for s in stages
    ]
    if any(plot.floor > 0 for panel in panels for plot in panel.plots):
        handles.append(Patch(color=style.FLOOR, alpha=0.25, label="± sensor noise"))
    style.legend_above(figure, handles)
    return figure


def _draw(ax: Axes, chart: Chart, panel: Panel, plot: Plot, stages: list[Stage]) -> None:
    over = panel.time if plot.over is None else plot.over
    shown = [stage for stage in stages if stage in plot.curves]
    for stage in shown:
        color, dots = style.COLORS[stage.color], stage.look == "dots"
        alpha = 0.4 if dots and plot.trends else 1.0
        ax.plot(over, plot.curves[stage], color=color, alpha=alpha, **_LOOKS[stage.look])
        if stage in plot.trends:
            trend = plot.trends[stage]
            ax.plot(trend.middle, trend.mean, color=style.INK, linewidth=1.6)
            ax.plot(trend.middle, trend.rms, color=style.INK, linewidth=0.9, linestyle="--")
    for shade in panel.shades:
        color = style.COLORS[shade.stage.color]
        ax.axvspan(shade.start, shade.end, color=color, alpha=0.14, linewidth=0)
    for limit in plot.limits:
        ax.axhline(limit, color=style.INK, linestyle=":", linewidth=1.0)
    if plot.floor > 0:
        ax.axhspan(-plot.floor, plot.floor, color=style.FLOOR, alpha=0.25, linewidth=0)
    if plot.log:
        style.log_scale(ax)
    elif plot.span is not None:
        ax.set_ylim(*plot.span)
    elif plot.centred:
        ax.axhline(0.0, color=style.QUIET, linewidth=0.6)
        curves = [plot.curves[stage] for stage in shown]
        peaks = [float(np.abs(c[np.isfinite(c)]).max(initial=0.0)) for c in curves]
        peaks = [peak for peak in peaks if peak > 0] or [1.0]
        most = 1.08 * min(max(peaks), CUT * min(peaks))
        ax.set_ylim(-most, most)
        ax.yaxis.set_major_locator(MaxNLocator(4, symmetric=True))
    if plot.label:
        ax.set_ylabel(plot.label, **style.plain(style.SMALL - 0.5, style.QUIET))
    if chart.abreast:
        ax.xaxis.set_major_locator(MaxNLocator(5))
        ax.set_xlabel(plot.axis, labelpad=2, **style.plain(style.SMALL - 0.5, style.QUIET))
    else:
        _label_time(ax, chart)


def _label_time(ax: Axes, chart: Chart) -> None:
    """Label the axis with each log's own time, and draw lines between logs."""
    low, high = chart.ends
    places: dict[float, str] = {}
    for _, first, last, shift in chart.stretches:
        locator = MaxNLocator(
            int(np.clip(10 * (last - first) / (high - low), 1, 10)), steps=[1, 2, 5, 10]
        )
        ticks = np.array(locator.tick_values(first, last))
        places |= {t + shift: f"{t:g}" for t in ticks if first - 1e-9 <= t <= last}
        if shift + first > low:
            start = first + shift - 0.01 * (high - low)
            ax.axvline(start, color=style.QUIET, linewidth=0.7, linestyle=(0, (4, 3)))
    ax.xaxis.set_major_locator(FixedLocator(list(places)))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: places.get(x, "")))
    ax.set_xlim(low - 0.01 * (high - low), high + 0.01 * (high - low))


@style.own_look()
def bars_figure(bars: Bars) -> Figure:
    """Return bars with their numbers, scaled as on a page."""
    count = sum(len(row.bars) for row in bars.rows) + len(bars.rows)
    figure = style.new_figure(1.0 + 0.2 * count)
    ax = style.polish(figure.subplots(), grid="none")
    y_start, ticks = 0.0, []
    for row in bars.rows:
        ends = [y_start + k for k in range(len(row.bars))]
        for y, (stage, value) in zip(ends, row.bars.items(), strict=True):
            end, color = bars.end(value), style.COLORS[stage.color]
            ax.barh(y, end, 0.86, color=color, alpha=stage.opacity)
            ax.annotate(
                row.text(value), (end, y), (4, 0), textcoords="offset points", va="center",
                **style.plain(style.SMALL),
            )  # fmt: skip
        for stage, value in row.shown_marks.items():
            color, span = style.COLORS[stage.color], (ends[0] - 0.6, ends[-1] + 0.6)
            ax.vlines(bars.end(value), *span, color=color, linestyle="--")
        ticks.append(float(np.mean(ends)))
        y_start = ends[-1] + 1.8
    labels = [style.label(row.label, 62) for row in bars.rows]
    ax.set_yticks(ticks, labels, **style.plain(style.SMALL + 0.5))
    ax.set_ylim(y_start - 1.0, -0.8)
    ax.set_xlim(0.0, 1.12)
    ax.set_xticks([])
    ax.tick_params(axis="y", length=0)
    handles: list[Line2D | Patch] = []
    for stage in bars.legend:
        color, words = style.COLORS[stage.color], style.label(stage.label)
        if stage.look == "thin":
            handles.append(Line2D([], [], color=color, linestyle="--", label=words))
        else:
            handles.append(Patch(color=color, alpha=stage.opacity, label=words))
    style.legend_above(figure, handles)
    style.note_below(figure, " ".join(filter(None, (bars.caption, bars.note))))
    return figure
