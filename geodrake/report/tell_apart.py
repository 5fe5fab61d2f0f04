"""A motion that distinguishes effects: which pairs, and what a rival cannot imitate."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from geodrake.excitation import ExcitationResult, Separation
from geodrake.excitation.verdict import CLEAR, DistinguishedPair, distinguished_pairs, improvement
from geodrake.report import style
from geodrake.report.excitation_tables import pairs_table, shaped_label
from geodrake.report.numbers import Units, number
from geodrake.report.page import Section, Tile, pictures

_MOST_PAIRS = 20
_MOST_SHOWN = 4
_CAPTION = (
    "What the effect adds to the effort of the joint where its rival fails most, and the most that "
    "the rival and everything else that is refitted make of it. One panel for each pair, the "
    "hardest first. Where the sign of the speed is hardly known, samples count less."
)


def tiles_of_pairs(result: ExcitationResult) -> tuple[Tile, ...]:
    """The hardest pair in numbers.

    Args:
        result: The result of `geodrake.excitation.design_separation`.
    """
    pairs = distinguished_pairs(result)
    factor = float(np.sqrt(improvement(result)))
    return (
        Tile("least difference", f"{number(pairs[0].deviations)} σ", "of the noise of all samples"),
        Tile("better than random", f"{number(factor)} ×", "than the best start"),
        Tile("pairs", str(len(pairs)), f"with at least {number(CLEAR)} σ: {_clear(pairs)}"),
    )


def pairs_section(result: ExcitationResult) -> Section:
    """Every pair with its difference, and how the hardest look.

    Args:
        result: The result of `geodrake.excitation.design_separation`.
    """
    pairs = distinguished_pairs(result)
    units = Units.of(result.objective.target.model)
    text = [
        f"By how many standard deviations of the noise, of all {result.samples} samples together, "
        "the two differ after everything that may move was refitted. RMS is at the joint where it "
        "is most.",
    ]
    if len(pairs) > _MOST_PAIRS:
        text.append(f"The {_MOST_PAIRS} hardest of {len(pairs)} pairs.")
    figures = pictures({"pairs": imitation_figure(result)}, {"pairs": _CAPTION})
    return Section(
        "What it distinguishes",
        tuple(text),
        (pairs_table(result, units, most=_MOST_PAIRS),),
        (),
        figures,
    )


@style.own_look()
def imitation_figure(result: ExcitationResult, *, most: int = _MOST_SHOWN) -> Figure:
    """Efforts of effects, and the best that their rivals make of them.

    Args:
        result: The result of `geodrake.excitation.design_separation`.
        most: Largest number of pairs to show.
    """
    separation, motion = result.objective, result.motion
    pairs = distinguished_pairs(result)[:most]
    units = Units.of(separation.target.model)
    family = result.trajectory.family
    times = family.times(result.samples)
    at = times if family.timed else np.arange(float(len(times)))
    figure = style.new_figure(0.8 + 1.5 * len(pairs))
    axes = figure.subplots(len(pairs), 1, sharex=True, squeeze=False)[:, 0]
    look = {"linewidth": 1.4} if family.timed else {"linewidth": 0, "marker": ".", "markersize": 3}
    for ax, entry in zip(axes, pairs, strict=True):
        if not isinstance(separation, Separation):
            continue
        truth, imitated = separation.imitation(motion, separation.pairs.index(entry.pair))
        j = int(np.argmax(np.square(truth - imitated).sum(0)))
        joint = result.limits.joints[j]
        ax.plot(at, truth[:, j], color=style.AFTER, **look)
        ax.plot(at, imitated[:, j], color=style.BEFORE, **look)
        words = f"{shaped_label(entry.pair.truth)} taken for {shaped_label(entry.pair.rival)}"
        style.joint_title(style.polish(ax), joint, words)
        ax.set_ylabel(f"effort, {units.at(joint, 'N·m')}", **style.plain(style.SMALL, style.QUIET))
    label = "time, s" if family.timed else "sample"
    axes[-1].set_xlabel(label, **style.plain(style.SMALL, style.QUIET))
    handles = [
        Line2D([], [], color=color, label=name)
        for color, name in ((style.AFTER, "effect"), (style.BEFORE, "best imitation"))
    ]
    style.legend_above(figure, handles)
    return figure


def _clear(pairs: tuple[DistinguishedPair, ...]) -> str:
    return str(sum(entry.deviations >= CLEAR for entry in pairs))
