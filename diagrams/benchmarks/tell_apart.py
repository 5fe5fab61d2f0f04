"""Motions that distinguish effects: what a first log leaves ambiguous, a designed motion settles.

A double pendulum has an effect that its model file lacks, in formulas of the study's own. Its first
log is slow and small, and `diagnose` names the effect and its rival together: the log cannot
distinguish them. Then the robot executes the motion that `geodrake excite --tell-apart` designs for
the pair, within the same narrow limits, and the log of that alone is diagnosed; likewise, to
compare, a random motion of the same family and limits, the one that the design starts from. A pair
is distinguished if the effect is among those that are as good as the best, and its rival is not.
Robots whose first log is not ambiguous are counted and left aside. A diagnosis, which wants most
blocks of a log to agree, may still not distinguish two effects on a motion that makes them differ:
a direction that few blocks have counts little. So motions repeat. Draws are kept beside the table,
so that an interrupted run goes on.

    python -m diagrams.benchmarks.tell_apart --json tell_apart.json --figures figures
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.console import Console
from rich.table import Table

from diagrams.benchmarks.rivals.cases import CASES, WORDS
from diagrams.benchmarks.rivals.trial import Draw, run
from diagrams.harness import cache_beside, results_of, script_parser, write
from geodrake.report import style
from geodrake.report.words import effect_label

VERSION = 1
"""Of what a draw is; one more when kept draws of older versions must not be used."""
LOGS = {"first": style.MEASURED, "random": style.BEFORE, "designed": style.AFTER}
LEAST_SHOWN = 0.01  # deviations


@dataclass(frozen=True)
class Plan:
    """What a run is made of.

    Attributes:
        cases: Numbers of the cases.
        wanted: Robots of each case whose first log is ambiguous.
        most: Robots of each case that are tried at most.
        iterations: Most iterations of the solver, in each of its two stages.
        seed: Of the first robot.
    """

    cases: tuple[int, ...] = tuple(range(len(CASES)))
    wanted: int = 10
    most: int = 30
    iterations: int = 20
    seed: int = 0


def draws_of(plan: Plan, *, cache: Path | None, workers: int) -> list[dict[str, Any]]:
    """Robots of every case, until enough first logs are ambiguous."""
    task, key = partial(run, iterations=plan.iterations), {"version": VERSION}
    key |= {"iterations": plan.iterations}
    rows: list[dict[str, Any]] = []
    tried = dict.fromkeys(plan.cases, 0)
    while True:
        draws = []
        for case in plan.cases:
            found = sum(row["ambiguous"] for row in rows if row["case"] == case)
            more = min(plan.wanted - found, plan.most - tried[case])
            draws += [Draw(case, plan.seed + tried[case] + k) for k in range(more)]
            tried[case] += max(more, 0)
        if not draws:
            return rows
        rows += results_of(task, draws, key=key, cache=cache, workers=workers)


def summary(case: int, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """How many of a case's robots are ambiguous, and how many of these are distinguished."""
    own = [row for row in rows if row["case"] == case]
    ambiguous = [row for row in own if row["ambiguous"]]
    result: dict[str, Any] = {
        "truth": CASES[case].truth,
        "rival": CASES[case].rival,
        "first_motion": WORDS[CASES[case].motion],
        "robots": len(own),
        "ambiguous": len(ambiguous),
    }
    for log in LOGS:
        values = [row[f"{log}_deviations"] for row in ambiguous]
        result[log] = {
            "told": sum(row[log]["told"] for row in ambiguous),
            "wrong": sum(row[log]["wrong"] for row in ambiguous),
            "deviations": float(np.median(values)) if values else None,
        }
    return result


def show(rows: Sequence[dict[str, Any]], console: Console) -> None:
    """Print the table."""
    table = Table("robot has", "taken for", "first motion", "robots", "ambiguous")
    for column in ("distinguished by random", "by designed", "σ first", "σ random", "σ designed"):
        table.add_column(column, justify="right")
    for row in rows:
        logs = [row[log] for log in LOGS]
        counts = (f"{log['told']} of {row['ambiguous']}" for log in logs[1:])
        deviations = ("-" if x["deviations"] is None else f"{x['deviations']:.2g}" for x in logs)
        names = effect_label(row["truth"]), effect_label(row["rival"]), row["first_motion"]
        table.add_row(*names, str(row["robots"]), str(row["ambiguous"]), *counts, *deviations)
    console.print(table)


def draw(table: dict[str, Any]) -> Figure:
    """How many pairs are distinguished, and by how many deviations of the noise they differ."""
    rows, plan = table["rows"], table["plan"]
    figure = style.new_figure(1.2 + 0.55 * len(rows))
    left, right = figure.subplots(1, 2, sharey=True, gridspec_kw={"width_ratios": [2, 3]})
    at = np.arange(len(rows))
    for shift, log in ((-0.17, "random"), (0.17, "designed")):
        counts = [row[log]["told"] for row in rows]
        left.barh(at + shift, counts, height=0.3, color=LOGS[log])
        for y, row in zip(at + shift, rows, strict=True):
            left.text(row[log]["told"] + 0.1, y, str(row[log]["told"]), va="center", fontsize=8)
    for k, case, (shift, log) in (
        (k, case, one)
        for k, case in enumerate(plan["cases"])
        for one in zip((-0.22, 0.0, 0.22), LOGS, strict=True)
    ):
        own = [d for d in table["draws"] if d["case"] == case and d["ambiguous"]]
        values = np.maximum([d[f"{log}_deviations"] for d in own], LEAST_SHOWN)
        marks = np.array([d[log]["told"] for d in own], bool)
        y = np.full(len(own), k + shift)
        right.plot(values[marks], y[marks], "o", color=LOGS[log], markersize=5)
        right.plot(values[~marks], y[~marks], "o", color=LOGS[log], markersize=5, fillstyle="none")
    names = [f"{effect_label(r['truth'])},\nnot {effect_label(r['rival'])}" for r in rows]
    left.set_yticks(at, names)
    left.invert_yaxis()
    for ax in (left, right):
        style.polish(ax)
    style.log_scale(right, "x")
    left.set_xlim(0, 1.12 * max(row["ambiguous"] for row in rows) + 0.5)
    label = style.plain(style.SMALL, style.QUIET)
    left.set_xlabel(
        f"distinguished, of {plan['wanted']} that the first log left ambiguous", **label
    )
    right.set_xlabel(
        f"deviations of the noise, from {LEAST_SHOWN:g} on; hollow: not distinguished", **label
    )
    handles = [
        Line2D([], [], color=color, marker="o", linewidth=0, label=f"{log} motion")
        for log, color in LOGS.items()
    ]
    style.legend_above(figure, handles)
    return figure


def table_of(plan: Plan, *, cache: Path | None, workers: int) -> dict[str, Any]:
    """The whole study."""
    draws = draws_of(plan, cache=cache, workers=workers)
    rows = [summary(case, draws) for case in plan.cases]
    return {"plan": asdict(plan), "rows": rows, "draws": draws}


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__)
    parser.add_argument("--wanted", type=int, help="ambiguous robots of each case (10)")
    parser.add_argument("--workers", type=int, help="number of processes")
    options = parser.parse_args()
    plan = Plan(seed=options.seed, wanted=options.wanted or 10)
    if options.quick:
        plan = Plan((0,), options.wanted or 1, 3, 5, options.seed)
    workers = options.workers or (1 if options.quick else min(2, os.cpu_count() or 1))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
    table = table_of(plan, cache=cache_beside(options.json), workers=workers)
    console = Console(width=150)
    show(table["rows"], console)
    for log in ("random", "designed"):
        count = sum(row[log]["told"] for row in table["rows"])
        total = sum(row["ambiguous"] for row in table["rows"])
        console.print(f"The {log} motions distinguish {count} of {total} ambiguous pairs.")
    write(options, table, tell_apart=lambda: draw(table))


if __name__ == "__main__":
    main()
