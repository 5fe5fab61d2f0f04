"""The command `geodrake identifiable`: what is identifiable from given logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from rich.console import Console

from geodrake.cli.excitation_options import IdentifiableOptions
from geodrake.cli.identify import named_effects
from geodrake.cli.option_values import joint_values, split_effects
from geodrake.cli.session import Command, Input, run
from geodrake.cli.tables import head, say, show_list, show_table
from geodrake.errors import ArgumentError
from geodrake.excitation.identifiability import LogIdentifiability, log_identifiability
from geodrake.report.excitation_json import identifiable_dict
from geodrake.report.excitation_tables import (
    identifiable_bodies_table,
    identifiable_effects_table,
)
from geodrake.report.excitation_words import identifiability_verdict
from geodrake.report.numbers import Units, percent, relative
from geodrake.report.tables import Table, cells

_MOST_COMBINATIONS = 12
_MOST_DIRECTIONS = 8
_SMALL = 0.05  # share of a direction below which a body is not named


def run_identifiable(options: IdentifiableOptions) -> None:
    """Run the command.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """
    if not 0 < options.threshold < np.inf:
        raise ArgumentError(f"A threshold is a positive variance; got {options.threshold}.")
    files, names = split_effects(options.effects)

    def decomposed(given: Input) -> LogIdentifiability:
        text, model = options.noise, given.model
        noise = None if text is None else joint_values(text, model, "--noise")
        return log_identifiability(
            given.model,
            given.logs,
            effects=named_effects(names, given.model, given.extra),
            threshold=options.threshold,
            noise=noise,
            progress=given.progress,
            **given.settings,
        )

    command = Command(
        "identifiable",
        "Reading the logs",
        decomposed,
        identifiable_dict,
        "render_identifiable",
        show_identifiable,
    )
    run(command, replace(options, effects=files))


def show_identifiable(console: Console, found: LogIdentifiability, units: Units) -> None:
    """What is identifiable of bodies and effects, directions, the verdict, and what is not."""
    most = percent(float(np.sqrt(found.identifiable.threshold)))
    head(console, f"Parameters identifiable to within {most}, of those that any motion could show")
    show_table(console, identifiable_bodies_table(found))
    if found.effects:
        head(console, "Effects; deviation of an estimate from these logs alone")
        show_table(console, identifiable_effects_table(found, units))
    head(console, "Directions, from the most certain on: deviation, and what they are mostly of")
    show_table(console, _directions(found))
    say(console, "Verdict", identifiability_verdict(found))
    rest = found.unidentifiable
    words = [f"{c.words}: ± {relative(c.relative)}" for c in rest[:_MOST_COMBINATIONS]]
    if len(rest) > _MOST_COMBINATIONS:
        words.append(f"and {len(rest) - _MOST_COMBINATIONS} more, all of which --json has")
    show_list(console, "Combinations that are not identifiable, worst first", words)
    show_list(console, "Notes", found.notes)


def _directions(found: LogIdentifiability) -> Table:
    """The best and worst directions, and those about the threshold."""
    variances, names = found.identifiable.variances, found.blocks
    rows, before = [], -1
    for k in _picked(len(variances), found.count):
        if k > before + 1:
            rows.append(cells("…", "", "", "", ""))
        shares = found.identifiable.shares[:, k]
        order = [i for i in np.argsort(-shares) if shares[i] > _SMALL][:3]
        rows.append(
            cells(
                str(k + 1),
                ", ".join(f"{names[i]} {percent(float(shares[i]))}" for i in order),
                "yes" if k < found.count else "no",
                relative(float(np.sqrt(variances[k]))),
                relative(float(np.sqrt(found.floor_variances[k]))),
            )
        )
        before = k
    head = ("", "mostly of", "identifiable", "deviation", "at sensor noise")
    return Table(head, tuple(rows), words=3)


def _picked(count: int, kept: int) -> list[int]:
    """A few of so many directions: at both ends and about the last identifiable one."""
    half = _MOST_DIRECTIONS // 4
    near = {
        *range(half),
        *range(kept - half, kept + half),
        *range(count - half, count),
    }
    return sorted(k for k in near if 0 <= k < count)
