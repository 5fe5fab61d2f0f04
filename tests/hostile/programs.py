"""Random fits that are as ill-conditioned as can be, each in a process of its own: none may die.

    python tests/hostile/programs.py --programs 2000 --seed 0 --json programs.json

Every program ends in a physical answer or in a `GeodrakeError`, in time. The table counts what
became of them, for each solver that was asked for.
"""

import argparse
import json
import os
import pickle
import resource
import select
import signal
import sys
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from hostile import PATIENCE, limit_own_time
from rich.console import Console
from rich.progress import track

from geodrake.errors import GeodrakeError
from geodrake.identification import PointMasses, PointMassEuclidean, PointMassKL, identify
from geodrake.inertia import (
    from_mass_com_inertia,
    is_physical,
    pseudo_inertia,
)

SECONDS = 90  # of the processor, for a program: four calls of a conic solver with 20 s each
SOLVERS = (None, "newton", "clarabel", "scs", "csdp")
SHARES = (0.4, 0.18, 0.3, 0.1, 0.02)
REGULARIZERS = ("euclidean", "pullback", "entropic", "riemannian", "masses_l2", "masses_kl")
DATA = ("plain", "rank-deficient", "columns 1e±12", "zero columns", "near-copies", "few rows")
REGIONS = ("none", "around", "touching", "tiny", "huge", "flat", "far")
CHANCES = (0.4, 0.2, 0.15, 0.1, 0.05, 0.05, 0.05)


@dataclass(frozen=True)
class Program:
    """One fit: what `identify` takes, and what kind it is.

    Attributes:
        number: Which it is, of its seed.
        kinds: What is odd about it, in words.
        solver: Solver that is asked for.
        arguments: A, b and the prior.
        options: What else `identify` takes.
    """

    number: int
    kinds: tuple[str, ...]
    solver: str | None
    arguments: tuple = field(repr=False)
    options: dict = field(repr=False)


@dataclass(frozen=True)
class Outcome:
    """What became of a program.

    Attributes:
        end: "solved", "refused", "unphysical", "raised", "died" or "hung".
        words: Which error or signal, or which solver gave the answer.
        seconds: Time it took.
    """

    end: str
    words: str
    seconds: float
    program: Program | None = None


def random_bodies(random, count):
    """(count, 10) physical bodies, from milligrams to thousands of tonnes, some nearly flat."""
    masses = 10.0 ** random.uniform(-6.0, 6.0, count)
    if random.random() < 0.5:  # of one size, as in a robot
        masses = masses[0] * 10.0 ** random.uniform(-1.0, 1.0, count)
    bodies = []
    for mass in masses:
        size = 10.0 ** random.uniform(-3.0, 1.0)
        axes = size * 10.0 ** (-random.uniform(0.0, 5.0, 3) * (random.random(3) < 0.3))
        turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
        spread = (turn * axes**2) @ turn.T / 5.0
        inertia = mass * (np.trace(spread) * np.eye(3) - spread)
        bodies.append(from_mass_com_inertia(mass, size * random.normal(size=3), inertia))
    return np.array(bodies)


def random_regressor(random, kind, count, extra):
    """(m, 10 count + extra) regressor of a kind of `DATA`."""
    p = 10 * count + extra
    rows = int(random.integers(1, 8)) if kind == "few rows" else int(random.integers(p // 2, 3 * p))
    A = random.normal(size=(rows, p))
    if kind == "rank-deficient":
        rank = int(random.integers(1, max(2, min(A.shape))))
        A = random.normal(size=(rows, rank)) @ random.normal(size=(rank, p))
    elif kind == "columns 1e±12":
        A *= 10.0 ** random.uniform(-12.0, 12.0, p)
    elif kind == "zero columns":
        A[:, random.random(p) < 0.5] = 0.0
    elif kind == "near-copies":
        A[:, 1:] = A[:, :1] + 10.0 ** random.uniform(-15.0, -5.0) * A[:, 1:]
    return A * 10.0 ** random.choice([0.0, random.uniform(-9.0, 9.0)])


def random_regions(random, kind, prior):
    """(n, 4, 4) ellipsoids of a kind of `REGIONS` for a prior."""
    if kind == "none":
        return None
    Q = []
    for P in pseudo_inertia(prior):
        mean = P[:3, 3] / P[3, 3]
        spread = P[:3, :3] / P[3, 3] - np.outer(mean, mean)
        scale = {"around": 5.0 * 10.0 ** random.uniform(0.0, 2.0), "touching": 3.0 + 1e-12}
        scale |= {"tiny": 3.0 * 10.0 ** random.uniform(-8.0, 0.0), "huge": 3e10, "flat": 6.0}
        shape = np.linalg.inv(spread) / scale.get(kind, 5.0)
        if kind == "flat":
            turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
            shape += np.outer(turn[0], turn[0]) * np.trace(shape) * 10.0 ** random.uniform(-3, 8)
        center = mean + (1e3 * random.normal(size=3) if kind == "far" else 0.0)
        region = np.zeros((4, 4))
        region[:3, :3], region[:3, 3] = -shape, shape @ center
        region[3, :3], region[3, 3] = region[:3, 3], 1.0 - center @ shape @ center
        Q.append(region * 10.0 ** random.choice([0.0, random.uniform(-8.0, 8.0)]))
    return np.array(Q)


def random_program(seed, number):
    """A program of a seed and a number; the same in every process."""
    random = np.random.default_rng([seed, number])
    count, extra = int(random.integers(1, 6)), int(random.integers(0, 4) * random.integers(0, 2))
    prior = random_bodies(random, count)
    data, region = str(random.choice(DATA)), str(random.choice(REGIONS, p=CHANCES))
    A = random_regressor(random, data, count, extra)
    truth = (
        random_bodies(random, count)
        if random.random() < 0.2
        else prior * random.uniform(0.3, 3.0, (count, 1))
    )
    b = A @ np.append(truth.ravel(), random.normal(size=extra))
    b = b + 10.0 ** random.uniform(-12.0, 1.0) * (np.abs(b).max() + 1e-300) * random.normal(
        size=len(b)
    )
    options = {"ellipsoids": random_regions(random, region, prior)}
    regularizer = str(random.choice(REGULARIZERS, p=[0.2, 0.3, 0.2, 0.15, 0.075, 0.075]))
    kinds = [regularizer, data, region]
    if random.random() < 0.3:
        options["total_mass"] = prior[:, 0].sum() * random.choice([1.0, 1.1, 1e-6, 1e6])
        kinds.append("total mass")
    if regularizer.startswith("masses"):
        points = PointMasses.of_bodies(prior, 12)
        make = PointMassKL if regularizer == "masses_kl" else PointMassEuclidean
        options["regularizer"], prior = make(points), points.parameters()
    else:
        options["regularizer"] = regularizer
    if random.random() < 0.25:
        least = np.linalg.lstsq(A, b)[0]
        floor = float(np.square(A @ least - b).sum())
        top = float(np.square(A @ np.append(prior.ravel(), np.zeros(extra)) - b).sum())
        options["residual_bound"] = floor + 10.0 ** random.uniform(-9.0, 1.0) * (top - floor) or 1.0
        kinds.append("bound")
    else:
        options["gamma"] = 10.0 ** random.uniform(-12.0, 12.0)
        kinds.append("gamma")
    solver = SOLVERS[random.choice(len(SOLVERS), p=SHARES)]
    if regularizer.startswith("masses") and solver == "newton":
        solver = None
    return Program(number, tuple(kinds), solver, (A, b, prior), options)


def solve(program):
    """The outcome of a program, in this process."""
    begin = time.perf_counter()
    try:
        result = identify(*program.arguments, **program.options, solver=program.solver)
    except GeodrakeError as error:
        words = f"{type(error).__name__}: {error.problem}"
        return Outcome("refused", words, time.perf_counter() - begin)
    except BaseException as error:  # whatever it is, it is counted
        return Outcome("raised", repr(error), time.perf_counter() - begin)
    seconds = time.perf_counter() - begin
    numbers = np.concatenate([result.phi.ravel(), result.extra, [result.residual]])
    if not (np.isfinite(numbers).all() and np.all(is_physical(result.phi))):
        return Outcome("unphysical", result.solver, seconds)
    return Outcome("solved", result.solver, seconds)


def apart(task, seconds):
    """What a function without arguments returns in a process of its own; its signal if it dies.

    It is "hung" after so many seconds of the processor, or after `PATIENCE` by the clock.
    """
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reader)
            limit_own_time(seconds)
            silence = os.open(os.devnull, os.O_WRONLY)
            for stream in (1, 2):
                os.dup2(silence, stream)
            with os.fdopen(writer, "wb") as stream:
                pickle.dump(task(), stream)
        finally:
            os._exit(0)
    os.close(writer)
    parts, end = [], time.monotonic() + PATIENCE
    with os.fdopen(reader, "rb") as stream:
        while ready := select.select([stream], [], [], max(0.0, end - time.monotonic()))[0]:
            parts.append(os.read(stream.fileno(), 1 << 16))
            if not parts[-1]:
                break
        if not ready:
            os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    died = os.WTERMSIG(status) if os.WIFSIGNALED(status) else None
    if not ready or died == signal.SIGXCPU:
        return "hung"
    if died is not None:
        return signal.Signals(died).name
    return pickle.loads(b"".join(parts)) if any(parts) else "nothing"


def run(seed, number):
    """The outcome of one program in a process of its own."""
    program, begin = random_program(seed, number), time.perf_counter()
    outcome = apart(lambda: solve(program), SECONDS)
    if isinstance(outcome, str):
        end = "hung" if outcome == "hung" else "died"
        outcome = Outcome(end, outcome, time.perf_counter() - begin)
    return replace(outcome, program=program)


def table(outcomes):
    """Counts of what became of the programs, a row for each solver that was asked for."""
    rows = {}
    for outcome in outcomes:
        rows.setdefault(outcome.program.solver or "default", Counter())[outcome.end] += 1
    return rows


def main():
    """Run the programs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--programs", type=int, default=2000, help="how many")
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quick", action="store_true", help="40 programs")
    parser.add_argument("--json", type=Path, help="file for the outcomes")
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    numbers = range(options.first, options.first + (40 if options.quick else options.programs))
    outcomes = [
        run(options.seed, number) for number in track(numbers, console=Console(stderr=True))
    ]
    for solver, row in sorted(table(outcomes).items()):
        print(f"{solver:10} {row.total():5} programs: {dict(row)}")
    odd = [outcome for outcome in outcomes if outcome.end not in ("solved", "refused")]
    print(*odd, sep="\n")
    if options.json:
        kept = ("number", "kinds", "solver", "end", "words", "seconds")
        every = (vars(outcome.program) | vars(outcome) for outcome in outcomes)
        listed = [{name: each[name] for name in kept} for each in every]
        told = {"seed": options.seed, "table": table(outcomes), "programs": listed}
        options.json.write_text(json.dumps(told, indent=1), encoding="utf-8")
    return int(bool(odd))


if __name__ == "__main__":
    sys.exit(main())
