"""The most informative motion that a robot can execute, [Lee2019] §4.4 and §4.5.2."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from geodrake.boundary.arguments import (
    function,
    instance,
    integer,
    integers,
    real_array,
)
from geodrake.boundary.interrupts import StopSearch, is_stop
from geodrake.boundary.showing import Shown
from geodrake.errors import ArgumentError
from geodrake.excitation.families import FourierMotion, MotionFamily
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.margins import COARSE, LimitUse, keeps_limits, limit_use
from geodrake.excitation.objective import Criterion, Objective
from geodrake.excitation.problem import DesignOptions, DesignProblem, make_problem
from geodrake.excitation.solve import INTERRUPTED, Budget, SearchEndError, check_solver, solve
from geodrake.excitation.starts import (
    check_start,
    possible_postures,
    random_guess,
    with_ramps,
    within_limits,
)
from geodrake.excitation.target import Target, make_target
from geodrake.excitation.trajectory import ExcitationTrajectory
from geodrake.inertia import Array
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel

THRESHOLD = 1e-2
"""Largest relative variance of an identifiable direction, as for logs."""

_MOST_SEEDS = 1000
_FOR_STARTS, _FOR_STAGE, _FOR_SOLVER = 0.9, 0.85, 0.8  # shares of time; the rest is for checks
_FOR_REPAIR = 0.5  # of the rest of a stage; the remainder is for motions that the solver visited
_LEAST_TIME = 1.0  # s, for a random motion
_ONE_STAGE, _STAGES = 24.0, (8.0, 64.0)
_AFTER_STOP = 2.0  # s, to bring an interrupted motion within the limits
_MAX_CHECKED = 200  # motions visited by the solver
_NEAREST_POSTURES = 50  # closest to the middle, from which seeds choose
_BALANCED_POSTURES = 400  # of a robot on its feet, from which seeds choose


@dataclass(frozen=True)
class DesignProgress:
    """The progress of a design."""

    seed: int  # number of the start, from zero
    seeds: int
    evaluations: int  # evaluations of the criterion since the design began
    value: float  # current cost, the criterion's logarithm; limits may still be violated
    is_stopped: bool = False  # whether the design was stopped and only checks its best motion


@dataclass(frozen=True)
class SeedOutcome:
    """Outcome of one initial motion."""

    seed: int | None  # of the random initial motion; None for a given one
    random_value: float  # criterion of the initial motion, which is within the limits
    value: float  # criterion of the final motion, which is within the limits
    evaluations: int
    seconds: float
    status: str


@dataclass(frozen=True, eq=False)
class ExcitationResult(Shown):
    """A designed motion."""

    trajectory: ExcitationTrajectory
    objective: Objective
    value: float  # the criterion as the source defines it (not the logarithm)
    # (n_B,) of the normalized information matrix, ascending: the inverse variances of an estimate
    # from `samples` samples, along its principal directions.
    eigenvalues: Array
    samples: int
    use: LimitUse  # use of the limits, ramps included
    limits: MotionLimits
    outcomes: tuple[SeedOutcome, ...]
    notes: tuple[str, ...] = ()
    is_interrupted: bool = False
    # The motion with ramps from and to where the robot stands; None without `DesignOptions.stand`.
    ramps: ExcitationTrajectory | None = None
    seconds: float = 0.0  # duration of the search, s

    @property
    def executed(self) -> ExcitationTrajectory:
        """The motion to execute and save, with its ramps if any."""
        return self.ramps or self.trajectory

    @property
    def motion(self) -> Motion:
        """The samples from which the value was computed."""
        return self.trajectory.motion(self.trajectory.family.times(self.samples))


def identifiable_directions(result: ExcitationResult) -> int:
    """Return the number of directions that the motion's samples identify within `THRESHOLD`.

    It is meaningful for the geometric normalization, whose variances are relative.
    """
    return int(np.count_nonzero(result.eigenvalues * THRESHOLD >= 1.0))


def improvement(result: ExcitationResult) -> float:
    """Return the ratio of the best initial motion's criterion to the result's.

    For D-optimality, it is the ratio of the geometric means of the variances.
    """
    random = min(outcome.random_value for outcome in result.outcomes)
    if result.objective.criterion.name == "d_optimality":
        return float(np.exp((random - result.value) / len(result.eigenvalues)))
    return random / result.value if np.isfinite(random) else np.inf


def design_excitation(
    what: RobotModel | Target | Objective,
    limits: MotionLimits | None = None,
    *,
    criterion: str | Criterion = "e_optimality",
    normalization: str = "geometric",
    trajectory: MotionFamily | None = None,
    options: DesignOptions | None = None,
    seeds: int | Sequence[int] = 3,
    progress: Callable[[DesignProgress], None] | None = None,
) -> ExcitationResult:
    """Return the most informative motion of a robot within its limits.

    Args:
        what: A robot whose inertias and effects should all be identified from efforts; or a
            `Target` with the unknowns, measurements and noise; or an `Objective` with its own
            criterion, such as a `Separation`.
        limits: Limits of the robot, or of the motors of a robot on its feet
            (`DesignOptions.stance`); `motion_limits(model, bounded=True)` if None.
        criterion: One of `CRITERIA`, or a `Criterion`.
        normalization: One of `NORMALIZATIONS`.
        trajectory: The family of motions; a Fourier series of 10 s if None.
        seeds: Number of random starts, or their seeds.
        progress: Called after every evaluation of the criterion. It or a signal handler may raise
            `StopSearch`: the result is then the best motion so far.
    """
    if progress is not None:
        function(progress, "progress")
    options = DesignOptions() if options is None else instance(options, "options", DesignOptions)
    budget = Budget.of(options.seconds)
    numbers: Sequence[int]
    if isinstance(seeds, int | np.integer):
        numbers = range(integer(seeds, "seeds", lower=1, upper=_MOST_SEEDS))
    else:
        few = seeds[: _MOST_SEEDS + 1] if isinstance(seeds, range) else seeds
        numbers = integers(few, "seeds", lower=0)
        if not 1 <= len(numbers) <= _MOST_SEEDS:
            found = "more" if numbers else "none"
            raise ArgumentError(
                f"seeds must be 1 to {_MOST_SEEDS} integers; there are {found}.", name="seeds"
            )
    check_solver(options.solver)
    if options.sharpness == ():
        raise ArgumentError("A design needs at least one stage; sharpness is ().")
    starts = [*numbers, *([] if options.guess is None else [None])]
    objective = _objective_of(what, criterion, normalization)
    problem, postures = _prepared(objective, limits, trajectory, options)
    stand, collisions = problem.stand, problem.collisions
    if stand is not None:
        check_start(problem, stand, name="robot's stand")
    run = _Design(problem, postures, progress, len(starts))
    ends = run.from_starts(starts, budget.part(_FOR_STARTS))
    best, _ = min(ends, key=lambda end: end[1].value)
    final = problem.trajectory(best)
    ramps = None if stand is None else with_ramps(problem, final, stand)
    eigenvalues = objective.eigenvalues(final.motion(problem.times))
    notes = [*problem.model.repairs, *([] if collisions is None else collisions.notes)]
    if run.is_stopped:
        notes.append("the search was interrupted: a longer one may find a better motion")
    if len(ends) < len(starts):
        why = "it was interrupted" if run.is_stopped else "time was up"
        notes.append(f"{len(starts) - len(ends)} initial motions were not tried, as {why}")
    return ExcitationResult(
        trajectory=final,
        objective=objective,
        value=objective.criterion.value(eigenvalues),
        eigenvalues=eigenvalues,
        samples=len(problem.times),
        use=limit_use(problem, final, ramps or final),
        limits=problem.motor_limits,
        outcomes=tuple(outcome for _, outcome in ends),
        notes=tuple(notes),
        is_interrupted=run.is_stopped,
        ramps=ramps,
        seconds=options.seconds - budget.left,
    )


def random_excitation(
    what: RobotModel | Target | Objective,
    limits: MotionLimits | None = None,
    *,
    trajectory: MotionFamily | None = None,
    options: DesignOptions | None = None,
    seed: int = 0,
) -> ExcitationTrajectory:
    """Return a random motion within a robot's limits, for example for validation.

    The arguments are those of `design_excitation`, which starts from such motions.
    """
    options = DesignOptions() if options is None else instance(options, "options", DesignOptions)
    objective = _objective_of(what, "e_optimality", "geometric")
    problem, postures = _prepared(objective, limits, trajectory, options)
    rng = np.random.default_rng(integer(seed, "seed", lower=0))
    return problem.trajectory(random_guess(problem, postures, rng, Budget.of(options.seconds)))


def _objective_of(
    what: RobotModel | Target | Objective, criterion: str | Criterion, normalization: str
) -> Objective:
    if isinstance(what, Objective):
        return what
    target = what if isinstance(what, Target) else make_target(what)
    criterion = criterion if isinstance(criterion, Criterion) else Criterion(criterion)
    return Objective(target, criterion, normalization)


def _prepared(
    objective: Objective,
    limits: MotionLimits | None,
    trajectory: MotionFamily | None,
    options: DesignOptions,
) -> tuple[DesignProblem, Array]:
    """Return the problem, and postures (n, nv) from which motions may start."""
    if limits is not None:
        instance(limits, "limits", MotionLimits)
    family = FourierMotion() if trajectory is None else trajectory
    instance(family, "trajectory", MotionFamily)
    problem = make_problem(objective, limits, family, options)
    if problem.start is not None:
        check_start(problem, problem.start)
        if problem.stance is None:
            return problem, problem.start[None]
    robot = problem.model, problem.limits, options.collisions
    most = _NEAREST_POSTURES if problem.stance is None else _BALANCED_POSTURES
    return problem, possible_postures(*robot, stance=problem.stance, most=most)


@dataclass
class _Design:
    """The sequence of starts of one design."""

    problem: DesignProblem
    postures: Array
    progress: Callable[[DesignProgress], None] | None
    starts: int
    first: Array | None = None  # the first random motion
    evaluations: int = 0
    is_stopped: bool = False

    def from_starts(
        self, seeds: Sequence[int | None], budget: Budget
    ) -> list[tuple[Array, SeedOutcome]]:
        """Return the best motions (f, nv) of all starts; the seed None stands for the guess.

        Each start gets half of the remaining time, the last one all of it. Starts that are not
        reached are omitted.
        """
        ends: list[tuple[Array, SeedOutcome]] = []
        for number, seed in enumerate(seeds):
            # A few finished starts are better than many unfinished ones.
            part = budget.part(1.0 / min(self.starts - number, 2))
            if ends and (part.left <= 0.0 or self.is_stopped):
                break
            begin, before, status = time.monotonic(), self.evaluations, "not solved"
            guess: Array | None = None
            try:
                guess = best = self._begin(seed, part if ends else budget)
                for stage in self._stages():
                    if part.left <= 0.0 or self.is_stopped:
                        break
                    best, status = self._improved(number, stage, best, part)
            except SearchEndError:
                continue
            except BaseException as error:
                if self.first is None or not is_stop(error):
                    raise
                self._stop(number, ends[-1][1].value if guess is None else self._value(best))
                if guess is None:
                    break
                status = INTERRUPTED
            outcome = SeedOutcome(
                seed=seed,
                random_value=self._value(guess),
                value=self._value(best),
                evaluations=self.evaluations - before,
                seconds=time.monotonic() - begin,
                status=status,
            )
            ends.append((best, outcome))
        if not ends:
            raise ArgumentError(
                f"No motion within the limits was found in {self.problem.options.seconds:g} s.",
                advice="Allow more time, or start from a motion within the limits.",
            )
        return ends

    def _begin(self, seed: int | None, budget: Budget) -> Array:
        """Return a random motion within the limits, or the one closest to the guess."""
        problem = self.problem
        if seed is None and self.first is not None:
            coefficients = real_array(problem.options.guess, "guess", problem.offset.shape)
            return within_limits(problem, problem.variables(coefficients), self.first, budget)
        budget = Budget.of(max(budget.left, _LEAST_TIME))
        guess = random_guess(problem, self.postures, np.random.default_rng(seed), budget)
        self.first = guess if self.first is None else self.first
        return guess

    def _stages(self) -> list[Criterion]:
        """Return the criteria of all stages, with decreasing smoothing."""
        criterion, options = self.problem.objective.criterion, self.problem.options
        if criterion.name in ("a_optimality", "d_optimality"):
            return [criterion]
        stages = options.sharpness or ((_ONE_STAGE,) if options.quick else _STAGES)
        return [replace(criterion, sharpness=sharpness) for sharpness in stages]

    def _improved(
        self, number: int, stage: Criterion, guess: Array, budget: Budget
    ) -> tuple[Array, str]:
        """Return the better of a motion and its improvement by a stage, and the solver's status.

        Solvers keep linear limits at every step, but those of efforts and collisions only at the
        end. A stopped solver may violate these. The improvement is therefore the solution, one
        close to it within the limits, or the best one visited.
        """
        problem = replace(self.problem, objective=replace(self.problem.objective, criterion=stage))
        reached, status, seen = solve(
            problem,
            guess,
            budget=budget.part(_FOR_STAGE * _FOR_SOLVER),
            watch=lambda value: self._notify(number, value),
        )
        if status == INTERRUPTED:
            self._stop(number, self._value(guess))
            budget = Budget.of(min(budget.left, _AFTER_STOP))
        repair, reached = budget.part(_FOR_REPAIR), reached.reshape(guess.shape)
        nearest = within_limits(problem, reached, guess, repair, stride=COARSE)
        value = problem.cost(nearest)[0]
        with suppress(SearchEndError):
            for better, y in sorted(seen, key=lambda pair: pair[0])[:_MAX_CHECKED]:
                if better >= value:
                    break
                if keeps_limits(problem, y, stride=COARSE, budget=budget):
                    nearest = y.reshape(guess.shape)
                    break
        inside = within_limits(self.problem, nearest, guess, budget)
        return min((guess, inside), key=self._value), status

    def _value(self, variables: Array) -> float:
        motion = self.problem.trajectory(variables).motion(self.problem.times)
        return self.problem.objective.value(motion)

    def _notify(self, number: int, value: float) -> None:
        self.evaluations += 1
        if self.progress is not None:
            self.progress(DesignProgress(number, self.starts, self.evaluations, value))

    def _stop(self, number: int, value: float) -> None:
        """Prevent further starts, and report it."""
        self.is_stopped = True
        if self.progress is not None:
            now = DesignProgress(number, self.starts, self.evaluations, value, is_stopped=True)
            with suppress(StopSearch):  # from repeated requests to stop
                self.progress(now)
