"""What rollouts look like: measured and simulated motion, window by window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import typed
from geodrake.control.rollout import Rollout
from geodrake.report.charts import Chart, Panel, Plot, Stage
from geodrake.report.curves import gap_filled
from geodrake.report.effort_chart import MEASURED
from geodrake.report.numbers import Units, number
from geodrake.report.page import (
    Page,
    Section,
    Tile,
    render,
)
from geodrake.report.tables import departures_table
from geodrake.report.words import departure
from geodrake.report.worst_joints import MOST_JOINTS

Array = NDArray[np.float64]

_CAPTION = (
    "Positions, window after window. Each window starts at the measured state; from there on the "
    "simulated robot is alone with the logged {under}. Lines are cut off where they leave the axes."
)
SIMULATED = Stage("after", "simulated", "after")
BEFORE = Stage("before", "before", "before")


@typed
def render_rollout(
    found: tuple[Rollout, Rollout | None],
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    units: Units | None = None,
    links: Mapping[str, str] | None = None,
) -> str:
    """Return the report of a rollout.

    Args:
        found: The rollout, and that of the model before, if there is one.
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
        f"{model_name} under the {after.under} of {', '.join(log_names)}",
        "compared",
        "simulated",
        f"The simulated model departs by {departure(after.relative)} of the motion.",
        ("Root mean square over joints of RMS departure over RMS motion.",),
        tiles,
        (Section("Joint by joint", (text,), (table,), charts=charts),),
        f"Made by geodrake: a plant with the model's inertias and effects under the logged "
        f"{after.under}.",
        links or {},
    )
    return render(page)


def rollout_chart(after: Rollout, before: Rollout | None, units: Units) -> Chart:
    """Measured and simulated positions of every joint over time, window after window.

    Args:
        before: That of the model before; None for none.
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
        span = float(known.min()) - margin, float(known.max()) + margin
        curves = {MEASURED.key: measured[j]}
        curves |= {key: _within(span, q[j]) for key, q in simulated.items()}
        plot = Plot(f"position, {unit}", curves, span=span)
        panels.append(Panel(joint.joint, f"RMS {number(joint.rms)} {unit}", time, (plot,)))
    spans = tuple(
        (f"{w.log} {w.time[0]:.1f} s", float(w.time[0]), float(w.time[-1]), float(s - w.time[0]))
        for s, w in zip(starts, after.windows, strict=True)
    )
    caption = _CAPTION.format(under=after.under)
    return Chart("rollout", caption, (MEASURED, *rollouts), _shown(panels, after), spans)


def _within(span: tuple[float, float], values: Array) -> Array:
    """Values with NaN where they are so far away that they leave the plot anyway."""
    low, high = span
    return np.where(np.abs(values - 0.5 * (low + high)) < 2.0 * (high - low), values, np.nan)


def _joined(parts: Sequence[Array | Sequence[Array]]) -> Array:
    """Rows of all windows, one after the other, with a NaN behind each."""
    gap = np.full((len(parts[0]), 1), np.nan)
    return np.concatenate([each for part in parts for each in (np.asarray(part), gap)], axis=1)


def _shown(panels: Sequence[Panel], rollout: Rollout) -> tuple[Panel, ...]:
    """Return the panels, those that depart most shown at first, and the worst one marked."""
    order = np.argsort([-joint.relative for joint in rollout.joints], kind="stable").tolist()
    seen, badge = order[:MOST_JOINTS], "departs most" if len(panels) > 1 else ""
    return tuple(
        replace(panel, shown=j in seen, badge=badge if j == order[0] else "")
        for j, panel in enumerate(panels)
    )
