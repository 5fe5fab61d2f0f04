"""Charts of errors: efforts over time, residuals over the motion, bars by step and by joint."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geodrake.diagnosis.results import Diagnosis, Explanation
from geodrake.identification.logs.model_errors import (
    Comparison,
    ErrorTable,
    JointError,
    Series,
    worst_windows,
)
from geodrake.inertia import Array
from geodrake.report.charts import (
    MOST_PANELS,
    NOISE,
    BarRow,
    Bars,
    Chart,
    Panel,
    Plot,
    Shade,
    Stage,
    Trend,
    gap_filled,
)
from geodrake.report.numbers import Units, number, shortened
from geodrake.report.words import effect_label, places_label, step_place, worst_joint

MEASURED = Stage("measured", "measured", look="wide")
BEFORE = Stage("as it stands", "before")
AFTER = Stage("final model", "after")

GAP = 1.5  # multiple of the usual sampling period above which a line breaks
_MOST_CANDIDATES, _MOST_LETTERS = 14, 80
_MOST_DOTS, _BINS = 160, 20
_SIGNALS = (
    ("velocity", "velocity", "rad/s"),
    ("position", "position", "rad"),
    ("predicted", "load (predicted effort)", "N·m"),
)
_EFFORTS = (
    "Measured and predicted effort of every joint, and below them measured − predicted; the band "
    "is sensor noise. Shaded: where the error is largest. Lines break where samples are missing."
)
_RESIDUALS = (
    "Measured − predicted effort over velocity, position and load; each joint has its own "
    "scale. Line: mean in bins of equal size; dashed: RMS; band: sensor noise."
)
_END = Stage("refitted on the logs", "after")
_WITHOUT = Stage("without it", "before", look="thin")
_CHOSEN, _UNLIKELY = Stage("chosen", "after"), Stage("less likely", "measured")
_TIED = Stage("tied", "tied")


def worst_joints(errors: ErrorTable) -> tuple[str, ...]:
    """Return the joints of largest nrms, in the table's order.

    They always include the joint of largest RMS. NaN counts as the largest.
    """
    nrms = np.array([joint.nrms for joint in errors.joints])
    rms = np.array([joint.rms for joint in errors.joints])
    order = np.argsort(-np.nan_to_num(nrms, nan=np.inf), kind="stable")
    worst = int(np.argmax(np.nan_to_num(rms, nan=np.inf)))
    chosen = [*order[:MOST_PANELS]]
    if worst not in chosen:
        chosen[-1] = worst
    return tuple(errors.joints[i].joint for i in sorted(chosen))


@dataclass(frozen=True)
class _Timeline:
    """Logs in a row on one axis: first and last instant of each, and its shift, s."""

    spans: Mapping[str, tuple[float, float]]
    shifts: Mapping[str, float]

    @classmethod
    def of(cls, series: Sequence[Series]) -> _Timeline:
        spans: dict[str, tuple[float, float]] = {}
        for s in (s for s in series if len(s.time)):  # joints at rest have no samples
            low, high = spans.get(s.log, (np.inf, -np.inf))
            spans[s.log] = min(low, float(s.time[0])), max(high, float(s.time[-1]))
        gap = 0.02 * sum(high - low for low, high in spans.values())
        shifts, start = {}, 0.0
        for log, (low, high) in spans.items():
            shifts[log] = start - low
            start += high - low + gap
        return cls(spans, shifts)

    def broken(self, series: Sequence[Series], name: str) -> tuple[Array, Array]:
        """Return instants and values of a signal, NaN where samples are missing."""
        time, values = [np.array([])], [np.array([])]
        for s in series:
            steps = np.diff(s.time)
            gaps = 1 + np.flatnonzero(steps > GAP * np.median(steps)) if len(steps) else steps
            breaks = np.append(gaps.astype(int), len(s.time))
            time.append(np.insert(s.time + self.shifts[s.log], breaks, np.nan))
            values.append(np.insert(getattr(s, name), breaks, np.nan))
        return np.concatenate(time), np.concatenate(values)


def effort_chart(
    models: Mapping[Stage, Comparison],
    units: Units,
    between: Mapping[Stage, Sequence[Series]] | None = None,
) -> Chart:
    """Return efforts over time, as predicted by one or two models and intermediate ones."""
    (first, before), *others = models.items()
    predicted = {first: before.series, **(between or {})}
    predicted |= {stage: found.series for stage, found in others}
    tables = [found.errors for found in models.values()]
    timeline, ends = _Timeline.of(before.series), [worst_joint(table).joint for table in tables]
    badges = {ends[0]: "worst joint before", ends[-1]: "worst joint after"}
    if len(set(ends)) == 1:
        badges = {ends[0]: "worst joint" + (" before and after" if len(tables) > 1 else "")}
    badges = badges if len(tables[0].joints) > 1 else {}
    shown, panels = {*worst_joints(tables[-1]), *badges}, []
    for entries in zip(*(table.joints for table in tables), strict=True):
        joint, unit = entries[0].joint, units.effort([entries[0].joint])
        joint_series = {stage: _of(series, joint) for stage, series in predicted.items()}
        if not any(joint_series.values()):
            continue
        rms, nrms = (" → ".join(number(getattr(e, n)) for e in entries) for n in ("rms", "nrms"))
        time, plots = _plots(timeline, joint_series, unit, entries[-1].floor)
        shades = tuple(
            Shade(
                stage,
                window.start + timeline.shifts[window.log],
                window.end + timeline.shifts[window.log],
                f"{window.log + ' ' if len(timeline.spans) > 1 else ''}"
                f"{window.start:.1f}–{window.end:.1f} s: RMS {number(window.rms)} {unit}",
            )
            for stage in models
            for window in worst_windows(joint_series[stage])
        )
        words, badge = f"RMS {rms} {unit}, nrms {nrms}", badges.get(joint, "")
        panels.append(Panel(joint, words, time, plots, shades, badge, joint in shown))
    spans = tuple((log, *ends, timeline.shifts[log]) for log, ends in timeline.spans.items())
    return Chart("efforts", _EFFORTS, tuple(panels), spans)


def step_stages(explanation: Explanation) -> dict[Stage, Sequence[Series]]:
    """Return the models after each step, with their predictions if known."""
    return {
        Stage(
            f"after {count}: + {effect_label(step.effect)}",
            f"step-{(count - 1) % 4 + 1}",
            shown=False,
        ): step.series
        for count, step in enumerate(explanation.steps, 1)
        if step.series
    }


def _of(series: Sequence[Series], joint: str) -> list[Series]:
    return [s for s in series if s.joint == joint and len(s.time)]


def _plots(
    timeline: _Timeline, joint_series: Mapping[Stage, Sequence[Series]], unit: str, floor: float
) -> tuple[Array, tuple[Plot, ...]]:
    """Return the sample times of a joint, and its efforts and residuals at every stage."""
    *_, last = (series for series in joint_series.values() if series)
    time, measured = timeline.broken(last, "measured")
    efforts: dict[Stage, Array] = {MEASURED: measured}
    residuals: dict[Stage, Array] = {}
    for stage, series in joint_series.items():
        for signal, curves in (("predicted", efforts), ("residual", residuals)):
            at, values = timeline.broken(series, signal)
            if not np.array_equal(time, at, equal_nan=True):  # prepared differently
                known = np.isfinite(at)
                at, values = (
                    (at[known], values[known]) if known.any() else np.array([[0.0], [np.nan]])
                )
                values = np.interp(time, at, values)  # NaN where the instant is
            curves[stage] = values
    return gap_filled(time), (
        Plot(f"effort, {unit}", efforts),
        Plot("residual", residuals, floor=floor, centred=True, tall=False),
    )


def residual_chart(models: Mapping[Stage, Comparison], units: Units) -> Chart:
    """Return residuals of models over velocity, position and load.

    A few hundred samples are drawn. Only the last model is shown at first.
    """
    *_, final = models.values()
    shown = worst_joints(final.errors)
    panels = []
    for entry in final.errors.joints:
        joint_series = {
            replace(stage, look="dots", shown=found is final): _of(found.series, entry.joint)
            for stage, found in models.items()
        }
        joint_series = {stage: series for stage, series in joint_series.items() if series}
        if joint_series:
            detail = f"RMS {number(entry.rms)} {units.effort([entry.joint])}"
            plots = tuple(_over(joint_series, entry, signal, units) for signal in _SIGNALS)
            is_shown = entry.joint in shown
            panels.append(Panel(entry.joint, detail, np.array([]), plots, shown=is_shown))
    return Chart("residuals", _RESIDUALS, tuple(panels), abreast=True)


def _over(
    joint_series: Mapping[Stage, Sequence[Series]],
    entry: JointError,
    signal: tuple[str, str, str],
    units: Units,
) -> Plot:
    """Return the residuals of a joint over one signal."""
    name, words, unit = signal
    dots: dict[Stage, tuple[Array, Array]] = {}
    trends = {}
    for stage, series in joint_series.items():
        values = np.concatenate([getattr(s, name) for s in series])
        residual = np.concatenate([s.residual for s in series])
        known = np.isfinite(values) & np.isfinite(residual)
        values, residual = values[known], residual[known]
        kept = np.linspace(0, len(values) - 1, min(_MOST_DOTS, len(values))).astype(int)
        dots[stage] = values[kept], residual[kept]
        if len(values) >= 2:
            order = np.argsort(values, kind="stable")
            bins = np.array_split(order, min(_BINS, max(1, len(order) // 8)))
            middle, mean = (np.array([x[b].mean() for b in bins]) for x in (values, residual))
            rms = np.array([np.sqrt((residual[b] ** 2).mean()) for b in bins])
            trends[stage] = Trend(middle, mean, rms)
    over = np.unique(np.concatenate([values for values, _ in dots.values()]))
    curves = {stage: np.full(len(over), np.nan) for stage in dots}
    for stage, (values, residual) in dots.items():
        curves[stage][np.searchsorted(over, values)] = residual
    return Plot(
        f"residual, {units.effort([entry.joint])}" if name == "velocity" else "",
        curves,
        floor=entry.floor,
        centred=True,
        over=over,
        axis=f"{words}, {units.at(entry.joint, unit)}",
        trends=trends,
    )


def step_bars(explanation: Explanation, joints: Collection[str]) -> Bars:
    """Return the held-out nrms after each step; `joints` are all at which an effect may act."""
    errors = [
        ("the model as it stands", BEFORE, explanation.start.nrms),
        ("refitted, nothing added", _END, explanation.refitted.nrms),
    ]
    for step in explanation.steps:
        words = f"+ {effect_label(step.effect)}, {step_place(step, joints, most=3)}"
        errors.append((shortened(words, _MOST_LETTERS), _END, step.error_after))
    marks = {NOISE: explanation.end.floor_nrms}
    rows = tuple(BarRow(words, {stage: nrms}, marks) for words, stage, nrms in errors)
    caption = "nrms on held-out data after each step, on a logarithmic axis."
    return Bars("steps", caption, rows)


def candidate_bars(diagnosis: Diagnosis, joints: Collection[str]) -> Bars:
    """Return the held-out nrms with each candidate, the chosen one first; see `step_bars`."""
    shown, refitted = diagnosis.candidates[:_MOST_CANDIDATES], diagnosis.refitted
    marks = {_WITHOUT: refitted.nrms, NOISE: refitted.floor_nrms}
    rows = []
    for i, candidate in enumerate(shown):
        words = f"{effect_label(candidate.effect)}, {places_label(candidate.where, joints, most=3)}"
        stage = _CHOSEN if i == 0 else _TIED if candidate.tied else _UNLIKELY
        note = ", tied" if i and candidate.tied else ""
        bar = {stage: candidate.error_after}
        rows.append(BarRow(shortened(words, _MOST_LETTERS), bar, marks, note))
    count = len(diagnosis.candidates)
    return Bars(
        "candidates",
        "nrms on held-out data with each candidate.",
        tuple(rows),
        f"The best {len(shown)} of {count} candidates." if count > len(shown) else "",
        log=False,
    )


def joint_bars(errors: ErrorTable, stages: Sequence[tuple[str, Mapping[str, float]]] = ()) -> Bars:
    """Return the RMS error of each joint over the std of its effort, first and after stages."""
    shades = np.linspace(0.25, 1.0, len(stages)) if len(stages) > 1 else np.ones(len(stages))
    names, rows = set(worst_joints(errors)), []
    for joint in (joint for joint in errors.joints if joint.joint in names):
        bars = {BEFORE: joint.rms / joint.std}
        for shade, (words, rms) in zip(shades, stages, strict=True):
            stage = Stage(words, "after", opacity=round(float(shade), 2))
            bars[stage] = rms.get(joint.joint, np.nan) / joint.std
        rows.append(BarRow(joint.joint, bars, {NOISE: joint.floor / joint.std}))
    caption = (
        "RMS error of each joint over the standard deviation of its effort, on a logarithmic axis."
    )
    few = len(rows) < len(errors.joints)
    note = f"The {len(rows)} joints of largest nrms, of {len(errors.joints)}." if few else ""
    return Bars("joint_errors", caption, tuple(rows), note)


def step_joint_bars(explanation: Explanation) -> Bars:
    """Return the errors of joints at the start and after each step of an explanation."""
    stages = [(f"+ {effect_label(step.effect)}", step.rms_after) for step in explanation.steps]
    return joint_bars(explanation.start, stages)
