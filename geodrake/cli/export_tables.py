"""An export as tables and a sentence in a terminal, or as plain text in a pipe."""

from __future__ import annotations

from rich.console import Console

from geodrake.cli.tables import head, say, show_list, show_table
from geodrake.control.export_proof.export import ProvenExport
from geodrake.report.export_tables import export_verdict, holds_table, lacks_table, proof_table
from geodrake.report.numbers import Units, number


def show_export(console: Console, found: ProvenExport, units: Units) -> None:
    """What the files lack, and what simulators make of them."""
    holds = holds_table(found, units)
    if holds.rows:
        head(console, "What the files hold, beside inertias")
        show_table(console, holds)
    if found.lacks:
        costs = found.costs
        with_all = "" if costs is None else f"; nrms without each, {number(costs.whole)} with all"
        head(console, f"What the files cannot hold{with_all}")
        show_table(console, lacks_table(found, units))
    if found.proof.differences:
        head(console, "Loaded again, against the model that the files hold")
        show_table(console, proof_table(found, units))
    say(console, "Result", export_verdict(found))
    show_list(console, "Notes", found.notes)
