"""Measured and predicted efforts of every joint over time, with the worst stretches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.results import Explanation
from geodrake.identification.logs.model_errors import Comparison, Series
from geodrake.identification.logs.worst_windows import worst_windows
from geodrake.report.charts import Chart, Panel, Plot, Shade, Stage
from geodrake.report.curves import gap_filled
from geodrake.report.numbers import Units, number
from geodrake.report.timeline import Timeline, log_of
from geodrake.report.words import effect_label, worst_joint
from geodrake.report.worst_joints import worst_joints

Array = NDArray[np.float64]

MEASURED = Stage("measured", "measured", "measured", wide=True)
BEFORE = Stage("before", "as it stands", "before")
AFTER = Stage("after", "final model", "after")
_CAPTION = (
    "Measured and predicted effort of every joint, and under it measured − predicted; the band is "
    "sensor noise. Shaded: where the error is largest. Lines break where samples were left out."
)
_COLORS = ("step-1", "step-2", "step-3", "step-4")


def effort_chart(
    before: Comparison,
    after: Comparison | None = None,
    *,
    stages: Mapping[Stage, Sequence[Series]] | None = None,
    units: Units | None = None,
    alone: Stage = BEFORE,
) -> Chart:
    """The chart of a comparison, or of two.

    Args:
        after: The final model on the same logs, if there is one.
        units: Units of the joints; those of revolute joints by default.
    """
    units = units or Units()
    first = BEFORE if after is not None else alone
    models = {first: before.series, **(stages or {})}
    if after is not None:
        models[AFTER] = after.series
    final = after or before
    timeline = Timeline.of(before.series)
    shown = worst_joints(final.errors)
    badges = _badges(before, after)
    panels = []
    for start, end in zip(before.errors.joints, final.errors.joints, strict=True):
        joint, unit = start.joint, units.effort([start.joint])
        own = {stage: _of(series, joint) for stage, series in models.items()}
        if not any(own.values()):
            continue
        rms = [start.rms] if after is None else [start.rms, end.rms]
        nrms = [start.nrms] if after is None else [start.nrms, end.nrms]
        detail = f"RMS {' → '.join(map(number, rms))} {unit}, nrms {' → '.join(map(number, nrms))}"
        time, plots = _plots(timeline, own, unit, end.floor)
        ends = {first: own[first], **({AFTER: own[AFTER]} if after is not None else {})}
        panels.append(
            Panel(
                joint,
                detail,
                time,
                plots,
                _shades(timeline, ends, unit),
                badges.get(joint, ""),
                joint in shown or joint in badges,
            )
        )
    spans = tuple((log, *ends, timeline.shifts[log]) for log, ends in timeline.spans.items())
    return Chart("efforts", _CAPTION, (MEASURED, *models), tuple(panels), spans)


def explanation_chart(explanation: Explanation, units: Units) -> Chart:
    """The chart of an explanation: as it stands, after each step, in the end."""
    if not explanation.steps:
        return effort_chart(explanation.before, units=units)
    between = {
        Stage(
            f"step{count}",
            f"after {count}: + {effect_label(step.effect)}",
            _COLORS[(count - 1) % len(_COLORS)],
            shown=False,
        ): step.series
        for count, step in enumerate(explanation.steps, 1)
        if step.series
    }
    return effort_chart(explanation.before, explanation.after, stages=between, units=units)


def _of(series: Sequence[Series], joint: str) -> list[Series]:
    return [s for s in series if s.joint == joint and len(s.time)]


def _plots(
    timeline: Timeline, own: Mapping[Stage, Sequence[Series]], unit: str, floor: float
) -> tuple[Array, tuple[Plot, ...]]:
    """Instants of a joint, and its efforts and residuals at every stage on them."""
    *_, last = (series for series in own.values() if series)
    broken, measured = timeline.broken(last, "measured")
    time = gap_filled(broken)
    efforts: dict[str, Array] = {MEASURED.key: measured}
    residuals: dict[str, Array] = {}
    for stage, series in own.items():
        for signal, curves in (("predicted", efforts), ("residual", residuals)):
            at, values = timeline.broken(series, signal)
            curves[stage.key] = _on(time, broken, at, values)
    return time, (
        Plot(f"effort, {unit}", efforts),
        Plot("residual", residuals, floor=floor, centred=True, tall=False),
    )


def _on(time: Array, broken: Array, at: Array, values: Array) -> Array:
    """Values at other instants: the same ones, but where a model was prepared in another way."""
    if np.array_equal(broken, at, equal_nan=True):
        return values
    known = np.isfinite(at)
    if not known.any():
        return np.full(len(time), np.nan)
    return np.where(np.isnan(broken), np.nan, np.interp(time, at[known], values[known]))


def _shades(
    timeline: Timeline, ends: Mapping[Stage, Sequence[Series]], unit: str
) -> tuple[Shade, ...]:
    several = len(timeline.spans) > 1
    found = []
    for stage, series in ends.items():
        logs = {s.block: log_of(s) for s in series}
        for window in worst_windows(series):
            log = logs[window.block]
            shift = timeline.shifts[log]
            words = (
                f"{log + ' ' if several else ''}{window.start:.1f}–{window.end:.1f} s: RMS "
                f"{number(window.rms)} {unit}"
            )
            found.append(Shade(stage.key, window.start + shift, window.end + shift, words))
    return tuple(found)


def _badges(before: Comparison, after: Comparison | None) -> dict[str, str]:
    """The joints that err most, by name."""
    if len(before.errors.joints) < 2:
        return {}
    first = worst_joint(before.errors).joint
    if after is None:
        return {first: "worst joint"}
    last = worst_joint(after.errors).joint
    if first == last:
        return {first: "worst joint, at first and in the end"}
    return {first: "worst joint at first", last: "worst joint in the end"}
