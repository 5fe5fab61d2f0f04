"""The page of `identify`: held-out errors, and what became of bodies and effects."""

from __future__ import annotations

from math import isfinite

import numpy as np

from geodrake.effects import Role
from geodrake.identification.models import ModelIdentification
from geodrake.report import explaining
from geodrake.report.charts import Stage
from geodrake.report.error_charts import effort_chart, joint_bars
from geodrake.report.numbers import UNKNOWN, Units, estimate, number
from geodrake.report.page import About, Cell, Page, Section, Table, cells
from geodrake.report.words import effect_label, listed, places_label

_IDENTIFIED = Stage("after", "identified", "after")


def identification_page(found: ModelIdentification, about: About) -> Page:
    """Say what an identification made of a model."""
    units = Units.of(found.model, [*about.units.effects.values()])
    before, after, models = found.before, found.after, {_IDENTIFIED: found.comparison}
    identified = [("identified", [joint.rms for joint in after.joints])]
    chart = effort_chart(found.comparison, units=units, alone=_IDENTIFIED)
    return Page(
        about.title,
        about.against,
        "identified",
        "identified",
        _headline(found),
        _lead(found),
        (
            explaining.error_tile("as it stands", before, units),
            explaining.error_tile("identified", after, units, "held-out data"),
            explaining.worst_tile(before, after),
            explaining.noise_tile(after),
            *explaining.removable_tiles(after, "of the squared error left"),
        ),
        (
            explaining.joints_section(
                {"before": before, "after": after}, units, joint_bars(before, identified)
            ),
            Section(
                "Bodies",
                "Mass in kg and centre of mass in mm in the body's frame, ± standard deviation.",
                (
                    "At the boundary, only the bounds of what a body can be keep the data from "
                    "asking for more.",
                ),
                tables=(explaining.bodies_table(found.bodies),),
            ),
            Section("Effects", tables=(_effects_table(found, units),)),
            Section(
                "Regularizers at the same training residual", tables=(_regularizers_table(found),)
            ),
            explaining.failing_section(models, chart),
            explaining.residuals_section(models, units),
            explaining.method_section(found.comparison, refitted=True),
            explaining.notes_section(found.notes),
        ),
        explaining.footer(found.comparison),
        about.links,
    )


def _headline(found: ModelIdentification) -> str:
    words = f"The held-out error goes from nrms {number(found.before.nrms)} to "
    words += number(found.after.nrms)
    if found.after.shows_noise:
        words += f"; sensor noise is {number(found.after.floor_nrms)}"
    return f"{words}."


def _lead(found: ModelIdentification) -> tuple[str, ...]:
    words = f"Fitted with the {found.regularizer} regularizer and gamma {_gamma(found.gamma)}"
    if found.sweep:
        words += f", chosen by held-out error from {len(found.sweep)}"
    if not found.at_boundary:
        return (f"{words}.",)
    return (
        f"{words}.",
        f"{listed(found.at_boundary)} ended at the boundary of what a body can be: nothing but "
        "that keeps the data from asking for the impossible.",
    )


def _effects_table(found: ModelIdentification, units: Units) -> Table:
    """Return parameters of the effects that were fitted, without payloads, which are bodies."""
    rows = []
    for fitted in found.model.effects:
        if fitted.effect.role is Role.BODY:
            continue
        where, name = fitted.effect.where, fitted.effect.name
        for k, parameter in enumerate(fitted.effect.parameters):
            deviation = np.nan if fitted.deviations is None else float(fitted.deviations[k])
            rows.append(
                cells(
                    Cell(effect_label(name), typed=name) if k == 0 else "",
                    places_label(where, units.joints) if k == 0 else "",
                    parameter.name,
                    estimate(float(fitted.parameters[k]), deviation),
                    units.parameter(name, parameter.name, " & ".join(where)),
                )
            )
    return Table(("effect", "where", "parameter", "value", "unit"), tuple(rows), words=3)


def _regularizers_table(found: ModelIdentification) -> Table:
    """Return what every regularizer makes of the same training residual."""
    rows = tuple(
        cells(
            other.regularizer,
            ", ".join(other.at_boundary) or UNKNOWN,
            _gamma(other.gamma),
            number(other.residual, 6),
            number(other.errors.nrms, 4),
        )
        for other in found.alternatives
    )
    head = ("regularizer", "at the boundary", "gamma", "training residual", "held-out nrms")
    return Table(head, rows, words=2)


def _gamma(value: float) -> str:
    """Return the weight of a regularizer, which a loose bound leaves as large as one likes."""
    return number(value) if isfinite(value) else "without end"
