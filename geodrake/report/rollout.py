"""What rollouts look like: measured and simulated motion, window by window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from geodrake.control.rollout import Rollout
from geodrake.report import style
from geodrake.report.charts import Chart, Panel, Plot, Stage, gap_filled
from geodrake.report.effort_chart import MEASURED
from geodrake.report.numbers import Units, number
from geodrake.report.page import (
    Page,
    Section,
    Tile,
    render,
    without_empty,
)
from geodrake.report.tables import departures_table
from geodrake.report.words import departure

Array = NDArray[np.float64]

_NO_FORCES = "as they are no forces on the links"
_CAPTION = (
    "Positions, window after window. Each window starts at the measured state; from there on the "
    "simulated robot is alone with the logged efforts. Lines are cut off where they leave the axes."
)
SIMULATED = Stage("after", "simulated", "after")
BEFORE = Stage("before", "before", "before")


def render_rollout(
    found: tuple[Rollout, Rollout | None],
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
    links: Mapping[str, str] | None = None,
) -> str:
    """The report of a rollout.

    Args:
        found: The rollout, and that of the model before, if there is one.
        title: Title of the page.
        model_name: What the model is called.
        log_names: What the logs are called.
        units: Units of the joints; those of revolute joints by default.
        links: Words -> address of further pages, such as a recording; none by default.
    """
    units, (after, before) = units or Units(), found
    text = (
        f"RMS of simulated − measured position over {len(after.windows)} windows of "
        f"{after.horizon:g} s, beside the RMS of what the joint moved since the window's start."
    )
    charts = (rollout_chart(after, before, units),)
    table = departures_table(after, before, units)
    tiles = (
        *([Tile("before", departure(before.relative), "of the motion")] if before else []),
        Tile("departure", departure(after.relative), "of the motion"),
        Tile("horizon", f"{after.horizon:g} s", "from a measured state on"),
    )
    page = Page(
        title,
        f"{model_name} under the efforts of {', '.join(log_names)}",
        "compared",
        "simulated",
        f"The simulated model departs by {departure(after.relative)} of the motion.",
        ("Root mean square over joints of RMS departure over RMS motion.",),
        tiles,
        without_empty(
            (
                Section("Joint by joint", (text,), (table,), charts=charts),
                Section(f"Not simulated, {_NO_FORCES}", items=after.left_out_words),
                Section(
                    f"Not simulated of the model before, {_NO_FORCES}",
                    items=before.left_out_words if before else (),
                ),
            )
        ),
        "Made by geodrake: a plant with the model's inertias and effects under the logged efforts.",
        links or {},
    )
    return render(page)


def rollout_chart(after: Rollout, before: Rollout | None, units: Units) -> Chart:
    """Measured and simulated positions of every joint over time, window after window.

    Args:
        after: The rollout.
        before: That of the model before; None for none.
        units: Units of the joints.
    """
    starts = np.arange(len(after.windows)) * 1.1 * after.horizon
    times = [s + w.time - w.time[0] for s, w in zip(starts, after.windows, strict=True)]
    time = gap_filled(_joined([[t] for t in times])[0])
    rollouts = {SIMULATED: after} if before is None else {BEFORE: before, SIMULATED: after}
    measured = _joined([w.measured.T for w in after.windows])
    simulated = {s.key: _joined([w.simulated.T for w in r.windows]) for s, r in rollouts.items()}
    panels = []
    for j, joint in enumerate(after.joints):
        unit = units.at(joint.joint, "rad")
        known = measured[j][np.isfinite(measured[j])]
        margin = 0.25 * float(np.ptp(known)) + 1e-6
        curves = {MEASURED.key: measured[j], **{key: q[j] for key, q in simulated.items()}}
        span = float(known.min()) - margin, float(known.max()) + margin
        plot = Plot(f"position, {unit}", curves, span=span)
        panels.append(Panel(joint.joint, f"RMS {number(joint.rms)} {unit}", time, (plot,)))
    spans = tuple(
        (f"{w.log} {w.time[0]:.1f} s", float(w.time[0]), float(w.time[-1]), float(s - w.time[0]))
        for s, w in zip(starts, after.windows, strict=True)
    )
    return Chart("rollout", _CAPTION, (MEASURED, *rollouts), _shown(panels, after), spans)


def _joined(parts: Sequence[Array | Sequence[Array]]) -> Array:
    """Rows of all windows, one after the other, with a NaN behind each."""
    gap = np.full((len(parts[0]), 1), np.nan)
    return np.concatenate([each for part in parts for each in (np.asarray(part), gap)], axis=1)


def _shown(panels: Sequence[Panel], rollout: Rollout) -> tuple[Panel, ...]:
    """The panels, those that depart most shown at first, and the worst one marked."""
    order = np.argsort([-joint.relative for joint in rollout.joints], kind="stable").tolist()
    seen, badge = order[: style.MOST_JOINTS], "departs most" if len(panels) > 1 else ""
    return tuple(
        replace(panel, shown=j in seen, badge=badge if j == order[0] else "")
        for j, panel in enumerate(panels)
    )


@style.own_look()
def rollout_figure(
    after: Rollout,
    before: Rollout | None = None,
    *,
    most: int = style.MOST_JOINTS,
    units: Units | None = None,
) -> Figure:
    """Measured and simulated positions of every joint, window after window.

    Args:
        after: The rollout.
        before: That of the model before, if there is one.
        most: Largest number of joints to show: those that depart most.
        units: Units of the joints; those of revolute joints by default.
    """
    units = units or Units()
    order = np.argsort([-joint.relative for joint in after.joints], kind="stable")[:most]
    figure = style.new_figure(0.8 + 1.5 * len(order))
    grid = figure.subplots(len(order), 1, sharex=True, squeeze=False)[:, 0]
    for ax, j in zip(grid, sorted(order), strict=True):
        joint = after.joints[j]
        _draw(style.polish(ax), after, before, int(j))
        unit = units.at(joint.joint, "rad")
        style.joint_title(ax, joint.joint, f"RMS {number(joint.rms)} {unit}")
        ax.set_ylabel(f"position, {unit}", **style.plain(style.SMALL, style.QUIET))
    grid[-1].set_xlabel("time, window after window, s", **style.plain(style.SMALL, style.QUIET))
    style.note_below(figure, style.of_worst(len(order), len(after.joints)))
    legend = [Line2D([], [], color=style.MEASURED, linewidth=3.2, label="measured")]
    if before is not None:
        legend.append(Line2D([], [], color=style.BEFORE, linewidth=1.2, label="before"))
    legend.append(Line2D([], [], color=style.AFTER, linewidth=1.4, label="simulated"))
    style.legend_above(figure, legend)
    return figure


def _draw(ax: Axes, after: Rollout, before: Rollout | None, j: int) -> None:
    start, seen = 0.0, np.concatenate([w.measured[:, j] for w in after.windows])
    low, high = float(seen.min()), float(seen.max())
    margin = 0.25 * (high - low) + 1e-6
    for k, window in enumerate(after.windows):
        time = start + window.time - window.time[0]
        ax.plot(time, window.measured[:, j], color=style.MEASURED, linewidth=3.2)
        if before is not None:
            ax.plot(time, before.windows[k].simulated[:, j], color=style.BEFORE, linewidth=1.0)
        ax.plot(time, window.simulated[:, j], color=style.AFTER, linewidth=1.2)
        start = float(time[-1]) + 0.1 * after.horizon
    ax.set_ylim(low - margin, high + margin)
