"""Drake's conic solvers in a subprocess, with descriptions of failures.

A panic in Rust, a failed assertion in C++ or `exit` in C ends the process, and Python cannot catch
it. A fork of this process needs no serialization of the arguments.
"""

from __future__ import annotations

import faulthandler
import os
import resource
import signal
import time
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing.connection import Connection, Pipe
from typing import Any, NoReturn, TypeVar

import numpy as np
from pydrake.solvers import (
    ClarabelSolver,
    MathematicalProgram,
    MathematicalProgramResult,
    ScsSolver,
    SolutionResult,
    SolverInterface,
    SolverOptions,
)

from geodrake.errors import ArgumentError, ConvergenceError, GeodrakeError, IdentificationError

T = TypeVar("T")
_INTERRUPTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

SOLVERS: dict[str, type[SolverInterface]] = {"clarabel": ClarabelSolver, "scs": ScsSolver}
"""Conic solvers by name; SCS serves as a cross-check."""


Accuracies = Sequence[float]
"""Tolerances of relative duality gaps and violations, to be tried in turn."""
ROUGHLY: Accuracies = (1e-7, 1e-6)
EXACTLY: Accuracies = (1e-10, 1e-9)
"""The second tolerance is for problems whose rounding errors exceed the first."""

_SECONDS = 20.0
"""Time limit of a fit by a conic solver."""

CONTRADICTION = (
    "The bounds, constraints and residual bound are infeasible for physical bodies.",
    "Widen the bounds, check the ellipsoids' sign ([x;1]ᵀQ[x;1] ≥ 0 inside) and the total "
    "mass, or raise the residual bound.",
)
OTHER_CAUSE = (
    "Most often the data and the prior differ by very many orders of magnitude.",
    "Check units and noise levels, raise gamma, or try another solver.",
)
_CAUSES = {
    SolutionResult.kInfeasibleConstraints: CONTRADICTION,
    SolutionResult.kUnbounded: (
        "Some parameters have neither data nor a prior.",
        "Add prior information for them, or remove their columns.",
    ),
}


class LostProcessError(Exception):
    """Failure of a subprocess without a result; its message completes a sentence."""


class LateProcessError(LostProcessError):
    """A subprocess that exceeded its time limit."""


def in_subprocess(work: Callable[[], T], *, seconds: float) -> T:
    """Return the pickled result of a function in a silent fork of this process.

    Raise its GeodrakeError; a LostProcessError for other exceptions and crashes; and a
    LateProcessError after the time limit.
    """
    line, other = Pipe()
    # Interrupts are delayed, so that the child does not inherit one.
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
    try:
        with warnings.catch_warnings():
            # Python warns of other threads. The child has none, and numerical libraries reset their
            # locks at a fork; a deadlocked child ends at the time limit.
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
        if not child:
            line.close()
            _serve(work, other)
    except OSError as error:
        raise LostProcessError(f"could not be started: {error.strerror}") from error
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)
    other.close()
    answer: tuple[T, Exception | None] | None = None
    wait_options = os.WNOHANG
    try:
        if not line.poll(max(seconds, 0.0)):
            raise LateProcessError(f"did not finish in {seconds:g} s")
        answer = line.recv()
    except (EOFError, OSError):
        wait_options = 0  # the child is ending, perhaps while sending
    finally:
        line.close()
        end = _end(child, wait_options)
    if answer is None:
        raise LostProcessError(f"ended with {end}")
    result, failure = answer
    if failure is not None:
        raise failure
    return result


def _end(child: int, wait_options: int) -> str:
    """End a process if it is still running, and return its status."""
    try:
        pid, status = os.waitpid(child, wait_options)
        if not pid:
            os.kill(child, signal.SIGKILL)
            _, status = os.waitpid(child, 0)
    except (ProcessLookupError, ChildProcessError):
        # The program reaps its children elsewhere, and the PID may be reused.
        return "unknown reason"
    code = os.waitstatus_to_exitcode(status)
    return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


def _serve(work: Callable[[], Any], line: Connection) -> NoReturn:
    """Send the result or exception of `work`, and end this process."""
    try:
        for number in _INTERRUPTS:
            signal.signal(number, signal.SIG_DFL)  # the parent handles interrupts
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _INTERRUPTS)
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        silence = os.open(os.devnull, os.O_WRONLY)
        for stream in (1, 2):
            os.dup2(silence, stream)
        try:
            line.send((work(), None))
        except GeodrakeError as error:
            line.send((None, error))
        except BaseException as error:  # Drake raises SystemExit if its assertions fail
            line.send((None, LostProcessError(f"raised {type(error).__name__}: {error}")))
    finally:
        os._exit(0)


def check_solver(solver: str) -> None:
    """Raise an ArgumentError if the solver is unknown."""
    if solver not in SOLVERS:
        raise ArgumentError(
            f"Conic solver '{solver}' is unknown or not installed; available: "
            f"{', '.join(SOLVERS)}.",
            advice="Omit `solver` for the default.",
        )


def solve_in_subprocess(solve: Callable[[Accuracies], T], solver: str) -> T:
    """Return the result of `solve` with the given accuracies, in a subprocess.

    If rounding leaves no significant digit of a step, Clarabel panics on NaN and ends its process.
    This cannot be predicted; a lower accuracy often avoids it.
    """
    deadline = time.monotonic() + _SECONDS
    for accuracies in (EXACTLY, EXACTLY[1:]):
        seconds = max(deadline - time.monotonic(), 0.0)
        try:
            return in_subprocess(partial(solve, accuracies), seconds=seconds)
        except LateProcessError as error:
            raise ConvergenceError(
                f"{solver} {error}, the time limit of a fit.",
                advice="Use the default solver, or raise gamma.",
                solver=solver,
            ) from None
        except LostProcessError as error:
            lost = str(error)
    raise solver_error(solver, OTHER_CAUSE, f": its process {lost}", status=lost)


def run_solver(
    program: MathematicalProgram, solver: str, accuracies: Accuracies = EXACTLY
) -> tuple[MathematicalProgramResult, float]:
    """Return the solution of a program, and a bound of Clarabel's duality gap in units of the cost.

    It runs in this process; `solve_in_subprocess` protects against crashes. The IdentificationError
    of a failed solver has the `status` in its evidence.
    """
    check_solver(solver)
    engine = SOLVERS[solver]()
    for tolerance in accuracies:
        reduced = 1e3 * tolerance  # "almost solved" counts as success in Drake
        settings: dict[str, float | int] = {}
        if solver == "clarabel":
            for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
                settings |= {name: tolerance, f"reduced_{name}": reduced}
        else:
            settings = {"eps_abs": 1e2 * tolerance, "eps_rel": 1e2 * tolerance}
            settings["max_iters"] = 100_000
        options = SolverOptions()
        for name, value in settings.items():
            options.SetOption(engine.solver_id(), name, value)
        result = engine.Solve(program, None, options)
        status = result.get_solution_result()
        if result.is_success():
            exact = getattr(result.get_solver_details(), "status", "") == "Solved"
            gap = (tolerance if exact else reduced) if solver == "clarabel" else np.nan
            return result, gap * max(1.0, abs(result.get_optimal_cost()))
        if status != SolutionResult.kSolverSpecificError:
            break
    why = _CAUSES.get(status, OTHER_CAUSE)
    raise solver_error(solver, why, f" ({status.name})", status=status.name)


def solver_error(
    solver: str, why: tuple[str, str], how: str = "", **evidence: Any
) -> IdentificationError:
    """Return the error of a solver without a solution, with a likely cause and advice."""
    problem = f"{solver} found no parameters{how}. {why[0]}"
    return IdentificationError(problem, advice=why[1], solver=solver, **evidence)
