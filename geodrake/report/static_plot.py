"""Pictures of plots that need no script: lines as SVG, and numbers beside them as text.

The lines stretch with the page and the numbers do not, so that both can be read at any width.
Colours are names of the page's style sheet, which knows light, dark and paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.report.charts import Chart, Panel, Plot, Stage
from geodrake.report.curves import decimated
from geodrake.report.frame import HEIGHT, WIDTH, Frame

Array = NDArray[np.float64]

_POINTS = 300
_CUT = 3.0
"""Residuals are cut off at so many times the largest of the best model."""


@dataclass(frozen=True)
class Tick:
    """A number beside an axis.

    Attributes:
        at: Where, in per cent from the left or from the top.
    """

    at: float
    text: str


@dataclass(frozen=True)
class Line:
    """A line, a dotted limit, or dots.

    Attributes:
        stage: Key of the stage it belongs to; "" for none.
        color: Name of its colour in the style sheet.
        kind: "line", "wide-line", "mean", "rms", "dots", "limit" or "zero".
    """

    stage: str
    color: str
    kind: str
    path: str


@dataclass(frozen=True)
class Box:
    """A shaded part of the plot, in the SVG's coordinates.

    Attributes:
        stage: Key of the stage it belongs to; "" for the noise.
        color: Name of its colour in the style sheet.
    """

    stage: str
    color: str
    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True)
class StaticPlot:
    """What a template needs to draw a plot.

    Attributes:
        label: What is shown, with its unit.
        boxes: Shaded parts, behind the lines.
        across: Numbers along the axis below.
        up: Numbers along the axis at the left.
        below: What the axis below is, with its unit; "" where another plot says it.
        tall: Whether it is the taller plot of its panel.
    """

    label: str
    lines: tuple[Line, ...]
    boxes: tuple[Box, ...]
    across: tuple[Tick, ...]
    up: tuple[Tick, ...]
    below: str = ""
    tall: bool = True


def static_plots(chart: Chart, panel: Panel) -> tuple[StaticPlot, ...]:
    """The plots of a panel."""
    *upper, last = panel.plots
    across = _time_ticks(chart)
    return (
        *(_static_plot(chart, panel, plot) for plot in upper),
        _static_plot(chart, panel, last, across),
    )


def _static_plot(
    chart: Chart, panel: Panel, plot: Plot, across: tuple[Tick, ...] = ()
) -> StaticPlot:
    shown = [stage for stage in chart.stages if stage.shown and stage.key in plot.curves]
    curves = np.array([plot.curves[stage.key] for stage in shown])
    time, curves = decimated(panel.time, curves, _POINTS)
    low, high = span_of(plot, curves)
    frame = Frame(chart.ends, (low, high))
    lines = [_horizontal(frame, 0.0, "zero")] if low < 0 < high else []
    lines += [_horizontal(frame, v, "limit") for v in plot.limits if low <= v <= high]
    kinds = ["dots" if chart.dots else "wide-line" if stage.wide else "line" for stage in shown]
    lines += [
        Line(
            stage.key, stage.color, kind, frame.dots(time, c) if chart.dots else frame.line(time, c)
        )
        for stage, kind, c in zip(shown, kinds, curves, strict=True)
    ]
    return StaticPlot(
        plot.label,
        tuple(lines),
        (*_shades(frame, panel, shown), *noise_band(frame, plot.floor)),
        across,
        value_ticks(frame, 5 if plot.tall else 3),
        chart.axis if across else "",
        plot.tall,
    )


def span_of(plot: Plot, curves: Array) -> tuple[float, float]:
    """Lowest and highest value that a plot shows.

    Args:
        curves: (C, K) values of the curves shown; NaN where one breaks.
    """
    if plot.span is not None:
        return plot.span
    if plot.centred:
        largest = [float(np.abs(c[np.isfinite(c)]).max(initial=0.0)) for c in curves]
        peaks = [peak for peak in largest if peak > 0] or [1.0]
        most = 1.08 * min(max(peaks), _CUT * min(peaks))
        return -most, most
    known = np.append(curves[np.isfinite(curves)], plot.limits)
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    margin = 0.06 * (high - low) or 0.5 * abs(high) or 1.0
    return low - margin, high + margin


def round_values(low: float, high: float, most: int) -> Array:
    """Round numbers that enclose an interval, in steps of 1, 2 or 5 times a power of ten."""
    if not high > low:
        return np.array([low])
    least = (high - low) / most
    power = 10.0 ** np.floor(np.log10(least))
    step = power * next(x for x in (1.0, 2.0, 5.0, 10.0) if x * power >= least * (1.0 - 1e-9))
    return np.asarray(step * np.arange(np.floor(low / step), np.ceil(high / step) + 1.0))


def value_ticks(frame: Frame, most: int) -> tuple[Tick, ...]:
    """Round numbers along the axis at the left."""
    low, high = frame.y
    margin = 0.03 * (high - low)
    values = round_values(low, high, most)
    return tuple(
        Tick(round(100 * (high - value) / (high - low), 1), _plain(value))
        for value in values
        if low + margin <= value <= high - margin
    )


def across_ticks(frame: Frame, most: int) -> tuple[Tick, ...]:
    """Round numbers along the axis below."""
    low, high = frame.x
    values = round_values(low, high, most)
    return tuple(
        Tick(round(100 * (value - low) / (high - low), 1), _plain(value))
        for value in values
        if low <= value <= high
    )


def noise_band(frame: Frame, floor: float) -> tuple[Box, ...]:
    """The band of sensor noise about zero, as far as it is in the plot; none without noise."""
    if not floor > 0:
        return ()
    top, bottom = np.clip(frame.down(np.array([floor, -floor])), 0, HEIGHT).round(1).tolist()
    return (Box("", "noise", 0, top, WIDTH, max(1.0, round(bottom - top, 1))),)


def _horizontal(frame: Frame, value: float, kind: str) -> Line:
    y = float(frame.down(np.array([value]))[0])
    return Line("", "quiet", kind, f"M0,{y:.1f}H{WIDTH}")


def _shades(frame: Frame, panel: Panel, shown: Sequence[Stage]) -> tuple[Box, ...]:
    colors = {stage.key: stage.color for stage in shown}
    boxes = []
    for shade in panel.shades:
        if shade.stage in colors:
            left, right = frame.across(np.array([shade.start, shade.end])).round(1).tolist()
            width = max(2.0, round(right - left, 1))
            boxes.append(Box(shade.stage, colors[shade.stage], left, 0, width, HEIGHT))
    return tuple(boxes)


def _time_ticks(chart: Chart) -> tuple[Tick, ...]:
    """Each log's own time, where it is on the common axis."""
    low, high = chart.ends
    ticks = []
    for _, start, end, shift in chart.spans:
        share = (end - start) / (high - low)
        values = round_values(start, end, max(1, round(8 * share)))
        inside = [v for v in values if start - 1e-9 <= v <= end + 1e-9] or [start]
        ticks += [Tick(round(100 * (v + shift - low) / (high - low), 1), _plain(v)) for v in inside]
    return tuple(ticks)


def _plain(value: float) -> str:
    """A round number without needless digits."""
    return f"{0.0 if abs(value) < 1e-12 else value:.4g}".replace("-", "−")
