"""What is identifiable from logs, as a figure and a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from geodrake.boundary.arguments import typed
from geodrake.excitation.identifiability import LogIdentifiability
from geodrake.report import style
from geodrake.report.excitation_tables import (
    identifiable_bodies_table,
    identifiable_effects_table,
    unidentifiable_table,
)
from geodrake.report.excitation_words import identifiability_verdict, identifiable_share
from geodrake.report.numbers import Units, percent
from geodrake.report.page import (
    Page,
    Section,
    Tile,
    render,
    without_empty,
)
from geodrake.report.pictures import pictures

_CAPTION = (
    "Left: relative deviation of an estimate along every principal direction, most certain first. "
    "Directions below the dotted line are identifiable. Right: how much of every body they make up."
)
_MOST = 40  # combinations that are listed
_CERTAIN = 1e-6  # least deviation that is drawn


@typed
def render_identifiable(
    found: LogIdentifiability,
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
    links: Mapping[str, str] | None = None,
) -> str:
    """Return the report of what is identifiable from logs.

    Args:
        model_name: What the model is called.
        log_names: What the logs are called.
        units: Units of the joints, `Units.of(model)`; those of revolute joints by default.
        links: Words -> address of further pages, such as a recording; none by default.
    """
    units = units or Units()
    most = percent(float(np.sqrt(found.identifiable.threshold)))
    count = sum(entry.is_identifiable for entry in found.effects)
    tiles = (
        Tile("directions identifiable", f"{found.count} of {found.possible}", f"to within {most}"),
        Tile("at sensor noise alone", f"{found.count_at_floor}", "if the model left nothing else"),
        *(
            [Tile("effects identifiable", f"{count} of {len(found.effects)}")]
            if found.effects
            else []
        ),
    )
    sections = without_empty((_bodies(found), _effects(found, units), _rest(found)))
    page = Page(
        title,
        f"what is identifiable of {model_name} from {', '.join(log_names)}",
        "compared",
        "identifiable",
        f"{identifiable_share(found)}.",
        (identifiability_verdict(found),),
        tiles,
        (*sections, *without_empty((Section("Notes", items=found.notes),))),
        "Made by geodrake: relative deviations are lengths in the geometric metric of inertial "
        "parameters, and depend neither on frames nor on units.",
        links or {},
    )
    return render(page)


def _bodies(found: LogIdentifiability) -> Section:
    text = (
        "A body has ten inertial parameters; so many of them are identifiable from the best of "
        "motions, some only together with those of others. Part of one can be."
    )
    figures = pictures({"directions": identifiable_figure(found)}, {"directions": _CAPTION})
    return Section("Bodies", (text,), (identifiable_bodies_table(found),), (), figures)


def _effects(found: LogIdentifiability, units: Units) -> Section:
    if not found.effects:
        return Section("Effects")
    text = "Deviation of an estimate from these logs alone, everything else estimated too."
    return Section("Effects", (text,), (identifiable_effects_table(found, units),))


def _rest(found: LogIdentifiability) -> Section:
    title = "Not identifiable"
    if not found.unidentifiable:
        return Section(title)
    count = len(found.unidentifiable)
    text = f"{count} of {found.possible} base parameters, SI units, worst first."
    return Section(title, (text,), (unidentifiable_table(found, most=_MOST),))


@style.own_look()
@typed
def identifiable_figure(found: LogIdentifiability) -> Figure:
    """Deviations along the principal directions, and what is identifiable of every body."""
    figure = style.new_figure(max(3.2, 1.2 + 0.3 * len(found.bodies)))
    left, right = figure.subplots(1, 2, width_ratios=[3, 2])
    _draw_directions(style.polish(left), found)
    _draw_bodies(style.polish(right, grid="x"), found)
    style.legend_above(
        figure,
        (
            Line2D([], [], color=style.AFTER, marker="o", linewidth=0, label="identifiable"),
            Line2D([], [], color=style.BEFORE, marker="o", linewidth=0, label="not identifiable"),
            Line2D([], [], color=style.FLOOR, linewidth=1.6, label="at sensor noise alone"),
            Patch(color=style.RULE, label="identifiable from some motion"),
        ),
    )
    return figure


def _draw_directions(ax: Axes, found: LogIdentifiability) -> None:
    count = np.arange(1, found.possible + 1)
    deviations = np.sqrt(found.identifiable.variances)
    kept = count <= found.count
    for chosen, color in ((kept, style.AFTER), (~kept, style.BEFORE)):
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
    ax.barh(at, [b.count for b in found.bodies], color=style.AFTER, height=0.7)
    ax.set_yticks(at, [style.joint_label(b.name) for b in found.bodies], parse_math=False)
    ax.invert_yaxis()
    ax.set_xlim(0, 10)
    ax.set_xlabel("parameters of the body", **style.plain(style.SMALL, style.QUIET))
