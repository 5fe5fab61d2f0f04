"""Pages of `rollout`: measured and simulated motion, window by window, and what a fit found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from geodrake.control.rollout import Rollout, RolloutFit
from geodrake.control.rollout.rollout_values import is_soft
from geodrake.inertia import Array
from geodrake.model.effort_signal import SERVO
from geodrake.model.robot_model import RobotModel
from geodrake.report.charts import MOST_PANELS, Chart, Panel, Plot, Stage, gap_filled
from geodrake.report.json_output import record
from geodrake.report.motion_errors import departures_table
from geodrake.report.numbers import Units, number, with_deviation
from geodrake.report.page import About, Page, Section, Table, Tile, View, cells
from geodrake.report.views import rollout_series
from geodrake.report.words import (
    capitalized,
    departure,
    departure_words,
    effect_label,
    rollout_fit_words,
)

_MEASURED = Stage("measured", "measured", look="wide")
_SIMULATED = Stage("simulated", "after")
_BEFORE = Stage("before", "before")
_CAPTION = (
    "Positions in successive windows. Each starts at the measured state, from which on only "
    "the logged {under} act on the simulated robot. Lines are cut where they leave the axes."
)


@dataclass(frozen=True, eq=False)
class Simulated:
    """A rollout, and that of the model before on the same windows, if there is one."""

    after: Rollout
    before: Rollout | None = None
    model: RobotModel | None = None


def rollout_page(found: Simulated | Rollout, about: About) -> Page:
    """Say how far a simulated model departs from the measured motion."""
    if isinstance(found, Rollout):
        found = Simulated(found)
    after, before, units = found.after, found.before, about.units
    count = len(after.windows)
    departs, horizon = departure_words(after.relative), f"{after.horizon:g} s"
    headline = f"The error of the simulated motion is {departs} within {horizon}"
    if before is not None:
        headline += f"; before, {departure_words(before.relative)}"
    if after.broken:
        headline += f"; in {after.broken} of {count} windows the simulation fails"
    return Page(
        about,
        "simulated",
        f"{headline}.",
        (
            Section(
                "Error of the simulated motion",
                f"RMS of simulated − measured position in {count} windows of {horizon}.",
                "Moved is the RMS motion of the joint in the window, and share of motion "
                "the error relative to it. The total is the root mean square over the "
                "joints.",
                tables=(departures_table(after, before, units),),
                charts=(rollout_chart(after, before, units),),
            ),
            Section("Notes", items=after.notes),
        ),
        of=_subject(after, about),
        tiles=(
            *([Tile("before", departure(before.relative), "of the motion")] if before else []),
            Tile("departure", departure(after.relative), "of the motion"),
            Tile("horizon", horizon, "from a measured state on"),
        ),
        footer=_footer(after),
    )


def rollout_fit_page(found: RolloutFit, about: About) -> Page:
    """Say what a fit of rollouts found, and whether it is taken."""
    units, (before, after) = about.units, found.held_out
    tested = sum(found.tested)
    servos = any(value.effect == SERVO for value in found.values)
    free = (
        "Elastic joints, backlash, servos and motors" if servos else "Elastic joints and backlash"
    )
    if not is_soft(found.model):
        free = "Servos, elasticity and backlash"
    return Page(
        about,
        "fitted" if found.taken else "stays",
        capitalized(rollout_fit_words(found)),
        (
            Section(
                "Fitted values",
                f"To {len(found.tested) - tested} windows of {after.horizon:g} s under the logged "
                f"{after.under}.",
                tables=(_values_table(found, units),),
            ),
            Section(
                "Error of the simulated motion",
                f"RMS of simulated − measured position; {tested} windows are held out.",
                tables=(_fit_table(found, units),),
                charts=(rollout_chart(found.after, found.before, units),),
            ),
            Section("Notes", items=found.notes),
        ),
        of=_subject(after, about),
        lead=(f"{free} were fitted to the motion; all else is unchanged.",),
        tiles=(
            Tile("before", departure(before.relative), "of the motion, held out"),
            Tile("fitted", departure(after.relative), "of the motion, held out"),
            Tile("horizon", f"{after.horizon:g} s", "from a measured state on"),
        ),
        footer=_footer(after),
    )


def _subject(after: Rollout, about: About) -> str:
    return f"{about.model} under the {after.under} of {', '.join(about.logs)}"


def _footer(after: Rollout) -> str:
    return (
        "Made by geodrake: a plant with the model's inertias and effects under the logged "
        f"{after.under}."
    )


def _values_table(found: RolloutFit, units: Units) -> Table:
    """Return what a fit of rollouts found, before and after."""
    rows = []
    for value in found.values:
        unit = units.parameter(value.effect, value.name, value.joint)
        before, after, deviation = (
            units.shown(value.effect, value.name, size)
            for size in (value.before, value.after, value.deviation)
        )
        name = ", ".join(filter(None, (effect_label(value.name), unit)))
        fitted = with_deviation(after, deviation)
        rows.append(cells(effect_label(value.effect), value.joint, name, before, fitted))
    return Table(("effect", "joint", "value", "before", "fitted"), rows, words=3)


def _fit_table(found: RolloutFit, units: Units) -> Table:
    """Return departures of every joint before and after a fit, in windows it saw and in others."""
    stages = (*found.fitted, *found.held_out)
    rows = [
        cells(
            f"{joint.joint}, {units.at(joint.joint, 'rad')}",
            *(stage.joints[j].rms for stage in stages),
            *(departure(stage.joints[j].relative) for stage in stages[2:]),
        )
        for j, joint in enumerate(found.before.joints)
    ]
    total = cells("of all joints", *[""] * 4, *(departure(stage.relative) for stage in stages[2:]))
    head = ("joint", "fitted before", "after", "held out before", "after", "of motion", "after")
    return Table(head, (*rows, total), total=1)


def rollout_chart(after: Rollout, before: Rollout | None, units: Units) -> Chart:
    """Return measured and simulated positions of every joint over time, window after window."""
    starts = np.arange(len(after.windows)) * 1.1 * after.horizon
    times = [s + w.time - w.time[0] for s, w in zip(starts, after.windows, strict=True)]
    time = gap_filled(_joined([[t] for t in times])[0])
    rollouts = {_SIMULATED: after} if before is None else {_BEFORE: before, _SIMULATED: after}
    measured = _joined([w.measured.T for w in after.windows])
    simulated = {s: _joined([w.simulated.T for w in r.windows]) for s, r in rollouts.items()}
    shares = np.nan_to_num([joint.relative for joint in after.joints], nan=0.0)
    order = np.argsort(-shares, kind="stable").tolist()
    badge = "departs most" if len(after.joints) > 1 else ""
    panels = []
    for j, joint in enumerate(after.joints):
        unit = units.at(joint.joint, "rad")
        known = measured[j][np.isfinite(measured[j])]
        margin = 0.25 * float(np.ptp(known)) + 1e-6
        span = float(known.min()) - margin, float(known.max()) + margin
        curves = {_MEASURED: measured[j]}
        curves |= {stage: _within(span, q[j]) for stage, q in simulated.items()}
        plot = Plot(f"position, {unit}", curves, span=span)
        panel = Panel(joint.joint, f"RMS {number(joint.rms)} {unit}", time, (plot,))
        worst = badge if j == order[0] else ""
        panels.append(replace(panel, shown=j in order[:MOST_PANELS], badge=worst))
    spans = tuple(
        (f"{w.log} {w.time[0]:.1f} s", float(w.time[0]), float(w.time[-1]), float(s - w.time[0]))
        for s, w in zip(starts, after.windows, strict=True)
    )
    caption = _CAPTION.format(under=after.under)
    return Chart("rollout", caption, tuple(panels), spans)


def _within(span: tuple[float, float], values: Array) -> Array:
    """Return values with NaN where they are so far away that they leave the plot anyway."""
    low, high = span
    return np.where(np.abs(values - 0.5 * (low + high)) < 2.0 * (high - low), values, np.nan)


def _joined(parts: Sequence[Array | Sequence[Array]]) -> Array:
    """Return rows of all windows, one after the other, with a NaN behind each."""
    gap = np.full((len(parts[0]), 1), np.nan)
    return np.concatenate([each for part in parts for each in (np.asarray(part), gap)], axis=1)


VIEWS = {
    Rollout: View(
        rollout_page,
        "Rollout",
        records=lambda found: [
            {**asdict(joint), "relative": joint.relative} for joint in found.joints
        ],
        samples=rollout_series,
        figure="rollout",
    ),
    Simulated: View(
        rollout_page,
        "RolloutBeside",
        lambda found: {
            **record("Rollout", found.after),
            **({} if found.before is None else {"before": found.before}),
        },
        samples=lambda found: rollout_series(found.after, found.before),
    ),
    RolloutFit: View(
        rollout_fit_page,
        "RolloutFit",
        records=lambda found: list(map(asdict, found.values)),
        samples=lambda found: rollout_series(found.after, found.before),
        figure="rollout",
    ),
}
"""How to see each of these results."""
