"""How fast identification is: Newton's method, Drake's conic programs, and the same in CVXPY.

Two fits, as in [Lee2019] §3.6: an arm of ten bodies with seven motors, from 4,100 samples of all
torques (107 parameters, made here), and a human of sixteen bodies in bounding ellipsoids (measured,
990 rows). Times are CPU times, medians of repeats, of everything from regressors to result unless
said otherwise. Peak memory is that of a process of its own. Geodesic least squares is tried on the
arm's first samples, beside the entropic fit at the same residual.

    OMP_NUM_THREADS=1 python -m diagrams.benchmarks.identification_speed --json speed.json
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from diagrams.benchmarks.fit_cases.cases import NOISE, Case, arm_case, human_case
from diagrams.benchmarks.fit_cases.in_cvxpy import cost, cvxpy_solution, has_cvxpy
from diagrams.harness import bars, cpu_clock, cpu_times, medians, peak_memory, script_parser, write
from diagrams.public_data import add_folder_option
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
    return medians(work, repeats)


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
    times = medians(methods, repeats)
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
    newton, drake = cpu_times(methods, repeats).values()
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
            start = cpu_clock()
            own = geodesic_least_squares(A, b, case.prior, gamma=gamma, sigma=NOISE)
            seconds = cpu_clock() - start
            bound = {"residual_bound": own.residual, "sigma": NOISE}
            other = identify(A, b, case.prior, regularizer="entropic", **bound)
            row = {"samples": size, "gamma": gamma, "seconds": seconds}
            row |= {"iterations": own.iterations, "rejected": len(own.rejected)}
            row |= {"curvature": own.curvature, "residual": own.residual / len(b)}
            row |= {"entropic residual": other.residual / len(b)}
            row |= {"geodesic": quality(own.phi), "entropic": quality(other.phi)}
            table.append(row | {"prior": quality(case.prior)})
    return table


def memory(name: str, arguments: list[str]) -> dict[str, Any]:
    """Return the largest memory, MB, of a process that makes a case, and of ones that solve it."""
    module = "diagrams.benchmarks.identification_speed"
    code = f"import sys\nfrom {module} import solve\nsolve(sys.argv)\n"

    def peak(*what: str) -> float:
        return peak_memory(code, name, *arguments, *what)[0] / 1024**2

    made = peak()
    return {solver: {"made": made, "solved": peak(solver)} for solver in ("clarabel", "newton")}


def solve(arguments: Sequence[str]) -> None:
    """Make a case, and solve it by a solver, if one is named."""
    name, samples, seed, shared, *solvers = arguments[1:]
    case = made_case(name, int(samples), int(seed), Path(shared))
    for solver in solvers if case is not None else ():
        case.identified("entropic", solver)


def made_case(name: str, samples: int, seed: int, shared: Path) -> Case | None:
    """Return the case of a name; None for one whose measurements are not there."""
    return arm_case(samples=samples, seed=seed) if name == "arm" else human_case(shared)


def measured(case: Case, *, gammas: int, repeats: int, arguments: list[str]) -> dict[str, Any]:
    """All numbers of one case."""
    return {
        "size": list(case.A.shape),
        "gamma": case.gamma,
        "whole": whole_times(case, repeats),
        "from the factor": solver_ratios(case, repeats=repeats),
        "sweep": sweep_ratio(case, count=gammas, repeats=max(1, repeats // 3)),
        "memory, MB": memory(case.name, arguments),
    }


def main() -> None:
    """Measure, print, and write what was asked for."""
    parser = script_parser(__doc__, "fewer samples and repeats")
    parser.add_argument("--repeats", type=int, help="of every time")
    add_folder_option(parser)
    options = parser.parse_args()
    samples = 300 if options.quick else 4100
    repeats = options.repeats or (1 if options.quick else 9)
    if not has_cvxpy():
        print("CVXPY is not installed (pip install geodrake[dev]): no comparison with it.")
    table: dict[str, Any] = {"cvxpy": has_cvxpy()}
    panels = {}
    for name in track(("arm", "human"), description="measuring"):
        case = made_case(name, samples, options.seed, options.shared)
        if case is None:
            print(f"There are no measurements in {options.shared / 'data'}: no {name}.")
            continue
        arguments = [str(each) for each in (samples, options.seed, options.shared)]
        gammas = 6 if options.quick else 20
        table[name] = measured(case, gammas=gammas, repeats=repeats, arguments=arguments)
        few = ((10,), (1.0,)) if options.quick else ((10, 30), (1.0, 10.0))
        table[name]["geodesic least squares"] = geodesic_rows(case, *few)
        title = f"{name}: {case.A.shape[0]} rows, {case.A.shape[1]} parameters"
        panels[title] = {key: 1e3 * t for key, t in table[name]["whole"].items()}
    print(json.dumps(table, indent=2))
    write(options, table, identification_speed=lambda: bars(panels, "ms"))


if __name__ == "__main__":
    main()
