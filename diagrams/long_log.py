"""How much memory a long log takes, from its file to the comparison and the diagnosis.

A log of the seven-joint arm is written to an NPZ file, and `geodrake` reads it in a process of its
own, whose largest memory is what counts. The raw numbers alone are 120 bytes a sample.

    python diagrams/long_log.py --samples 10000000 --json long_log.json --figures figures
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.progress import track

from geodrake.logs import Motion
from geodrake.model import RobotModel, load_model
from geodrake.report import style

MODELS = Path(__file__).parents[1] / "models"
PERIOD = 1e-3  # s
CHUNK = 20_000
NOISE = 0.1  # N·m
FRICTION = 2.0  # N·m, dry, at every joint

_CHILD = """
import resource, sys, time
from pathlib import Path
from geodrake import diagnosis
from geodrake.model import load_model
work, model, log = sys.argv[1:]
begin = time.process_time()
getattr(diagnosis, work)(load_model(model), [log])
seconds = time.process_time() - begin
status = Path("/proc/self/status")
if status.exists():
    # Linux hands a parent's ru_maxrss on to its children, but not its VmHWM.
    lines = status.read_text(encoding="utf-8").splitlines()
    peak = next(float(line.split()[1]) for line in lines if line.startswith("VmHWM"))
else:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(peak * 1024 / 1e9, seconds)
"""


@dataclass(frozen=True)
class Cost:
    """What a log took.

    Attributes:
        work: "compare" or "diagnose".
        samples: Length of the log.
        raw: Size of its numbers, GB.
        peak_memory: Largest memory of the process, with Python and Drake in it, GB.
        seconds: CPU time, s.
    """

    work: str
    samples: int
    raw: float
    peak_memory: float
    seconds: float


def write_long_log(path: Path, robot: Path, *, samples: int, seed: int) -> None:
    """Writes the log array by array, with no more than a column in memory."""
    model = load_model(robot)
    joints = len(model.joints)
    rng = np.random.default_rng(seed)
    sines = rng.uniform(0.2, 1.0, (3, joints)), rng.uniform(0.5, 4.0, (3, joints))
    columns = [
        "time",
        *(f"{joint}.{kind}" for kind in ("position", "effort") for joint in model.joints),
    ]
    with tempfile.TemporaryDirectory() as folder:
        arrays = [
            np.lib.format.open_memmap(Path(folder) / f"{k}.npy", "w+", float, (samples,))
            for k in range(len(columns))
        ]
        for first in track(range(0, samples, CHUNK), description="writing"):
            rows = slice(first, min(first + CHUNK, samples))
            time = PERIOD * np.arange(rows.start, rows.stop)
            table = np.column_stack([time, *_measured(model, time, sines, rng)])
            for array, numbers in zip(arrays, table.T, strict=True):
                array[rows] = numbers
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
            for k, (name, array) in enumerate(zip(columns, arrays, strict=True)):
                array.flush()
                archive.write(Path(folder) / f"{k}.npy", f"{name}.npy")


def _measured(
    model: RobotModel,
    time: np.ndarray,
    sines: tuple[np.ndarray, np.ndarray],
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and efforts (N, n) of sums of sines, with noise and dry friction."""
    amplitude, rate = sines
    phase = time[:, None, None] * rate
    q = (amplitude * np.sin(phase)).sum(1)
    v = (amplitude * rate * np.cos(phase)).sum(1)
    vd = -(amplitude * rate**2 * np.sin(phase)).sum(1)
    effort = model.effort(Motion(model.positions(q), v, vd)) + FRICTION * np.sign(v)
    return q + rng.normal(0.0, 1e-5, q.shape), effort + rng.normal(0.0, NOISE, q.shape)


def measure(work: str, robot: Path, path: Path, samples: int) -> Cost:
    """Runs a command of the library on the log in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", _CHILD, work, str(robot), str(path)],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
    memory, seconds = map(float, done.stdout.split())
    raw = 8e-9 * samples * (1 + 2 * len(load_model(robot).joints))
    return Cost(work, samples, raw, memory, seconds)


def memory_figure(costs: Sequence[Cost]) -> Figure:
    """Largest memory of each command, beside that of the raw numbers."""
    figure = style.new_figure(0.9 + 0.5 * len(costs))
    ax = style.polish(figure.subplots(), grid="x")
    labels = ["raw numbers", *(cost.work for cost in costs)]
    sizes = [costs[0].raw, *(cost.peak_memory for cost in costs)]
    bars = ax.barh(labels, sizes, color=[style.MEASURED, *[style.AFTER] * len(costs)], height=0.6)
    ax.bar_label(bars, [f"{size:.3g} GB" for size in sizes], padding=4, **style.plain())
    ax.invert_yaxis()
    ax.margins(x=0.15)
    title = f"Largest memory for a log of {costs[0].samples:,} samples, with Python and Drake"
    ax.set_title(title, loc="left", **style.plain(fontweight="bold"))
    return figure


def main() -> None:
    """Measures, prints, and writes what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a short log of two joints")
    parser.add_argument("--seed", type=int, default=0, help="of the motion and the noise")
    parser.add_argument("--samples", type=int, help="length of the log")
    parser.add_argument("--work", nargs="+", default=["compare", "diagnose"], help="what to run")
    parser.add_argument("--json", type=Path, help="file for the numbers")
    parser.add_argument("--figures", type=Path, help="folder for the figure")
    options = parser.parse_args()
    robot = MODELS / ("double_pendulum.urdf" if options.quick else "arm7.urdf")
    samples = options.samples or (20_000 if options.quick else 1_000_000)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.npz"
        write_long_log(path, robot, samples=samples, seed=options.seed)
        costs = [measure(work, robot, path, samples) for work in options.work]
    table = [asdict(cost) for cost in costs]
    print(json.dumps(table, indent=2))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(table, indent=2) + "\n")
    if options.figures:
        options.figures.mkdir(parents=True, exist_ok=True)
        memory_figure(costs).savefig(options.figures / "long_log_memory.png")


if __name__ == "__main__":
    main()
