"""The lines of the report, and the calibration of what was said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from diagrams.benchmarks.hidden.bars import Line, share
from diagrams.benchmarks.ordinary.draws import COLOURS, ORDINARY, OUTSIDE, QUIET

Row = Mapping[str, Any]
BINS = ((0.5, 0.7), (0.7, 0.9), (0.9, 0.99), (0.99, 1.0))
SURE = 0.9


def lines_of(rows: Sequence[Row]) -> list[Line]:
    """All lines."""
    ordinary = [row for row in rows if row["case"] == ORDINARY]
    outside = [row for row in rows if row["case"] == OUTSIDE]
    tools = [row for row in ordinary if row["mass"]]
    found = [row for row in tools if "found_mass" in row]
    seconds = [row["seconds"] for row in ordinary if not row["failed"]]
    said = [row for row in found if row["calibrated"]]
    widths = [row["mass_half_width"] for row in found]
    return [
        share("ordinary: everything named", [not row["missing"] for row in ordinary], 0.95),
        share("ordinary: nothing else named", [_is_clean(row) for row in ordinary], 0.95),
        share("… both", [not row["missing"] and _is_clean(row) for row in ordinary], 0.95),
        share("tool named", ["found_mass" in row for row in tools], 0.98),
        share(
            "tool's mass inside its interval",
            [row["mass_inside"] for row in found],
            0.9,
            highest=0.98,
        ),
        share("… of calibrated efforts", [row["mass_inside"] for row in said]),
        *_quantiles("half width of a tool's mass", widths, 0.15),
        *_quantiles("… calibrated", [row["mass_half_width"] for row in said], 0.15),
        *_quantiles("error of a tool's mass", [row["mass_error"] for row in found], None),
        *_quantiles("seconds of CPU", seconds, 5.0),
        share(
            "no catalogue has it: a wrong name at > 0.9",
            [_is_sure_and_wrong(row) for row in outside],
            0.1,
            most=True,
        ),
        share("… a wrong name at all", [not _is_clean(row) for row in outside], most=True),
        *(
            share(
                f"nothing hidden, {colour} noise: something named",
                [bool(r["steps"]) for r in rows if r["case"] == QUIET and r["colour"] == colour],
                0.01,
                most=True,
            )
            for colour in COLOURS
        ),
        *calibration(rows),
    ]


def calibration(rows: Sequence[Row]) -> list[Line]:
    """How many of the things said with a probability in a bin are true."""
    steps = [step for row in rows for step in row["steps"]]
    bars = {(0.9, 0.99): {"bar": 0.85, "highest": 0.99}}
    return [
        share(
            f"said at {low:g} – {high:g}: true" if high < 1.0 else f"said at > {low:g}: true",
            [step["right"] for step in steps if low < step["probability"] <= high],
            **bars.get((low, high), {}),
        )
        for low, high in BINS
    ]


def _is_clean(row: Row) -> bool:
    return not (row["wrong"] or row["failed"])


def _is_sure_and_wrong(row: Row) -> bool:
    return any(step["probability"] > SURE and not step["right"] for step in row["steps"])


def _quantiles(figure: str, values: Sequence[float], bar: float | None) -> list[Line]:
    """The median, which the bar is for, and what nine of ten are below."""
    levels = (("median", 0.5, bar), ("90 %", 0.9, None))
    return [
        Line(
            f"{figure}, {name}",
            most,
            True,
            float(np.quantile(values, level)) if values else None,
            *((min(values), max(values)) if values else (None, None)),
            len(values),
        )
        for name, level, most in levels
    ]
