"""Benchmark of hidden effects: what `geodrake explain` says of logs whose truth is known.

Pinocchio or MuJoCo make logs of five arms with effects in other formulas than geodrake's: one
effect of its catalogue, two, none, or one that it has no name for. Robots, motions (fast, slow,
from point to point), noise (0.5, 1, 2 % of effort), bodies (those of the model file, or 20 % off
in the geometric metric) and sizes (3 to 25 % of effort) are drawn at random. geodrake gets the log
and the model file. Further studies: `--coverage N` of the intervals of found parameters under
coloured noise, `--disturbed N` of the same beside outside effects, `--kinds N` of kinds that are
hard, `--smallest N` of the smallest effect that is found, by bisection.

    python -m diagrams.benchmarks.hidden_effects --json hidden_effects.json
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

from diagrams.benchmarks.hidden.bars import (
    bars,
    coverage_lines,
    kind_lines,
    show_lines,
    smallest_lines,
    told,
)
from diagrams.benchmarks.hidden.logs import COVERAGE, SMALLEST, Draw, all_draws, study_draws
from diagrams.benchmarks.hidden.scoring import coverage_of, score_draw, smallest_of
from diagrams.harness import positive_number, run_draws, script_parser, show, whole_number, write

QUICK_EFFECTS = ("coulomb_friction", "effort_offset", "payload")
QUICK_OUTSIDE = ("oscillation in time",)

FURTHER = {
    "kinds": "logs a hard kind and seed",
    "coverage": "logs an effect and seed under coloured noise",
    "disturbed": "the same beside an effect of no catalogue",
    "smallest": "logs an effect and seed",
}
"""Studies that there are only where logs are asked for: of what."""


def run_draw(draw: Draw) -> dict[str, Any]:
    """Return a row of the table."""
    return {COVERAGE: coverage_of, SMALLEST: smallest_of}.get(draw.case, score_draw)(draw)


def wanted_draws(logs: Mapping[str, Any], seeds: Iterable[int]) -> list[Draw]:
    """Return what the options ask for, for one seed after the other."""
    return [
        each
        for seed in seeds
        for each in (
            *all_draws(logs["draws"], seed),
            *study_draws("timing", min(logs["draws"], 1), seed),
            *(each for name in FURTHER for each in study_draws(name, logs[name], seed)),
        )
    ]


def quick_draws(seed: int) -> list[Draw]:
    """Return a few short logs of every study."""
    short = {"robot": "double_pendulum", "duration": 8.0, "rate": 100.0}
    found = all_draws(1, seed, effects=QUICK_EFFECTS, outside=QUICK_OUTSIDE, others=(1, 2), **short)
    for name in ("coverage", "smallest"):
        found += study_draws(name, 1, seed, effects=QUICK_EFFECTS[:1], **short)
    return found


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument(
        "--seeds", type=positive_number, default=1, help="seeds, from --seed on, that are pooled"
    )
    number = partial(parser.add_argument, type=whole_number, metavar="N")
    number("--draws", default=6, help="logs an effect and seed; 0 for none")
    for name, words in FURTHER.items():
        number(f"--{name}", default=0, help=words)
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.seeds)
    wanted = quick_draws(options.seed) if options.quick else wanted_draws(vars(options), seeds)
    rows = run_draws(parser, options, run_draw, wanted)
    lines = [*bars(rows), *kind_lines(rows), *coverage_lines(rows)]
    smallest = smallest_lines([row for row in rows if row["case"] == SMALLEST])
    show_lines("Hidden effects", lines)
    if smallest:
        show("Smallest effect found in 9 of 10 logs", smallest)
    write(options, {"lines": told(lines), "smallest": smallest, "rows": rows})


if __name__ == "__main__":
    main()
