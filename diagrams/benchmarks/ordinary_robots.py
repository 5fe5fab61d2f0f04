"""Benchmark of ordinary robots: what `geodrake explain` says of arms as they are.

Pinocchio or MuJoCo make two logs each of four public arms with friction at every joint, often
rotors at every joint and a tool, and a model file that is exact, or 15 or 30 % off; with 50 to
500 samples a second, with velocities or without. Other robots have an effect of no catalogue, for
which every name is wrong, or hide nothing. Told are whether everything is named and nothing else,
the tool's mass with its interval, the processor's seconds, and the calibration: of all that is said
with a probability, how much is true.

    python -m diagrams.benchmarks.ordinary_robots --seeds 10 --json ordinary.json --figures figures
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console

from diagrams.benchmarks.hidden.bars import Line
from diagrams.benchmarks.ordinary.draws import ORDINARY, OUTSIDE, QUIET, Draw, all_draws, draw
from diagrams.benchmarks.ordinary.lines import lines_of
from diagrams.benchmarks.ordinary.scoring import is_missed, miss_words, score_draw
from diagrams.harness import positive_number, run_draws, script_parser, show, write


def run_draw(each: Draw, *, seed: int) -> dict[str, Any]:
    """A row of the table; the seed is in what was drawn."""
    del seed
    return score_draw(each)


def quick_draws(seed: int) -> list[Draw]:
    """A short draw of every case, of the arm that moves fastest."""
    short = {"duration": 10.0, "rate": 100.0, "velocities": True, "noise": 0.005}
    return [
        draw(ORDINARY, "ur5", 0, seed, **short, tool=0.1, off=0.0, rotors=False),
        draw(OUTSIDE, "ur5", 0, seed, **short, kind="pendulum in a link"),
        draw(QUIET, "ur5", 0, seed, **short),
    ]


def report(console: Console, lines: Sequence[Line], rows: Sequence[dict[str, Any]]) -> None:
    """Prints the table, and what was missed."""
    columns = {"figure": "", "asked": "", "reached": "", "interval": "", "of": "d", "": ""}
    show("Ordinary robots", columns, [shown(line) for line in lines])
    missed = [row for row in rows if is_missed(row)]
    console.print(f"Missed, {len(missed)} of {len(rows)} draws:")
    for row in missed:
        console.print(f"- {miss_words(row)}", markup=False, highlight=False, soft_wrap=True)


def shown(line: Line) -> dict[str, Any]:
    """Return a line of the report as its table has it."""
    form = "{:.1f}".format if "seconds" in line.figure else "{:.1%}".format
    asked = None if line.bar is None else f"{'≤' if line.most else '≥'} {form(line.bar)}"
    if line.bar is not None and line.highest is not None:
        asked = f"{form(line.bar)} – {form(line.highest)}"
    found = line.value is not None
    return {
        "figure": line.figure,
        "asked": asked,
        "reached": form(line.value) if found else None,
        "interval": f"{form(line.low)} – {form(line.high)}" if found else None,
        "of": line.logs,
        "": {True: "reached", False: "missed", None: ""}[line.reached],
    }


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    number = {"type": positive_number, "metavar": "N"}
    parser.add_argument("--seeds", default=1, **number, help="seeds, from --seed on")
    parser.add_argument("--most", default=None, **number, help="only the first N draws")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.seeds)
    wanted = [each for seed in seeds for each in all_draws(seed)][: options.most]
    rows = run_draws(
        parser, options, run_draw, quick_draws(options.seed) if options.quick else wanted
    )
    lines = lines_of(rows)
    report(Console(width=120), lines, rows)
    told = [{**asdict(line), "reached": line.reached} for line in lines]
    write(options, {"lines": told, "rows": rows})
    if options.figures:
        from diagrams.benchmarks.ordinary.figures import write_figures

        write_figures(options.figures, rows)


if __name__ == "__main__":
    main()
