"""A chart of a page as a figure, for notebooks."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from geodrake.report import style
from geodrake.report.charts import Chart, Panel, Plot, Stage
from geodrake.report.worst_joints import of_worst

_COLORS = {"measured": style.MEASURED, "before": style.BEFORE, "after": style.AFTER}


@style.own_look()
def chart_figure(chart: Chart) -> Figure:
    """The panels that a page shows at first: a row each, with a column for each of its plots."""
    panels = [panel for panel in chart.panels if panel.shown]
    columns = max(len(panel.plots) for panel in panels)
    figure = style.new_figure(0.8 + 1.4 * len(panels))
    grid = figure.subplots(len(panels), columns, sharex=True, squeeze=False)
    for axes, panel in zip(grid, panels, strict=True):
        style.joint_title(axes[0], panel.title, panel.detail)
        for ax, plot in zip(axes, panel.plots, strict=False):
            _draw(style.polish(ax), chart, panel, plot)
    for ax in grid[-1]:
        ax.set_xlabel(chart.axis, **style.plain(style.SMALL, style.QUIET))
    style.note_below(figure, of_worst(len(panels), len(chart.panels)))
    if len(chart.stages) > 1:
        style.legend_above(figure, [_line(stage) for stage in chart.stages])
    return figure


def _draw(ax: Axes, chart: Chart, panel: Panel, plot: Plot) -> None:
    for stage in chart.stages:
        if stage.key in plot.curves:
            look = {"linewidth": 0, "marker": ".", "markersize": 3} if chart.dots else {}
            ax.plot(panel.time, plot.curves[stage.key], **{**_look(stage), **look})
    for limit in plot.limits:
        ax.axhline(limit, color=style.INK, linestyle=":", linewidth=1.0)
    if plot.span is not None:
        ax.set_ylim(*plot.span)
    ax.set_ylabel(plot.label, **style.plain(style.SMALL - 1, style.QUIET))


def _line(stage: Stage) -> Line2D:
    return Line2D([], [], label=stage.label, **_look(stage))


def _look(stage: Stage) -> dict[str, Any]:
    return {"color": _COLORS.get(stage.color, style.AFTER), "linewidth": 3.2 if stage.wide else 1.3}
