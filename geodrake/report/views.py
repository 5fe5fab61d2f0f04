"""Pages, JSON, tables, samples and figures of results of any type.

`geodrake.boundary.showing.Shown` imports this module by its name.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geodrake.boundary.escaping import printable
from geodrake.boundary.optional_packages import optional_package
from geodrake.boundary.whole_files import Content
from geodrake.errors import ArgumentError
from geodrake.identification.logs.model_errors import Comparison
from geodrake.inertia import Array
from geodrake.report.numbers import Units
from geodrake.report.page import About, Page, View

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from geodrake.control.rollout import Rollout

_KINDS = {
    "explaining": ("Comparison", "Diagnosis", "Explanation", "ModelIdentification"),
    "exciting": ("ExcitationResult", "LogIdentifiability"),
    "rollouts": ("Rollout", "Simulated", "RolloutFit"),
    "fleets": ("FleetResult",),
    "exports": ("ProvenExport", "DynamicsCheck", "DigestRun", "InspectedLogs"),
    "playback": ("Playback",),
}
"""Module of this package -> result types of its `VIEWS`; each is imported when needed."""


def view_of(result: object, part: str = "page") -> View:
    """Return the view of a result; raise if it has none, or lacks a part (a field of `View`)."""
    for kind in type(result).__mro__:
        for module, names in _KINDS.items():
            if kind.__name__ in names:
                view = import_module(f"geodrake.report.{module}").VIEWS.get(kind)
                if view is not None and getattr(view, part):
                    return view
    raise ArgumentError(f"{type(result).__name__} has no {part}.")


def page_of(result: object, about: About | None = None) -> Page:
    """Return the page of a result, by default with its model's units and without names."""
    if about is None:
        model = getattr(result, "model", None)
        about = About() if model is None else About(units=Units.of(model))
    return view_of(result).page(result, about)


def numbers_of(result: object) -> dict[str, Any]:
    """Return a result as a dictionary, for JSON."""
    return view_of(result).numbers(result)


def html(result: object) -> str:
    """Return a sentence and the tables of a result as HTML."""
    from geodrake.report.html import notebook_html

    return notebook_html(page_of(result))


def dataframe(result: object, *, series: bool) -> Any:
    """Return a result as a pandas DataFrame; see `Shown.to_dataframe`."""
    pandas = optional("pandas", "notebook")
    if series:
        return pandas.DataFrame(dict(samples(result)))
    return pandas.DataFrame(view_of(result, "records").records(result))


def samples(result: object) -> Columns:
    """Return the samples behind a result."""
    return view_of(result, "samples").samples(result)


def figure(result: object) -> Figure:
    """Return the main figure of a result."""
    from geodrake.report.figures import bars_figure, chart_figure

    name, sections = view_of(result, "figure").figure, page_of(result).sections
    bars = {bars.name: bars for section in sections for bars in section.bars}
    charts = {chart.name: chart for section in sections for chart in section.charts}
    if name not in bars.keys() | charts.keys():
        raise ArgumentError(f"{type(result).__name__} has no figure.")
    return bars_figure(bars[name]) if name in bars else chart_figure(charts[name])


Columns = Mapping[str, Sequence[str] | Array]  # name of a column -> values, all of equal length


def comparison_series(now: Comparison, before: Comparison | None = None) -> Columns:
    """Return efforts of a comparison, N·m or N; NaN where a joint's sample is missing.

    Returns:
        `time`, `log`, and for every joint `measured`, `predicted` and `residual` (measured −
        predicted); with a previous model also `predicted_before` and `residual_before`.
    """
    stages = {"": now} if before is None else {"_before": before, "": now}
    logs: dict[str, set[float]] = {}
    for s in (s for comparison in stages.values() for s in comparison.series):
        logs.setdefault(s.log, set()).update(s.time.tolist())
    rows = [(log, time) for log, times in logs.items() for time in sorted(times)]
    index = {row: k for k, row in enumerate(rows)}
    columns: dict[str, Sequence[str] | Array] = {
        "time": np.array([time for _, time in rows]),
        "log": [printable(log) for log, _ in rows],
    }
    for joint in dict.fromkeys(s.joint for s in now.series):
        measured = np.full(len(rows), np.nan)
        predicted = {stage: np.full(len(rows), np.nan) for stage in stages}
        for stage, comparison in stages.items():
            for s in (s for s in comparison.series if s.joint == joint):
                indices = [index[s.log, time] for time in s.time.tolist()]
                measured[indices], predicted[stage][indices] = s.measured, s.predicted
        columns |= _joint_columns(joint, measured, predicted)
    return columns


def _joint_columns(joint: str, measured: Array, predicted: Mapping[str, Array]) -> Columns:
    """Return the measured values of a joint, and the predictions and residuals of each stage."""
    columns = {f"{joint}.measured": measured}
    for stage, values in predicted.items():
        columns[f"{joint}.predicted{stage}"] = values
        columns[f"{joint}.residual{stage}"] = measured - values
    return columns


def rollout_series(now: Rollout, before: Rollout | None = None) -> Columns:
    """Return positions of a rollout, rad or m, in successive windows.

    Returns:
        The columns of `comparison_series`, and the number of each `window`.
    """
    windows, stages = now.windows, {"": now} if before is None else {"_before": before, "": now}
    columns: dict[str, Sequence[str] | Array] = {
        "time": np.concatenate([w.time for w in windows]),
        "log": [printable(w.log) for w in windows for _ in w.time],
        "window": np.concatenate([np.full(len(w.time), float(k)) for k, w in enumerate(windows)]),
    }
    measured = np.concatenate([w.measured for w in windows])
    simulated = {s: np.concatenate([w.simulated for w in r.windows]) for s, r in stages.items()}
    for j, joint in enumerate(now.joints):
        predicted = {stage: values[:, j] for stage, values in simulated.items()}
        columns |= _joint_columns(joint.joint, measured[:, j], predicted)
    return columns


def series_content(columns: Columns, path: Path) -> Content:
    """Return the content of a CSV or Parquet file; missing samples are empty in CSV."""
    if path.suffix.lower() == ".parquet":
        arrow, parquet = optional("pyarrow", "logs"), optional("pyarrow.parquet", "logs")
        return partial(parquet.write_table, arrow.table(dict(columns)))
    lines = io.StringIO()
    writer = csv.writer(lines, lineterminator="\n")
    writer.writerow(columns)
    texts = (
        [f"{x:.10g}" if np.isfinite(x) else "" for x in values.tolist()]
        if isinstance(values, np.ndarray)
        else values
        for values in columns.values()
    )
    writer.writerows(zip(*texts, strict=True))
    return lines.getvalue()


def check_series(path: Path) -> None:
    """Raise if a file of samples cannot be written here."""
    if path.suffix.lower() == ".parquet":
        optional("pyarrow", "logs")


def optional(module: str, extra: str) -> Any:
    """Return a module of an optional package."""
    return optional_package(module, extra, "tables of results", ArgumentError)
