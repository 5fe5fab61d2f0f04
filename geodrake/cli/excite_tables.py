"""A designed motion as tables and a sentence in a terminal, or as plain text in a pipe."""

from __future__ import annotations

import numpy as np
from rich.console import Console

from geodrake.cli.tables import head, number_columns, say, show_list, table_of
from geodrake.cli.wording import number, percent
from geodrake.excitation import ExcitationResult, FourierMotion, Separation, SplineMotion
from geodrake.excitation.verdict import told_apart, verdict

_NONE = "-"
_MOST_PAIRS = 12


def show_excitation(console: Console, result: ExcitationResult, name: str) -> None:
    """What the motion is, what it uses of the limits, how it was found, what it is worth."""
    console.print(f"{name}: {motion_words(result)}", soft_wrap=True)
    _show_pairs(console, result)
    _show_use(console, result)
    _show_starts(console, result)
    say(console, "Verdict", verdict(result))
    show_list(console, "Notes", result.notes)


def motion_words(result: ExcitationResult) -> str:
    """What kind of motion it is."""
    family = result.trajectory.family
    if isinstance(family, FourierMotion):
        base = family.omega / (2.0 * np.pi)
        return (
            f"a Fourier motion of {family.duration:g} s, {family.modes} harmonics of {base:.3g} Hz"
        )
    if isinstance(family, SplineMotion):
        return f"a spline motion of {family.duration:g} s, {family.points} control points"
    return f"{family.count // 3} free samples"


def _show_use(console: Console, result: ExcitationResult) -> None:
    limits, use = result.limits, result.use
    head(console, "What it uses of the limits")
    table = table_of(console, "joint")
    number_columns(table, "from", "to", "range", "velocity", "acceleration", "effort")
    q = result.trajectory.states(result.trajectory.family.times(result.samples))[0]
    for j, joint in enumerate(limits.joints):
        table.add_row(
            joint,
            number(float(q[:, j].min())),
            number(float(q[:, j].max())),
            percent(float(use.position[j])),
            *(
                percent(float(getattr(use, name)[j]))
                if np.isfinite(getattr(limits, name)[j])
                else _NONE
                for name in ("velocity", "acceleration", "effort")
            ),
        )
    console.print(table)
    if np.isfinite(use.distance):
        say(
            console,
            "Nearest",
            f"{use.nearest}, {1e3 * use.distance:.0f} mm apart, where "
            f"{1e3 * use.clearance:.0f} mm are to be kept.",
        )


def _show_pairs(console: Console, result: ExcitationResult) -> None:
    """Who is told from whom, the hardest first."""
    pairs = told_apart(result)
    if not pairs:
        return
    head(console, "What it tells apart, everything else refitted")
    table = table_of(console, "effect", "where", "from")
    number_columns(table, "deviations", "RMS, N·m or N")
    for told in pairs[:_MOST_PAIRS]:
        where = ", ".join(told.pair.where) or "the robot"
        numbers = f"{told.deviations:.3g}", number(told.effort)
        table.add_row(told.pair.truth, where, told.pair.rival, *numbers)
    console.print(table)
    if len(pairs) > _MOST_PAIRS:
        console.print(f"and {len(pairs) - _MOST_PAIRS} that differ more", soft_wrap=True)


def _show_starts(console: Console, result: ExcitationResult) -> None:
    separation = isinstance(result.objective, Separation)
    name = "1/deviations² of the hardest pair" if separation else result.objective.criterion.name
    head(console, f"Starts; {name}, less is better")
    table = table_of(console, "seed")
    number_columns(table, "random", "designed", "evaluations", "seconds")
    table.add_column("solver")
    for outcome in result.outcomes:
        table.add_row(
            str(outcome.seed),
            f"{outcome.random_value:.4g}",
            f"{outcome.value:.4g}",
            str(outcome.evaluations),
            f"{outcome.seconds:.1f}",
            outcome.status,
        )
    console.print(table)
