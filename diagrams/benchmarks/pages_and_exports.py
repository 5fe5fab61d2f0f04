"""What a user's demo takes, and what simulators make of fitted models in all formats.

The demo runs in a process of its own, as a user starts it. The models are those of the demo and of
two public logs of a UR10e; simulators load their exports, which are compared with the models.

    python -m diagrams.benchmarks.pages_and_exports --json pages.json
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from importlib.resources import as_file, files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from diagrams.benchmarks.long_log import write_long_log
from diagrams.harness import MODELS, ONE_THREAD, cpu_time, script_parser, show, write
from diagrams.public_data import add_folder_option, require
from geodrake import load_model
from geodrake.control.export_proof import export_to
from geodrake.control.export_proof.formats import FORMATS
from geodrake.diagnosis import explain
from geodrake.logs import read_log

UR10E = ("reference/ur10e.urdf", "data/ur10e_free_a.csv", "data/ur10e_free_b.csv")


def demo_seconds(folder: Path) -> float:
    """Return the CPU time of `geodrake demo`, s, with its compiled code cached in the folder."""
    command = [sys.executable, "-m", "geodrake", "demo", "--quiet"]
    surroundings = {**os.environ, **ONE_THREAD, "NUMBA_CACHE_DIR": str(folder / "compiled")}
    how = {"cwd": folder, "env": surroundings, "stdout": subprocess.DEVNULL}
    return cpu_time(lambda: subprocess.run(command, check=True, **how))


def exported(
    folder: Path, model: Path, paths: Sequence[Path], formats: Sequence[str]
) -> dict[str, Any]:
    """Return, by format, how simulators and checks on logs reproduce a model of `explain`."""
    fitted, exports = explain(load_model(model), [read_log(path) for path in paths]).model, {}
    for name in formats:
        found = export_to(name, fitted, folder / name, paths)
        exports[name] = {
            "simulators": [
                {"name": d.engine, "what": d.what, "largest": d.largest, "of": d.typical}
                for d in found.proof.differences
            ],
            "lacks": [lost.effect for lost in found.lacks],
            "nrms": None if found.costs is None else [found.costs.whole, found.costs.held],
        }
    return exports


def show_robot(name: str, exports: dict[str, Any]) -> None:
    """Print one robot."""
    lines = [
        {"format": form, "nrms, file holds": " -> ".join(f"{x:.4f}" for x in each["nrms"] or ())}
        | {"simulator": f"{row['name']}, {row['what']}", "largest difference": row["largest"]}
        | {"of RMS": row["of"]}
        for form, each in exports.items()
        for row in each["simulators"]
    ]
    show(f"{name}: exports", lines)


def main() -> None:
    """Measure, print, and write what was asked for."""
    parser = script_parser(__doc__, "two joints, 8 s, one format")
    add_folder_option(parser)
    options = parser.parse_args()
    found: dict[str, Any] = {}
    formats = ("python",) if options.quick else tuple(FORMATS)
    with as_file(files("geodrake") / "demo") as demo, TemporaryDirectory() as name:
        folder = Path(name)
        if options.quick:
            model, log = MODELS / "double_pendulum.urdf", folder / "log.npz"
            write_long_log(log, model, samples=8000, seed=options.seed)
            robots = {"pendulum": (model, [log])}
        else:
            require(parser, options.shared, *UR10E)
            found["demo with compilation, CPU s"] = demo_seconds(folder)
            found["demo, CPU s"] = demo_seconds(folder)
            model, *logs = (options.shared.resolve() / path for path in UR10E)
            robots = {"demo": (demo / "demo.urdf", [demo / "demo.csv"]), "UR10e": (model, logs)}
        for robot, (model, logs) in robots.items():
            (folder / robot).mkdir()
            found[robot] = {"exports": exported(folder / robot, model, logs, formats)}
            show_robot(robot, found[robot]["exports"])
    write(options, found)


if __name__ == "__main__":
    main()
