"""An identification as tables and a sentence in a terminal, or as plain text in a pipe."""

from __future__ import annotations

from rich.console import Console

from geodrake.cli.tables import head, say, show_list, show_table
from geodrake.identification.models import ModelIdentification
from geodrake.report.identification_tables import (
    bodies_table,
    fitted_effects_table,
    identification_verdict,
    regularizers_table,
)
from geodrake.report.numbers import Units
from geodrake.report.tables import errors_table


def show_identification(console: Console, found: ModelIdentification, units: Units) -> None:
    """Errors per joint, bodies and effects before and after, the verdict, notes."""
    head(console, f"Error of each joint, RMS in {units.effort()} on held-out data")
    show_table(console, errors_table({"before": found.before, "after": found.after}, units))
    head(console, "Bodies; mass in kg, centre of mass in mm in the body's frame")
    show_table(console, bodies_table(found.bodies))
    for title, table in (
        ("Effects", fitted_effects_table(found, units)),
        ("Regularizers at the same training residual", regularizers_table(found)),
    ):
        if table.rows:
            head(console, title)
            show_table(console, table)
    say(console, "Verdict", identification_verdict(found))
    show_list(console, "Notes", found.notes)
