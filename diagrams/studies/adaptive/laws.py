"""Adaptation laws by name, and how their speeds γ⁻¹ are chosen, by one rule for all.

The rule takes, from the grid 1e-5, 3e-5, 1e-4, … 3e3, the speed of least mean tracking error over
draws that are not reported, among the speeds that lose no draw and let V, which must not rise, rise
by at most 1 % of its start. The second half is the source's "as large as possible without accruing
large numerical integration errors" ([Lee2019] §5.5).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from statistics import fmean, pstdev
from typing import Any

from numpy.typing import ArrayLike

from diagrams.harness import positive_number, run_draws, script_parser, show, write
from geodrake.control import euclidean_adaptation, natural_adaptation, pullback_adaptation
from geodrake.control.adaptation import UpdateLaw
from geodrake.manifolds import Manifold

NONE, EUCLIDEAN, PULLBACK, NATURAL = "none", "euclidean", "pullback", "natural"
LAWS = (NONE, EUCLIDEAN, PULLBACK, NATURAL)
SOURCE_SPEEDS = {EUCLIDEAN: 5e-5, PULLBACK: 1.0, NATURAL: 1.0}
"""γ⁻¹ of [Lee2019] §5.5."""


def make_law(name: str, manifold: Manifold, start: ArrayLike, speed: float) -> UpdateLaw | None:
    """Return a law by its name."""
    if name == NONE:
        return None
    gamma = 1.0 / speed
    if name == EUCLIDEAN:
        return euclidean_adaptation(manifold.dimension, gamma)
    if name == PULLBACK:
        return pullback_adaptation(manifold, start, gamma)
    return natural_adaptation(manifold, gamma)


GRID = tuple(float(f"{digit}e{power}") for power in range(-5, 4) for digit in (1, 3))
LARGEST_RISE = 0.01
CALIBRATION_SEED = 20_190_801
"""Of the draws that speeds are chosen on; those of studies have small seeds."""

CHOSEN = {
    "wam": {EUCLIDEAN: 1e-3, PULLBACK: 30.0, NATURAL: 30.0},
    "payload": {EUCLIDEAN: 3.0, PULLBACK: 300.0, NATURAL: 3.0},
    "controller_acceleration": {EUCLIDEAN: 3e-5, NATURAL: 10.0},
    "controller_filtered": {EUCLIDEAN: 1e-5, NATURAL: 3e3},  # Euclidean: all were lost
    "sandbags": {EUCLIDEAN: 10.0, PULLBACK: 300.0, NATURAL: 100.0},
}
"""γ⁻¹ that `--choose-gains` of the scripts found."""


def speeds(study: str, kind: str) -> dict[str, float]:
    """Return γ⁻¹ of every law, the source's or the rule's."""
    return {NONE: 1.0, **(SOURCE_SPEEDS if kind == "source" else CHOSEN[study])}


def cells(
    rows: Sequence[Any], names: Sequence[str]
) -> Iterator[tuple[dict[str, Any], list[Any], list[Any]]]:
    """Yield a line for all rows with equal values of some columns, these rows, and those kept."""
    for cell in dict.fromkeys(tuple(row[name] for name in names) for row in rows):
        found = [row for row in rows if tuple(row[name] for name in names) == cell]
        kept = [row for row in found if not row["lost"]]
        rises = [row["rise"] for row in found if row["rise"] is not None]
        line = {
            **dict(zip(names, cell, strict=True)),
            "speed": found[0]["speed"],
            "draws": len(found),
            "lost": len(found) - len(kept),
            "rms": fmean(row["rms"] for row in kept) if kept else None,
            "deviation": pstdev(row["rms"] for row in kept) if kept else None,
            "unphysical": fmean(row["unphysical"] for row in found),
            "rise": max(rises, default=None),
        }
        yield line, found, kept


def grid_lines(rows: Sequence[Any], group: str) -> list[dict[str, Any]]:
    """Return a line for each speed, law and value of the column `group`, with the chosen marked."""
    lines = [{**line, "chosen": ""} for line, *_ in cells(rows, (group, "law", "speed"))]
    for value, law in dict.fromkeys((line[group], line["law"]) for line in lines):
        own = [line for line in lines if (line[group], line["law"]) == (value, law)]
        allowed = [x for x in own if not x["lost"] and (x["rise"] or 0.0) <= LARGEST_RISE]
        for best in sorted(allowed, key=lambda line: line["rms"])[:1]:
            best["chosen"] = "chosen"
    return lines


def study_parser(doc: str, *, gains: str, estimates: bool = False) -> argparse.ArgumentParser:
    """Return a parser with the options of studies of laws.

    Args:
        gains: Default of the adaptation speeds, "rule" or "source".
        estimates: Whether draws differ by first estimates, of which there may be several.
    """
    parser = script_parser(doc, draws=True, figures=True)
    rule = "apply the rule by which speeds are chosen, and say what it chooses"
    parser.add_argument("--choose-gains", action="store_true", help=rule)
    which = "adaptation speeds: by one rule for all laws, or of [Lee2019] §5.5 (%(default)s)"
    parser.add_argument("--gains", choices=("rule", "source"), default=gains, help=which)
    if estimates:
        count = "number of first estimates (2; 1 with --quick)"
        parser.add_argument("--draws", type=positive_number, help=count)
    return parser


def run_study(
    parser: argparse.ArgumentParser,
    task: Callable[..., dict[str, Any]],
    wanted: Callable[[argparse.Namespace], Sequence[Any]],
    grid: Callable[[argparse.Namespace], Sequence[Any]],
    tell: Callable[[argparse.Namespace, list[Any]], None],
    *,
    group: str,
) -> None:
    """Run draws from the command line and print them, or choose speeds on those of a grid.

    Args:
        parser: That of `study_parser`, perhaps with further options.
        task: Function of a draw and a seed that returns a row.
        group: Column besides the law within which a speed is chosen.
    """
    options = parser.parse_args()
    if "draws" in options:
        options.draws = options.draws or (1 if options.quick else 2)
    draws = (grid if options.choose_gains else wanted)(options)
    rows = run_draws(parser, options, partial(task, seed=options.seed), draws)
    if options.choose_gains:
        lines = grid_lines(rows, group)
        show("RMS in degrees", lines)
        write(options, {"grid": lines})
    else:
        tell(options, rows)
