"""Time of one criterion and its gradient, of finite differences of it, and of a whole design.

E-optimality with the geometric normalization of an iiwa, 1,000 samples of a Fourier motion with 70
coefficients. All are CPU times of one core. The iiwa is read from the folder --shared; without it,
and with --quick, an arm of our own takes its place.

    OMP_NUM_THREADS=1 python diagrams/excitation_speed.py --json speed.json --figures figures
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

import numpy as np
from excitation.manipulator import IIWA, NOISE, family, limits, manipulator
from excitation.options import study_parser, write_table
from public_data import add_folder_option
from rich.console import Console
from rich.table import Table

from geodrake.excitation import Criterion, DesignOptions, Objective, design_excitation, make_target
from geodrake.excitation.design import make_problem
from geodrake.logs import Motion
from geodrake.model import RobotModel

DESIGN_SAMPLES = 300  # of the design, as `geodrake excite` takes
NAMES = {
    "evaluation": "criterion and gradient, s",
    "differences": "finite differences of the criterion, s",
    "ratio": "differences over criterion and gradient",
    "design": "a whole design from one start, 300 samples, s",
}


def measure(model: RobotModel, *, samples: int, modes: int, seed: int, repeats: int) -> Any:
    """CPU times of one evaluation, and of the same slopes by finite differences."""
    motion, bounds = family(modes), limits(model)
    options = DesignOptions(samples=samples, rest=False)
    target = make_target(model, noise=NOISE)
    objective = Objective(target, Criterion())
    problem = make_problem(objective, bounds, motion, options)
    y = np.random.default_rng(seed).uniform(-0.2, 0.2, problem.scale.size)

    def value(y: np.ndarray) -> float:
        eigenvalues = objective.eigenvalues(Motion(*(problem.basis @ problem.coefficients(y))))
        return float(objective.criterion.objective(np.log(eigenvalues))[0])

    problem.cost(y)
    times = []
    for _ in range(repeats):
        begin = process_time()
        start, gradient = problem.cost(y)
        times.append(process_time() - begin)
    begin, h = process_time(), 1e-6
    slopes = np.array([(value(y + h * unit) - start) / h for unit in np.eye(len(y))])
    differences = process_time() - begin
    begin = process_time()
    shorter = replace(options, samples=min(samples, DESIGN_SAMPLES))
    design_excitation(target, bounds, trajectory=motion, options=shorter, seeds=[seed])
    return {
        "coefficients": len(y),
        "samples": samples,
        "evaluation": median(times),
        "differences": differences,
        "ratio": differences / median(times),
        "design": process_time() - begin,
        "disagreement": float(np.abs(gradient - slopes).max() / np.abs(gradient).max()),
    }


def draw(row: dict[str, Any], path: Path) -> None:
    """The three times as bars."""
    from geodrake.report import style

    figure = style.new_figure(2.2)
    ax = figure.subplots()
    names = [name for name in NAMES if name != "ratio"]
    ax.barh([NAMES[name] for name in names], [row[name] for name in names], color=style.AFTER)
    ax.invert_yaxis()
    style.polish(ax)
    style.log_scale(ax, "x")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def main() -> None:
    """Run the study from the command line."""
    parser = study_parser(__doc__)
    add_folder_option(parser, "with the iiwa")
    options = parser.parse_args()
    ours = options.quick or not (options.shared / IIWA).is_file()
    model = manipulator(None if ours else options.shared)
    sizes = {"samples": 100, "modes": 1} if options.quick else {"samples": 1000, "modes": 5}
    row = measure(model, **sizes, seed=options.seed, repeats=3 if options.quick else 10)
    table = Table("", f"{'an arm of our own' if ours else 'iiwa'}, CPU times")
    for name, words in NAMES.items():
        table.add_row(words, f"{row[name]:.3g}")
    Console().print(table)
    write_table(options.json, {"robot": "arm7" if ours else "iiwa", **row})
    if options.figures:
        draw(row, options.figures / "excitation_speed.png")


if __name__ == "__main__":
    main()
