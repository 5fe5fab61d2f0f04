"""Plots over time as plain data: what the page's script draws, and its picture without one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.escaping import printable
from geodrake.report.curves import decimated, floats, packed

Array = NDArray[np.float64]

MOST_POINTS = 2000
"""Largest number of points of a curve that a page holds."""
_MOST_NUMBERS = 16_000
"""Largest number of points of all curves of a panel together."""


@dataclass(frozen=True)
class Stage:
    """What curves of one colour show: the measurement, or a model.

    Attributes:
        key: Short name, the same in all charts of a page.
        label: What it is, in words.
        color: Name of the colour in the page's style sheet.
        shown: Whether it is shown at first.
        wide: Whether its lines are wide, behind the others.
    """

    key: str
    label: str
    color: str
    shown: bool = True
    wide: bool = False


@dataclass(frozen=True, eq=False)
class Plot:
    """One axis with curves over the time of its panel.

    Attributes:
        label: What is shown, with its unit.
        curves: Stage -> (K,) values; NaN where a line breaks.
        floor: Half the width of a band about zero, the noise; 0 for none.
        centred: Whether zero is in the middle, and what is far larger than the best is cut off.
        span: Lowest and highest value shown; None for those of the curves.
        tall: Whether the plot is the taller one of its panel.
    """

    label: str
    curves: Mapping[str, Array]
    limits: tuple[float, ...] = ()
    floor: float = 0.0
    centred: bool = False
    span: tuple[float, float] | None = None
    tall: bool = True


@dataclass(frozen=True)
class Shade:
    """A stretch of time that is shaded.

    Attributes:
        stage: The stage of which it is a worst one.
        start: Beginning on the chart's axis, s.
        end: End, s.
        words: What it is, in words.
    """

    stage: str
    start: float
    end: float
    words: str


@dataclass(frozen=True, eq=False)
class Panel:
    """The plots of one joint, above each other.

    Attributes:
        detail: Its errors, in words.
        time: (K,) increasing instants on the chart's axis, s.
        badge: What is special about the joint, in words; "" for nothing.
        shown: Whether the panel is shown at first.
    """

    title: str
    detail: str
    time: Array
    plots: tuple[Plot, ...]
    shades: tuple[Shade, ...] = ()
    badge: str = ""
    shown: bool = True


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels with one common axis of time.

    Attributes:
        name: Short name, different from those of other charts of a page.
        stages: Of which stages the curves are, measured first.
        spans: Name, first and last instant, and shift to the common axis, of every log, s.
        axis: What the axis is, with its unit.
        dots: Whether samples are dots, not joined by lines.
        parts: What the panels are of.
    """

    name: str
    caption: str
    stages: tuple[Stage, ...]
    panels: tuple[Panel, ...]
    spans: tuple[tuple[str, float, float, float], ...]
    axis: str = "time in the log, s"
    dots: bool = False
    parts: str = "Joints"
    unit: str = "s"

    @property
    def ends(self) -> tuple[float, float]:
        """First and last instant on the common axis, s."""
        spans = self.spans or (("", 0.0, 1.0, 0.0),)
        low, high = spans[0][1] + spans[0][3], spans[-1][2] + spans[-1][3]
        return low, (high if high > low else low + 1.0)

    def color_of(self, key: str) -> str:
        """The colour of a stage, by its key."""
        return next(stage.color for stage in self.stages if stage.key == key)

    @property
    def data(self) -> str:
        """The chart as JSON that may stand in a page."""
        numbers = {
            "ends": self.ends,
            "axis": self.axis,
            "unit": self.unit,
            "dots": self.dots,
            "spans": [(printable(name), *numbers) for name, *numbers in self.spans],
            "stages": [
                {"key": s.key, "label": printable(s.label), "color": s.color, "wide": s.wide}
                for s in self.stages
            ],
            "panels": [_panel(panel) for panel in self.panels],
        }
        text = json.dumps(numbers, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        return text.replace("&", r"\u0026").replace("<", r"\u003c").replace(">", r"\u003e")


def _panel(panel: Panel) -> dict[str, Any]:
    curves = [values for plot in panel.plots for values in plot.curves.values()]
    most = min(MOST_POINTS, _MOST_NUMBERS // len(curves))
    time, thinned = decimated(panel.time, np.array(curves), most)
    rows = iter(thinned)
    packs = [{key: packed(next(rows)) for key in plot.curves} for plot in panel.plots]
    derived = _derived(panel) if len(time) == len(panel.time) else ()
    return {
        "title": printable(panel.title),
        "time": floats(time),
        "shades": [[shade.stage, shade.start, shade.end] for shade in panel.shades],
        "plots": [
            {
                "label": printable(plot.label),
                "limits": plot.limits,
                "floor": plot.floor if isfinite(plot.floor) else 0.0,
                "centred": plot.centred,
                "span": plot.span,
                "tall": plot.tall,
                "curves": {
                    key: None if plot is panel.plots[0] and key in derived else values
                    for key, values in pack.items()
                },
            }
            for plot, pack in zip(panel.plots, packs, strict=True)
        ],
    }


def _derived(panel: Panel) -> tuple[str, ...]:
    """Stages whose curve is the first one less what the panel's residuals are."""
    residuals = next((plot.curves for plot in panel.plots if plot.centred), {})
    first, *others = panel.plots[0].curves.items()
    return tuple(
        key
        for key, values in others
        if key in residuals and np.allclose(first[1] - residuals[key], values, equal_nan=True)
    )
