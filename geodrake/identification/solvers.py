"""Drake's conic solvers in a subprocess, with descriptions of failures.

A panic in Rust, a failed assertion in C++ or `exit` in C end the process they are in, and nothing
in Python can catch them. A copy of this process by `fork` has all data, whatever they are.
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
"""SCS is there to cross-check."""


Accuracies = Sequence[float]
"""Relative duality gaps and violations to ask for in turn."""
ROUGHLY: Accuracies = (1e-7, 1e-6)
EXACTLY: Accuracies = (1e-10, 1e-9)
"""The last digit may be out of reach of rounding, and a little less will do."""

_SECONDS = 20.0
"""Time that a fit by a conic solver may take."""

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
    """The failure of a subprocess without a result, as the rest of a sentence."""


class LateProcessError(LostProcessError):
    """A process whose time was over."""


def in_subprocess(work: Callable[[], T], *, seconds: float) -> T:
    """Return or raise the result of a function in a silent copy of this process.

    What it returns is pickled. What it raises is a LostProcessError, unless it is a GeodrakeError,
    as are its end and, as a LateProcessError, the end of its time.
    """
    line, other = Pipe()
    # An interrupt waits, so that it is not one of the copy's too.
    waiting = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
    try:
        with warnings.catch_warnings():
            # Python warns of other threads: the copy has none, and numerical libraries look after
            # their own locks at a fork. One that waits all the same is lost when its time is over.
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
        if not child:
            line.close()
            _serve(work, other)
    except OSError as error:
        raise LostProcessError(f"could not be started: {error.strerror}") from error
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, waiting)
    other.close()
    answer: tuple[T, Exception | None] | None = None
    patience = os.WNOHANG
    try:
        if not line.poll(max(seconds, 0.0)):
            raise LateProcessError(f"did not finish in {seconds:g} s")
        answer = line.recv()
    except (EOFError, OSError):
        patience = 0  # it is ending, perhaps amid its answer
    finally:
        line.close()
        end = _ended(child, patience)
    if answer is None:
        raise LostProcessError(f"ended with {end}")
    result, failure = answer
    if failure is not None:
        raise failure
    return result


def _ended(child: int, patience: int) -> str:
    """Ensure that a process has ended, and return its status."""
    try:
        found, status = os.waitpid(child, patience)
        if not found:
            os.kill(child, signal.SIGKILL)
            _, status = os.waitpid(child, 0)
    except (ProcessLookupError, ChildProcessError):
        # The program has its children reaped elsewhere, and the number may be another's.
        return "unknown reason"
    code = os.waitstatus_to_exitcode(status)
    return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


def _serve(work: Callable[[], Any], line: Connection) -> NoReturn:
    """Send the result or exception of `work`, and end this process."""
    try:
        for number in _INTERRUPTS:
            signal.signal(number, signal.SIG_DFL)  # an interrupt is the first process's
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
        except BaseException as error:  # Drake raises SystemExit where its assertions fail
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


def solved_apart(solve: Callable[[Accuracies], T], solver: str) -> T:
    """Return the result of `solve`, given accuracies to try, in a subprocess.

    Where rounding has left no digit of a step, Clarabel panics on the numbers that are none, and
    that ends the process it is in. No check before the call can tell, as it takes the last digits
    of an iterate; a little less accuracy often ends before that.
    """
    over = time.monotonic() + _SECONDS
    for accuracies in (EXACTLY, EXACTLY[1:]):
        seconds = max(over - time.monotonic(), 0.0)
        try:
            return in_subprocess(partial(solve, accuracies), seconds=seconds)
        except LateProcessError as error:
            raise ConvergenceError(
                f"{solver} {error}, which is all that a fit has.",
                advice="Use the default solver, or raise gamma.",
                solver=solver,
            ) from None
        except LostProcessError as error:
            lost = str(error)
    raise no_parameters(solver, OTHER_CAUSE, f": its process {lost}", status=lost)


def run_solver(
    program: MathematicalProgram, solver: str, accuracies: Accuracies = EXACTLY
) -> tuple[MathematicalProgramResult, float]:
    """Return the solution of a program, and the duality gap that Clarabel may have left.

    It runs in this process; `solved_apart` is safe where this is not. The gap is in the unit of the
    cost. The IdentificationError of a solver that found no solution has the `status` in its
    evidence.
    """
    check_solver(solver)
    engine = SOLVERS[solver]()
    for share in accuracies:
        almost = 1e3 * share  # "almost solved" counts as success in Drake
        own: dict[str, float | int] = {}
        if solver == "clarabel":
            for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
                own |= {name: share, f"reduced_{name}": almost}
        else:
            own = {"eps_abs": 1e2 * share, "eps_rel": 1e2 * share, "max_iters": 100_000}
        options = SolverOptions()
        for name, value in own.items():
            options.SetOption(engine.solver_id(), name, value)
        result = engine.Solve(program, None, options)
        status = result.get_solution_result()
        if result.is_success():
            exact = getattr(result.get_solver_details(), "status", "") == "Solved"
            gap = (share if exact else almost) if solver == "clarabel" else np.nan
            return result, gap * max(1.0, abs(result.get_optimal_cost()))
        if status != SolutionResult.kSolverSpecificError:
            break
    why = _CAUSES.get(status, OTHER_CAUSE)
    raise no_parameters(solver, why, f" ({status.name})", status=status.name)


def no_parameters(
    solver: str, why: tuple[str, str], how: str = "", **evidence: Any
) -> IdentificationError:
    """Return the error of a solver without a solution, with a likely cause and advice."""
    problem = f"{solver} found no parameters{how}. {why[0]}"
    return IdentificationError(problem, advice=why[1], solver=solver, **evidence)
