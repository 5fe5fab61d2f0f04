"""The command `geodrake identifiable`: what given logs can tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from rich.console import Console

from geodrake.cli.excitation_options import IdentifiableOptions
from geodrake.cli.identify import named_effects
from geodrake.cli.option_values import joint_values, split_effects
from geodrake.cli.session import Command, Input, run
from geodrake.cli.tables import head, number_columns, say, show_list, table_of
from geodrake.cli.wording import Wording, number, percent
from geodrake.errors import ArgumentError
from geodrake.excitation_json import identifiable_dict
from geodrake.identifiability import LogIdentifiability, ToldBlock, log_identifiability

_MOST_UNTOLD = 12
_MOST_DIRECTIONS = 8
_SMALL = 0.05  # share of a direction below which a body is not named


def run_identifiable(options: IdentifiableOptions) -> None:
    """Run the command.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """
    if options.save is not None:
        raise ArgumentError(
            "What logs can tell changes no model: there is nothing to save.",
            advice="Leave --save out; geodrake identify saves a fitted model.",
        )
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
            tell=given.tell,
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


def show_identifiable(console: Console, found: LogIdentifiability, wording: Wording) -> None:
    """Bodies and effects with what is told of them, directions, the verdict, what is not told."""
    most = percent(float(np.sqrt(found.identifiable.threshold)))
    head(console, f"Parameters told to within {most}, of those that any motion could tell")
    table = table_of(console, "body")
    number_columns(table, "told", "of", "share")
    for body in found.bodies:
        table.add_row(body.name, f"{body.told:.1f}", f"{body.possible:.1f}", percent(body.share))
    table.add_section()
    counts = (sum(getattr(b, name) for b in found.bodies) for name in ("told", "possible"))
    table.add_row("all bodies", *(f"{count:.1f}" for count in counts), "")
    console.print(table)
    if found.effects:
        _show_effects(console, found.effects, wording)
    _show_directions(console, found)
    say(console, "Verdict", found.verdict())
    rest = found.untold
    words = [f"{c.words}: ± {_relative(c.relative)}" for c in rest[:_MOST_UNTOLD]]
    if len(rest) > _MOST_UNTOLD:
        words.append(f"and {len(rest) - _MOST_UNTOLD} more, all of which --json has")
    show_list(console, "Combinations that are not told, worst first", words)
    show_list(console, "Notes", found.notes)


def _show_effects(console: Console, effects: Sequence[ToldBlock], wording: Wording) -> None:
    head(console, "Effects; deviation of an estimate from these logs alone")
    table = table_of(console, "effect", "where")
    number_columns(table, "value", "deviation")
    table.add_column("")
    table.add_column("")
    for entry in effects:
        unit = wording.unit(entry.effect, entry.parameter, entry.where)
        table.add_row(
            entry.name,
            ", ".join(entry.where),
            number(entry.value),
            number(entry.deviation),
            "" if unit == "1" else unit,
            "told" if entry.is_told else "not told",
        )
    console.print(table)


def _show_directions(console: Console, found: LogIdentifiability) -> None:
    """The best and worst directions, and those about the threshold."""
    head(console, "Directions, from the most certain on: deviation, and what they are mostly of")
    table = table_of(console, "#")
    number_columns(table, "deviation", "at sensor noise")
    table.add_column("told")
    table.add_column("of", overflow="fold")
    variances, names = found.identifiable.variances, found.blocks
    shown = _picked(len(variances), found.told)
    for before, k in zip([-1, *shown], shown, strict=False):
        if k > before + 1:
            table.add_row("…")
        shares = found.identifiable.shares[:, k]
        order = [i for i in np.argsort(-shares) if shares[i] > _SMALL][:3]
        table.add_row(
            str(k + 1),
            _relative(float(np.sqrt(variances[k]))),
            _relative(float(np.sqrt(found.floor_variances[k]))),
            "yes" if k < found.told else "no",
            ", ".join(f"{names[i]} {percent(float(shares[i]))}" for i in order),
        )
    console.print(table)


def _picked(count: int, told: int) -> list[int]:
    """A few of so many directions: at both ends and on both sides of the last one told."""
    half = _MOST_DIRECTIONS // 4
    near = {
        *range(half),
        *range(told - half, told + half),
        *range(count - half, count),
    }
    return sorted(k for k in near if 0 <= k < count)


def _relative(deviation: float) -> str:
    if not np.isfinite(deviation):
        return "unknown"
    return f"{100 * deviation:.2g} %" if deviation < 1 else f"{number(deviation)} times its size"
