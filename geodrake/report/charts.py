"""Charts as plain data, curves and bars, which pages and matplotlib draw."""

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

MOST_PANELS = 8  # panels shown at first, and in figures
MOST_POINTS = 2000  # points of a curve on a page
CUT = 3.0  # residuals are cut off at this multiple of the best model's largest

_MOST_NUMBERS = 16_000  # points of all curves of a panel together
_LARGEST, _MISSING = 32767, -32768
_LEAST = 1e-6  # nrms of a perfect model on a logarithmic axis


@dataclass(frozen=True)
class Stage:
    """The subject of curves or bars: the measurement, or a model."""

    label: str  # the same in all charts of a page that show it
    color: str  # name of the colour in the page's style sheet
    look: str = "line"  # or "wide", "dots", or for a mark across bars "thin"
    shown: bool = field(default=True, compare=False)  # at first
    opacity: float = 1.0  # of bars, from 0 to 1

    @property
    def key(self) -> str:
        """Return its identifier on a page."""
        return f"{self.label} ({self.look})"


@dataclass(frozen=True, eq=False)
class Trend:
    """Mean and RMS of samples in bins (B,), and the middles of the bins."""

    middle: Array
    mean: Array
    rms: Array


@dataclass(frozen=True, eq=False)
class Plot:
    """One axis with curves."""

    label: str  # quantity and unit
    curves: Mapping[Stage, Array]  # (K,) values of each stage; NaN where a line breaks
    limits: tuple[float, ...] = ()
    floor: float = 0.0  # half the width of a noise band about zero; 0 for none
    centred: bool = False  # whether zero is in the middle, and values are cut off; see `CUT`
    span: tuple[float, float] | None = None  # shown range; None for that of the curves
    tall: bool = True  # whether it is the taller plot of its panel
    log: bool = False  # whether the axis is logarithmic
    over: Array | None = None  # (K,) increasing abscissae; None for the time of its panel
    axis: str = ""  # quantity and unit of `over`
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
    time: Array  # (K,) increasing, on the chart's axis, s
    plots: tuple[Plot, ...]
    shades: tuple[Shade, ...] = ()
    badge: str = ""  # a remark such as "worst joint"
    shown: bool = True  # at first


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels with a common axis, or with plots side by side that have their own."""

    name: str  # unique on a page
    caption: str
    panels: tuple[Panel, ...]
    # Name, first and last instant, and shift to the common axis of every log, s; may be empty.
    spans: tuple[tuple[str, float, float, float], ...] = ()
    axis: str = "time in the log, s"  # quantity and unit of the common axis
    parts: str = "Joints"  # heading of the list of panels
    unit: str = "s"  # of the common axis
    abreast: bool = False  # whether plots of a panel are side by side, each with its own axis

    @property
    def ends(self) -> tuple[float, float]:
        """First and last instant on the common axis."""
        spans = self.stretches or (("", 0.0, 1.0, 0.0),)
        low, high = spans[0][1] + spans[0][3], spans[-1][2] + spans[-1][3]
        return low, (high if high > low else low + 1.0)

    @property
    def stretches(self) -> tuple[tuple[str, float, float, float], ...]:
        """Return the spans, or if there are none, that of the first panel."""
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
    time_plots = [plot for plot in panel.plots if plot.over is None]
    time, rows, derived = panel.time, iter(()), list[str]()
    if time_plots:
        curves = np.array([values for plot in time_plots for values in plot.curves.values()])
        time, thinned = decimated(time, curves, min(MOST_POINTS, _MOST_NUMBERS // len(curves)))
        rows = iter(thinned)
    if time_plots and len(time) == len(panel.time):
        # The page computes curves that are the first one minus the residuals.
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
    """Return values as offset, scale, and 16 bit integers in base64.

    A value is offset + scale · integer; −32768 stands for NaN.
    """
    known = np.isfinite(values)
    finite = values[known]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    offset, scale = 0.5 * (low + high), 0.5 * (high - low) / _LARGEST
    integers = np.full(len(values), _MISSING, "<i2")
    integers[known] = np.round((finite - offset) / scale) if scale > 0 else 0
    return offset, scale, _encoded(integers)


def decimated(time: Array, curves: Array, most: int) -> tuple[Array, Array]:
    """Reduce times (K,) and curves (C, K) to at most so many points, at least four.

    Each bucket of samples becomes its smallest and largest value, in the order in which the curve
    passes them. NaN stay where lines break.
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
    low, high = (ufunc.reduceat(curves, starts, axis=1) for ufunc in (np.fmin, np.fmax))
    rises = curves[:, starts] <= curves[:, stops - 1]
    values = np.stack([np.where(rises, low, high), np.where(rises, high, low)], -1)
    times = np.stack([time[starts], time[np.minimum((starts + stops) // 2, count - 1)]], -1)
    kept = np.stack([stops > starts, stops > starts + 1], -1)
    return times[kept], values[:, kept]


def gap_filled(time: Array) -> Array:
    """Interpolate the missing times, at which lines break."""
    missing = np.isnan(time)
    index = np.arange(len(time))
    return np.interp(index, index[~missing], time[~missing]) if (~missing).any() else time[:0]


NOISE = Stage("sensor noise", "noise", look="thin")


@dataclass(frozen=True)
class BarRow:
    """Bars with a label, and marks across them; NaN if unknown."""

    label: str
    bars: Mapping[Stage, float]
    marks: Mapping[Stage, float]
    note: str = ""  # after the numbers

    @property
    def shown_marks(self) -> Mapping[Stage, float]:
        """Return the marks with a positive, finite value."""
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
        """Return the end of a bar, from 0 to 1; 0 for NaN."""
        values = [x for row in self.rows for x in (*row.bars.values(), *row.shown_marks.values())]
        known = [max(x, _LEAST) for x in values if isfinite(x)] or [1.0]
        if not isfinite(value):
            return 0.0
        if not self.log:
            return value / max(known)
        low, high = 0.6 * min(known), 1.01 * max(known)
        return log(max(value, _LEAST) / low) / log(high / low)
