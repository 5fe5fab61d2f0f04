"""Motions of a KUKA iiwa designed in four base representations with three normalizations.

[Lee2019] §4.6.2 and table 4.2: Fourier motions of 10 s by E-optimality. With the geometric
normalization, base parameters may be written down in any way. Beside them are motions by criteria
that others published, with the same start, limits and number of solver iterations, and the best of
random motions, of which there are as many as the solver may take iterations. Rounding may lead the
solver different ways; from the best geometric motion it goes on to the same optimum in every
representation. Errors are those to be expected, exactly, by the covariance of least squares. The
iiwa is read from the folder --shared; without it, and with --quick, an arm of our own takes its
place. Finished designs are kept beside the table, so that an interrupted run goes on.

    python -m diagrams.studies.iiwa_excitation --json iiwa.json --figures figures
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
from rich.console import Console
from rich.table import Table

from diagrams.harness import cache_beside, results_of, script_parser, write
from diagrams.public_data import add_folder_option
from diagrams.studies.excitation.manipulator import (
    DURATION,
    IIWA,
    Validation,
    family,
    limits,
    manipulator,
    represented_target,
)
from diagrams.studies.excitation.refined import refined
from geodrake.excitation import (
    NORMALIZATIONS,
    Criterion,
    DesignOptions,
    ExcitationTrajectory,
    Objective,
    Target,
    design_excitation,
)
from geodrake.excitation.problem import make_problem
from geodrake.excitation.starts import random_guess
from geodrake.logs import Motion
from geodrake.report import style

VERSION = 1
"""Of what a design is; one more when kept designs of older versions must not be used."""
RANDOM = "random"
PEERS = {
    ("none", "condition_number"): "Gautier and Khalil 1992",
    ("diagonal", "condition_number"): "Venture, Ayusawa and Nakamura 2009 [64]",
    ("none", "d_optimality"): "Swevers et al. 1997",
}
"""Criteria of others; D-optimality is the same with every normalization."""
REFINED = "geometric, refined"
REFINEMENT = 400


@dataclass(frozen=True)
class Plan:
    """What every design has in common.

    Attributes:
        shared: Folder with the iiwa; None for our own arm.
        modes: Of the Fourier series.
        samples: By which information is counted.
        iterations: Most iterations of the solver, in each of its two stages.
        seeds: Number of random starts.
        validation: Number of random samples at which efforts are predicted.
        seed: Of starts, prior, base representations and validation.
    """

    shared: str | None
    modes: int = 5
    samples: int = 300
    iterations: int = 150
    seeds: int = 1
    validation: int = 2000
    seed: int = 0


@dataclass(frozen=True)
class Cell:
    """A line of the table.

    Attributes:
        normalization: One of `NORMALIZATIONS`, `RANDOM` or `REFINED`.
        base: Number of the base representation, from one.
        criterion: One of `CRITERIA`.
    """

    normalization: str
    base: int = 1
    criterion: str = "e_optimality"


def design(cell: Cell, *, plan: Plan) -> dict[str, Any]:
    """The best motion by one criterion in one representation, and the errors that it leaves."""
    model = manipulator(None if plan.shared is None else Path(plan.shared))
    target = represented_target(model, cell.base, plan.seed)
    options = DesignOptions(
        samples=plan.samples, rest=False, iterations=plan.iterations, quick=False
    )
    judge = make_problem(Objective(target), limits(model), family(plan.modes), options)
    if cell.normalization == RANDOM:
        rng = np.random.default_rng([plan.seed, 1])
        middle = judge.limits.middle[None]
        guesses = [random_guess(judge, middle, rng) for _ in range(2 * plan.iterations)]
        motions = [judge.trajectory(guess) for guess in guesses]
        values = [judge.objective.value(motion.motion(judge.times)) for motion in motions]
        trajectory, evaluations = motions[int(np.argmin(values))], len(values)
    else:
        result = design_excitation(
            target,
            limits(model),
            criterion=cell.criterion,
            normalization=cell.normalization,
            trajectory=family(plan.modes),
            options=options,
            seeds=range(plan.seed, plan.seed + plan.seeds),
        )
        trajectory = result.trajectory
        evaluations = sum(outcome.evaluations for outcome in result.outcomes)
    return {"evaluations": evaluations, **line(cell, trajectory, target, plan)}


def refine(cell: Cell, *, plan: Plan, coefficients: Sequence[Any]) -> dict[str, Any]:
    """The optimum that the solver finds from the best motion, in one representation."""
    model = manipulator(None if plan.shared is None else Path(plan.shared))
    target = represented_target(model, cell.base, plan.seed)
    iterations = min(REFINEMENT, 4 * plan.iterations)
    options = DesignOptions(samples=plan.samples, rest=False, iterations=iterations, quick=False)
    arguments = (target, limits(model), family(plan.modes), np.array(coefficients), options)
    trajectory, minimized, status = refined(*arguments)
    found = {"minimized": minimized, "status": status}
    return {**found, **line(cell, trajectory, target, plan)}


def line(
    cell: Cell, trajectory: ExcitationTrajectory, target: Target, plan: Plan
) -> dict[str, Any]:
    """What a motion of a cell is worth: by the geometric criteria, and in expected errors."""
    motion = trajectory.motion(trajectory.family.times(plan.samples))
    eigenvalues = Objective(target).eigenvalues(motion)
    model = manipulator(None if plan.shared is None else Path(plan.shared))
    return {
        **asdict(cell),
        "coefficients": trajectory.coefficients.tolist(),
        "geometric_e": Criterion().value(eigenvalues),
        "geometric_condition": Criterion("condition_number").value(eigenvalues),
        **Validation.of(model, plan.validation, plan.seed).errors(target, trajectory),
    }


def first_random(plan: Plan) -> dict[str, Any]:
    """The motion that all designs start from."""
    model = manipulator(None if plan.shared is None else Path(plan.shared))
    target = represented_target(model, 1, plan.seed)
    options = DesignOptions(samples=plan.samples, rest=False, quick=False)
    problem = make_problem(Objective(target), limits(model), family(plan.modes), options)
    rng = np.random.default_rng(plan.seed)
    trajectory = problem.trajectory(random_guess(problem, problem.limits.middle[None], rng))
    return line(Cell("one random motion"), trajectory, target, plan)


def values_by_base(found: dict[str, Any], bases: int, plan: Plan) -> list[float]:
    """The criterion of one motion, normalized as it was designed, in every representation."""
    model = manipulator(None if plan.shared is None else Path(plan.shared))
    motion = family(plan.modes).basis(np.linspace(0.0, DURATION, plan.samples))
    q, v, vd = motion @ np.array(found["coefficients"])
    targets = (represented_target(model, base + 1, plan.seed) for base in range(bases))
    criterion, way = Criterion(found["criterion"]), found["normalization"]
    return [Objective(one, criterion, way).value(Motion(q, v, vd)) for one in targets]


def spread(rows: Sequence[dict[str, Any]], normalization: str) -> dict[str, float]:
    """How much base representations matter to the error and to the motion's coefficients."""
    cells = [(row, row["normalization"], row["criterion"]) for row in rows]
    own = [row for row, *cell in cells if cell == [normalization, "e_optimality"]]
    error, motion = [r["error"] for r in own], np.array([r["coefficients"] for r in own])
    value = [row["geometric_e"] for row in own]
    return {
        "error_largest_over_smallest_less_1": max(error) / min(error) - 1.0,
        "value_largest_over_smallest_less_1": max(value) / min(value) - 1.0,
        "coefficients_apart": float(np.abs(motion - motion[0]).max()),
    }


def run(plan: Plan, *, bases: int, cache: Path | None, workers: int) -> dict[str, Any]:
    """Table 4.2, and the comparison with others."""
    cells = [Cell(name, base + 1) for name in NORMALIZATIONS for base in range(bases)]
    cells += [Cell(name, 1, criterion) for name, criterion in PEERS] + [Cell(RANDOM)]
    cells.append(Cell("geometric", 1, "a_optimality"))
    key = {"version": VERSION, **asdict(plan), "shared": plan.shared is not None}
    resumable = {"cache": cache, "workers": workers}
    rows = results_of(partial(design, plan=plan), cells, key=key, **resumable)
    own = [row for row in rows if row["normalization"] == "geometric"]
    first = min(own, key=lambda row: row["geometric_e"])
    best, start = first["geometric_e"], first["coefficients"]
    cells = [Cell(REFINED, base + 1) for base in range(bases)]
    task = partial(refine, plan=plan, coefficients=start)
    rows += results_of(task, cells, key={**key, "from": best}, **resumable)
    spreads = {name: spread(rows, name) for name in (*NORMALIZATIONS, REFINED)}
    for name in NORMALIZATIONS:
        first = next(row for row in rows if row["normalization"] == name)
        values = values_by_base(first, bases, plan)
        spreads[name]["criterion_largest_over_smallest_less_1"] = max(values) / min(values) - 1.0
    rows = [*rows, first_random(plan)]
    for row in rows:
        row.pop("coefficients", None)
        row["criterion_over_best_geometric"] = row["geometric_e"] / best
    return {
        "plan": {**asdict(plan), "shared": plan.shared is not None},
        "rows": rows,
        "spread": spreads,
    }


def show(table: dict[str, Any], console: Console) -> None:
    """Print table 4.2."""
    groups = list(table["rows"][0]["effort"])
    out = Table("normalization", "criterion", "base", "error", *(f"J {g}, N·m" for g in groups))
    for name in (*(f"J {g}, rad/s²" for g in groups), "E over best"):
        out.add_column(name)
    for row in table["rows"]:
        values = [row["error"], *row["effort"].values(), *row["acceleration"].values()]
        out.add_row(
            row["normalization"],
            row["criterion"].replace("_", " "),
            str(row["base"]),
            *(f"{value:.3g}" for value in values),
            f"{row['criterion_over_best_geometric']:.3g}",
        )
    console.print(out)
    for name, one in table["spread"].items():
        error, apart = one["error_largest_over_smallest_less_1"], one["coefficients_apart"]
        console.print(
            f"{name}: between representations, errors of the designs differ by {error:.3g}, and "
            f"coefficients by {apart:.3g}"
        )
        if name in NORMALIZATIONS:
            value = one["criterion_largest_over_smallest_less_1"]
            console.print(f"    the criterion of one and the same motion by {value:.3g}")


_CRITERIA = {
    "a_optimality": "A",
    "d_optimality": "D",
    "e_optimality": "E",
    "condition_number": "condition",
}


def draw(rows: Sequence[dict[str, Any]]) -> Figure:
    """Errors by criterion and base representation."""
    figure = style.new_figure(4.2)
    colors = {"none": style.MEASURED, "diagonal": style.BEFORE, "geometric": style.AFTER}
    names = [
        f"{r['normalization']}: {_CRITERIA[r['criterion']]}, base {r['base']}"
        if r["normalization"].split(",")[0] in colors
        else r["normalization"]
        for r in rows
    ]
    panels = {
        "parameter error": [row["error"] for row in rows],
        "acceleration of the last joint, rad/s²": [
            list(row["acceleration"].values())[-1] for row in rows
        ],
        "criterion (geometric E) over the best": [
            row["criterion_over_best_geometric"] for row in rows
        ],
    }
    shades = [colors.get(row["normalization"].split(",")[0], style.FLOOR) for row in rows]
    for i, (ax, title) in enumerate(zip(figure.subplots(1, 3), panels, strict=True)):
        ax.scatter(panels[title], range(len(rows)), color=shades, s=28)
        ax.set_yticks(range(len(rows)), [""] * len(rows) if i else names)
        ax.invert_yaxis()
        style.polish(ax)
        style.log_scale(ax, "x")
        ax.set_title(title, loc="left", **style.plain())
    return figure


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__)
    add_folder_option(parser, "with the iiwa")
    parser.add_argument("--bases", type=int, help="base representations (4; 2 with --quick)")
    parser.add_argument("--iterations", type=int, help="of the solver (150; 5 with --quick)")
    parser.add_argument("--seeds", type=int, default=1, help="number of random starts")
    parser.add_argument("--workers", type=int, help="number of processes")
    options = parser.parse_args()
    own = options.quick or not (options.shared / IIWA).is_file()
    plan = Plan(
        shared=None if own else str(options.shared),
        modes=3 if options.quick else 5,
        samples=60 if options.quick else 300,
        iterations=options.iterations or (5 if options.quick else 150),
        seeds=options.seeds,
        validation=200 if options.quick else 2000,
        seed=options.seed,
    )
    bases = options.bases or (2 if options.quick else 4)
    workers = options.workers or (1 if options.quick else min(2, os.cpu_count() or 1))
    console = Console(width=200)
    table = run(plan, bases=bases, cache=cache_beside(options.json), workers=workers)
    show(table, console)
    write(options, table, iiwa_excitation=lambda: draw(table["rows"]))


if __name__ == "__main__":
    main()
