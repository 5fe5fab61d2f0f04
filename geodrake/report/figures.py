"""Figures of errors: by joint, step by step, and of candidates against each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from geodrake.boundary.arguments import typed
from geodrake.diagnosis.results import Candidate, Diagnosis, Explanation
from geodrake.identification.logs.model_errors import ErrorTable
from geodrake.report import style
from geodrake.report.numbers import number
from geodrake.report.words import effect_label, places_label, step_place
from geodrake.report.worst_joints import MOST_JOINTS, of_worst, worst_joints

_LEAST = 1e-6  # nrms, so that a perfect model has a place on a logarithmic axis
_MOST_CANDIDATES = 14
_MOST_WORDS = 62
_MOST_UPRIGHT = 110  # letters under an axis


@style.own_look()
@typed
def joint_error_figure(
    start: ErrorTable,
    stages: Sequence[tuple[str, Sequence[float]]] = (),
    *,
    most: int = MOST_JOINTS,
) -> Figure:
    """Error of each joint over the standard deviation of its effort: start, steps, noise floor.

    Args:
        stages: Words and (nv,) RMS of every joint, N·m or N, after each step.
        most: Largest number of joints to show: those of largest nrms at the start.

    Returns:
        One axes with a group of bars for each joint.
    """
    shown = set(worst_joints(start, most))
    at = [i for i, joint in enumerate(start.joints) if joint.joint in shown]
    std = np.array([start.joints[i].std for i in at])
    columns = [("as it stands", np.array([start.joints[i].rms for i in at]))]
    columns += [(words, np.array([rms[i] for i in at])) for words, rms in stages]
    floor = np.array([start.joints[i].floor for i in at]) / std
    figure = style.new_figure(3.7)
    ax = style.polish(figure.subplots(), grid="y")
    width = min(0.3, 0.82 / len(columns))
    colors = _colors(len(columns))
    tops = np.maximum([rms / std for _, rms in columns], _LEAST)
    for i, (top, color) in enumerate(zip(tops, colors, strict=True)):
        shift = (i - 0.5 * (len(columns) - 1)) * width
        ax.bar(np.arange(len(at)) + shift, top, 0.92 * width, color=color)
    seen = np.concatenate([tops[np.isfinite(tops)], floor[floor > 0]])
    ax.set_ylim(0.5 * seen.min(), 1.6 * seen.max())
    style.log_scale(ax, "y")
    ax.hlines(
        np.maximum(floor, _LEAST), np.arange(len(at)) - 0.45, np.arange(len(at)) + 0.45,
        color=style.FLOOR, linewidth=2,
    )  # fmt: skip
    names = [style.joint_label(start.joints[i].joint) for i in at]
    text = style.plain(style.SMALL)
    if sum(map(len, names)) > _MOST_UPRIGHT:
        text |= {"rotation": 20, "ha": "right"}
    ax.set_xticks(range(len(at)), names, **text)
    ax.set_xlim(-0.6, len(at) - 0.4)
    ax.tick_params(axis="x", length=0)
    ax.set_ylabel("RMS error / std of the effort", **style.plain(style.SMALL, style.QUIET))
    handles = [Patch(color=c, label=w) for (w, _), c in zip(columns, colors, strict=True)]
    noise = Line2D([], [], color=style.FLOOR, linewidth=2, label="sensor noise")
    style.legend_above(figure, [*handles, noise], columns=4)
    style.note_below(figure, of_worst(len(at), len(start.joints)))
    return figure


@typed
def step_stages(explanation: Explanation) -> list[tuple[str, list[float]]]:
    """Words and RMS of every joint after each step, as `joint_error_figure` takes them."""
    joints = [joint.joint for joint in explanation.start.joints]
    return [
        (
            style.label(f"+ {effect_label(step.effect)}"),
            [step.rms_after.get(j, np.nan) for j in joints],
        )
        for step in explanation.steps
    ]


@style.own_look()
@typed
def step_figure(explanation: Explanation) -> Figure:
    """Return how the held-out nrms falls with each step, with the noise floor.

    Returns:
        One axes with a line for the model as it stands, one for its own parameters refitted, and
        one for each step.
    """
    start, end = explanation.start, explanation.end
    joints = [joint.joint for joint in start.joints]
    rows = [("the model as it stands", start.nrms, start.nrms)]
    if explanation.steps:
        rows.append(("its own parameters refitted", start.nrms, explanation.refitted.nrms))
    for step in explanation.steps:
        words = f"+ {effect_label(step.effect)}, {step_place(step, joints, most=3)}"
        rows.append((style.label(words, _MOST_WORDS), step.error_before, step.error_after))
    figure = style.new_figure(1.0 + 0.36 * len(rows))
    ax = style.polish(figure.subplots(), grid="x")
    spans = np.maximum([row[1:] for row in rows], _LEAST)
    for i, (before, after) in enumerate(spans.tolist()):
        color = style.BEFORE if i == 0 else style.AFTER
        ax.plot([before, after], [i, i], color=color, linewidth=7, alpha=0.3, solid_capstyle="butt")
        ax.plot([after], [i], "o", color=color, markersize=7)
        if i + 1 < len(rows):
            ax.plot([after, after], [i, i + 1], color=style.QUIET, linewidth=0.8, linestyle=":")
        ax.annotate(
            number(after), (after, i), (-8, 0), textcoords="offset points", ha="right",
            va="center", **style.plain(style.SMALL, fontweight="bold"),
            bbox={"boxstyle": "square,pad=0.15", "facecolor": "white", "linewidth": 0},
        )  # fmt: skip
    if end.floor_nrms > 0:
        ax.axvline(end.floor_nrms, color=style.FLOOR, linewidth=1.6, linestyle="--")
    least = min(spans.min(), end.floor_nrms or np.inf)
    ax.set_xlim(0.6 * least, 1.5 * spans.max())
    style.log_scale(ax, "x")
    ax.set_yticks(range(len(rows)), [row[0] for row in rows], **style.plain(style.SMALL + 0.5))
    ax.set_ylim(len(rows) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("nrms on held-out data", **style.plain(style.SMALL, style.QUIET))
    noise = Line2D([], [], color=style.FLOOR, linestyle="--", label="sensor noise")
    style.legend_above(figure, [noise])
    return figure


@style.own_look()
@typed
def candidate_figure(diagnosis: Diagnosis, *, most: int = _MOST_CANDIDATES) -> Figure:
    """Held-out nrms that each candidate would leave, the chosen one first.

    Returns:
        One axes with a bar for each candidate; those tied with the best are marked.
    """
    shown = diagnosis.candidates[:most]
    joints = [joint.joint for joint in diagnosis.start.joints]
    figure = style.new_figure(1.1 + 0.36 * max(len(shown), 1))
    ax = style.polish(figure.subplots(), grid="x")
    for i, candidate in enumerate(shown):
        ax.barh(i, candidate.error_after, 0.62, color=_candidate_color(i, candidate))
        words = number(candidate.error_after) + (", tied" if i and candidate.tied else "")
        ax.annotate(
            words, (candidate.error_after, i), (6, 0), textcoords="offset points", va="center",
            **style.plain(style.SMALL, fontweight="bold" if i == 0 else "normal"),
        )  # fmt: skip
    floor, before = diagnosis.refitted.floor_nrms, diagnosis.refitted.nrms
    ax.axvline(before, color=style.BEFORE, linewidth=1.6)
    ax.axvline(floor, color=style.FLOOR, linewidth=1.6, linestyle="--")
    ax.set_xlim(0, 1.12 * max([before, floor, *(c.error_after for c in shown)]))
    labels = [f"{effect_label(c.effect)}, {places_label(c.where, joints, most=3)}" for c in shown]
    ax.set_yticks(
        range(len(shown)), [style.label(text, _MOST_WORDS) for text in labels],
        **style.plain(style.SMALL + 0.5),
    )  # fmt: skip
    ax.set_ylim(max(len(shown), 1) - 0.4, -0.6)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("nrms on held-out data", **style.plain(style.SMALL, style.QUIET))
    style.legend_above(figure, _candidate_legend(any(c.tied for c in shown[1:])))
    if len(diagnosis.candidates) > most:
        style.note_below(figure, f"The best {most} of {len(diagnosis.candidates)} candidates.")
    return figure


def _candidate_color(rank: int, candidate: Candidate) -> str:
    return style.AFTER if rank == 0 else style.TIED if candidate.tied else style.RULE


def _candidate_legend(ties: bool) -> list[Patch | Line2D]:
    handles: list[Patch | Line2D] = [
        Line2D([], [], color=style.BEFORE, label="without it"),
        Patch(color=style.AFTER, label="chosen"),
        Patch(color=style.RULE, label="less likely"),
        Line2D([], [], color=style.FLOOR, linestyle="--", label="sensor noise"),
    ]
    if ties:
        handles.insert(2, Patch(color=style.TIED, label="as good, as far as the logs show"))
    return handles


def _colors(count: int) -> list[tuple[str, float]]:
    """Colour and opacity of the start, then from faint to full for what follows."""
    shades = np.linspace(0.25, 1.0, count - 1) if count > 2 else np.ones(count - 1)
    return [(style.BEFORE, 1.0), *((style.AFTER, float(shade)) for shade in shades)]
