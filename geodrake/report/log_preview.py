"""A log as it was understood: a figure, words and numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from geodrake.logs.inspection import LogInspection
from geodrake.report import style
from geodrake.report.json_output import number_or
from geodrake.report.numbers import number, percent
from geodrake.report.tables import Table, cells

_MOST_POINTS = 4000  # of a curve
_MOST_NAMED = 3  # gaps or rests that are named
_EMPTY = "all its cells are empty"
_SI = {"current": "A", "voltage": "V", "pwm": "share"}  # which names of quantities do not say


@style.own_look()
def preview_figure(found: LogInspection) -> Figure:
    """Positions and efforts of every joint over time, stretches at rest shaded.

    Commands are broken lines over positions; without efforts, how far they are from there.
    """
    log = found.log
    figure = style.new_figure(1.0 + 1.1 * len(log.joints))
    axes = figure.subplots(len(log.joints), 2, sharex=True, squeeze=False)
    every = max(1, len(log) // _MOST_POINTS)
    time = log.time[::every]
    for row, joint in zip(range(len(axes)), log.joints, strict=True):
        position = log.position[::every, row]
        values, words = _effort_curve(found, row)
        for ax, curve, color in (
            (axes[row, 0], position, style.AFTER),
            (axes[row, 1], values[::every], style.BEFORE),
        ):
            style.polish(ax)
            ax.plot(time, curve, color=color, linewidth=0.8)
            for first, last in found.rests:
                ax.axvspan(first, last, color=style.RULE, alpha=0.5, linewidth=0)
        title = "position, rad or m"
        if log.command is not None and np.isfinite(log.command[:, row]).any():
            command = log.command[::every, row]
            axes[row, 0].plot(time, command, color=style.QUIET, linewidth=0.8, linestyle="--")
            title += "; broken: command"
        style.joint_title(axes[row, 0], joint, title)
        style.joint_title(axes[row, 1], "", words)
    for ax in axes[-1]:
        ax.set_xlabel("time, s", **style.plain(style.SMALL, style.QUIET))
    style.note_below(figure, "Grey: no joint moves." if found.rests else "")
    return figure


def _effort_curve(found: LogInspection, row: int) -> tuple[NDArray[np.float64], str]:
    """(N,) what a joint has for its effort, and what it is."""
    log = found.log
    kind = log.effort_kinds.get(log.joints[row], "effort")
    effort = log.effort[:, row]
    if log.command is not None and not np.isfinite(effort).any():
        return log.command[:, row] - log.position[:, row], "command − position, rad or m"
    words = {"pwm": "duty cycle, share of 1", "effort": "effort, N·m or N"}
    return effort, words.get(kind, f"{kind}, {_SI.get(kind, '')}")


def columns_table(found: LogInspection) -> Table:
    """Which column became which joint and quantity."""
    rows = [
        cells(
            column.joint,
            column.quantity,
            column.column,
            _unit_words(column.unit or _SI.get(column.quantity, ""), column.factor),
            number(column.lowest),
            number(column.highest),
            str(column.empty or ""),
        )
        for column in found.columns
    ]
    head = ("joint", "quantity", "column", "unit", "least", "largest", "empty")
    return Table(head, tuple(rows), words=4)


def inspection_words(found: LogInspection) -> tuple[str, ...]:
    """Rows, rates, gaps and rest, in sentences."""
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
    """What was understood of a log, as numbers and names."""
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
