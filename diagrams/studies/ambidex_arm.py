"""Identify an AMBIDEX-like arm from few samples, with every regularizer ([Lee2019] §3.6.1).

Torques of 47 random point-to-point motions are simulated with friction and noise, and the prior is
wrong in every link ([Lee2019] §B.2). Each draw has its own prior and its own stretches of the
training samples. All regularizers reach the training residual of the entropic divergence, and
friction is what all samples say ([Lee2019] §3.5.1, §3.6.1). Draws that are done are kept in a file,
so that an interrupted run goes on.

With the Euclidean distance, kilograms are dear and moments of inertia cost next to nothing. So
masses, and with them the zero-moment point, stay as wrong as they were, and moments go where noise
and uneven friction drive them, until P ⪰ 0 or the hull stops them: its error grows with --hull,
those of the others do not. Whether it is better than the prior depends on that too (--delta).

    python -m diagrams.studies.ambidex_arm --json ambidex.json --figures figures
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from statistics import fmean, pstdev
from typing import Any

from rich.console import Console
from rich.table import Table

from diagrams.harness import results_of, script_parser, write
from diagrams.studies.ambidex.arm import Arm
from diagrams.studies.ambidex.draws import NAMES, Plan, run_draw
from diagrams.studies.ambidex.measurements import TRAINING, Measurements, measure

VERSION = 1
"""Of what a draw is; one more when kept draws of older versions must not be used."""
GAMMA = 0.03  # the source's, (N·m)²
COUNTS = (10, 30, 100, 300, 1000, TRAINING)


def run(plan: Plan, measured: Measurements, *, cache: Path | None, workers: int) -> list[Any]:
    """Rows of all draws, from the cache as far as they are there."""
    task = partial(run_draw, plan=plan, measured=measured)
    found = results_of(task, range(plan.draws), key=key(plan), cache=cache, workers=workers)
    return [row for rows in found for row in rows]


def key(plan: Plan) -> dict[str, Any]:
    """What a kept draw must have been made with."""
    return {"version": VERSION, **asdict(plan), "counts": list(plan.counts), "draws": None}


def summarize(rows: Sequence[Any], plan: Plan) -> list[dict[str, Any]]:
    """Means and deviations over the draws, for the prior and every fit."""
    summary = []
    cells = [(0, "prior")] + [(count, name) for count in plan.counts for name in NAMES]
    for count, name in cells:
        found = [r for r in rows if (r["samples"], r["regularizer"]) == (count, name)]
        if not found:
            continue
        line: dict[str, Any] = {"samples": count, "regularizer": name, "draws": len(found)}
        for column in ("training", "test", "rigid", "distance", "zmp", "seconds", "at_boundary"):
            values = [r[column] for r in found if r[column] is not None]
            if values:
                line[column], line[f"{column}_deviation"] = fmean(values), pstdev(values)
        priors = {r["draw"]: r["test"] for r in rows if r["regularizer"] == "prior"}
        line["worse_than_prior"] = fmean(r["test"] > priors[r["draw"]] for r in found)
        summary.append(line)
    return summary


def show(summary: Sequence[dict[str, Any]], console: Console) -> None:
    """Print the summary."""
    table = Table(
        "samples", "regularizer", "draws", "training", "test", "of the bodies", "distance"
    )
    for name in ("ZMP cm", "worse than prior", "at boundary", "s"):
        table.add_column(name)
    for line in summary:
        spread = [
            f"{1e3 * line[c]:.2f} ± {1e3 * line[f'{c}_deviation']:.2f}" if c in line else ""
            for c in ("training", "test", "rigid")
        ]
        table.add_row(
            str(line["samples"]),
            line["regularizer"],
            str(line["draws"]),
            *spread,
            f"{line['distance']:.2f}",
            f"{100 * line['zmp']:.2f}",
            f"{100 * line['worse_than_prior']:.0f} %",
            f"{line['at_boundary']:.1f}",
            f"{line['seconds']:.2f}",
            end_section=line["regularizer"] in ("prior", NAMES[-1]),
        )
    console.print("RMS errors of motor torques in mN·m, means and deviations over the draws")
    console.print(table)


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__, "few draws, 30 and all samples", draws=True)
    parser.add_argument("--draws", type=int, help="number of draws (30; 4 with --quick)")
    parser.add_argument("--gamma", type=float, default=GAMMA, help="of the entropic divergence")
    parser.add_argument("--delta", type=float, default=0.4, help="how wrong the prior's links are")
    parser.add_argument("--hull", type=float, default=2.0, help="size of the hulls over the links'")
    parser.add_argument("--counts", type=int, nargs="+", help="numbers of training samples")
    options = parser.parse_args()
    counts = options.counts or ((30, TRAINING) if options.quick else COUNTS)
    if not all(0 < count <= TRAINING for count in counts):
        parser.error(f"--counts are between 1 and {TRAINING}.")
    draws = options.draws or (4 if options.quick else 30)
    plan = Plan(
        draws=draws,
        counts=tuple(counts),
        gamma=options.gamma,
        delta=options.delta,
        hull=options.hull,
        seed=options.seed,
    )
    cache = options.cache or (options.json and options.json.with_suffix(".draws.jsonl"))
    arm, console = Arm.load(), Console(width=160)
    measured = measure(arm, seed=plan.seed, hull=plan.hull)
    try:
        rows = run(plan, measured, cache=cache, workers=options.jobs)
    except KeyboardInterrupt:
        where = f"Finished draws are in {cache}; the same command goes on." if cache else ""
        parser.exit(130, f"Interrupted. {where}\n")
    summary = summarize(rows, plan)
    show(summary, console)
    write(options, {"plan": plan, "summary": summary, "rows": rows})
    if options.figures:
        from diagrams.studies.ambidex.figures import write_figures

        write_figures(options.figures, summary, plan, (arm, measured))


if __name__ == "__main__":
    main()
