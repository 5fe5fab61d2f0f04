"""How much time and memory a long log takes, from its file to the comparison and the diagnosis.

`geodrake` reads an NPZ log of the seven-joint arm in a process of its own, whose peak memory is
reported; the raw numbers alone take 120 bytes a sample. CSV and Parquet files are only read.

    python -m diagrams.benchmarks.long_log --samples 10000000 --json long_log.json
"""

from __future__ import annotations

import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from pyarrow import csv, parquet
from rich.progress import track

from diagrams.harness import MODELS, peak_memory, script_parser, sines, tell
from geodrake.logs import Motion
from geodrake.model import RobotModel, load_model

PERIOD = 1e-3  # s
CHUNK = 20_000
NOISE = 0.1  # N·m
FRICTION = 2.0  # N·m, dry, at every joint

_WORK = """
import sys, time
from geodrake import diagnosis
from geodrake.model import load_model
work, model, log = sys.argv[1:]
begin = time.process_time()
getattr(diagnosis, work)(load_model(model), [log])
print(time.process_time() - begin)
"""
_READING = """
import sys, time
from geodrake.logs import read_log
begin = time.process_time()
read_log(sys.argv[1])
print(time.process_time() - begin)
"""
FORMATS = ("csv", "parquet")


def write_long_log(path: Path, robot: Path, *, samples: int, seed: int) -> None:
    """Write the log array by array, with one column in memory at most."""
    model = load_model(robot)
    joints = len(model.joints)
    rng = np.random.default_rng(seed)
    waves = rng.uniform(0.2, 1.0, (3, joints)), rng.uniform(0.5, 4.0, (3, joints))
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
            table = np.column_stack([time, *_measured(model, time, waves, rng)])
            for array, numbers in zip(arrays, table.T, strict=True):
                array[rows] = numbers
        with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
            for k, (name, array) in enumerate(zip(columns, arrays, strict=True)):
                array.flush()
                archive.write(Path(folder) / f"{k}.npy", f"{name}.npy")


def _measured(
    model: RobotModel,
    time: np.ndarray,
    waves: tuple[np.ndarray, np.ndarray],
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and efforts (N, n) of sums of sines, with noise and dry friction."""
    q, v, vd = sines(time, *waves)
    effort = model.effort(Motion(model.positions(q), v, vd)) + FRICTION * np.sign(v)
    return q + rng.normal(0.0, 1e-5, q.shape), effort + rng.normal(0.0, NOISE, q.shape)


def measure(work: str, robot: Path, path: Path, samples: int) -> dict[str, Any]:
    """Run a command of the library on the log in its own process; sizes are in GB."""
    peak, (seconds,) = peak_memory(_WORK, work, robot, path)
    raw = 8e-9 * samples * (1 + 2 * len(load_model(robot).joints))
    sizes = {"samples": samples, "raw": raw, "peak_memory": peak / 1e9}
    return {"work": work, **sizes, "seconds": float(seconds)}


def measure_reading(form: str, path: Path, samples: int) -> dict[str, Any]:
    """Write the log in another format and read it in its own process; sizes are in GB."""
    table = pyarrow.table(dict(np.load(path)))
    other = path.with_suffix(f".{form}")
    (csv.write_csv if form == "csv" else parquet.write_table)(table, other)
    size = other.stat().st_size / 1e9
    peak, (seconds,) = peak_memory(_READING, other)
    other.unlink()
    sizes = {"samples": samples, "raw": table.nbytes / 1e9, "peak_memory": peak / 1e9}
    return {"work": f"read {form}", **sizes, "file": size, "seconds": float(seconds)}


def main() -> None:
    """Measure, print and write."""
    parser = script_parser(__doc__, "a short log of two joints")
    parser.add_argument("--samples", type=int, help="length of the log")
    works = ["compare", "diagnose", *FORMATS]
    parser.add_argument("--work", nargs="+", default=works, choices=works, help="what to run")
    options = parser.parse_args()
    robot = MODELS / ("double_pendulum.urdf" if options.quick else "arm7.urdf")
    samples = options.samples or (20_000 if options.quick else 1_000_000)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.npz"
        write_long_log(path, robot, samples=samples, seed=options.seed)
        costs = [
            measure_reading(work, path, samples)
            if work in FORMATS
            else measure(work, robot, path, samples)
            for work in options.work
        ]
    tell(options, costs)


if __name__ == "__main__":
    main()
