"""Charts as plain data, curves over an axis and bars, which pages and matplotlib draw."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, isfinite, log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.escaping import printable
from geodrake.inertia import Array
from geodrake.report.json_output import picked
from geodrake.report.numbers import number

MOST_PANELS = 8  # panels that are shown at first, and that figures have
MOST_POINTS = 2000  # largest number of points of a curve that a page holds
CUT = 3.0  # residuals are cut off at so many times the largest of the best model

_MOST_NUMBERS = 16_000  # points of all curves of a panel together
_LARGEST, _MISSING = 32767, -32768
_LEAST = 1e-6  # nrms, so that a perfect model has a place on a logarithmic axis


@dataclass(frozen=True)
class Stage:
    """The subject of curves or bars: the measurement, or a model."""

    label: str  # the same in all charts of a page that show it
    color: str  # name of the colour in the page's style sheet
    # "line", "wide", which is behind the others, or "dots"; of bars "thin", for a mark across them.
    look: str = "line"
    shown: bool = field(default=True, compare=False)  # whether it is shown at first
    opacity: float = 1.0  # of bars, from 0 to 1

    @property
    def key(self) -> str:
        """Return its identifier on a page."""
        return f"{self.label} ({self.look})"


@dataclass(frozen=True, eq=False)
class Trend:
    """Mean and RMS of samples in bins: (B,) middles of the bins, mean and RMS there."""

    middle: Array
    mean: Array
    rms: Array


@dataclass(frozen=True, eq=False)
class Plot:
    """One axis with curves."""

    label: str  # what is shown, with its unit
    curves: Mapping[Stage, Array]  # (K,) values of each stage; NaN where a line breaks
    limits: tuple[float, ...] = ()
    floor: float = 0.0  # half the width of a band about zero, the noise; 0 for none
    # Whether zero is in the middle, and what is far larger than the best is cut off.
    centred: bool = False
    # Lowest and highest value shown; None for those of the curves.
    span: tuple[float, float] | None = None
    tall: bool = True  # whether the plot is the taller one of its panel
    log: bool = False  # whether the axis is logarithmic
    # (K,) increasing values that it is drawn over; None for the time of its panel.
    over: Array | None = None
    axis: str = ""  # what these are, with their unit
    # Mean and RMS of the curve of a stage.
    trends: Mapping[Stage, Trend] = field(default_factory=dict)


@dataclass(frozen=True)
class Shade:
    """An interval of the axis in which the error of a stage is largest, with a description."""

    stage: Stage
    start: float
    end: float
    words: str


@dataclass(frozen=True, eq=False)
class Panel:
    """The plots of one joint."""

    title: str
    detail: str  # its errors, in words
    time: Array  # (K,) increasing instants on the chart's axis, s
    plots: tuple[Plot, ...]
    shades: tuple[Shade, ...] = ()
    badge: str = ""  # what is special about the joint, in words; "" for nothing
    shown: bool = True  # whether the panel is shown at first


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels with one common axis, or with plots side by side that have their own."""

    name: str  # short name, different from those of other charts of a page
    caption: str
    panels: tuple[Panel, ...]
    # Name, first and last instant, and shift to the common axis, of every log, s; none if the
    # curves are of one stretch.
    spans: tuple[tuple[str, float, float, float], ...] = ()
    axis: str = "time in the log, s"  # what the common axis is, with its unit
    parts: str = "Joints"  # what the panels are of
    unit: str = "s"  # unit of the common axis
    # Whether the plots of a panel stand side by side, each over an axis of its own.
    abreast: bool = False

    @property
    def ends(self) -> tuple[float, float]:
        """First and last instant on the common axis."""
        spans = self.stretches or (("", 0.0, 1.0, 0.0),)
        low, high = spans[0][1] + spans[0][3], spans[-1][2] + spans[-1][3]
        return low, (high if high > low else low + 1.0)

    @property
    def stretches(self) -> tuple[tuple[str, float, float, float], ...]:
        """Return the spans; without any, one from the first to the last instant of a panel."""
        time = self.panels[0].time if self.panels else np.array([])
        if self.spans or self.abreast or not len(time):
            return self.spans
        return (("", float(time[0]), float(time[-1]), 0.0),)

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Return the stages of the curves, in their order."""
        plots = (plot for panel in self.panels for plot in panel.plots)
        return tuple(dict.fromkeys(stage for plot in plots for stage in plot.curves))

    @property
    def data(self) -> str:
        """The chart as JSON for embedding in a page."""
        numbers = {
            **picked(self, "ends", "axis", "unit", "abreast"),
            "spans": [(printable(name), *numbers) for name, *numbers in self.stretches],
            "stages": [
                {"key": s.key, "label": printable(s.label), "color": s.color, "look": s.look}
                for s in self.stages
            ],
            "panels": [_panel(panel) for panel in self.panels],
        }
        text = json.dumps(numbers, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        return text.replace("&", r"\u0026").replace("<", r"\u003c").replace(">", r"\u003e")


def _panel(panel: Panel) -> dict[str, Any]:
    on_time = [plot for plot in panel.plots if plot.over is None]
    time, rows, derived = panel.time, iter(()), list[str]()
    if on_time:
        curves = np.array([values for plot in on_time for values in plot.curves.values()])
        time, thinned = decimated(time, curves, min(MOST_POINTS, _MOST_NUMBERS // len(curves)))
        rows = iter(thinned)
    if on_time and len(time) == len(panel.time):
        # Curves that are the first one minus the residuals, which the page computes.
        residuals = next((plot.curves for plot in panel.plots if plot.centred), {})
        first, *others = panel.plots[0].curves.items()
        derived = [
            stage.key
            for stage, values in others
            if stage in residuals
            and np.allclose(first[1] - residuals[stage], values, equal_nan=True)
        ]
    packs = [
        {
            stage.key: packed(values if plot.over is not None else next(rows))
            for stage, values in plot.curves.items()
        }
        | (dict.fromkeys(derived) if plot is panel.plots[0] else {})
        for plot in panel.plots
    ]
    return {
        "title": printable(panel.title),
        "time": _encoded(time.astype("<f4")),
        "shades": [[shade.stage.key, shade.start, shade.end] for shade in panel.shades],
        "plots": [
            {
                "label": printable(plot.label),
                **picked(plot, "limits", "centred", "span", "tall", "log"),
                "floor": plot.floor if isfinite(plot.floor) else 0.0,
                "axis": printable(plot.axis),
                "over": None if plot.over is None else packed(plot.over),
                "curves": pack,
                "trends": {
                    stage.key: [packed(trend.middle), packed(trend.mean), packed(trend.rms)]
                    for stage, trend in plot.trends.items()
                },
            }
            for plot, pack in zip(panel.plots, packs, strict=True)
        ],
    }


def _encoded(values: NDArray[Any]) -> str:
    return base64.b64encode(values.tobytes()).decode()


def packed(values: Array) -> tuple[float, float, str]:
    """Return values as 16 bit integers: offset and scale to float, and the integers in base64.

    A value is offset + scale · integer; −32768 stands for a missing one.
    """
    known = np.isfinite(values)
    finite = values[known]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    offset, scale = 0.5 * (low + high), 0.5 * (high - low) / _LARGEST
    whole = np.full(len(values), _MISSING, "<i2")
    whole[known] = np.round((finite - offset) / scale) if scale > 0 else 0
    return offset, scale, _encoded(whole)


def decimated(time: Array, curves: Array, most: int) -> tuple[Array, Array]:
    """Return (M,) instants and (C, M) values of curves (C, K), at most so many, at least four.

    Two points stand for a bucket of instants (K,): its least and largest value, the least first
    where the curve rises. NaN stay where lines break.
    """
    count = len(time)
    if count <= most:
        return time, curves
    breaks = np.flatnonzero(np.isnan(curves).all(0))
    if 4 * len(breaks) > most:  # too many gaps to show
        return decimated(np.delete(time, breaks), np.delete(curves, breaks, axis=1), most)
    even = np.linspace(0, count, (most - 3 * len(breaks)) // 2, endpoint=False).astype(int)
    starts = np.unique(np.concatenate([even, breaks, breaks + 1]))
    starts = starts[starts < count]
    stops = np.append(starts[1:], count)
    low, high = (of.reduceat(curves, starts, axis=1) for of in (np.fmin, np.fmax))
    rises = curves[:, starts] <= curves[:, stops - 1]
    values = np.stack([np.where(rises, low, high), np.where(rises, high, low)], -1)
    times = np.stack([time[starts], time[np.minimum((starts + stops) // 2, count - 1)]], -1)
    kept = np.stack([stops > starts, stops > starts + 1], -1)
    return times[kept], values[:, kept]


def gap_filled(time: Array) -> Array:
    """Put instants that are missing, where a line breaks, between their neighbours."""
    missing = np.isnan(time)
    index = np.arange(len(time))
    return np.interp(index, index[~missing], time[~missing]) if (~missing).any() else time[:0]


NOISE = Stage("sensor noise", "noise", look="thin")


@dataclass(frozen=True)
class BarRow:
    """Bars of one name, and marks across them, by what they are of; NaN where not known.

    Marks without a value are not drawn.
    """

    label: str
    bars: Mapping[Stage, float]
    marks: Mapping[Stage, float]
    note: str = ""  # behind the numbers

    @property
    def shown_marks(self) -> Mapping[Stage, float]:
        """Return the marks that have a value."""
        return {stage: value for stage, value in self.marks.items() if 0.0 < value < inf}

    def text(self, value: float) -> str:
        """Return a value in words."""
        return number(value) + self.note


@dataclass(frozen=True)
class Bars:
    """A bar chart with a short name and an optional note."""

    name: str
    caption: str
    rows: tuple[BarRow, ...]
    note: str = ""
    log: bool = True  # whether the axis is logarithmic

    @property
    def legend(self) -> tuple[Stage, ...]:
        """Return the stages of the bars, then those of the marks."""
        bars = [stage for row in self.rows for stage in row.bars]
        return tuple(dict.fromkeys((*bars, *(stage for row in self.rows for stage in row.marks))))

    @property
    def letters(self) -> int:
        """Return the maximum number of characters beside the longest bar."""
        texts = (row.text(value) for row in self.rows for value in row.bars.values())
        return max(map(len, texts), default=0)

    def end(self, value: float) -> float:
        """Return the end of a bar, from 0 to 1; 0 without a value."""
        values = [x for row in self.rows for x in (*row.bars.values(), *row.shown_marks.values())]
        known = [max(x, _LEAST) for x in values if isfinite(x)] or [1.0]
        if not isfinite(value):
            return 0.0
        if not self.log:
            return value / max(known)
        low, high = 0.6 * min(known), 1.01 * max(known)
        return log(max(value, _LEAST) / low) / log(high / low)
