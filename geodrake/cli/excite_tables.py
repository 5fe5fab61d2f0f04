"""A designed motion as tables and a sentence in a terminal, or as plain text in a pipe."""

from __future__ import annotations

import numpy as np
from rich.console import Console

from geodrake.cli.tables import head, say, show_list, show_table
from geodrake.excitation import ExcitationResult, FourierMotion, Separation, SplineMotion
from geodrake.excitation.verdict import distinguished_pairs
from geodrake.report.excitation_tables import limits_table, pairs_table, starts_table
from geodrake.report.excitation_words import excitation_verdict, nearest_bodies
from geodrake.report.numbers import Units

_MOST_PAIRS = 12


def show_excitation(console: Console, result: ExcitationResult, name: str) -> None:
    """What the motion is, what it uses of the limits, how it was found, what it is worth."""
    console.print(f"{name}: {motion_words(result)}", soft_wrap=True)
    units = Units.of(result.objective.target.model)
    _show_pairs(console, result, units)
    _show_use(console, result, units)
    _show_starts(console, result)
    say(console, "Verdict", excitation_verdict(result))
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


def _show_use(console: Console, result: ExcitationResult, units: Units) -> None:
    head(console, "Where the joints move, and the largest shares of their limits")
    show_table(console, limits_table(result, units))
    nearest = nearest_bodies(result)
    if nearest:
        say(console, "Nearest to each other", nearest)


def _show_pairs(console: Console, result: ExcitationResult, units: Units) -> None:
    """Which effects are distinguishable, the hardest pair first."""
    table = pairs_table(result, units, most=_MOST_PAIRS)
    if not table.rows:
        return
    head(console, "What it distinguishes, everything else refitted")
    show_table(console, table)
    more = len(distinguished_pairs(result)) - _MOST_PAIRS
    if more > 0:
        console.print(f"and {more} that differ more", soft_wrap=True)


def _show_starts(console: Console, result: ExcitationResult) -> None:
    separation = isinstance(result.objective, Separation)
    name = "1/deviations² of the hardest pair" if separation else result.objective.criterion.name
    head(console, f"Starts; {name}, less is better")
    show_table(console, starts_table(result))
