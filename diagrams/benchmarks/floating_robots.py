"""Benchmark of floating bases: what `geodrake explain` says of quadrupeds and a humanoid.

MuJoCo makes two logs each of robots that sway on planted feet or trot in place, with noise of
encoders, an IMU, efforts and an estimator of the base. Hidden are a payload on the trunk, a link
that is heavier than its file says, friction and rotors at all joints, a wrong gain of a joint's
effort, an offset of a foot's sensor, or nothing. Contacts are logged, logged with errors, or not
logged; wrenches of the feet and efforts of the joints are logged, or not.

    python -m diagrams.benchmarks.floating_robots --json floating.json --figures figures
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.console import Console

from diagrams.benchmarks.floating.draws import FLAGS, PAYLOAD, QUIET, SWAY, TROT, Draw, all_draws
from diagrams.benchmarks.floating.lines import lines_of
from diagrams.benchmarks.floating.scoring import is_missed, miss_words, score_draw
from diagrams.benchmarks.hidden.bars import Line
from diagrams.benchmarks.ordinary.figures import calibration_figure
from diagrams.benchmarks.ordinary_robots import shown
from diagrams.harness import positive_number, run_draws, script_parser, show, write


def run_draw(each: Draw, *, seed: int) -> dict[str, Any]:
    """Return a row of the table; the seed is in what was drawn."""
    del seed
    return score_draw(each)


def quick_draws(seed: int) -> list[Draw]:
    """Return short logs of the smallest robot, with and without a payload."""
    short = {"contacts": FLAGS, "wrenches": True, "duration": 4.0, "seed": seed}
    return [
        Draw("a1", PAYLOAD, motions=(SWAY,), number=0, **short),  # type: ignore[arg-type]
        Draw("a1", QUIET, motions=(TROT,), number=1, **short),  # type: ignore[arg-type]
    ]


def report(console: Console, lines: Sequence[Line], rows: Sequence[dict[str, Any]]) -> None:
    """Print the table, and what was missed."""
    columns = {"figure": "", "asked": "", "reached": "", "interval": "", "of": "d", "": ""}
    show("Floating bases", columns, [shown(line) for line in lines])
    missed = [row for row in rows if is_missed(row)]
    console.print(f"Missed, {len(missed)} of {len(rows)} draws:")
    for row in missed:
        console.print(f"- {miss_words(row)}", markup=False, highlight=False, soft_wrap=True)


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument("--most", type=positive_number, metavar="N", help="only the first N draws")
    options = parser.parse_args()
    wanted = quick_draws(options.seed) if options.quick else all_draws(options.seed)[: options.most]
    rows = run_draws(parser, options, run_draw, wanted)
    lines = lines_of(rows)
    report(Console(width=120), lines, rows)
    told = [{**asdict(line), "reached": line.reached} for line in lines]
    write(
        options,
        {"lines": told, "rows": rows},
        floating_calibration=lambda: calibration_figure(rows),
    )


if __name__ == "__main__":
    main()
