"""Each kind of result as people see it: its page, JSON, rows of numbers, samples, and a figure.

`geodrake.boundary.showing.Shown` asks for them by the name of this module.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from geodrake.errors import ArgumentError
from geodrake.report.numbers import Units
from geodrake.report.page import About, Page, View
from geodrake.report.series_table import Columns, optional

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_KINDS = {
    "explaining": (
        *("Comparison", "Diagnosis", "Explanation", "Explained", "ModelIdentification"),
    ),
    "exciting": ("ExcitationResult", "LogIdentifiability"),
    "rollouts": ("Rollout", "Simulated", "RolloutFit"),
    "fleets": ("FleetResult", "WatchedFleet"),
    "exports": ("ProvenExport", "CheckedModel", "DigestRun", "InspectedLogs"),
    "playing": ("Played",),
}
"""Module here -> the results that its `VIEWS` are of; imported only where there is one of them."""


_PARTS = {"records": "rows of numbers"}
"""How parts of a `View` are called in words, where that is not their name."""


def view_of(result: object, part: str = "page") -> View:
    """Return how to see a result.

    Args:
        part: What of it is asked for, as `View` calls it.

    Raises:
        ArgumentError: It is no result, or has no such part.
    """
    for kind in type(result).__mro__:
        for module, names in _KINDS.items():
            if kind.__name__ in names:
                view = import_module(f"geodrake.report.{module}").VIEWS.get(kind)
                if view is not None and getattr(view, part):
                    return view
    raise ArgumentError(f"{type(result).__name__} has no {_PARTS.get(part, part)}.")


def page_of(result: object, about: About | None = None) -> Page:
    """Return all that there is to say of a result, to be printed by `render` or `show_page`.

    Args:
        about: What it is of; by default the result's own model, without names.
    """
    if about is None:
        model = getattr(result, "model", None)
        about = About() if model is None else About(units=Units.of(model))
    return view_of(result).page(result, about)


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
