"""What drafted formulas look like: a figure, and their part of a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from geodrake.boundary.arguments import typed
from geodrake.diagnosis.drafting import Draft
from geodrake.diagnosis.drafting.results import DraftedEffect
from geodrake.diagnosis.results import Explanation
from geodrake.report import style
from geodrake.report.numbers import Units, number
from geodrake.report.page import Section
from geodrake.report.pictures import pictures
from geodrake.report.report import render_explanation
from geodrake.report.tables import formulas_table
from geodrake.report.words import correlate_words

_CAPTION = (
    "What everything else leaves at a joint, and the effort of the formula: over time, and one "
    "against the other. On the line, the formula explains all."
)
_GAP = 1.5  # samples farther apart than so many times the usual are not joined by a line


@typed
def render_drafted(
    found: tuple[Explanation, Draft],
    *,
    title: str,
    model_name: str,
    log_names: Sequence[str],
    links: Mapping[str, str] | None = None,
) -> str:
    """Return the report of an explanation and of the formulas for its rest.

    Args:
        model_name: What the model is called.
        log_names: What the logs are called.
        links: Words -> address of further pages, such as a recording; none by default.
    """
    explanation, draft = found
    section = draft_section(draft, Units.of(explanation.model))
    return render_explanation(
        explanation,
        title=title,
        model_name=model_name,
        log_names=log_names,
        more=(section,),
        links=links,
    )


def draft_section(draft: Draft, units: Units) -> Section:
    """Return the formulas found and what the rest goes with, with the figure."""
    title = "Formulas for the rest"
    items = tuple(map(correlate_words, draft.correlates))
    if not draft.effects:
        text = "No formula takes away enough of the error on held-out data to be believed."
        return Section(title, (text,), items=items)
    joints = [effect.formula.joint for effect in draft.effects]
    text = (
        "Sums of products of simple functions of the motion, found by a sparse search and judged "
        f"on held-out data; RMS in {units.effort(joints)}. A formula that fits is not yet a cause."
    )
    figures = pictures({"draft": draft_figure(draft, units=units)}, {"draft": _CAPTION})
    return Section(title, (text,), (formulas_table(draft),), items, figures)


@style.own_look()
@typed
def draft_figure(draft: Draft, *, units: Units | None = None) -> Figure:
    """Return what formulas explain: over time, and against what everything else leaves.

    Args:
        draft: A draft with an effect at least.
        units: Units of the joints; those of revolute joints by default.

    Returns:
        Two axes for each joint.
    """
    units = units or Units()
    figure = style.new_figure(0.8 + 2.2 * len(draft.effects))
    grid = figure.subplots(len(draft.effects), 2, squeeze=False, width_ratios=[2, 1])
    for (over_time, against), effect in zip(grid, draft.effects, strict=True):
        unit = units.effort([effect.formula.joint])
        _draw_over_time(style.polish(over_time), effect)
        _draw_against(style.polish(against), effect)
        change = f"RMS {number(effect.rms_before)} → {number(effect.rms_after)} {unit}"
        style.joint_title(over_time, effect.formula.joint)
        against.set_title(change, loc="right", pad=4, **style.plain(style.SMALL, style.QUIET))
        label = style.plain(style.SMALL, style.QUIET)
        over_time.set_ylabel(f"effort, {unit}", **label)
        over_time.set_xlabel("samples, block after block", **label)
        against.set_xlabel(f"formula, {unit}", **label)
        against.set_ylabel("left without it", **label)
    style.legend_above(
        figure,
        (
            Line2D([], [], color=style.MEASURED, linewidth=3.2, label="left without it"),
            Line2D([], [], color=style.AFTER, linewidth=1.2, label="formula on held-out data"),
            Patch(color=style.FLOOR, alpha=0.25, label="± sensor noise"),
        ),
    )
    return figure


def _draw_over_time(ax: Axes, effect: DraftedEffect) -> None:
    steps = np.diff(effect.time)
    usual = np.median(np.abs(steps)) if len(steps) else 1.0
    breaks = 1 + np.flatnonzero((steps > _GAP * usual) | (steps < 0))
    at = np.insert(np.arange(len(effect.time), dtype=float), breaks, np.nan)
    for values, color, width in (
        (effect.residual, style.MEASURED, 2.6),
        (effect.effort, style.AFTER, 1.0),
    ):
        ax.plot(at, np.insert(values, breaks, np.nan), color=color, linewidth=width)


def _draw_against(ax: Axes, effect: DraftedEffect) -> None:
    ends = np.array([effect.effort.min(), effect.effort.max()])
    ax.plot(ends, ends, color=style.INK, linewidth=0.8)
    ax.fill_between(
        ends, ends - effect.floor, ends + effect.floor, color=style.FLOOR, alpha=0.25, linewidth=0
    )
    ax.scatter(
        effect.effort, effect.residual, s=5, color=style.AFTER, alpha=0.35, linewidth=0,
        rasterized=True,
    )  # fmt: skip
