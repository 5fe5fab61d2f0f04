"""A motion that distinguishes effects: which pairs, and what a rival cannot imitate."""

from __future__ import annotations

import numpy as np

from geodrake.excitation import ExcitationResult, Separation
from geodrake.excitation.verdict import CLEAR, DistinguishedPair, distinguished_pairs, improvement
from geodrake.report.charts import Chart, Panel, Plot, Stage
from geodrake.report.excitation_tables import pairs_table, shaped_label
from geodrake.report.numbers import Units, number
from geodrake.report.page import Section, Tile

EFFECT = Stage("effect", "effect", "after")
IMITATION = Stage("imitation", "best imitation", "before")
_MOST_PAIRS = 20
_MOST_SHOWN = 4
_CAPTION = (
    "What the effect adds to the effort of the joint where its rival fails most, and the most that "
    "the rival and everything else that is refitted make of it. One panel for each pair, the "
    "hardest first. Where the sign of the speed is hardly known, samples count less."
)


def tiles_of_pairs(result: ExcitationResult) -> tuple[Tile, ...]:
    """The hardest pair in numbers."""
    pairs = distinguished_pairs(result)
    factor = float(np.sqrt(improvement(result)))
    return (
        Tile("least difference", f"{number(pairs[0].deviations)} σ", "of the noise of all samples"),
        Tile("better than random", f"{number(factor)} ×", "than the best start"),
        Tile("pairs", str(len(pairs)), f"with at least {number(CLEAR)} σ: {_clear(pairs)}"),
    )


def pairs_section(result: ExcitationResult) -> Section:
    """Every pair with its difference, and how the hardest look."""
    pairs = distinguished_pairs(result)
    units = Units.of(result.objective.target.model)
    text = [
        f"By how many standard deviations of the noise, of all {result.samples} samples together, "
        "the two differ after everything that may move was refitted. RMS is at the joint where it "
        "is most.",
    ]
    if len(pairs) > _MOST_PAIRS:
        text.append(f"The {_MOST_PAIRS} hardest of {len(pairs)} pairs.")
    return Section(
        "What it distinguishes",
        tuple(text),
        (pairs_table(result, units, most=_MOST_PAIRS),),
        charts=(imitation_chart(result),),
    )


def imitation_chart(result: ExcitationResult, *, most: int = _MOST_SHOWN) -> Chart:
    """Efforts of effects, and the best that their rivals make of them."""
    separation, family = result.objective, result.trajectory.family
    units = Units.of(separation.target.model)
    times = family.times(result.samples)
    at = times if family.timed else np.arange(float(len(times)))
    panels = []
    for entry in distinguished_pairs(result)[:most]:
        if not isinstance(separation, Separation):
            continue
        truth, imitated = separation.imitation(result.motion, separation.pairs.index(entry.pair))
        j = int(np.argmax(np.square(truth - imitated).sum(0)))
        joint = result.limits.joints[j]
        words = f"{joint}: {shaped_label(entry.pair.truth)} for {shaped_label(entry.pair.rival)}"
        curves = {EFFECT.key: truth[:, j], IMITATION.key: imitated[:, j]}
        plot = Plot(f"effort, {units.at(joint, 'N·m')}", curves)
        panels.append(Panel(words, "", at, (plot,)))
    spans = (("", float(at[0]), float(at[-1]), 0.0),)
    axis = "time, s" if family.timed else "sample"
    stages = (EFFECT, IMITATION)
    return Chart(
        "pairs", _CAPTION, stages, tuple(panels), spans, axis, not family.timed, parts="Pairs"
    )


def _clear(pairs: tuple[DistinguishedPair, ...]) -> str:
    return str(sum(entry.deviations >= CLEAR for entry in pairs))
