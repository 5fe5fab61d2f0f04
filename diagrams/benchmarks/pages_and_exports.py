"""What the commands of a user take and give: CPU time, sizes of pages, exports.

Each command runs in a process of its own, as a user starts it, on the demo and on two public logs
of a UR10e. The fitted models are exported to all formats, and what simulators make of them is
compared with the model.

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
from diagrams.harness import MODELS, ONE_THREAD, cpu_time, script_parser, show, show_values, write
from diagrams.public_data import add_folder_option, require
from geodrake import load_model
from geodrake.control.export_proof import export_to
from geodrake.control.export_proof.formats import FORMATS

UR10E = ("reference/ur10e.urdf", "data/ur10e_free_a.csv", "data/ur10e_free_b.csv")


def cpu_seconds(folder: Path, *words: str | Path) -> float:
    """Return the CPU time of a command of `geodrake`, s."""
    command = [sys.executable, "-m", "geodrake", *map(str, words), "--quiet"]
    how = {"cwd": folder, "env": {**os.environ, **ONE_THREAD}, "stdout": subprocess.DEVNULL}
    return cpu_time(lambda: subprocess.run(command, check=True, **how))


def measured(
    folder: Path, model: Path, logs: Sequence[Path], formats: Sequence[str], seconds: float
) -> dict[str, Any]:
    """Return times, pages, a replay of some seconds, and exports of what `explain` saves."""
    page, saved = folder / "page.html", folder / "robot.yaml"
    explain = cpu_seconds(folder, "explain", model, *logs, "--report", page, "--save", saved)
    replay = ("--out", folder / "play.html", "--seconds", str(seconds))
    play = cpu_seconds(folder, "play", saved, *logs, *replay)
    fitted, exports = load_model(saved), {}
    for name in formats:
        found = export_to(name, fitted, folder / name, logs)
        exports[name] = {
            "simulators": [
                {"name": d.engine, "what": d.what, "largest": d.largest, "of": d.typical}
                for d in found.proof.differences
            ],
            "lacks": [lost.effect for lost in found.lacks],
            "nrms": None if found.costs is None else [found.costs.whole, found.costs.held],
        }
    return {
        "explain, CPU s": explain,
        "page, bytes": page.stat().st_size,
        "play, CPU s": play,
        "play, bytes": (folder / "play.html").stat().st_size,
        "exports": exports,
    }


def show_robot(name: str, found: dict[str, Any]) -> None:
    """Print one robot."""
    show_values(name, {key: value for key, value in found.items() if key != "exports"})
    lines = [
        {"format": form, "nrms, file holds": " -> ".join(f"{x:.4f}" for x in each["nrms"] or ())}
        | {"simulator": f"{row['name']}, {row['what']}", "largest difference": row["largest"]}
        | {"of RMS": row["of"]}
        for form, each in found["exports"].items()
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
    seconds = 2.0 if options.quick else 30.0  # of replays
    with as_file(files("geodrake") / "demo") as demo, TemporaryDirectory() as name:
        folder = Path(name)
        if options.quick:
            model, log = MODELS / "double_pendulum.urdf", folder / "log.npz"
            write_long_log(log, model, samples=8000, seed=options.seed)
            robots = {"pendulum": (model, [log])}
        else:
            require(parser, options.shared, *UR10E)
            cpu_seconds(folder, "demo")  # compiles, if that was not done yet
            found["demo, CPU s"] = cpu_seconds(folder, "demo")
            model, *logs = (options.shared.resolve() / path for path in UR10E)
            robots = {"demo": (demo / "demo.urdf", [demo / "demo.csv"]), "UR10e": (model, logs)}
        for robot, (model, logs) in robots.items():
            (folder / robot).mkdir()
            found[robot] = measured(folder / robot, model, logs, formats, seconds)
            show_robot(robot, found[robot])
    write(options, found)


if __name__ == "__main__":
    main()
