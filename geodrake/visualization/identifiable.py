"""What logs can tell, as a figure and a report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from geodrake.identifiability import LogIdentifiability, ToldCombination
from geodrake.visualization import style
from geodrake.visualization.numbers import number, percent
from geodrake.visualization.page import (
    Cell,
    Page,
    Section,
    Table,
    Tile,
    cells,
    pictures,
    render,
    without_empty,
)
from geodrake.visualization.units import Units

_CAPTION = (
    "Left: relative deviation of an estimate along every principal direction, most certain first. "
    "Directions below the dotted line are told. Right: how much of every body they make up."
)
_MOST = 40  # combinations told one by one
_CERTAIN = 1e-6  # least deviation that is drawn


def render_identifiable(
    found: LogIdentifiability,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
) -> str:
    """The report of what logs can tell; arguments as for `render_comparison`."""
    units = units or Units()
    most = percent(float(np.sqrt(found.identifiable.threshold)))
    told = sum(entry.is_told for entry in found.effects)
    tiles = (
        Tile("directions told", f"{found.told} of {found.possible}", f"to within {most}"),
        Tile("at sensor noise alone", f"{found.told_at_floor}", "if the model left nothing else"),
        *([Tile("effects told", f"{told} of {len(found.effects)}")] if found.effects else []),
    )
    sections = without_empty((_bodies(found), _effects(found, units), _untold(found)))
    page = Page(
        title,
        f"what {', '.join(log_names)} can tell of {model_name}",
        "compared",
        "identifiable",
        f"The logs tell {found.told} of {found.possible} directions to within {most}.",
        (found.verdict(),),
        tiles,
        (*sections, *without_empty((Section("Notes", items=found.notes),))),
        "Made by geodrake: relative deviations are lengths in the geometric metric of inertial "
        "parameters, and depend neither on frames nor on units.",
    )
    return render(page)


def _bodies(found: LogIdentifiability) -> Section:
    rows = tuple(
        cells(
            body.name,
            Cell(f"{body.told:.1f}", bar=min(1.0, body.share)),
            f"{body.possible:.1f}",
            percent(body.share),
        )
        for body in found.bodies
    )
    text = (
        "A body has ten inertial parameters; a motion of the robot can tell so many of them at "
        "best, some only together with those of others. Part of one can be told."
    )
    table = Table(("body", "told", "of", "share"), rows)
    figures = pictures({"told": identifiable_figure(found)}, {"told": _CAPTION})
    return Section("Bodies", (text,), (table,), (), figures)


def _effects(found: LogIdentifiability, units: Units) -> Section:
    if not found.effects:
        return Section("Effects")
    rows = []
    for entry in found.effects:
        place = " & ".join(entry.where)
        rows.append(
            cells(
                entry.name,
                ", ".join(entry.where),
                "told" if entry.is_told else "not told",
                number(entry.value),
                number(entry.deviation),
                units.parameter(entry.effect, entry.parameter, place),
            )
        )
    head = ("parameter", "where", "", "value", "deviation", "unit")
    text = "Deviation of an estimate from these logs alone, everything else estimated too."
    return Section("Effects", (text,), (Table(head, tuple(rows), words=3),))


def _untold(found: LogIdentifiability) -> Section:
    rest = found.untold
    rows = tuple(
        cells(c.words, number(c.value), number(c.deviation), _relative(c)) for c in rest[:_MOST]
    )
    if not rows:
        return Section("Not told")
    text = f"{len(rest)} of {found.possible} base parameters, SI units, worst first."
    head = ("combination", "in the model", "deviation", "relative")
    return Section("Not told", (text,), (Table(head, rows),))


def _relative(combination: ToldCombination) -> str:
    relative = combination.relative
    if not np.isfinite(relative):
        return "unknown"
    return percent(relative) if relative < 1 else f"{number(relative)} times its size"


@style.own_look()
def identifiable_figure(found: LogIdentifiability) -> Figure:
    """Deviations along the principal directions, and what is told of every body."""
    figure = style.new_figure(max(3.2, 1.2 + 0.3 * len(found.bodies)))
    left, right = figure.subplots(1, 2, width_ratios=[3, 2])
    _draw_directions(style.polish(left), found)
    _draw_bodies(style.polish(right, grid="x"), found)
    style.legend_above(
        figure,
        (
            Line2D([], [], color=style.AFTER, marker="o", linewidth=0, label="told"),
            Line2D([], [], color=style.BEFORE, marker="o", linewidth=0, label="not told"),
            Line2D([], [], color=style.FLOOR, linewidth=1.6, label="at sensor noise alone"),
            Patch(color=style.RULE, label="that any motion could tell"),
        ),
    )
    return figure


def _draw_directions(ax: Axes, found: LogIdentifiability) -> None:
    count = np.arange(1, found.possible + 1)
    deviations = np.sqrt(found.identifiable.variances)
    told = count <= found.told
    for chosen, color in ((told, style.AFTER), (~told, style.BEFORE)):
        seen = chosen & np.isfinite(deviations)
        at = np.maximum(deviations[seen], _CERTAIN)
        ax.plot(count[seen], at, "o", color=color, markersize=4)
    ideal = np.sqrt(found.floor_variances)
    ideal = np.where(np.isfinite(ideal), np.maximum(ideal, _CERTAIN), np.nan)
    ax.plot(count, ideal, color=style.FLOOR, linewidth=1.6)
    limit = float(np.sqrt(found.identifiable.threshold))
    ax.axhline(limit, color=style.INK, linestyle=":", linewidth=1.0)
    style.log_scale(ax, "y")
    label = style.plain(style.SMALL, style.QUIET)
    ax.set_xlabel("principal direction", **label)
    ax.set_ylabel("relative deviation", **label)


def _draw_bodies(ax: Axes, found: LogIdentifiability) -> None:
    at = np.arange(len(found.bodies))
    ax.barh(at, [b.possible for b in found.bodies], color=style.RULE, height=0.7)
    ax.barh(at, [b.told for b in found.bodies], color=style.AFTER, height=0.7)
    ax.set_yticks(at, [style.joint_label(b.name) for b in found.bodies], parse_math=False)
    ax.invert_yaxis()
    ax.set_xlim(0, 10)
    ax.set_xlabel("parameters of the body", **style.plain(style.SMALL, style.QUIET))
