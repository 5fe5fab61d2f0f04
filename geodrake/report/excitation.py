"""A designed motion, as figures and a report."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from geodrake.boundary.arguments import typed
from geodrake.excitation import ExcitationResult, Separation
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.verdict import THRESHOLD, identifiable_directions, improvement
from geodrake.inertia import Array
from geodrake.report import style
from geodrake.report.charts import Chart, Panel, Plot, Stage
from geodrake.report.excitation_tables import limits_table, starts_table
from geodrake.report.excitation_words import excitation_verdict, nearest_bodies
from geodrake.report.numbers import Units, number, percent
from geodrake.report.page import (
    Page,
    Section,
    Tile,
    render,
    without_empty,
)
from geodrake.report.pictures import pictures
from geodrake.report.tell_apart import pairs_section, tiles_of_pairs
from geodrake.report.worst_joints import MOST_JOINTS

_FINE = 600  # instants that are drawn
_COLUMNS = (
    ("position", "rad", ""),
    ("velocity", "rad/s", "velocity"),
    ("acceleration", "rad/s²", "acceleration"),
    ("effort", "N·m", "effort"),
)
DESIGNED = Stage("designed", "designed", "after")
_MOTION_CAPTION = (
    "Position, velocity, acceleration and effort of every joint. Dotted lines are limits; an axis "
    "without them shows a motion that stays far inside."
)
_EIGENVALUE_CAPTION = (
    "Relative deviation of an estimate along every principal direction, for the motion designed. "
    "The dotted line is a deviation of ten per cent."
)


@typed
def render_excitation(
    result: ExcitationResult,
    *,
    title: str,
    model_name: str,
    links: Mapping[str, str] | None = None,
) -> str:
    """Return the report of a designed motion.

    Args:
        model_name: What the model is called.
        links: Words -> address of further pages, such as a recording; none by default.
    """
    apart = isinstance(result.objective, Separation)
    factor = np.sqrt(improvement(result)) if apart else improvement(result)
    page = Page(
        title,
        f"a motion for {model_name}",
        "compared",
        "designed",
        f"A motion {number(float(factor))} times better than the best random one.",
        (excitation_verdict(result),),
        tiles_of_pairs(result) if apart else _tiles(result),
        without_empty(
            (
                pairs_section(result) if apart else _information(result),
                _motion(result),
                _starts(result),
                _notes(result),
            )
        ),
        "Made by geodrake: limits hold between samples too; information is that of the samples "
        "with the noise that was asked for.",
        links or {},
    )
    return render(page)


def _tiles(result: ExcitationResult) -> tuple[Tile, ...]:
    objective, count = result.objective, len(result.eigenvalues)
    criterion = objective.criterion.name.replace("_", " ")
    tiles = (
        Tile(criterion, number(result.value), f"{objective.normalization} normalization"),
        Tile("better than random", f"{number(improvement(result))} ×", "than the best start"),
    )
    if objective.normalization != "geometric":
        return tiles
    found = f"{identifiable_directions(result)} of {count}"
    return (
        *tiles,
        Tile("directions identifiable", found, f"to {percent(float(np.sqrt(THRESHOLD)))}"),
    )


def _motion(result: ExcitationResult) -> Section:
    units = Units.of(result.objective.target.model)
    table, nearest = limits_table(result, units), nearest_bodies(result)
    text = ["Where the joints move, and the largest shares of their limits that the motion uses."]
    if nearest:
        text.append(f"Nearest to each other: {nearest}")
    return Section("The motion", tuple(text), (table,), charts=(motion_chart(result, units),))


def _information(result: ExcitationResult) -> Section:
    figures = pictures(
        {"eigenvalues": eigenvalue_figure(result)}, {"eigenvalues": _EIGENVALUE_CAPTION}
    )
    text = (
        f"From {result.samples} samples. Directions are combinations of inertial parameters and of "
        "those of effects, in the units of the normalization."
    )
    return Section("What it identifies", (text,), pictures=figures)


def _starts(result: ExcitationResult) -> Section:
    apart = isinstance(result.objective, Separation)
    text = (
        ("One over the squared deviations of the hardest pair; less is better.",) if apart else ()
    )
    return Section("Starts", text, (starts_table(result),))


def _notes(result: ExcitationResult) -> Section:
    return Section("Notes", items=result.notes)


def motion_chart(result: ExcitationResult, units: Units) -> Chart:
    """Position, velocity, acceleration and effort of every joint over time, with their limits."""
    limits, timed = result.limits, result.trajectory.family.timed
    at, signals = _sampled(result)
    panels = []
    for j, joint in enumerate(limits.joints):
        plots = tuple(
            Plot(
                f"{name}, {units.at(joint, unit)}",
                {DESIGNED.key: values[:, j]},
                tuple(b for b in _bounds(limits, j, limit) if abs(b) <= _reach(values[:, j])),
                tall=name == "position",
            )
            for values, (name, unit, limit) in zip(signals, _COLUMNS, strict=True)
        )
        panels.append(Panel(joint, "", at, plots, shown=j < MOST_JOINTS))
    spans = (("", float(at[0]), float(at[-1]), 0.0),)
    axis = "time, s" if timed else "sample"
    return Chart("motion", _MOTION_CAPTION, (DESIGNED,), tuple(panels), spans, axis, not timed)


def _sampled(result: ExcitationResult) -> tuple[Array, tuple[Array, ...]]:
    """Instants, or numbers of samples, and q, v, v̇ and effort (N, nv) there."""
    model, trajectory = result.objective.target.model, result.trajectory
    times = trajectory.family.times(_FINE)
    states = trajectory.states(times)
    width = result.objective.target.sign_width
    effort = model.effort(trajectory.motion_of(states), sign_width=width)
    at = times if trajectory.family.timed else np.arange(float(len(times)))
    return at, (*states, effort)


def _bounds(limits: MotionLimits, j: int, name: str) -> tuple[float, float]:
    """Lower and upper limit of a joint's position, or of another signal by name."""
    if not name:
        return float(limits.lower[j]), float(limits.upper[j])
    most = float(getattr(limits, name)[j])
    return -most, most


def _reach(values: Array) -> float:
    """Return how far away a limit may be to be drawn."""
    return 2.5 * max(float(np.abs(values).max()), 1e-9)


@style.own_look()
@typed
def eigenvalue_figure(result: ExcitationResult) -> Figure:
    """Deviations along the principal directions, from the most certain on."""
    figure = style.new_figure(2.8)
    ax = style.polish(figure.subplots())
    values = result.eigenvalues[::-1]
    deviations = 1.0 / np.sqrt(np.where(values > 0, values, np.nan))
    count = np.arange(1, len(values) + 1)
    ax.plot(count, deviations, "o", color=style.AFTER, markersize=4)
    handles = [Line2D([], [], color=style.AFTER, marker="o", linewidth=0, label="designed")]
    if result.objective.normalization == "geometric":
        limit = float(np.sqrt(THRESHOLD))
        ax.axhline(limit, color=style.INK, linestyle=":", linewidth=1.0)
    style.log_scale(ax, "y")
    label = style.plain(style.SMALL, style.QUIET)
    ax.set_xlabel("principal direction", **label)
    ax.set_ylabel("deviation", **label)
    style.legend_above(figure, handles)
    return figure
