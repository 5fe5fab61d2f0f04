"""Servos of unknown gains: what `geodrake explain` says of logs without efforts.

Pinocchio and MuJoCo simulate arms of one to seven joints whose servos follow commands. Stiffness,
damping, delay, dry and viscous friction and armature are drawn at random; a log has positions and
commands alone, and geodrake the model file. Told are how often all hidden effects are in the set of
what it names, how often true values lie inside the intervals (two standard deviations), how far
values are off, and how long it takes.

    python -m diagrams.benchmarks.servo_gains --json servo_gains.json

With `--integral`, the same servos have an integral, too; with `--limited`, they are at the limit of
their torque, which the model file states, for part of each log.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from diagrams.benchmarks.servos.draws import ServoDraw, servo_draws
from diagrams.benchmarks.servos.figures import save_ratios
from diagrams.benchmarks.servos.scoring import score_servo
from diagrams.harness import positive_number, run_draws, script_parser, show, write


def run_draw(draw: ServoDraw, *, seed: int) -> dict[str, Any]:
    """A row of the table; the seed is in what was drawn."""
    del seed
    return score_servo(draw)


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Shares and medians over all logs."""
    values = [value for row in rows for value in row["values"]]
    table: dict[str, Any] = {
        "logs": len(rows),
        "all effects in the set": float(np.mean([row["in_set"] for row in rows])),
        "other effects named, a log": float(np.mean([len(row["extra"]) for row in rows])),
        "departure over that of the true model, median": float(
            np.median([_worse(row) for row in rows])
        ),
        "departure over the motion before, median": _on_the_way(rows, 0),
        "after the first step": _on_the_way(rows, 1),
        "at the end": _on_the_way(rows, -1),
        "seconds a log, median": float(np.median([row["seconds"] for row in rows])),
        "with motions before, on the way and after, most": max(
            row["seconds"] + row["seconds of motions"] for row in rows
        ),
    }
    for what in dict.fromkeys(value["what"] for value in values):
        same = [value for value in values if value["what"] == what]
        ratios = np.array([value["ratio"] for value in same if value["ratio"]])
        table[what] = {
            "inside": float(np.mean([value["inside"] for value in same])),
            "median error": float(np.median(np.abs(ratios - 1.0))),
            "values": len(same),
        }
    return table


def _on_the_way(rows: Sequence[Mapping[str, Any]], at: int) -> float:
    """Median over logs of the departure over the motion, RMS of all joints, at a step."""
    return float(
        np.median([np.sqrt(np.square(row["motion on the way"][at]).mean()) for row in rows])
    )


def _worse(row: Mapping[str, Any]) -> float:
    """Departure from the motion over that of the true model, both over all joints."""
    ours, best = (np.square(row[key]).mean() for key in ("motion", "motion of the true model"))
    return float(np.sqrt(ours / best))


def main() -> None:
    """Run from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument("--logs", type=positive_number, default=40, help="(%(default)s)")
    parser.add_argument("--integral", action="store_true", help="servos have an integral")
    parser.add_argument("--limited", action="store_true", help="torques have a limit")
    options = parser.parse_args()
    kinds = {"integral": options.integral, "limited": options.limited}
    draws = servo_draws(options.logs, options.seed, **kinds)
    if options.quick:
        first = ServoDraw("double_pendulum", "mujoco", False, 0, options.seed, duration=6.0)
        draws = [replace(first, **kinds)]
    rows = run_draws(parser, options, run_draw, draws)
    table = summary(rows)
    columns = {"figure": "", "value": ".3g", "inside": ".0%", "off by, median": ".1%", "of": ""}
    lines = [
        {"figure": name, "value": value}
        if not isinstance(value, dict)
        else {
            "figure": name,
            "inside": value["inside"],
            "off by, median": value["median error"],
            "of": value["values"],
        }
        for name, value in table.items()
    ]
    show("Servos of unknown gains", columns, lines)
    if options.figures is not None:
        save_ratios(rows, options.figures)
    write(options, {"summary": table, "rows": rows})


if __name__ == "__main__":
    main()
