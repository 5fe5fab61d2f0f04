"""What there is to see of each kind of result: tables for a notebook, rows of numbers, a figure.

`geodrake.boundary.showing.Shown` asks for it. A kind of result is entered by registering what makes
its `tables`, `records`, `series` and `figure`; one without an entry has none of that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import singledispatch
from typing import TYPE_CHECKING, Any

from geodrake.boundary.escaping import html_text
from geodrake.control.rollout import Rollout, RolloutFit
from geodrake.diagnosis.results import Diagnosis, Explanation
from geodrake.errors import ArgumentError
from geodrake.excitation import ExcitationResult, LogIdentifiability
from geodrake.identification.logs.model_errors import Comparison, ErrorTable
from geodrake.identification.models.results import BodyChange, ModelIdentification
from geodrake.report.excitation_tables import identifiable_bodies_table, limits_table
from geodrake.report.excitation_words import excitation_verdict, identifiability_verdict
from geodrake.report.identification_tables import (
    bodies_table,
    fitted_effects_table,
    identification_verdict,
)
from geodrake.report.numbers import Units
from geodrake.report.series_table import Columns, comparison_series, optional, rollout_series
from geodrake.report.tables import (
    Cell,
    Table,
    candidates_table,
    departures_table,
    error_stages,
    errors_table,
    rollout_fit_table,
    rollout_values_table,
    short_steps_table,
)
from geodrake.report.words import (
    comparison_verdict,
    departure,
    diagnosis_verdict,
    explanation_verdict,
    rollout_fit_words,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Records = list[dict[str, Any]]
_CELL = "text-align: {side}; white-space: pre-line"


def html(result: object) -> str:
    """A sentence and the tables of a result."""
    sentence, shown = tables(result)
    return f"<div><p>{html_text(sentence)}</p>{''.join(map(_table, shown))}</div>"


def dataframe(result: object, *, series: bool) -> Any:
    """A result as a pandas DataFrame; see `Shown.to_dataframe`."""
    pandas = optional("pandas", "notebook")
    return pandas.DataFrame(dict(samples(result)) if series else records(result))


@singledispatch
def tables(result: object) -> tuple[str, Sequence[Table]]:
    """A sentence, and tables."""
    raise _unknown(result, "tables")


@singledispatch
def records(result: object) -> Records:
    """Rows of names and numbers, SI."""
    raise _unknown(result, "rows of numbers")


@singledispatch
def samples(result: object) -> Columns:
    """The samples behind it."""
    raise _unknown(result, "samples")


@singledispatch
def figure(result: object) -> Figure:
    """The figure that says most."""
    raise _unknown(result, "figure")


def _unknown(result: object, what: str) -> ArgumentError:
    return ArgumentError(f"{type(result).__name__} has no {what}.")


@tables.register
def _(result: Comparison) -> tuple[str, Sequence[Table]]:
    return comparison_verdict(result), [errors_table({"RMS": result.errors}, Units())]


@records.register
def _(result: Comparison) -> Records:
    return _error_records({"rms": result.errors})


@samples.register
def _(result: Comparison) -> Columns:
    return comparison_series(result)


@figure.register(Comparison)
def _(result: Comparison) -> Figure:
    from geodrake.report.series_figures import effort_figure

    return effort_figure(result)


@tables.register
def _(result: Diagnosis) -> tuple[str, Sequence[Table]]:
    units = Units(tuple(joint.joint for joint in result.start.joints))
    return diagnosis_verdict(result, units), [candidates_table(result, units)]


@records.register
def _(result: Diagnosis) -> Records:
    return [asdict(candidate) for candidate in result.candidates]


@samples.register
def _(result: Diagnosis) -> Columns:
    return comparison_series(result.comparison)


@figure.register(Diagnosis)
def _(result: Diagnosis) -> Figure:
    from geodrake.report.figures import candidate_figure

    return candidate_figure(result)


@tables.register
def _(result: Explanation) -> tuple[str, Sequence[Table]]:
    units = Units.of(result.model)
    shown = short_steps_table(result, units), errors_table(error_stages(result), units)
    return explanation_verdict(result, units), shown


@records.register
def _(result: Explanation) -> Records:
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
        for step in result.steps
        for where, values in step.parameters.items()
        for name, value in values.items()
    ]


@samples.register
def _(result: Explanation) -> Columns:
    return comparison_series(result.after, result.before)


@figure.register(Explanation)
def _(result: Explanation) -> Figure:
    from geodrake.report.series_figures import effort_figure

    after = result.after if result.steps else None
    return effort_figure(result.before, after=after, units=Units.of(result.model))


@tables.register
def _(result: ModelIdentification) -> tuple[str, Sequence[Table]]:
    units = Units.of(result.model)
    shown = [bodies_table(result.bodies), fitted_effects_table(result, units)]
    stages = errors_table({"before": result.before, "after": result.after}, units)
    return identification_verdict(result), [*shown, stages]


@records.register
def _(result: ModelIdentification) -> Records:
    return [_body_record(body) for body in result.bodies]


@samples.register
def _(result: ModelIdentification) -> Columns:
    return comparison_series(result.comparison)


@figure.register(ModelIdentification)
def _(result: ModelIdentification) -> Figure:
    from geodrake.report.series_figures import effort_figure

    return effort_figure(result.comparison, units=Units.of(result.model))


@tables.register
def _(result: ExcitationResult) -> tuple[str, Sequence[Table]]:
    units = Units.of(result.objective.target.model)
    return excitation_verdict(result), [limits_table(result, units)]


@records.register
def _(result: ExcitationResult) -> Records:
    use, limits = result.use, result.limits
    shares = {
        name: getattr(use, name) for name in ("position", "velocity", "acceleration", "effort")
    }
    return [
        {"joint": joint, **{f"{name}_share": float(share[j]) for name, share in shares.items()}}
        for j, joint in enumerate(limits.joints)
    ]


@samples.register
def _(result: ExcitationResult) -> Columns:
    trajectory = result.trajectory
    times = trajectory.family.times(result.samples)
    states = zip(("position", "velocity", "acceleration"), trajectory.states(times), strict=True)
    columns: dict[str, Any] = {"time": times}
    for name, values in states:
        columns |= {f"{j}.{name}": values[:, k] for k, j in enumerate(trajectory.joints)}
    return columns


@figure.register(ExcitationResult)
def _(result: ExcitationResult) -> Figure:
    from geodrake.report.chart_figure import chart_figure
    from geodrake.report.excitation import motion_chart

    return chart_figure(motion_chart(result, Units.of(result.objective.target.model)))


@tables.register
def _(result: LogIdentifiability) -> tuple[str, Sequence[Table]]:
    return identifiability_verdict(result), [identifiable_bodies_table(result)]


@records.register
def _(result: LogIdentifiability) -> Records:
    return [asdict(block) for block in (*result.bodies, *result.effects)]


@figure.register(LogIdentifiability)
def _(result: LogIdentifiability) -> Figure:
    from geodrake.report.identifiable import identifiable_figure

    return identifiable_figure(result)


@tables.register
def _(result: Rollout) -> tuple[str, Sequence[Table]]:
    words = f"The simulated model departs by {departure(result.relative)} of the motion."
    return words, [departures_table(result, None, Units())]


@records.register
def _(result: Rollout) -> Records:
    return [{**asdict(joint), "relative": joint.relative} for joint in result.joints]


@samples.register
def _(result: Rollout) -> Columns:
    return rollout_series(result)


@samples.register
def _(result: tuple) -> Columns:  # type: ignore[type-arg]
    """A rollout, and that of the model before."""
    return rollout_series(*result)


@figure.register(Rollout)
def _(result: Rollout) -> Figure:
    from geodrake.report.chart_figure import chart_figure
    from geodrake.report.rollout import rollout_chart

    return chart_figure(rollout_chart(result, None, Units()))


@tables.register
def _(result: RolloutFit) -> tuple[str, Sequence[Table]]:
    units, words = Units.of(result.model), rollout_fit_words(result)
    found = rollout_values_table(result, units), rollout_fit_table(result, units)
    return f"{words[:1].upper()}{words[1:]}", found


@records.register
def _(result: RolloutFit) -> Records:
    return [asdict(value) for value in result.values]


@samples.register
def _(result: RolloutFit) -> Columns:
    return rollout_series(result.after, result.before)


@figure.register(RolloutFit)
def _(result: RolloutFit) -> Figure:
    from geodrake.report.chart_figure import chart_figure
    from geodrake.report.rollout import rollout_chart

    return chart_figure(rollout_chart(result.after, result.before, Units.of(result.model)))


def _error_records(stages: Mapping[str, ErrorTable]) -> Records:
    *_, last = stages.values()
    return [
        {
            "joint": joint.joint,
            "std": joint.std,
            **{name: errors.joints[j].rms for name, errors in stages.items()},
            "floor": joint.floor,
            "nrms": joint.nrms,
            "removable": joint.removable,
        }
        for j, joint in enumerate(last.joints)
    ]


def _body_record(body: BodyChange) -> dict[str, Any]:
    centres = {
        f"com_{axis}{end}": float(body.com[k][i])
        for k, end in enumerate(("_before", ""))
        for i, axis in enumerate("xyz")
    }
    masses = {"mass_before": body.mass[0], "mass": body.mass[1]}
    return {"body": body.name, **masses, "mass_deviation": body.mass_deviation, **centres}


def _table(table: Table) -> str:
    """A table as notebooks show it."""
    head = "".join(_cell("th", name, k < table.words) for k, name in enumerate(table.head))
    rows = (
        "".join(_cell("td", _text(cell), k < table.words) for k, cell in enumerate(row))
        for row in table.rows
    )
    title = f"<caption>{html_text(table.title)}</caption>" if table.title else ""
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f"<table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _cell(tag: str, text: str, is_word: bool) -> str:
    style = _CELL.format(side="left" if is_word else "right")
    return f'<{tag} style="{style}">{html_text(text)}</{tag}>'


def _text(cell: Cell) -> str:
    return cell.typed or cell.text
