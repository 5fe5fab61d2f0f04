"""Public measurements and models of real robots that some studies read.

They belong to others and are not part of the project. A folder, the one that GEODRAKE_MEASUREMENTS
names or `shared` beside the checkout, has them as `data` (logs, in geodrake's own format) and
`reference` (model files).
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

FOLDER = Path(os.environ.get("GEODRAKE_MEASUREMENTS", Path(__file__).parents[2] / "shared"))

_UR10E = (
    "six joints as in ur10e.urdf, position, velocity and effort at some 100 Hz; effort is motor "
    "current times drive gain"
)
_ABOUT: Mapping[str, str] = {
    "data/ur10e_free_a.csv": f"Universal Robots UR10e, no payload, an exciting motion ({_UR10E})",
    "data/ur10e_free_b.csv": "the same arm, another exciting motion",
    "data/ur10e_free_c.csv": "the same arm, a third exciting motion",
    "data/ur10e_changed.csv": "the motion of ur10e_free_c with something at the wrist",
    "data/ur10e_ptp.csv": "the same arm from point to point",
    "data/tx40.csv": "Staubli TX40, six joints as in tx40.urdf, position and effort at 5 kHz, "
    "mapped from motors to joints with the coupling of the wrist",
    "data/double_pendulum_c1_*.csv": "double pendulum of the design C.1, four runs at some 500 Hz, "
    "from the repository dfki-ric-underactuated-lab/double_pendulum on GitHub, where they are "
    "under data/system_identification",
    "data/human_force_plate.npz": "a human on a force plate ([Lee2019] section 3.6.3): arrays A "
    "(990, 160), b (990,), sigma (3,), phi_prior (16, 10), Q (16, 4, 4) and X_WB (16, 4, 4)",
    "data/so101/*.csv": "SO-101, six hobby servos, raw commands and positions at 50 Hz of the SAGE "
    "recordings, five motions of two minutes",
    "data/xl330/*.csv": "Dynamixel XL330 that swings a weight, of bam's recordings",
    "reference/so101.urdf": "the arm's description, in TheRobotStudio/SO-ARM100",
    "reference/ur10e.urdf": "the maker's description of the arm, in ROS's ur_description",
    "reference/tx40.urdf": "a description of the arm with the joints of the log",
}


def installed_model(path: str) -> Path:
    """Return the path of a model file of `example-robot-data`, if it is installed."""
    folder = Path("example-robot-data") / "robots"
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        return folder / path
    return Path(str(package.locate_file(Path("cmeel.prefix/share") / folder / path)))


def add_folder_option(parser: argparse.ArgumentParser, what: str = "of the measurements") -> None:
    """Add `--shared`, the folder of the public measurements and models."""
    parser.add_argument("--shared", type=Path, default=FOLDER, help=f"folder {what}")


def require(parser: argparse.ArgumentParser, folder: Path, *names: str) -> None:
    """End a script with a message if files or patterns below a folder are missing."""
    absent = [name for name in names if not any(folder.glob(name))]
    if not absent:
        return
    lines = [f"There are no measurements in {folder}: it lacks"]
    lines += [f"  {name}: {_ABOUT[name]}" for name in absent]
    lines += [
        "They are public, belong to others and are no part of geodrake. Logs are CSV files in SI",
        "units with the header time,<joint>.position[,<joint>.velocity],<joint>.effort. Put them",
        "where they are missed, or name another folder with --shared or GEODRAKE_MEASUREMENTS.",
    ]
    parser.exit(2, "\n".join(lines) + "\n")
