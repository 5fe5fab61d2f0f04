"""Pages of `rollout`: measured and simulated motion in windows, and fits to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from geodrake.control.rollout import Rollout, RolloutFit
from geodrake.control.rollout.motion_search import is_soft
from geodrake.control.rollout.roll_out import JointDeparture
from geodrake.inertia import Array
from geodrake.model.effort_signal import SERVO
from geodrake.model.robot_model import RobotModel
from geodrake.report.charts import MOST_PANELS, Chart, Panel, Plot, Stage, gap_filled
from geodrake.report.json_output import record
from geodrake.report.numbers import Units, chance, number, percent, with_deviation
from geodrake.report.page import About, Page, Section, Table, View, cells
from geodrake.report.views import rollout_series
from geodrake.report.words import capitalized, effect_label

_MEASURED = Stage("measured", "measured", look="wide")
_SIMULATED = Stage("simulated", "after")
_BEFORE = Stage("before", "before")
_CAPTION = (
    "Positions in successive windows. Each starts at the measured state; after that, only the "
    "logged {under} act on the simulated robot. Lines are cut where they leave the axes."
)


@dataclass(frozen=True, eq=False)
class Simulated:
    """A rollout, and optionally that of the previous model in the same windows."""

    after: Rollout
    before: Rollout | None = None
    model: RobotModel | None = None


def rollout_page(found: Simulated | Rollout, about: About) -> Page:
    """Return the page of a rollout."""
    if isinstance(found, Rollout):
        found = Simulated(found)
    after, before, units = found.after, found.before, about.units
    count, horizon = len(after.windows), f"{after.horizon:g} s"
    headline = f"The error of the simulated motion is {departure_words(after.relative)}"
    headline += f" within {horizon}"
    if before is not None:
        headline += f"; before, {departure_words(before.relative)}"
    if after.broken:
        headline += f"; in {after.broken} of {count} windows the simulation fails"
    motion = Section(
        "Error of the simulated motion",
        f"RMS of simulated − measured position in {count} windows of {horizon}.",
        "Moved is the RMS motion of the joint in the window, and share of motion the error "
        "relative to it. The total is the root mean square over the joints.",
        tables=(departures_table(after, before, units),),
        charts=(rollout_chart(after, before, units),),
    )
    sections = motion, Section("Notes", items=after.notes)
    page = Page(about, f"{headline}.", sections, verdict="simulated")
    return _with_rollout(page, after)


def rollout_fit_page(found: RolloutFit, about: About) -> Page:
    """Return the page of a fit to rollouts."""
    units, (_, after) = about.units, found.held_out
    tested = sum(found.tested)
    fitted = "elastic joints and backlash"
    if not is_soft(found.model):
        fitted = "servos, elasticity and backlash"
    elif any(value.effect == SERVO for value in found.values):
        fitted = "elastic joints, backlash, servos and motors"
    sections = (
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
    )
    page = Page(
        about,
        capitalized(rollout_fit_words(found)),
        (*sections, Section("Notes", items=found.notes)),
        verdict="fitted",
        facts={"Fitted": f"{fitted}; all else is unchanged"},
    )
    return _with_rollout(page, after)


def _with_rollout(page: Page, after: Rollout) -> Page:
    """Return a page with the parts common to all pages of rollouts."""
    return replace(
        page,
        of=f"{page.about.model} under the {after.under} of {', '.join(page.about.logs)}",
        footer="Made by geodrake: a plant with the model's inertias and effects under the logged "
        f"{after.under}.",
    )


def departure(share: float) -> str:
    """Return the error of a simulated motion, as a share of the measured motion."""
    if np.isnan(share):
        return "at rest"
    if np.isinf(share):
        return "diverged"
    return percent(share) if share < 10 else f"{number(share)} ×"


def departure_words(share: float) -> str:
    """Return `departure` for use in a sentence."""
    text = departure(share)
    return text if np.isinf(share) else f"{text} of the motion".replace("× of", "times")


def rollout_fit_words(found: RolloutFit) -> str:
    """Return the outcome of a fit to rollouts, in a sentence."""
    before, after = found.held_out
    shares = f"from {departure(before.relative)} to {departure_words(after.relative)}"
    if found.taken:
        return (
            f"the fit is accepted: the error in held-out windows falls {shares} (p = "
            f"{chance(found.chance)})."
        )
    reason = f"is not significant (p = {chance(found.chance)}, {sum(found.tested)} windows); "
    reason += "add logs or --windows"
    if after.relative > before.relative:
        reason = "is an increase"
    return f"the fit is rejected: its change in held-out windows, {shares}, {reason}."


def departures_table(after: Rollout, before: Rollout | None, units: Units) -> Table:
    """Return the position error of every joint."""
    rows = []
    for j, joint in enumerate(after.joints):
        log, instant = joint.worst
        ends = (before.joints[j].rms, joint.rms) if before else (joint.rms,)
        worst = f"{log} {instant:.1f} s"
        name = _with_unit(joint, units)
        rows.append(cells(name, joint.moved, *ends, departure(joint.relative), worst))
    heads = ("before", "after") if before else ("error",)
    return Table(("joint", "moved", *heads, "share of motion", "worst at"), rows)


def stages_table(stages: Sequence[Rollout], units: Units) -> Table:
    """Return the position error of every joint before the first and after each step."""
    steps = [f"after step {k}" for k in range(1, len(stages))]
    rows = [
        cells(
            _with_unit(joint, units),
            *(stage.joints[j].rms for stage in stages),
        )
        for j, joint in enumerate(stages[0].joints)
    ]
    return Table(("joint", "before", *steps), rows, title="Step by step", detailed=True)


def _with_unit(joint: JointDeparture, units: Units) -> str:
    return f"{joint.joint}, {units.at(joint.joint, 'rad')}"


def _values_table(found: RolloutFit, units: Units) -> Table:
    """Return the fitted values, before and after."""
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
    """Return the position errors before and after a fit, in fitted and held-out windows."""
    stages = (*found.fitted, *found.held_out)
    rows = [
        cells(
            _with_unit(joint, units),
            *(stage.joints[j].rms for stage in stages),
            *(departure(stage.joints[j].relative) for stage in stages[2:]),
        )
        for j, joint in enumerate(found.before.joints)
    ]
    total = cells("of all joints", *[""] * 4, *(departure(stage.relative) for stage in stages[2:]))
    head = ("joint", "fitted before", "after", "held out before", "after", "of motion", "after")
    return Table(head, (*rows, total), total=1)


def rollout_chart(after: Rollout, before: Rollout | None, units: Units) -> Chart:
    """Return measured and simulated positions of every joint in successive windows."""
    starts = np.arange(len(after.windows)) * 1.1 * after.horizon
    times = [s + w.time - w.time[0] for s, w in zip(starts, after.windows, strict=True)]
    time = gap_filled(_joined(times))
    measured = _joined([w.measured for w in after.windows])
    rollouts = {_SIMULATED: after} if before is None else {_BEFORE: before, _SIMULATED: after}
    simulated = {s: _joined([w.simulated for w in r.windows]) for s, r in rollouts.items()}
    shares = np.nan_to_num([joint.relative for joint in after.joints], nan=0.0)
    order = np.argsort(-shares, kind="stable").tolist()
    panels = []
    for j, joint in enumerate(after.joints):
        unit = units.at(joint.joint, "rad")
        known = measured[np.isfinite(measured[:, j]), j]
        margin = 0.25 * float(np.ptp(known)) + 1e-6
        low, high = float(known.min()) - margin, float(known.max()) + margin
        curves = {_MEASURED: measured[:, j]}
        for stage, q in simulated.items():
            is_close = np.abs(q[:, j] - 0.5 * (low + high)) < 2.0 * (high - low)
            curves[stage] = np.where(is_close, q[:, j], np.nan)  # others leave the plot
        plot = Plot(f"position, {unit}", curves, span=(low, high))
        worst = "departs most" if j == order[0] and len(order) > 1 else ""
        detail, shown = f"RMS {number(joint.rms)} {unit}", j in order[:MOST_PANELS]
        panels.append(Panel(joint.joint, detail, time, (plot,), badge=worst, shown=shown))
    spans = tuple(
        (f"{w.log} {w.time[0]:.1f} s", float(w.time[0]), float(w.time[-1]), float(s - w.time[0]))
        for s, w in zip(starts, after.windows, strict=True)
    )
    caption = _CAPTION.format(under=after.under)
    return Chart("rollout", caption, tuple(panels), spans)


def _joined(parts: Sequence[Array]) -> Array:
    """Return the rows of all windows, with a row of NaN after each."""
    gap = np.full((1, *parts[0].shape[1:]), np.nan)
    return np.concatenate([each for part in parts for each in (part, gap)])


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
"""Type of result -> its view."""
