"""Runs of `geodrake fleet` that are killed, a worker or the whole run, and go on.

Two processes digest a fleet of Pinocchio's arms, once undisturbed and then many times with a kill
at a random moment: in every other run of a worker, which must be replaced, otherwise of the run
itself, which is then started again. Reported are whether the results are the same to the last
letter, and how many existing digests were made again.

    OMP_NUM_THREADS=1 python -m diagrams.benchmarks.fleet_kills --json fleet_kills.json
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from diagrams.benchmarks.simulated.fleet import TYPES, FleetDraw, write_fleet_file, write_logs
from diagrams.harness import positive_number, script_parser, show_values, write
from geodrake.fleet import digest_files

_POLL = 0.01  # s
WORKER, RUN = "a worker", "the run"


@dataclass(frozen=True)
class KilledRun:
    """Result of a run in which something was killed."""

    killed: str
    there: int  # digests that were there at that moment
    again: int  # how many digests were made that had been made before
    same: bool  # whether the results are those of the undisturbed run, letter by letter


@dataclass
class Digests:
    """The digests of a run, counted again and again."""

    folder: Path
    # File -> what changes if it is written again.
    seen: dict[str, tuple[int, int]] = field(default_factory=dict)
    again: int = 0

    def look(self) -> int:
        """Return their present number."""
        folders = self.folder.glob("*/digests")
        for path in (file for folder in folders for file in digest_files(folder)):
            stat = path.stat()
            now = stat.st_ino, stat.st_mtime_ns
            self.again += self.seen.setdefault(path.name, now) != now
            self.seen[path.name] = now
        return len(self.seen)


def begin(path: Path) -> subprocess.Popen[bytes]:
    """Start the command."""
    more = ("--workers", "2", "--json", str(path.parent / "fleet.json"), "-q")
    command = [sys.executable, "-m", "geodrake", "fleet", str(path), *more]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL)


def follow(
    run: subprocess.Popen[bytes], digests: Digests, kill: Callable[[int], bool] | None = None
) -> None:
    """Count digests until a run ends; call `kill` with their number until it returns true.

    Raises:
        SystemExit: The run failed on its own.
    """
    while run.poll() is None:
        there = digests.look()
        if kill is not None and kill(there):
            kill = None
        time.sleep(_POLL)
    digests.look()
    if run.returncode not in (0, -signal.SIGKILL):
        sys.exit(f"The run ended with exit code {run.returncode}.")


def killed_run(path: Path, expected: bytes, what: str, after: int) -> KilledRun:
    """Return the result of one run in which something is killed, continued to its end."""
    shutil.rmtree(path.parent / "results", ignore_errors=True)
    (path.parent / "fleet.json").unlink(missing_ok=True)
    digests, at = Digests(path.parent / "results"), []
    run = begin(path)

    def kill(there: int) -> bool:
        if there < after:
            return False
        try:
            processes = [psutil.Process(run.pid)]
            if what == WORKER:
                children = processes[0].children(recursive=True)
                processes = [p for p in children if any("spawn_main" in w for w in p.cmdline())]
            if not processes:
                return False
            processes[-1].kill()
        except psutil.NoSuchProcess:  # it ended meanwhile
            return False
        at.append(there)
        return True

    follow(run, digests, kill)
    if what == RUN:
        follow(begin(path), digests)
    found = (path.parent / "fleet.json").read_bytes()
    return KilledRun(what, at[0] if at else -1, digests.again, found == expected)


def main() -> None:
    """Run from the command line."""
    parser = script_parser(__doc__, "two runs of few logs")
    parser.add_argument("--runs", type=positive_number, default=20, help="(%(default)s)")
    options = parser.parse_args()
    robots, days = (2, 3) if options.quick else (6, 12)
    runs = 2 if options.quick else options.runs
    draws = [FleetDraw(TYPES[0], k, options.seed, days=days, duration=8.0) for k in range(robots)]
    rng, rows = np.random.default_rng([options.seed, 20]), []
    with tempfile.TemporaryDirectory() as folder:
        for draw in draws:
            write_logs(draw, Path(folder))
        path = write_fleet_file(Path(folder), draws)
        follow(begin(path), Digests(Path(folder) / "results"))
        expected = (Path(folder) / "fleet.json").read_bytes()
        for k in range(runs):
            after = int(rng.integers(1, robots * days))
            what = (WORKER, RUN)[k % 2]
            row = killed_run(path, expected, what, after)
            while row.there < 0 and after > 1:  # it was over before: once more, and sooner
                after //= 2
                row = killed_run(path, expected, what, after)
            rows.append(row)
    table = {
        "logs": robots * days,
        "runs": runs,
        "nothing killed": sum(row.there < 0 for row in rows),
        "the same results": sum(row.same for row in rows),
        "digests made again": sum(row.again for row in rows),
    }
    show_values("Runs that are killed", table)
    write(options, {"summary": table, "rows": rows})


if __name__ == "__main__":
    main()
