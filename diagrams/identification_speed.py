"""How fast identification is: Newton's method, Drake's conic programs, and the same in CVXPY.

Two fits, as in [Lee2019] §3.6: an arm of ten bodies with seven motors, from 4,100 samples of all
torques (107 parameters, made here), and a human of sixteen bodies in bounding ellipsoids (measured,
990 rows). Times are CPU times, medians of repeats, of everything from regressors to result unless
said otherwise. Peak memory is that of a process of its own. Geodesic least squares is tried on the
arm's first samples, beside the entropic fit at the same residual.

    OMP_NUM_THREADS=1 python diagrams/identification_speed.py --json speed.json --figures figures
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from fit_cases.cases import NOISE, Case, arm_case, human_case
from fit_cases.in_cvxpy import cost, cvxpy_solution, has_cvxpy
from public_data import add_folder_option
from rich.progress import track

from geodrake.identification import geodesic_least_squares, identify, solve_fit
from geodrake.identification.newton import solve_newton
from geodrake.inertia import pseudo_inertia
from geodrake.inertia.positive_definite import distance


def whole_times(case: Case, repeats: int) -> dict[str, float]:
    """CPU seconds from regressors to result."""
    methods = {
        "pullback, Clarabel": ("pullback", "clarabel"),
        "entropic, Clarabel": ("entropic", "clarabel"),
        "entropic, Newton": ("entropic", "newton"),
    }
    work = {name: lambda m=method: case.identified(*m) for name, method in methods.items()}
    return cpu_times(work, repeats)


def solver_ratios(case: Case, *, repeats: int) -> dict[str, Any]:
    """Newton against Drake's program and CVXPY's on the same triangular factor, one cold solve."""
    problem = case.problem(case.gamma)
    solutions: dict[str, np.ndarray] = {}

    def keep(name: str, x: np.ndarray) -> None:
        solutions[name] = x

    methods: dict[str, Callable[[], None]] = {
        "newton": lambda: keep("newton", solve_newton(problem).x),
        "drake": lambda: keep("drake", solve_fit(problem).x),
    }
    if has_cvxpy():
        methods["cvxpy"] = lambda: keep("cvxpy", cvxpy_solution(problem))
    times = cpu_times(methods, repeats)
    least = cost(problem, solutions["newton"])
    table: dict[str, Any] = {
        "seconds": times,
        "newton / drake": times["newton"] / times["drake"],
        "cost difference, drake": cost(problem, solutions["drake"]) / least - 1.0,
    }
    if "cvxpy" in times:
        table |= {
            "newton / cvxpy": times["newton"] / times["cvxpy"],
            "drake / cvxpy": times["drake"] / times["cvxpy"],
            "cost difference, cvxpy": cost(problem, solutions["cvxpy"]) / least - 1.0,
        }
    return table


def sweep_ratio(case: Case, *, count: int, repeats: int) -> dict[str, Any]:
    """A sweep over γ by Newton's method against one by Drake's program, each solve cold."""
    gammas = case.gamma * np.logspace(1.0, -4.0, count)
    problems = [case.problem(gamma) for gamma in gammas]
    found: dict[str, Any] = {}

    def keep(name: str, results: Any) -> None:
        found[name] = results

    methods = {
        "newton": lambda: keep("newton", [solve_newton(single) for single in problems]),
        "drake": lambda: keep("drake", [solve_fit(single) for single in problems]),
    }
    rounds = [[cpu_time(work) for work in methods.values()] for _ in range(repeats)]
    newton, drake = zip(*rounds, strict=True)
    costs = {
        name: np.array([cost(*pair) for pair in zip(problems, [r.x for r in own], strict=True)])
        for name, own in found.items()
    }
    return {
        "gammas": [float(gammas[0]), float(gammas[-1]), len(gammas)],
        "seconds": {"newton": float(np.median(newton)), "drake": float(np.median(drake))},
        "drake / newton": float(np.median(np.divide(drake, newton))),
        "largest cost difference": float(np.abs(costs["drake"] / costs["newton"] - 1.0).max()),
    }


def geodesic_rows(
    case: Case, sizes: Sequence[int], gammas: Sequence[float]
) -> list[dict[str, Any]]:
    """Geodesic least squares ([Lee2019] §3.4) of few samples, and the entropic fit at its residual.

    The motors' inertia is known. Errors are of all samples, and RMS distances of the bodies.
    """
    if case.truth is None:
        return []
    n = case.prior.size
    truth, effort = case.truth[:n], case.b - case.A[:, n:] @ case.truth[n:]
    bodies = pseudo_inertia(truth.reshape(case.prior.shape))

    def quality(phi: np.ndarray) -> dict[str, float]:
        away = np.square(distance(pseudo_inertia(phi), bodies))
        error = case.A[:, :n] @ (phi.ravel() - truth)
        return {"error": float(np.sqrt(np.mean(error**2))), "distance": float(away.mean() ** 0.5)}

    table = []
    for size in sizes:
        A, b = case.A[: 7 * size, :n], effort[: 7 * size]
        for gamma in gammas:
            start = _cpu_clock()
            own = geodesic_least_squares(A, b, case.prior, gamma=gamma, sigma=NOISE)
            seconds = _cpu_clock() - start
            bound = {"residual_bound": own.residual, "sigma": NOISE}
            other = identify(A, b, case.prior, regularizer="entropic", **bound)
            row = {"samples": size, "gamma": gamma, "seconds": seconds}
            row |= {"iterations": own.iterations, "rejected": len(own.rejected)}
            row |= {"curvature": own.curvature, "residual": own.residual / len(b)}
            row |= {"entropic residual": other.residual / len(b)}
            row |= {"geodesic": quality(own.phi), "entropic": quality(other.phi)}
            table.append(row | {"prior": quality(case.prior)})
    return table


def cpu_time(work: Callable[[], object]) -> float:
    """CPU time of a call, s, and of the process in which a conic solver runs."""
    start = _cpu_clock()
    work()
    return _cpu_clock() - start


def _cpu_clock() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def cpu_times(methods: dict[str, Callable[[], Any]], repeats: int) -> dict[str, float]:
    """Median CPU times in s, after one call each to warm up; the methods take turns."""
    times = {name: [cpu_time(work)] for name, work in methods.items()}
    for _ in range(repeats):
        for name, work in methods.items():
            times[name].append(cpu_time(work))
    return {name: float(np.median(own[1:])) for name, own in times.items()}


def peak_memory(case: Case, solvers: Sequence[str], arguments: list[str]) -> dict[str, Any]:
    """Largest memory, MB, of a process that only makes a case, and of one that then solves it."""

    def peak(what: str) -> float:
        command = [sys.executable, __file__, "--peak", f"{case.name},{what}", *arguments]
        return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)

    made = peak("none")
    return {solver: {"made": made, "solved": peak(f"entropic,{solver}")} for solver in solvers}


def print_peak(case: Case | None, what: str) -> None:
    """Solve a case, and print the largest memory of this process, MB."""
    if case is not None and what != "none":
        case.identified(*what.split(","))
    status = Path("/proc/self/status")
    if status.exists():
        # Linux hands a parent's ru_maxrss on to its children, but not its VmHWM.
        lines = status.read_text(encoding="utf-8").splitlines()
        peak = next(float(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    else:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    solver = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss  # which is a copy of this one
    print(max(peak, solver) / 1024)


def draw(table: dict[str, Any], path: Path) -> None:
    """Bars of the CPU time from regressors to result."""
    from matplotlib.figure import Figure

    cases = [name for name in ("arm", "human") if name in table]
    figure = Figure(figsize=(3.6 * len(cases) + 0.6, 3.4), layout="constrained")
    for axes, name in zip(np.ravel(figure.subplots(1, len(cases))), cases, strict=True):
        times = {key.replace(", ", ",\n"): 1e3 * t for key, t in table[name]["whole"].items()}
        axes.bar_label(axes.bar(list(times), list(times.values()), width=0.6), fmt="%.0f")
        axes.set_ylabel("CPU time, ms")
        size = table[name]["size"]
        axes.set_title(f"{name}: {size[0]} rows, {size[1]} parameters", fontsize=10)
        axes.spines[["top", "right"]].set_visible(False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def measured(case: Case, *, gammas: int, repeats: int, arguments: list[str]) -> dict[str, Any]:
    """All numbers of one case."""
    return {
        "size": list(case.A.shape),
        "gamma": case.gamma,
        "whole": whole_times(case, repeats),
        "from the factor": solver_ratios(case, repeats=repeats),
        "sweep": sweep_ratio(case, count=gammas, repeats=max(1, repeats // 3)),
        "memory, MB": peak_memory(case, ("clarabel", "newton"), arguments),
    }


def main() -> None:
    """Measures, prints, and writes what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer samples and repeats")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--repeats", type=int, help="of every time")
    parser.add_argument("--json", type=Path, help="file for the numbers")
    parser.add_argument("--figures", type=Path, help="folder for the figure")
    add_folder_option(parser)
    parser.add_argument("--peak", help=argparse.SUPPRESS)
    options = parser.parse_args()
    samples = 300 if options.quick else 4100
    repeats = options.repeats or (1 if options.quick else 9)

    makers: dict[str, Callable[[], Case | None]] = {
        "arm": lambda: arm_case(samples=samples, seed=options.seed),
        "human": lambda: human_case(options.shared),
    }
    if options.peak:
        name, what = options.peak.split(",", 1)
        case = makers[name]()
        print_peak(case, what)
        return
    if not has_cvxpy():
        print("CVXPY is not installed (pip install geodrake[dev]): no comparison with it.")
    arguments = ["--seed", str(options.seed), "--shared", str(options.shared)]
    arguments += ["--quick"] if options.quick else []
    table: dict[str, Any] = {"cvxpy": has_cvxpy()}
    for name, make in track(makers.items(), description="measuring"):
        case = make()
        if case is None:
            print(f"There are no measurements in {options.shared / 'data'}: no {name}.")
            continue
        gammas = 6 if options.quick else 20
        table[name] = measured(case, gammas=gammas, repeats=repeats, arguments=arguments)
        few = ((10,), (1.0,)) if options.quick else ((10, 30), (1.0, 10.0))
        table[name]["geodesic least squares"] = geodesic_rows(case, *few)
    print(json.dumps(table, indent=2))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(table, indent=2) + "\n")
    if options.figures:
        draw(table, options.figures / "identification_speed.png")


if __name__ == "__main__":
    main()
