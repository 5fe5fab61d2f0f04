"""Each kind of result as people see it: its page, rows of numbers, samples, and a figure.

`geodrake.boundary.showing.Shown` asks for them by the name of this module.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from geodrake.control.rollout import Rollout, RolloutFit
from geodrake.diagnosis.results import Diagnosis, Explanation
from geodrake.errors import ArgumentError
from geodrake.excitation import ExcitationResult, LogIdentifiability
from geodrake.fleet.fleet_result import FleetResult
from geodrake.identification.logs.model_errors import Comparison
from geodrake.identification.models.results import BodyChange, ModelIdentification
from geodrake.report.exciting import excitation_page, identifiability_page
from geodrake.report.explaining import (
    Explained,
    comparison_page,
    diagnosis_page,
    explanation_page,
    identification_page,
)
from geodrake.report.fleets import fleet_page
from geodrake.report.html import notebook_html
from geodrake.report.numbers import Units
from geodrake.report.page import About, Page
from geodrake.report.rollouts import Simulated, rollout_fit_page, rollout_page
from geodrake.report.series_table import Columns, comparison_series, optional, rollout_series

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Records = list[dict[str, Any]]


@dataclass(frozen=True)
class _Kind:
    """How to see one kind of result; `figure` is the name of the chart or bars that say most."""

    page: Callable[[Any, About], Page]
    records: Callable[[Any], Records] | None = None
    samples: Callable[[Any], Columns] | None = None
    figure: str = ""


def page_of(result: object, about: About | None = None) -> Page:
    """Return all that there is to say of a result, to be printed by `render` or `show_page`.

    Args:
        about: What it is of; by default the result's own model, without names.
    """
    if about is None:
        model = getattr(result, "model", None)
        about = About() if model is None else About(units=Units.of(model))
    return _view(result, "page").page(result, about)


def html(result: object) -> str:
    """Return a sentence and the tables of a result."""
    return notebook_html(page_of(result))


def dataframe(result: object, *, series: bool) -> Any:
    """Return a result as a pandas DataFrame; see `Shown.to_dataframe`."""
    pandas = optional("pandas", "notebook")
    if series:
        return pandas.DataFrame(dict(samples(result)))
    make = _view(result, "rows of numbers").records
    if make is None:
        raise ArgumentError(f"{type(result).__name__} has no rows of numbers.")
    return pandas.DataFrame(make(result))


def samples(result: object) -> Columns:
    """Return the samples behind a result."""
    make = _view(result, "samples").samples
    if make is None:
        raise ArgumentError(f"{type(result).__name__} has no samples.")
    return make(result)


def figure(result: object) -> Figure:
    """Return the figure that says most of a result."""
    from geodrake.report.figures import bars_figure, chart_figure

    name = _view(result, "figure").figure
    for section in page_of(result).sections:
        for bars in section.bars:
            if bars.name == name:
                return bars_figure(bars)
        for chart in section.charts:
            if chart.name == name:
                return chart_figure(chart)
    raise ArgumentError(f"{type(result).__name__} has no figure.")


def _view(result: object, what: str) -> _Kind:
    for kind, view in _VIEWS.items():
        if isinstance(result, kind):
            return view
    raise ArgumentError(f"{type(result).__name__} has no {what}.")


def _error_records(comparison: Comparison) -> Records:
    return [
        {
            "joint": joint.joint,
            "std": joint.std,
            "rms": joint.rms,
            "floor": joint.floor,
            "nrms": joint.nrms,
            "removable": joint.removable,
        }
        for joint in comparison.errors.joints
    ]


def _step_records(found: Explanation) -> Records:
    return [
        {
            "effect": step.effect,
            "where": where,
            "parameter": name,
            "value": value,
            "deviation": step.deviations.get(where, {}).get(name),
            "error_before": step.error_before,
            "error_after": step.error_after,
            "probability": step.probability,
        }
        for step in found.steps
        for where, values in step.parameters.items()
        for name, value in values.items()
    ]


def _body_record(body: BodyChange) -> dict[str, Any]:
    centres = {
        f"com_{axis}{end}": float(body.com[k][i])
        for k, end in enumerate(("_before", ""))
        for i, axis in enumerate("xyz")
    }
    masses = {"mass_before": body.mass[0], "mass": body.mass[1]}
    return {"body": body.name, **masses, "mass_deviation": body.mass_deviation, **centres}


def _use_records(found: ExcitationResult) -> Records:
    names = ("position", "velocity", "acceleration", "effort")
    return [
        {"joint": joint, **{f"{name}_share": float(getattr(found.use, name)[j]) for name in names}}
        for j, joint in enumerate(found.limits.joints)
    ]


def _motion(found: ExcitationResult) -> Columns:
    trajectory = found.trajectory
    times = trajectory.family.times(found.samples)
    states = zip(("position", "velocity", "acceleration"), trajectory.states(times), strict=True)
    columns: dict[str, Any] = {"time": times}
    for name, values in states:
        columns |= {f"{j}.{name}": values[:, k] for k, j in enumerate(trajectory.joints)}
    return columns


_VIEWS: Mapping[type, _Kind] = {
    Comparison: _Kind(comparison_page, _error_records, comparison_series, "efforts"),
    Diagnosis: _Kind(
        diagnosis_page,
        lambda found: [asdict(candidate) for candidate in found.candidates],
        lambda found: comparison_series(found.comparison),
        "candidates",
    ),
    Explanation: _Kind(
        explanation_page,
        _step_records,
        lambda found: comparison_series(found.after, found.before),
        "efforts",
    ),
    Explained: _Kind(
        explanation_page,
        lambda found: _step_records(found.explanation),
        lambda found: samples(found.explanation),
        "efforts",
    ),
    ModelIdentification: _Kind(
        identification_page,
        lambda found: [_body_record(body) for body in found.bodies],
        lambda found: comparison_series(found.comparison),
        "efforts",
    ),
    ExcitationResult: _Kind(excitation_page, _use_records, _motion, "motion"),
    LogIdentifiability: _Kind(
        identifiability_page,
        lambda found: [asdict(block) for block in (*found.bodies, *found.effects)],
        None,
        "directions",
    ),
    Rollout: _Kind(
        rollout_page,
        lambda found: [{**asdict(joint), "relative": joint.relative} for joint in found.joints],
        rollout_series,
        "rollout",
    ),
    Simulated: _Kind(rollout_page, samples=lambda found: rollout_series(found.after, found.before)),
    RolloutFit: _Kind(
        rollout_fit_page,
        lambda found: [asdict(value) for value in found.values],
        lambda found: rollout_series(found.after, found.before),
        "rollout",
    ),
    FleetResult: _Kind(fleet_page),
}
