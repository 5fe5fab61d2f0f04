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
from geodrake.excitation.collisions import CollisionWorld
from geodrake.excitation.families import FourierMotion, MotionFamily
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.margins import COARSE, LimitUse, keeps_limits, least_of, limit_use
from geodrake.excitation.objective import Criterion, Objective
from geodrake.excitation.problem import DesignOptions, DesignProblem, make_problem
from geodrake.excitation.solve import (
    INTERRUPTED,
    Budget,
    OutOfTimeError,
    SolverEnd,
    check_solver,
    solve,
)
from geodrake.excitation.starts import (
    RampPlanner,
    check_start,
    possible_postures,
    random_guess,
    within_limits,
)
from geodrake.excitation.target import Target, make_target
from geodrake.excitation.trajectory import ExcitationTrajectory, ExecutableMotion, RampedTrajectory
from geodrake.inertia import Array
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel

THRESHOLD = 1e-2
"""Largest relative variance of a direction that counts as identifiable, as for given logs."""

_MOST_SEEDS = 1000
_FOR_STARTS, _FOR_STAGE, _FOR_SOLVER = 0.9, 0.85, 0.8  # of the time; the rest is for closer looks
_FOR_WAY = 0.5  # of what is left of a stage; the rest is for motions that the solver saw
_A_MOMENT = 1.0  # s
_ONE_STAGE, _STAGES = 24.0, (8.0, 64.0)
_AFTER_STOP = 2.0  # s, for the way back to the limits of a motion that was stopped
_LOOKED_AT = 200  # most of the motions that a solver saw
_STOPPED = "the search was interrupted: a longer one may find a better motion"
_RAMP_LOOKS = 200  # at collisions of a ramp
_NEAREST_POSTURES = 50  # to the middle, out of which seeds take theirs
_BALANCED_POSTURES = 400  # of a robot on its feet, through which seeds lead


@dataclass(frozen=True)
class DesignProgress:
    """Where a design is."""

    seed: int  # number of the start, from zero
    seeds: int
    evaluations: int  # evaluations of the criterion since the design began
    value: float  # what is minimized, now: the criterion's logarithm; limits may not yet be kept
    # Whether the design was stopped, and only the best motion is looked at.
    is_stopped: bool = False


@dataclass(frozen=True)
class SeedOutcome:
    """Outcome of one initial motion."""

    seed: int | None  # of the random motion that it began with; None for a given motion
    random_value: float  # criterion of the motion that it began with, which keeps the limits
    value: float  # criterion of the motion that it ended with, which keeps them too
    evaluations: int
    seconds: float
    status: str


@dataclass(frozen=True, eq=False)
class ExcitationResult(Shown):
    """A designed motion."""

    trajectory: ExcitationTrajectory
    objective: Objective
    value: float  # its value, as the source defines it (not the logarithm)
    # (n_B,) of the normalized information matrix, ascending: the inverse variances of an estimate
    # from `samples` samples, along its principal directions.
    eigenvalues: Array
    samples: int
    use: LimitUse  # what it uses of its limits, all of which it keeps, ramps included
    limits: MotionLimits
    outcomes: tuple[SeedOutcome, ...]
    notes: tuple[str, ...] = ()
    is_interrupted: bool = False
    # The motion with ramps from and to where the robot stands; None if nobody said where.
    ramps: RampedTrajectory | None = None
    seconds: float = 0.0  # how long the search took, s

    @property
    def executed(self) -> ExecutableMotion:
        """The motion to execute and to save, with its ramps if any."""
        return self.ramps or self.trajectory

    @property
    def motion(self) -> Motion:
        """The samples that the value is of."""
        return self.trajectory.motion(self.trajectory.family.times(self.samples))


def identifiable_directions(result: ExcitationResult) -> int:
    """Return how many directions the motion's samples identify to within `THRESHOLD`.

    Meaningful for the geometric normalization, whose variances are relative.
    """
    return int(np.count_nonzero(result.eigenvalues * THRESHOLD >= 1.0))


def improvement(result: ExcitationResult) -> float:
    """Return the ratio of the best initial motion's criterion to the result's.

    Of D-optimality, the factor of the geometric mean of the variances.
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
        what: A robot, of which all inertias and the model's effects are to be identified from
            efforts; or a `Target`: what is unknown, what is measured and with which noise; or an
            `Objective`, such as a `Separation`, which has a criterion of its own.
        limits: What the robot may do; those of `motion_limits(model, bounded=True)` if None. Of a
            robot on its feet (`DesignOptions.stance`), those of its motors.
        criterion: One of `CRITERIA`, or a `Criterion`.
        normalization: One of `NORMALIZATIONS`.
        trajectory: The family of motions; a Fourier series of 10 s if None.
        seeds: Number of random starts, or their seeds.
        progress: Called after every evaluation of the criterion. It may raise `StopSearch`, as a
            handler of signals may: then the best motion so far is the result.
    """
    if progress is not None:
        function(progress, "progress")
    given = DesignOptions() if options is None else instance(options, "options", DesignOptions)
    budget = Budget.of(given.seconds)
    asked = _asked(seeds)
    check_solver(given.solver)
    if not 1 <= len(asked) <= _MOST_SEEDS or given.sharpness == ():
        raise ArgumentError(
            f"A design needs 1 to {_MOST_SEEDS} seeds and at least one stage; got "
            f"{len(asked)} seeds and the stages {given.sharpness}."
        )
    chosen = [*asked]
    objective = _objective_of(what, criterion, normalization)
    problem, postures = _prepared(objective, limits, trajectory, given)
    model, options = problem.model, problem.options
    stand = problem.stand
    if stand is not None:
        check_start(problem, stand, name="robot's stand")
    run = _Run(problem, postures, progress)
    ends = run.from_seeds(chosen, budget.part(_FOR_STARTS))
    best, _ = min(ends, key=lambda end: end[1].value)
    use = limit_use(problem, best)
    final, ramps = problem.trajectory(best), None
    if stand is not None:
        ramps = RampPlanner(problem).ramped(final, stand)
        use = _with_ramps(use, ramps, options.collisions)
    eigenvalues = objective.eigenvalues(final.motion(problem.times))
    return ExcitationResult(
        trajectory=final,
        objective=objective,
        value=objective.criterion.value(eigenvalues),
        eigenvalues=eigenvalues,
        samples=len(problem.times),
        use=use,
        limits=problem.motor_limits,
        outcomes=tuple(outcome for _, outcome in ends),
        notes=(
            *model.repairs,
            *(() if options.collisions is None else options.collisions.notes),
            *_time_notes(run, run.starts - len(ends)),
        ),
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
    """Return a random motion within a robot's limits, such as one that validates what is found.

    Arguments and errors are those of `design_excitation`, which begins with such motions.
    """
    given = DesignOptions() if options is None else instance(options, "options", DesignOptions)
    objective = _objective_of(what, "e_optimality", "geometric")
    problem, postures = _prepared(objective, limits, trajectory, given)
    rng = np.random.default_rng(integer(seed, "seed", lower=0))
    return problem.trajectory(random_guess(problem, postures, rng, Budget.of(given.seconds)))


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
    """Return the problem, and postures (n, nv) in which motions may begin."""
    if limits is not None:
        instance(limits, "limits", MotionLimits)
    family = FourierMotion() if trajectory is None else trajectory
    instance(family, "trajectory", MotionFamily)
    problem = make_problem(objective, limits, family, options)
    if problem.start is not None:
        check_start(problem, problem.start)
        if problem.stance is None:
            return problem, problem.start[None]
    own = problem.model, problem.limits, options.collisions
    most = _NEAREST_POSTURES if problem.stance is None else _BALANCED_POSTURES
    return problem, possible_postures(*own, stance=problem.stance, most=most)


def _with_ramps(
    use: LimitUse, ramps: RampedTrajectory, collisions: CollisionWorld | None
) -> LimitUse:
    """Return the use of limits with the clearances on ramps, which take half of the others."""
    if collisions is None:
        return use
    clearances = dict(use.clearances)
    for part in ramps.parts:
        if not isinstance(part, ExcitationTrajectory):
            q = part.motion(np.linspace(0.0, part.length, _RAMP_LOOKS)).q
            clearances = least_of(clearances, collisions.nearest(q))
    return replace(use, clearances=clearances)


def _time_notes(run: _Run, left_out: int) -> tuple[str, ...]:
    """Return notes on what was not tried for lack of time."""
    why = "it was interrupted" if run.is_stopped else "time was up"
    notes = [_STOPPED] if run.is_stopped else []
    if left_out:
        notes.append(f"{left_out} initial motions were not tried, as {why}")
    return tuple(notes)


def _asked(seeds: int | Sequence[int]) -> Sequence[int]:
    """Return the seeds of random starts, from their number or as given."""
    if isinstance(seeds, int | np.integer):
        return range(integer(seeds, "seeds"))
    return integers(seeds, "seeds", lower=0)


@dataclass
class _Run:
    """The starts of one design, one after the other."""

    problem: DesignProblem
    postures: Array
    progress: Callable[[DesignProgress], None] | None
    starts: int = 0
    evaluations: int = 0
    is_stopped: bool = False

    def from_seeds(self, seeds: Sequence[int], budget: Budget) -> list[tuple[Array, SeedOutcome]]:
        """Return the best motions (f, nv) from random ones, and from the guess if any.

        A start has half of the time that is left, the last one all of it; those that it does not
        reach are left out.
        """
        options = self.problem.options
        given = None if options.guess is None else self._given(options.guess)
        asked: list[int | None] = [*seeds, *([] if given is None else [None])]
        self.starts = len(asked)
        ends: list[tuple[Array, SeedOutcome]] = []
        first: Array | None = None
        for start, seed in enumerate(asked):
            own = budget.part(1.0 / min(self.starts - start, 2))  # few that end beat many
            if first is not None and (own.left <= 0.0 or self.is_stopped):
                break
            try:
                if seed is None and given is not None and first is not None:
                    guess = within_limits(self.problem, given, first, own)
                else:
                    guess = self._random(seed, own if first is not None else budget)
            except OutOfTimeError:
                continue
            except BaseException as error:
                if first is None or not is_stop(error):
                    raise
                self._stop(start, ends[-1][1].value)
                break
            first = guess if first is None else first
            ends.append(self._from(start, seed, guess, own))
        if not ends:
            raise ArgumentError(
                f"No motion within the limits was found in {options.seconds:g} s.",
                advice="Allow more time, or start from a motion within the limits.",
            )
        return ends

    def _random(self, seed: int | None, budget: Budget) -> Array:
        """Return a random motion within the limits."""
        least = Budget.of(max(budget.left, _A_MOMENT))
        return random_guess(self.problem, self.postures, np.random.default_rng(seed), least)

    def _given(self, guess: Array) -> Array:
        """Return the variables of the motion that was given."""
        return self.problem.variables(real_array(guess, "guess", self.problem.offset.shape))

    def _from(
        self, number: int, seed: int | None, guess: Array, budget: Budget
    ) -> tuple[Array, SeedOutcome]:
        """Return the best motion from one, and how it was found."""
        begin, before = time.monotonic(), self.evaluations
        random_value = self._value(guess)
        found, status = guess, "not solved"
        try:
            for stage in self._stages():
                if budget.left <= 0.0 or self.is_stopped:
                    break
                found, status = self._improved(number, stage, found, budget)
        except BaseException as error:
            if not is_stop(error):
                raise
            self._stop(number, self._value(found))
            status = INTERRUPTED
        outcome = SeedOutcome(
            seed=seed,
            random_value=random_value,
            value=self._value(found),
            evaluations=self.evaluations - before,
            seconds=time.monotonic() - begin,
            status=status,
        )
        return found, outcome

    def _improved(
        self, number: int, stage: Criterion, guess: Array, budget: Budget
    ) -> tuple[Array, str]:
        """Return the better of a motion and its improvement by a stage, and the solver's status."""
        problem = replace(self.problem, objective=replace(self.problem.objective, criterion=stage))
        found = solve(
            problem,
            guess,
            budget=budget.part(_FOR_STAGE * _FOR_SOLVER),
            watch=lambda value, _: self._notify(number, value),
            quick=problem.options.quick,
        )
        if found.status == INTERRUPTED:
            self._stop(number, self._value(guess))
            budget = Budget.of(min(budget.left, _AFTER_STOP))
        inside = self._inside(problem, found, guess, budget)
        better = inside if self._value(inside) < self._value(guess) else guess
        return better, found.status

    def _inside(
        self, problem: DesignProblem, found: SolverEnd, guess: Array, budget: Budget
    ) -> Array:
        """Return a motion within limits: the solution, one near it, or the best seen on the way.

        Solvers keep linear limits on their way, those of efforts and collisions in the end only. A
        solver that is stopped may be beyond these, and the way back long.
        """
        reached = found.variables.reshape(guess.shape)
        nearest = within_limits(problem, reached, guess, budget.part(_FOR_WAY), stride=COARSE)
        value = problem.cost(nearest)[0]
        with suppress(OutOfTimeError):
            for better, y in found.seen[:_LOOKED_AT]:
                if better >= value:
                    break
                if keeps_limits(problem, y, stride=COARSE, budget=budget):
                    nearest = y.reshape(guess.shape)
                    break
        return within_limits(self.problem, nearest, guess, budget)

    def _stop(self, number: int, value: float) -> None:
        """Start nothing more, and report it."""
        self.is_stopped = True
        if self.progress is not None:
            now = DesignProgress(number, self.starts, self.evaluations, value, is_stopped=True)
            with suppress(StopSearch):  # of one who goes on asking
                self.progress(now)

    def _stages(self) -> list[Criterion]:
        """Return the criterion, ever less smoothed if it is."""
        criterion = self.problem.objective.criterion
        if criterion.name in ("a_optimality", "d_optimality"):
            return [criterion]
        options = self.problem.options
        stages = options.sharpness or ((_ONE_STAGE,) if options.quick else _STAGES)
        return [replace(criterion, sharpness=sharpness) for sharpness in stages]

    def _value(self, variables: Array) -> float:
        motion = self.problem.trajectory(variables).motion(self.problem.times)
        return self.problem.objective.value(motion)

    def _notify(self, number: int, value: float) -> None:
        self.evaluations += 1
        if self.progress is not None:
            self.progress(DesignProgress(number, self.starts, self.evaluations, value))
