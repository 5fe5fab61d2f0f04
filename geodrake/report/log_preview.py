"""A log as it was understood: a figure, words and numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from geodrake.logs.inspection import LogInspection
from geodrake.report import style
from geodrake.report.json_output import number_or
from geodrake.report.numbers import number, percent
from geodrake.report.tables import Table, cells

_MOST_POINTS = 4000  # of a curve
_MOST_NAMED = 3  # gaps or rests that are named
_EMPTY = "all its cells are empty"


@style.own_look()
def preview_figure(found: LogInspection) -> Figure:
    """Positions and efforts of every joint over time, stretches at rest shaded.

    Args:
        found: What was understood of the log.
    """
    log = found.log
    figure = style.new_figure(1.0 + 1.1 * len(log.joints))
    axes = figure.subplots(len(log.joints), 2, sharex=True, squeeze=False)
    every = max(1, len(log) // _MOST_POINTS)
    time = log.time[::every]
    for row, joint in zip(range(len(axes)), log.joints, strict=True):
        for ax, values, color in (
            (axes[row, 0], log.position, style.AFTER),
            (axes[row, 1], log.effort, style.BEFORE),
        ):
            style.polish(ax)
            ax.plot(time, values[::every, row], color=color, linewidth=0.8)
            for first, last in found.rests:
                ax.axvspan(first, last, color=style.RULE, alpha=0.5, linewidth=0)
        style.joint_title(axes[row, 0], joint, "position, rad or m")
        style.joint_title(axes[row, 1], "", "effort, N·m or N")
    for ax in axes[-1]:
        ax.set_xlabel("time, s", **style.plain(style.SMALL, style.QUIET))
    style.note_below(figure, "Grey: no joint moves." if found.rests else "")
    return figure


def columns_table(found: LogInspection) -> Table:
    """Which column became which joint and quantity.

    Args:
        found: What was understood of the log.
    """
    rows = [
        cells(
            column.joint,
            column.quantity,
            column.column,
            _unit_words(column.unit, column.factor),
            number(column.lowest),
            number(column.highest),
            str(column.empty or ""),
        )
        for column in found.columns
    ]
    head = ("joint", "quantity", "column", "unit", "least", "largest", "empty")
    return Table(head, tuple(rows), words=4)


def inspection_words(found: LogInspection) -> tuple[str, ...]:
    """Rows, rates, gaps and rest, in sentences.

    Args:
        found: What was understood of the log.
    """
    log, mean = found.log, len(found.log) / found.seconds
    source = f"time from {found.time_column}" if found.time_column else "time by --rate"
    words = [
        f"{len(log)} rows in {number(found.seconds)} s, typically every "
        f"{number(1e3 * found.period)} ms, {number(mean, 4)} a second on average; {source}",
    ]
    if found.jitter > 1e-3 * found.period:
        words.append(
            f"time between rows varies by {number(1e3 * found.jitter)} ms (standard deviation)"
        )
    gaps = [f"{number(length)} s at t = {instant:.2f} s" for instant, length in found.gaps]
    if gaps:
        words.append(f"{len(gaps)} gaps: {_named(gaps)}")
    rests = [f"t = {first:.2f} to {last:.2f} s" for first, last in found.rests]
    if rests:
        share = percent(found.rest / found.seconds)
        words.append(f"at rest for {number(found.rest)} s, {share}: {_named(rests)}")
    return tuple(words)


def inspection_dict(found: LogInspection) -> dict[str, Any]:
    """What was understood of a log, as numbers and names.

    Args:
        found: What was understood of the log.
    """
    return {
        "name": found.log.name,
        "joints": list(found.log.joints),
        "rows": len(found.log),
        "seconds": found.seconds,
        "period": found.period,
        "jitter": found.jitter,
        "time_column": found.time_column,
        "columns": [
            {
                "joint": column.joint,
                "quantity": column.quantity,
                "column": column.column,
                "unit": column.unit,
                "factor": column.factor,
                "lowest": number_or(column.lowest, _EMPTY),
                "highest": number_or(column.highest, _EMPTY),
                "empty": column.empty,
            }
            for column in found.columns
        ],
        "gaps": [{"time": instant, "seconds": length} for instant, length in found.gaps],
        "rests": [{"from": first, "to": last} for first, last in found.rests],
        "notes": list(found.notes),
    }


def _unit_words(unit: str, factor: float) -> str:
    if not np.isclose(factor, 1.0, rtol=1e-12, atol=0.0):
        return f"{unit} × {number(factor, 4)}".strip()
    return unit


def _named(words: Sequence[str]) -> str:
    return ", ".join(words[:_MOST_NAMED]) + (" …" if len(words) > _MOST_NAMED else "")
