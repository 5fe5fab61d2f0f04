"""How fast the regressor is, against Pinocchio's.

Both engines compute the same regressors of a seven-joint arm at the same samples on one core. Times
are CPU times, medians of repeats. `long_log.py` has the cost of a long log.

    python -m diagrams.benchmarks.regressor_speed --json speed.json
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from diagrams.harness import MODELS, medians, script_parser, tell
from geodrake.inertia import inertial_parameters
from geodrake.robot import KinematicTree, inverse_dynamics, inverse_dynamics_regressor
from geodrake.robot.plant import load_plant
from geodrake.robot.regressor import regressor_pieces

ARM = MODELS / "arm7.urdf"


def measure_speed(robot: Path, *, samples: int, repeats: int, seed: int) -> dict[str, Any]:
    """Return the times of both regressors on the same random samples of a robot, µs a sample.

    "regressor" reduces samples as logs are reduced, "at once" allocates one for all samples, and
    "difference" is the largest of an entry, relative to the largest entry.
    """
    plant = load_plant(robot).plant
    tree, phi = KinematicTree.from_plant(plant), inertial_parameters(plant)
    rng, shape = np.random.default_rng(seed), (samples, tree.num_velocities)
    motion = tuple(rng.uniform(-scale, scale, shape) for scale in (3.0, 2.0, 5.0))

    def pieces() -> None:
        for _ in regressor_pieces(tree, *motion):
            pass

    works = {
        "regressor": pieces,
        "at_once": lambda: inverse_dynamics_regressor(tree, *motion),
        "efforts": lambda: inverse_dynamics(tree, *motion, phi),
    }
    ours = {name: 1e6 * time / samples for name, time in medians(works, repeats).items()}
    try:
        import pinocchio
    except ImportError:
        return {"robot": robot.stem, **ours}
    model = pinocchio.buildModelFromUrdf(str(robot))
    data = model.createData()

    def loop() -> None:
        for q, v, vd in zip(*motion, strict=True):
            pinocchio.computeJointTorqueRegressor(model, data, q, v, vd)

    theirs = 1e6 * medians({"": loop}, repeats)[""] / samples
    n, first = tree.num_velocities, [x[0] for x in motion]
    expected = pinocchio.computeJointTorqueRegressor(model, data, *first).reshape(n, n, 10)
    own = inverse_dynamics_regressor(tree, *(x[:1] for x in motion)).reshape(n, n, 10)
    error = np.abs(own - expected[:, :, [0, 1, 2, 3, 4, 6, 9, 5, 8, 7]]).max()
    return {
        "robot": robot.stem,
        **ours,
        "pinocchio": theirs,
        "ratio": ours["regressor"] / theirs,
        "difference": float(error / np.abs(expected).max()),
    }


def main() -> None:
    """Measure, print, and write what was asked for."""
    options = script_parser(__doc__).parse_args()
    sizes = {"samples": 5_000, "repeats": 2} if options.quick else {"samples": 50_000, "repeats": 9}
    tell(options, {"speed": [measure_speed(ARM, **sizes, seed=options.seed)]})


if __name__ == "__main__":
    main()
