"""Time of one criterion and its gradient, and of finite differences of it.

The criterion is E-optimality with the geometric normalization, for 1,000 samples of an iiwa's
Fourier motion with 70 coefficients. Times are CPU times of one core. The iiwa is read from the
folder --shared; without it, or with --quick, an arm of this project is used instead.

    OMP_NUM_THREADS=1 python -m diagrams.benchmarks.excitation_speed --json speed.json
"""

from __future__ import annotations

from typing import Any

import numpy as np

from diagrams.harness import cpu_time, medians, script_parser, tell
from diagrams.public_data import add_folder_option
from diagrams.studies.iiwa_excitation import IIWA, NOISE, family, limits, manipulator
from geodrake.excitation import Criterion, DesignOptions, Objective, make_target
from geodrake.excitation.problem import make_problem
from geodrake.logs import Motion
from geodrake.model import RobotModel


def measure(model: RobotModel, *, samples: int, modes: int, seed: int, repeats: int) -> Any:
    """Return CPU times, s, of one evaluation, and of its gradient by finite differences."""
    motion, bounds = family(modes), limits(model)
    options = DesignOptions(samples=samples, rest=False, quick=False)
    target = make_target(model, noise=NOISE)
    objective = Objective(target, Criterion())
    problem = make_problem(objective, bounds, motion, options)
    y = np.random.default_rng(seed).uniform(-0.2, 0.2, problem.scale.size)

    def value(y: np.ndarray) -> float:
        eigenvalues = objective.eigenvalues(Motion(*(problem.basis @ problem.coefficients(y))))
        return float(objective.criterion.objective(np.log(eigenvalues))[0])

    once = medians({"evaluation": lambda: problem.cost(y)}, repeats)["evaluation"]
    differences = cpu_time(lambda: [value(y + 1e-6 * unit) for unit in np.eye(len(y))])
    sizes = {"coefficients": len(y), "samples": samples}
    times = {"evaluation": once, "differences": differences, "ratio": differences / once}
    return sizes | times


def main() -> None:
    """Run the study from the command line."""
    parser = script_parser(__doc__)
    add_folder_option(parser, "with the iiwa")
    options = parser.parse_args()
    ours = options.quick or not (options.shared / IIWA).is_file()
    model = manipulator(None if ours else options.shared)
    sizes = {"samples": 100, "modes": 1} if options.quick else {"samples": 1000, "modes": 5}
    row = measure(model, **sizes, seed=options.seed, repeats=3 if options.quick else 10)
    tell(options, {"robot": "arm7" if ours else "iiwa", **row})


if __name__ == "__main__":
    main()
