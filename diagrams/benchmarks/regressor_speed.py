"""How fast the regressor is, against Pinocchio's.

Both engines compute the same regressors of an arm of seven joints, and of a tree of thirty, at the
same samples, on one core: times are CPU times, medians of repeats. What a long log costs
is in `long_log.py`.

    python -m diagrams.benchmarks.regressor_speed --json speed.json
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from diagrams.harness import MODELS, bars, medians, script_parser, tell
from geodrake.inertia import inertial_parameters
from geodrake.robot import KinematicTree, inverse_dynamics, inverse_dynamics_regressor, load_plant
from geodrake.robot.regressor import regressor_pieces

ARM = MODELS / "arm7.urdf"


def measure_speed(robot: Path, *, samples: int, repeats: int, seed: int) -> dict[str, Any]:
    """Return the time both regressors on the same random samples of a robot, µs a sample.

    "regressor" is that of logs as they are reduced, "at once" that of all samples in new memory,
    and "difference" that of an entry at most, relative to the largest.
    """
    plant = load_plant(robot).plant
    tree, phi = KinematicTree.from_plant(plant), inertial_parameters(plant)
    motion = random_motion(np.random.default_rng(seed), samples, tree.num_velocities)

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


def write_tree(folder: Path, *, limbs: int = 5, joints: int = 6, seed: int = 0) -> Path:
    """Return a robot of several limbs that hang on one body, as a URDF file."""
    rng = np.random.default_rng(seed)

    def text(x: np.ndarray) -> str:
        return " ".join(f"{value:.4f}" for value in x)

    parts = ['<robot name="tree"><link name="base"/>']
    for limb in range(limbs):
        parent = "link_0_0" if limb else "base"
        for joint in range(joints):
            name = f"{limb}_{joint}"
            xyz, rpy = rng.uniform(-0.3, 0.3, 3), rng.uniform(-2.0, 2.0, 3)
            axis = "xyz".index(rng.choice([*"xyz"]))
            parts.append(
                f'<link name="link_{name}"><inertial><origin xyz="{text(0.2 * xyz)}"/>'
                f'<mass value="{rng.uniform(1.0, 3.0):.3f}"/>'
                '<inertia ixx="0.03" iyy="0.02" izz="0.025" ixy="0.002" iyz="0" ixz="0.001"/>'
                f'</inertial></link><joint name="joint_{name}" type="revolute">'
                f'<origin xyz="{text(xyz)}" rpy="{text(rpy)}"/><parent link="{parent}"/>'
                f'<child link="link_{name}"/><axis xyz="{text(np.eye(3)[axis])}"/>'
                '<limit lower="-3" upper="3" effort="100" velocity="3"/></joint>'
            )
            parent = f"link_{name}"
    path = folder / "tree.urdf"
    path.write_text("\n".join([*parts, "</robot>"]), encoding="utf-8")
    return path


def random_motion(rng: np.random.Generator, samples: int, joints: int) -> tuple[np.ndarray, ...]:
    """Return positions, velocities and accelerations (samples, joints) of a lively arm."""
    return tuple(rng.uniform(-scale, scale, (samples, joints)) for scale in (3.0, 2.0, 5.0))


def main() -> None:
    """Measure, print, and write what was asked for."""
    options = script_parser(__doc__).parse_args()
    repeats, part = (2, 10) if options.quick else (9, 1)
    with TemporaryDirectory() as folder:
        robots = {ARM: 50_000, write_tree(Path(folder), seed=options.seed): 5_000}
        speeds = [
            measure_speed(robot, samples=count // part, repeats=repeats, seed=options.seed)
            for robot, count in robots.items()
        ]
    panels = {
        f"{speed['robot']}, one core": {
            name: speed[name] for name in ("efforts", "regressor", "pinocchio") if name in speed
        }
        for speed in speeds
    }
    tell(options, {"speed": speeds}, regressor_speed=lambda: bars(panels, "µs"))


if __name__ == "__main__":
    main()
