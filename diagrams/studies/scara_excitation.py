"""A payload on a SCARA arm: motions designed in four frames with three normalizations.

[Lee2019] §4.6.1 and table 4.1: 50 free samples minimize the condition number, for the mass, centre
and moment of inertia of the payload. With the geometric normalization, the optimum is the same in
every frame, until rounding has made the solver's ways part: some 300 steps along a flat valley,
hence the limit of --iterations. Errors are those to be expected, exactly, by the covariance of
least squares. Finished designs are kept beside the table, so that an interrupted run goes on.

    python -m diagrams.studies.scara_excitation --json scara.json --figures figures
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
from diagrams.studies.excitation.expected import identified_by, parameter_error, root_covariance
from diagrams.studies.excitation.scara import (
    FRAMES,
    SAMPLES,
    TRUTH,
    errors_in_frame_3,
    limits,
    payload,
    payload_target,
    scara,
)
from geodrake.excitation import (
    CRITERIA,
    NORMALIZATIONS,
    Criterion,
    DesignOptions,
    ExcitationTrajectory,
    FreeSamples,
    Objective,
    design_excitation,
)
from geodrake.report import style

VERSION = 2
"""Of what a design is; one more when kept designs of older versions must not be used."""
COLUMNS = {"m": "m, kg", "px": "p^x, mm", "py": "p^y, mm", "rz": "r^z, mm", "error": "error"}


@dataclass(frozen=True)
class Plan:
    """What every design has in common.

    Attributes:
        criterion: One of `CRITERIA`.
        iterations: Most iterations of the solver, in each of its two stages.
        seeds: Number of random starts.
        seed: Of the first of them.
    """

    criterion: str = "condition_number"
    iterations: int = 100
    seeds: int = 1
    seed: int = 0


@dataclass(frozen=True)
class Cell:
    """A line of the table.

    Attributes:
        normalization: One of `NORMALIZATIONS`.
        frame: One of `FRAMES`.
    """

    normalization: str
    frame: str


def design(cell: Cell, *, plan: Plan) -> dict[str, Any]:
    """The best samples by one normalization in one frame, and the errors that they leave."""
    target = payload_target(cell.frame)
    result = design_excitation(
        target,
        limits(),
        criterion=plan.criterion,
        normalization=cell.normalization,
        trajectory=FreeSamples(SAMPLES),
        options=DesignOptions(iterations=plan.iterations, quick=False),
        seeds=range(plan.seed, plan.seed + plan.seeds),
    )
    return {
        **asdict(cell),
        "value": result.value,
        "random_value": result.outcomes[0].random_value,
        "coefficients": result.trajectory.coefficients.tolist(),
        **errors(result.trajectory),
        **geometric_value(result.trajectory, plan),
        "value_by_frame": values_by_frame(result.trajectory, cell.normalization, plan),
    }


def values_by_frame(
    trajectory: ExcitationTrajectory, normalization: str, plan: Plan
) -> dict[str, float]:
    """The criterion of the same samples in every frame."""
    criterion, motion = Criterion(plan.criterion), trajectory.motion(np.zeros(SAMPLES))
    return {
        frame: Objective(payload_target(frame), criterion, normalization).value(motion)
        for frame in FRAMES
    }


def errors(trajectory: ExcitationTrajectory) -> dict[str, float]:
    """Errors to be expected: those of table 4.1, in frame {3}, and the dimensionless one."""
    found = identified_by(payload_target("3"), trajectory, SAMPLES)
    R, truth = root_covariance(found), scara("3", payload(*TRUTH)).phi[1:]
    return {**errors_in_frame_3(R @ R.T), "error": parameter_error(found, truth)}


def geometric_value(trajectory: ExcitationTrajectory, plan: Plan) -> dict[str, float]:
    """The criterion with geometric normalization, by which all motions can be compared."""
    objective = Objective(payload_target("3"), Criterion(plan.criterion))
    return {"geometric_value": objective.value(trajectory.motion(np.zeros(SAMPLES)))}


def random_samples(plan: Plan, count: int) -> dict[str, Any]:
    """Root mean square errors over sets of samples drawn evenly within the limits."""
    rng, bounds = np.random.default_rng([plan.seed, 1]), limits()
    rates = (bounds.reach, bounds.velocity, bounds.acceleration)
    found = []
    for _ in range(count):
        coefficients = np.vstack([rng.uniform(-x, x, (SAMPLES, 2)) for x in rates])
        trajectory = ExcitationTrajectory(
            FreeSamples(SAMPLES), coefficients, bounds.joints, np.arange(2)
        )
        found.append({**errors(trajectory), **geometric_value(trajectory, plan)})
    means = {
        key: float(np.sqrt(np.mean([one[key] ** 2 for one in found])))
        for key in (*COLUMNS, "geometric_value")
    }
    return {"normalization": "random samples", "frame": "", **means}


def spread(rows: Sequence[dict[str, Any]], normalization: str) -> dict[str, float]:
    """How much frames matter: to the criterion of the same samples, to errors, and to samples."""
    own = [row for row in rows if row["normalization"] == normalization]
    error = [row["error"] for row in own]
    samples = np.array([row["coefficients"] for row in own])
    values = [[*row["value_by_frame"].values()] for row in own]
    return {
        "criterion_largest_over_smallest_less_1": max(max(v) / min(v) - 1.0 for v in values),
        "error_largest_over_smallest_less_1": max(error) / min(error) - 1.0,
        "samples_apart": float(np.abs(samples - samples[0]).max()),
    }


def show(rows: Sequence[dict[str, Any]], console: Console) -> None:
    """Print table 4.1."""
    table = Table("normalization", "frame", *COLUMNS.values(), "geometric criterion")
    for row in rows:
        values = [
            f"{row[key]:.4f}" if key in ("m", "error") else f"{row[key]:.2f}" for key in COLUMNS
        ]
        table.add_row(row["normalization"], row["frame"], *values, f"{row['geometric_value']:.4f}")
    console.print(table)


def draw(rows: Sequence[dict[str, Any]]) -> Figure:
    """Errors by normalization and frame."""
    figure = style.new_figure(3.0)
    colors = {"none": style.MEASURED, "diagonal": style.BEFORE, "geometric": style.AFTER}
    names = [f"{row['normalization']} {row['frame']}" for row in rows]
    for ax, (key, title) in zip(figure.subplots(1, len(COLUMNS)), COLUMNS.items(), strict=True):
        shades = [colors.get(row["normalization"], style.FLOOR) for row in rows]
        ax.scatter([row[key] for row in rows], range(len(rows)), color=shades, s=28)
        ax.set_yticks(range(len(rows)), names if key == "m" else [""] * len(rows))
        ax.invert_yaxis()
        style.polish(ax)
        style.log_scale(ax, "x")
        ax.tick_params(axis="x", labelrotation=60)
        ax.set_title(f"RMS {title}", loc="left", **style.plain())
    return figure


def run(plan: Plan, *, cache: Path | None, workers: int) -> dict[str, Any]:
    """Table 4.1, and what frames matter."""
    cells = [Cell(name, frame) for name in NORMALIZATIONS for frame in FRAMES]
    key = {"version": VERSION, **asdict(plan)}
    rows = results_of(partial(design, plan=plan), cells, key=key, cache=cache, workers=workers)
    spreads = {name: spread(rows, name) for name in NORMALIZATIONS}
    rows = [{k: v for k, v in row.items() if k != "coefficients"} for row in rows]
    return {"plan": asdict(plan), "rows": [*rows, random_samples(plan, 20)], "spread": spreads}


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__)
    parser.add_argument("--criterion", choices=CRITERIA, default="condition_number")
    parser.add_argument("--iterations", type=int, help="of the solver (100; 10 with --quick)")
    parser.add_argument("--seeds", type=int, default=1, help="number of random starts")
    parser.add_argument("--workers", type=int, help="number of processes")
    options = parser.parse_args()
    iterations = options.iterations or (10 if options.quick else 100)
    plan = Plan(options.criterion, iterations, options.seeds, options.seed)
    workers = options.workers or (1 if options.quick else min(2, os.cpu_count() or 1))
    table = run(plan, cache=cache_beside(options.json), workers=workers)
    console = Console(width=140)
    show(table["rows"], console)
    for name, one in table["spread"].items():
        error, apart = one["error_largest_over_smallest_less_1"], one["samples_apart"]
        value = one["criterion_largest_over_smallest_less_1"]
        console.print(
            f"{name}: between frames, the criterion of the same samples differs by {value:.3g}, "
            f"errors of the designs by {error:.3g}, and their samples by {apart:.3g}"
        )
    write(options, table, scara_excitation=lambda: draw(table["rows"]))


if __name__ == "__main__":
    main()
