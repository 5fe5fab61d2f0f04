"""The lines of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from diagrams.benchmarks.floating.draws import PAYLOAD, QUIET
from diagrams.benchmarks.hidden.bars import Line, median, share
from diagrams.benchmarks.ordinary.lines import calibration

Row = Mapping[str, Any]
_EXACT = 1e-9


def lines_of(rows: Sequence[Row]) -> list[Line]:
    """Return all lines."""
    hiding = [row for row in rows if row["hidden"] != QUIET]
    quiet = [row for row in rows if row["hidden"] == QUIET]
    loads = [row for row in rows if row["hidden"] == PAYLOAD]
    found = [row for row in loads if "found_mass" in row]
    told = [row for row in rows if not row["failed"] and row["end_error"] is not None]
    measured = [row["end_error"] for row in told if row["wrenches"]]
    unknown = [row["end_error"] for row in told if not row["wrenches"]]
    return [
        share(
            "efforts agree with inverse dynamics", [r["inverse_error"] < _EXACT for r in rows], 1.0
        ),
        share("read and explained", [not row["failed"] for row in rows], 1.0),
        share("truth named and placed", [_is_named(row) for row in hiding], 0.9),
        share("… and nothing else", [_is_named(row) and not row["wrong"] for row in hiding]),
        share("payload named", ["found_mass" in row for row in loads]),
        share("… mass inside its interval", [row["mass_inside"] for row in found], 0.9),
        share("… mass within 5 %", [row["mass_error"] <= 0.05 for row in found], 0.9),
        share("nothing hidden: something named", [bool(r["steps"]) for r in quiet], 0.0, most=True),
        median("held-out joint error, unknown wrenches", unknown, 0.2),
        median("held-out joint error, measured wrenches", measured, 0.1),
        median("seconds of CPU of compare", [row["compare_seconds"] for row in told], 5.0),
        median("seconds of CPU of explain", [row["explain_seconds"] for row in told], 30.0),
        *calibration(rows),
    ]


def _is_named(row: Row) -> bool:
    return not (row["failed"] or row["missing"])
