"""What an export looks like as a page."""

from __future__ import annotations

from collections.abc import Sequence

from geodrake.boundary.arguments import typed
from geodrake.control.export_proof.export import ProvenExport
from geodrake.report.export_tables import (
    export_verdict,
    holds_table,
    lacks_table,
    proof_table,
)
from geodrake.report.numbers import Units, number
from geodrake.report.page import Page, Section, Tile, render, without_empty

_HOLDS = (
    "Values in the files, beside the inertias. Friction that they cannot hold is approximated by "
    "least squares over the motion."
)
_LACKS = (
    "nrms with the effect approximated or left out, and all others as they are in the model: what "
    "the format costs."
)
_PROOF = (
    "Each simulator read the files itself. Efforts are those that the motion needs; positions "
    "those of rollouts from states of the motion on, in steps of a millisecond."
)


@typed
def render_export(
    found: ProvenExport,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
) -> str:
    """Return the report of an export.

    Args:
        model_name: What the model is called.
        log_names: What the logs are called.
        units: Units of the joints; those of revolute joints by default.
    """
    units, costs = units or Units(), found.costs
    verdict, _, rest = export_verdict(found).removesuffix(".").partition(". ")
    rest = f"{rest}." if rest else ""
    tiles = [Tile("format", found.form.name, ", ".join(found.exported.files))]
    if costs is not None:
        tiles += [
            Tile("model", number(costs.whole), "nrms"),
            Tile("files", number(costs.held), "nrms of what they hold"),
        ]
        if costs.ignored is not None:
            left = ", ".join(found.proof.ignored)
            tiles.append(Tile("simulated", number(costs.ignored), f"nrms without {left}"))
    holds, lacks, proof = (table(found, units) for table in (holds_table, lacks_table, proof_table))
    sections = (
        Section("What the files hold", (_HOLDS,), (holds,)) if holds.rows else Section(""),
        Section("What they cannot hold", (_LACKS,) if costs else (), (lacks,))
        if lacks.rows
        else Section(""),
        Section("Loaded again", (_PROOF,), (proof,)) if proof.rows else Section(""),
        Section("Notes", items=found.notes),
    )
    subject = f"{model_name} to {found.form.name}"
    page = Page(
        title,
        f"{subject}, on {', '.join(log_names)}" if log_names else subject,
        "compared",
        "exported",
        f"{verdict[0].upper()}{verdict[1:]}.",
        (rest,) if rest else (),
        tuple(tiles),
        without_empty(sections),
        "Made by geodrake: a model written for a simulator, and loaded again.",
    )
    return render(page)
