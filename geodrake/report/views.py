"""Each kind of result as people see it: its page, JSON, rows of numbers, samples, and a figure.

`geodrake.boundary.showing.Shown` asks for them by the name of this module.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
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
    from geodrake.control.rollout.results import Window

_KINDS = {
    "explaining": ("Comparison", "Diagnosis", "Explanation", "Explained", "ModelIdentification"),
    "exciting": ("ExcitationResult", "LogIdentifiability"),
    "rollouts": ("Rollout", "Simulated", "RolloutFit"),
    "fleets": ("FleetResult",),
    "exports": ("ProvenExport", "DynamicsCheck", "DigestRun", "InspectedLogs"),
    "playback": ("Playback",),
}
"""Module here -> the results that its `VIEWS` are of; imported only where there is one of them."""


_PARTS = {"records": "rows of numbers"}
"""How parts of a `View` are called in words, where that is not their name."""


def view_of(result: object, part: str = "page") -> View:
    """Return how to see a result; refuse what is none, or has no such part as `View` calls it."""
    for kind in type(result).__mro__:
        for module, names in _KINDS.items():
            if kind.__name__ in names:
                view = import_module(f"geodrake.report.{module}").VIEWS.get(kind)
                if view is not None and getattr(view, part):
                    return view
    raise ArgumentError(f"{type(result).__name__} has no {_PARTS.get(part, part)}.")


def page_of(result: object, about: About | None = None) -> Page:
    """Return the page of a result, by default with its own model and without names."""
    if about is None:
        model = getattr(result, "model", None)
        about = About() if model is None else About(units=Units.of(model))
    return view_of(result).page(result, about)


def numbers_of(result: object) -> dict[str, Any]:
    """Return a result as a dictionary, for JSON."""
    return view_of(result).numbers(result)


def html(result: object) -> str:
    """Return a sentence and the tables of a result."""
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
    """Return the figure that says most of a result."""
    from geodrake.report.figures import bars_figure, chart_figure

    name, sections = view_of(result, "figure").figure, page_of(result).sections
    bars = {bars.name: bars for section in sections for bars in section.bars}
    charts = {chart.name: chart for section in sections for chart in section.charts}
    if name not in bars.keys() | charts.keys():
        raise ArgumentError(f"{type(result).__name__} has no figure.")
    return bars_figure(bars[name]) if name in bars else chart_figure(charts[name])


Columns = Mapping[str, Sequence[str] | Array]  # name of a column -> its values, all of one length


def comparison_series(now: Comparison, before: Comparison | None = None) -> Columns:
    """Return efforts of a comparison, N·m or N; NaN where a joint's sample was left out.

    Returns:
        `time`, `log`, and of every joint `measured`, `predicted` and `residual`, measured −
        predicted; with a model before also `predicted_before` and `residual_before`.
    """
    stages = {"": now} if before is None else {"_before": before, "": now}
    index = _index((s.log, s.time) for c in stages.values() for s in c.series)
    columns: dict[str, Sequence[str] | Array] = {
        "time": np.array([time for _, time in index]),
        "log": [printable(log) for log, _ in index],
    }
    for joint in dict.fromkeys(s.joint for s in now.series):
        values = {f"{joint}.measured": np.full(len(index), np.nan)}
        for stage, comparison in stages.items():
            predicted = np.full(len(index), np.nan)
            for s in (s for s in comparison.series if s.joint == joint):
                at = [index[s.log, time] for time in s.time.tolist()]
                values[f"{joint}.measured"][at], predicted[at] = s.measured, s.predicted
            values[f"{joint}.predicted{stage}"] = predicted
            values[f"{joint}.residual{stage}"] = values[f"{joint}.measured"] - predicted
        columns |= values
    return columns


def rollout_series(now: Rollout, before: Rollout | None = None) -> Columns:
    """Return positions of a rollout, rad or m, window after window.

    Returns:
        `time`, `log`, `window`, and of every joint `measured`, `predicted` and `residual`, measured
        − predicted; with a model before also `predicted_before` and `residual_before`.
    """
    windows = now.windows
    columns: dict[str, Sequence[str] | Array] = {
        "time": np.concatenate([w.time for w in windows]),
        "log": [printable(w.log) for w in windows for _ in w.time],
        "window": np.concatenate([np.full(len(w.time), float(k)) for k, w in enumerate(windows)]),
    }
    measured = _stacked(windows, "measured")
    stages = {"": now} if before is None else {"_before": before, "": now}
    for j, joint in enumerate(now.joints):
        columns[f"{joint.joint}.measured"] = measured[:, j]
        for stage, rollout in stages.items():
            predicted = _stacked(rollout.windows, "simulated")[:, j]
            columns[f"{joint.joint}.predicted{stage}"] = predicted
            columns[f"{joint.joint}.residual{stage}"] = measured[:, j] - predicted
    return columns


def series_content(columns: Columns, path: Path) -> Content:
    """Return what goes into a CSV or Parquet file; empty entries of a CSV were left out of fits."""
    if path.suffix.lower() == ".parquet":
        arrow, parquet = optional("pyarrow", "logs"), optional("pyarrow.parquet", "logs")
        return partial(parquet.write_table, arrow.table(dict(columns)))
    lines = io.StringIO()
    writer = csv.writer(lines, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*map(_texts, columns.values()), strict=True))
    return lines.getvalue()


def check_series(path: Path) -> None:
    """Refuse a file of samples that could not be written in the end."""
    if path.suffix.lower() == ".parquet":
        optional("pyarrow", "logs")


def optional(module: str, extra: str) -> Any:
    """Return a module of a package that results can do without."""
    return optional_package(module, extra, "tables of results", ArgumentError)


def _index(stretches: Iterable[tuple[str, Array]]) -> dict[tuple[str, float], int]:
    """Return log and instant -> row, in the order of logs and of time."""
    logs: dict[str, set[float]] = {}
    for log, time in stretches:
        logs.setdefault(log, set()).update(time.tolist())
    rows = ((log, time) for log, times in logs.items() for time in sorted(times))
    return {row: k for k, row in enumerate(rows)}


def _stacked(windows: Sequence[Window], name: str) -> Array:
    return np.concatenate([getattr(w, name) for w in windows])


def _texts(values: Sequence[str] | Array) -> Sequence[str]:
    if isinstance(values, np.ndarray):
        return [f"{value:.10g}" if np.isfinite(value) else "" for value in values.tolist()]
    return values
