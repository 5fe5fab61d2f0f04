"""The report of an identification: held-out errors, and what became of bodies and effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from geodrake.boundary.arguments import typed
from geodrake.identification.models import ModelIdentification
from geodrake.report import sections
from geodrake.report.bars import Bars, joint_bars
from geodrake.report.charts import Stage
from geodrake.report.effort_chart import effort_chart
from geodrake.report.identification_tables import (
    bodies_table,
    fitted_effects_table,
    gamma_words,
    identification_verdict,
    regularizers_table,
)
from geodrake.report.numbers import Units
from geodrake.report.page import Page, Section, render, without_empty
from geodrake.report.report import footer, subject, with_bars

IDENTIFIED = Stage("after", "identified", "after")


@typed
def render_identification(
    found: ModelIdentification,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
    links: Mapping[str, str] | None = None,
) -> str:
    """Return the report of an identification; arguments as for `render_comparison`.

    Args:
        model_name: What the model is called.
        log_names: What the logs are called.
        units: Units of the joints, `Units.of(model)`; those of revolute joints by default.
        links: Words -> address of further pages, such as a recording; none by default.
    """
    units = units or Units.of(found.model)
    verdict = identification_verdict(found)
    before, after = found.before, found.after
    tiles = (
        sections.error_tile("as it stands", before, units),
        sections.error_tile("identified", after, units, "held-out data"),
        sections.worst_tile(before, after),
        sections.noise_tile(after),
        *sections.removable_tiles(after, "of the squared error left"),
    )
    joints = sections.joints_section({"before": before, "after": after}, units)
    chart = effort_chart(found.comparison, units=units, alone=IDENTIFIED)
    parts = (
        with_bars(joints, _joint_errors(found)),
        sections.failing_section(found.comparison, charts=[chart], alone=IDENTIFIED),
        bodies_section(found),
        *effects_sections(found, units),
        sections.dependence_section({IDENTIFIED: found.comparison}, units),
        sections.method_section(found.comparison, refitted=True),
        sections.notes_section(found.notes),
    )
    page = Page(
        title,
        subject(model_name, log_names),
        "identified",
        "identified",
        verdict[:1].upper() + verdict[1:],
        (),
        tiles,
        without_empty(parts),
        footer(found.comparison),
        links or {},
    )
    return render(page)


def _joint_errors(found: ModelIdentification) -> Bars:
    identified = [("identified", [joint.rms for joint in found.after.joints])]
    return joint_bars(found.before, identified)


def bodies_section(found: ModelIdentification) -> Section:
    """Mass and centre of mass of every body, with their standard deviations."""
    text = (
        f"With the {found.regularizer} regularizer and gamma {gamma_words(found.gamma)}; value ± "
        "standard deviation, masses in kg, centres of mass in mm in the body's frame. At the "
        "boundary, only the bounds of what a body can be keep the data from asking for more."
    )
    return Section("Bodies", (text,), (bodies_table(found.bodies),))


def effects_sections(found: ModelIdentification, units: Units) -> tuple[Section, ...]:
    """Effects that were fitted and regularizers that were compared, where there are any."""
    effects, others = fitted_effects_table(found, units), regularizers_table(found)
    return (
        Section("Effects", tables=(effects,) if effects.rows else ()),
        Section(
            "Regularizers at the same training residual", tables=(others,) if others.rows else ()
        ),
    )
