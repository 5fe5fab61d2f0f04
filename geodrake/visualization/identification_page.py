"""The report of an identification: held-out errors, and what became of every body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from geodrake.model_identification import BodyChange, ModelIdentification
from geodrake.visualization.numbers import number, with_deviation
from geodrake.visualization.page import Cell, Section, Table, cells
from geodrake.visualization.report import render_comparison
from geodrake.visualization.units import Units

_MILLIMETRES = 1e3


def render_identification(
    found: ModelIdentification,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
) -> str:
    """The report of an identification; arguments as for `render_comparison`."""
    return render_comparison(
        replace(found.comparison, notes=found.notes),
        title=title,
        model_name=model_name,
        log_names=log_names,
        units=units,
        more=(bodies_section(found),),
    )


def bodies_section(found: ModelIdentification) -> Section:
    """Mass and centre of mass of every body, with their standard deviations."""
    head = ("body", "mass before, kg", "mass, kg", "centre of mass before, mm", "centre, mm", "")
    rows = tuple(_row(body) for body in found.bodies)
    text = (
        f"With the {found.regularizer} regularizer and gamma {number(found.gamma)}; value ± "
        "standard deviation, centres of mass in the body's frame."
    )
    return Section("Bodies", (text,), (Table(head, rows),))


def _row(body: BodyChange) -> tuple[Cell, ...]:
    before, after = (_MILLIMETRES * com for com in body.com)
    centre = (
        with_deviation(float(value), float(deviation))
        for value, deviation in zip(after, _MILLIMETRES * body.com_deviation, strict=True)
    )
    return cells(
        body.name,
        number(body.mass[0]),
        with_deviation(body.mass[1], body.mass_deviation),
        ", ".join(number(float(value)) for value in before),
        ", ".join(centre),
        "at the boundary of what a body can be" if body.at_boundary else "",
    )
