"""Benchmark of mistakes in columns: does geodrake name them, and nothing where columns are right?

Pinocchio or MuJoCo make logs of five arms (double pendulum, arms of six and seven joints, UR5,
Panda) on fast, slow and point-to-point motions; bodies are 20 % off in the geometric metric, gains
3 %, efforts have 1 % of noise, friction and rotors that the model file does not state. Then a
mistake is made in the columns: a sign, a unit, a gain, a zero, swapped joints, a part of the
efforts taken out, a wrong time. It counts as named if the findings are it, at its joints, and
nothing else. Logs of which the robot differs otherwise (payload, slope, springs) must give none.

    python -m diagrams.benchmarks.column_errors --json column_errors.json
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from diagrams.benchmarks.hidden.engines import ENGINES
from diagrams.benchmarks.hidden.robots import robot_names
from diagrams.benchmarks.wrong_columns.logs import (
    DURATION,
    MISTAKES,
    MOTIONS,
    RIGHT,
    WrongLog,
    make_log,
)
from diagrams.harness import positive_number, run_draws, script_parser, show, write
from geodrake.diagnosis import check_columns

QUICK = ("sign of an effort", "efforts swapped", "another zero", "as it is")


def run_draw(draw: WrongLog, *, seed: int) -> dict[str, Any]:
    """A row of the table; the seed is in what was drawn."""
    del seed
    model, log, secrets = make_log(draw)
    start = time.process_time()
    found = check_columns(model, [log])
    seconds = time.process_time() - start
    wanted = sorted(
        (secret.kind, tuple(model.joints[j] for j in secret.joints) or tuple(model.joints))
        for secret in secrets
    )
    return {
        "mistake": draw.mistake,
        "robot": draw.robot,
        "motion": draw.motion,
        "named": sorted((each.kind, each.joints) for each in found) == wanted,
        "first": bool(found) and (found[0].kind, found[0].joints) in wanted,
        "kinds": [f"{each.kind} of {', '.join(each.joints)}" for each in found],
        "probabilities": [each.probability for each in found],
        "joints": len(model.joints),
        "seconds": seconds,
    }


def draws(count: int, seed: int) -> list[WrongLog]:
    """So many logs of everything, over all robots, engines and motions in turn.

    A pendulum has no joint between others: another zero of its joints is a slope, or a body that
    has turned.
    """
    engines, found = tuple(ENGINES), list[WrongLog]()
    for mistake in (*MISTAKES, *RIGHT):
        able = [r for r in robot_names() if (mistake, r) != ("another zero", "double_pendulum")]
        found += [
            WrongLog(
                mistake,
                able[k % len(able)],
                engines[k // len(able) % len(engines)],
                MOTIONS[k % len(MOTIONS)],
                k,
                seed,
                DURATION,
            )
            for k in range(count)
        ]
    return found


def lines_of(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A line of the table for each mistake."""
    found = []
    for mistake in dict.fromkeys(row["mistake"] for row in rows):
        own = [row for row in rows if row["mistake"] == mistake]
        right = mistake in RIGHT
        found.append(
            {
                "columns": mistake,
                "logs": len(own),
                "named": None if right else sum(row["named"] for row in own),
                "first": None if right else sum(row["first"] for row in own),
                "alarms": sum(bool(row["kinds"]) for row in own) if right else None,
                "seconds": max(row["seconds"] for row in own),
            }
        )
    return found


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, draws=True)
    parser.add_argument("--logs", type=positive_number, default=10, help="of each mistake")
    options = parser.parse_args()
    wanted = draws(options.logs, options.seed)
    if options.quick:
        wanted = [
            WrongLog(mistake, "double_pendulum", "pinocchio", MOTIONS[0], 0, options.seed, 8.0)
            for mistake in QUICK
        ]
    rows = run_draws(parser, options, run_draw, wanted)
    lines = lines_of(rows)
    columns = {"columns": "", "logs": "d", "named": "d", "first": "d", "alarms": "d"}
    show("Mistakes in columns", {**columns, "seconds": ".1f"}, lines)
    write(options, {"lines": lines, "rows": rows})


if __name__ == "__main__":
    main()
