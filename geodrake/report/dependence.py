"""Residuals against velocity, position and load: plots that have no time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.identification.logs.model_errors import Comparison, JointError, Series
from geodrake.report.charts import Stage
from geodrake.report.frame import Frame
from geodrake.report.numbers import Units, number
from geodrake.report.static_plot import (
    Line,
    StaticPlot,
    across_ticks,
    noise_band,
    value_ticks,
)
from geodrake.report.worst_joints import worst_joints

Array = NDArray[np.float64]

_MOST_DOTS = 240
_BINS = 20
_SIGNALS = (
    ("velocity", "velocity", "rad/s"),
    ("position", "position", "rad"),
    ("predicted", "load (predicted effort)", "N·m"),
)
_CAPTION = (
    "{stage}: measured − predicted effort against velocity, position and load, each joint on its "
    "own scale. Line: mean in bins of equally many samples; dashed: RMS; band: sensor noise."
)


@dataclass(frozen=True)
class DependenceRow:
    """The plots of one joint.

    Attributes:
        detail: Its error, in words.
        plots: One for each signal.
        shown: Whether the joint is shown at first.
    """

    title: str
    detail: str
    plots: tuple[StaticPlot, ...]
    shown: bool


@dataclass(frozen=True)
class Dependence:
    """Residuals of one model against what they may depend on.

    Attributes:
        rows: One for each joint.
    """

    stage: Stage
    caption: str
    rows: tuple[DependenceRow, ...]


def residual_dependence(comparison: Comparison, stage: Stage, units: Units) -> Dependence:
    """The residuals of every joint."""
    shown = worst_joints(comparison.errors)
    rows = []
    for entry in comparison.errors.joints:
        own = [s for s in comparison.series if s.joint == entry.joint and len(s.time)]
        if own:
            unit = units.effort([entry.joint])
            plots = _plots(own, entry, stage, units)
            detail = f"RMS {number(entry.rms)} {unit}"
            rows.append(DependenceRow(entry.joint, detail, plots, entry.joint in shown))
    label = stage.label[:1].upper() + stage.label[1:]
    return Dependence(stage, _CAPTION.format(stage=label), tuple(rows))


def _plots(
    own: Sequence[Series], entry: JointError, stage: Stage, units: Units
) -> tuple[StaticPlot, ...]:
    residual = np.concatenate([s.residual for s in own])
    peak = 1.08 * float(np.abs(residual[np.isfinite(residual)]).max(initial=0.0)) or 1.0
    plots: list[StaticPlot] = []
    for name, words, unit in _SIGNALS:
        values = np.concatenate([getattr(s, name) for s in own])
        label = "residual" if plots else f"residual, {units.effort([entry.joint])}"
        below = f"{words}, {units.at(entry.joint, unit)}"
        plots.append(_plot(values, residual, peak, floor=entry.floor, color=stage.color))
        plots[-1] = replace(plots[-1], label=label, below=below)
    return tuple(plots)


def _plot(
    values: Array,
    residual: Array,
    peak: float,
    *,
    floor: float,
    color: str,
) -> StaticPlot:
    finite = np.isfinite(values) & np.isfinite(residual)
    values, residual = values[finite], residual[finite]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    margin = 0.03 * (high - low) or 1.0
    frame = Frame((low - margin, high + margin), (-peak, peak))
    kept = np.linspace(0, len(values) - 1, min(_MOST_DOTS, len(values))).astype(int)
    lines = [
        Line("", "quiet", "zero", frame.line(np.array(frame.x), np.zeros(2))),
        Line("", color, "dots", frame.dots(values[kept], residual[kept])),
    ]
    if len(values) >= 2:
        order = np.argsort(values, kind="stable")
        bins = np.array_split(order, min(_BINS, max(1, len(order) // 8)))
        middle = np.array([values[b].mean() for b in bins])
        mean = np.array([residual[b].mean() for b in bins])
        rms = np.array([np.sqrt((residual[b] ** 2).mean()) for b in bins])
        lines += [
            Line("", "ink", "mean", frame.line(middle, mean)),
            Line("", "ink", "rms", frame.line(middle, rms)),
        ]
    band = noise_band(frame, floor)
    return StaticPlot("", tuple(lines), band, across_ticks(frame, 4), value_ticks(frame, 4))
