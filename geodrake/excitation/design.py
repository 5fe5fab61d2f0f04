"""The most informative motion that a robot can execute, [Lee2019] §4.4."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import function, instance, integer, integers
from geodrake.boundary.interrupts import StopSearch, is_stop
from geodrake.errors import ArgumentError
from geodrake.excitation.budget import Budget, OutOfTimeError
from geodrake.excitation.criteria import Criterion
from geodrake.excitation.design_results import (
    DesignOptions,
    DesignProgress,
    ExcitationResult,
    SeedOutcome,
)
from geodrake.excitation.families import FourierMotion, MotionFamily
from geodrake.excitation.guess import random_guess, within_limits
from geodrake.excitation.information import Objective
from geodrake.excitation.limits import MotionLimits, motion_limits
from geodrake.excitation.margins import FINE, limit_use
from geodrake.excitation.nonlinear_solvers import (
    AFTER_STOP,
    INTERRUPTED,
    check_solver,
    solve,
)
from geodrake.excitation.postures import check_start, possible_postures
from geodrake.excitation.problem import DesignProblem
from geodrake.excitation.target import Target, make_target
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_MOST_SAMPLES, _MOST_SEEDS = 10_000, 1000
_FOR_STARTS, _FOR_STAGE = 0.9, 0.85  # of the time; the rest is for a closer look at limits
_A_MOMENT = 1.0  # s
_STOPPED = "interrupted: the motion is the best by then, and a longer search may find a better one"
_NEAREST_POSTURES = 50  # to the middle, out of which seeds take theirs


def design_excitation(
    what: RobotModel | Target,
    limits: MotionLimits | None = None,
    *,
    criterion: str | Criterion = "e_optimality",
    normalization: str = "geometric",
    trajectory: MotionFamily | None = None,
    options: DesignOptions | None = None,
    seeds: int | Sequence[int] = 3,
    progress: Callable[[DesignProgress], None] | None = None,
) -> ExcitationResult:
    """Return the motion within limits from which a robot's parameters are identified best.

    Args:
        what: A robot, of which all inertias and the model's effects are to be identified from
            efforts; or a `Target`: what is unknown, what is measured and with which noise.
        limits: What the robot may do; the limits of its model file if None.
        criterion: One of `CRITERIA`, or a `Criterion`.
        normalization: One of `NORMALIZATIONS`.
        trajectory: The family of motions; a Fourier series of 10 s if None.
        options: How the design is made.
        seeds: Number of random starts, or their seeds.
        progress: Called after every evaluation of the criterion. It may raise `StopSearch`, as a
            handler of signals may: then the best motion so far is the result.

    Raises:
        ArgumentError: Limits leave no room, a speed is not limited, the start cannot be held, no
            posture can, or the noise is not positive; the message says which joint and where.
    """
    target = what if isinstance(what, Target) else make_target(what)
    criterion = criterion if isinstance(criterion, Criterion) else Criterion(criterion)
    return design_objective(
        Objective(target, criterion, normalization),
        limits,
        trajectory=trajectory,
        options=options,
        seeds=seeds,
        progress=progress,
    )


def design_objective(
    objective: Objective,
    limits: MotionLimits | None = None,
    *,
    trajectory: MotionFamily | None = None,
    options: DesignOptions | None = None,
    seeds: int | Sequence[int] = 3,
    progress: Callable[[DesignProgress], None] | None = None,
) -> ExcitationResult:
    """Return the motion within limits that is best by an objective.

    Args:
        objective: Function of the motion, such as a normalized criterion of a target.
        progress: Called after every evaluation.

    Raises:
        ArgumentError: As `design_excitation`.
    """
    instance(objective, "objective", Objective)
    if limits is not None:
        instance(limits, "limits", MotionLimits)
    if progress is not None:
        function(progress, "progress")
    given = DesignOptions() if options is None else options
    options = instance(given, "options", DesignOptions)
    budget = Budget.of(options.seconds)
    family = FourierMotion() if trajectory is None else trajectory
    instance(family, "trajectory", MotionFamily)
    asked = _asked(seeds)
    check_solver(options.solver)
    many = not 1 <= options.samples <= _MOST_SAMPLES or len(asked) > _MOST_SEEDS
    if many or not len(asked) or not options.sharpness:
        raise ArgumentError(
            f"A design needs at least one seed, sample and stage; got {len(asked)} seeds, "
            f"{options.samples} samples and {options.sharpness}.",
            advice=f"Give at most {_MOST_SEEDS} seeds and {_MOST_SAMPLES} samples.",
        )
    chosen = [*asked]
    problem = make_problem(objective, limits, family, options)
    model = objective.target.model
    if problem.start is None:
        postures = possible_postures(
            model, problem.limits, options.collisions, most=_NEAREST_POSTURES
        )
    else:
        check_start(model, problem.limits, problem.start, options.collisions)
        postures = problem.start[None]
    run = _Run(problem, options, postures, progress)
    ends = run.from_seeds(chosen, budget.part(_FOR_STARTS))
    best, _ = min(ends, key=lambda end: end[1].value)
    use = limit_use(problem, best, budget=run.for_a_closer_look(budget))
    final = problem.trajectory(best)
    eigenvalues = objective.eigenvalues(final.motion(problem.times))
    return ExcitationResult(
        trajectory=final,
        objective=objective,
        value=objective.criterion.value(eigenvalues),
        eigenvalues=eigenvalues,
        samples=len(problem.times),
        use=use,
        limits=problem.limits,
        outcomes=tuple(outcome for _, outcome in ends),
        notes=(
            *model.repairs,
            *(() if options.collisions is None else options.collisions.notes),
            *_time_notes(problem, run, run.starts - len(ends), use.stride),
        ),
        is_interrupted=run.is_stopped,
    )


def _time_notes(problem: DesignProblem, run: _Run, left_out: int, stride: int) -> tuple[str, ...]:
    """Return what there was no time for."""
    why = "it was interrupted" if run.is_stopped else "time was up"
    notes = [_STOPPED] if run.is_stopped else []
    if left_out:
        notes.append(f"{left_out} starts were not begun, as {why}")
    if stride > 1:
        apart = stride * float(problem.family.limit_times(FINE)[1])
        notes.append(f"collisions were looked for every {apart:.2g} s only, as {why}")
    return tuple(notes)


def _asked(seeds: int | Sequence[int]) -> Sequence[int]:
    """Return the seeds of random starts, from their number or as given."""
    if isinstance(seeds, int | np.integer):
        return range(integer(seeds, "seeds"))
    return integers(seeds, "seeds", lower=0)


def make_problem(
    objective: Objective,
    limits: MotionLimits | None,
    family: MotionFamily,
    options: DesignOptions,
) -> DesignProblem:
    """Return the design problem of options.

    Args:
        objective: What the motion shall make small.
        limits: Limits by joint; None for those of the model.

    Raises:
        ArgumentError: Limits leave no room or let samples be without bounds, or the ends leave no
            coefficient free.
    """
    model = objective.target.model
    limits = motion_limits(model) if limits is None else limits
    if limits.joints != model.joints:
        raise ArgumentError(
            f"The limits are of the joints {limits.joints}; the robot has {model.joints}."
        )
    if not family.timed and not np.isfinite(limits.acceleration).all():
        joint = limits.joints[int(np.argmin(np.isfinite(limits.acceleration)))]
        raise ArgumentError(
            f"The acceleration of joint {joint!r} is not limited, and free samples have no other "
            "bound for it.",
            advice=f"Say how large it may be, such as acceleration={{{joint!r}: 5.0}}.",
            joint=joint,
        )
    start = None if options.start is None else np.asarray(options.start, float)
    return DesignProblem(
        objective,
        limits,
        family,
        samples=options.samples,
        rest=options.rest,
        start=start if family.timed else None,
        collisions=options.collisions,
    )


@dataclass
class _Run:
    """The starts of one design, one after the other."""

    problem: DesignProblem
    options: DesignOptions
    postures: Array
    progress: Callable[[DesignProgress], None] | None
    starts: int = 0
    evaluations: int = 0
    is_stopped: bool = False

    def from_seeds(self, seeds: Sequence[int], budget: Budget) -> list[tuple[Array, SeedOutcome]]:
        """Return the best motions (f, nv) from random ones, and from the guess if there is one.

        A start has half of the time that is left, the last one all of it; those that it does not
        reach are left out.

        Raises:
            ArgumentError: Not even a first motion within the limits was found in time.
            StopSearch: It was stopped before there was one.
        """
        given = None if self.options.guess is None else self._given(self.options.guess)
        asked: list[int | None] = [*seeds, *([] if given is None else [None])]
        self.starts = len(asked)
        ends: list[tuple[Array, SeedOutcome]] = []
        first: Array | None = None
        for number, seed in enumerate(asked):
            own = budget.part(1.0 / min(self.starts - number, 2))  # few that end beat many
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
                self._stop(number, ends[-1][1].value)
                break
            first = guess if first is None else first
            ends.append(self._from(number, seed, guess, own))
        if not ends:
            raise ArgumentError(
                f"No motion within the limits was found in {self.options.seconds:g} s.",
                advice="Allow more seconds, or start from a motion that keeps them.",
            )
        return ends

    def _random(self, seed: int | None, budget: Budget) -> Array:
        """Return a random motion within the limits; a moment for it there is always."""
        least = Budget.of(max(budget.left, _A_MOMENT))
        return random_guess(self.problem, self.postures, np.random.default_rng(seed), least)

    def _given(self, guess: Array) -> Array:
        """Variables of the motion that was given.

        Raises:
            ArgumentError: It is of another family or robot.
        """
        expected = self.problem.offset.shape
        if np.shape(guess) != expected or not np.isfinite(guess).all():
            raise ArgumentError(
                f"The guess has the shape {np.shape(guess)} and must be {expected}, and finite.",
                advice="Take it from a trajectory of the same family.",
            )
        return self.problem.variables(np.asarray(guess, float))

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
        """Return the better of a motion and what a stage makes of it, and what the solver said."""
        problem = replace(self.problem, objective=replace(self.problem.objective, criterion=stage))
        reached, status = solve(
            problem,
            guess,
            solver=self.options.solver,
            iterations=self.options.iterations,
            seconds=_FOR_STAGE * budget.left,
            watch=lambda value, _: self._notify(number, value),
        )
        if status == INTERRUPTED:
            self._stop(number, self._value(guess))
            budget = self.for_a_closer_look(budget)
        inside = within_limits(self.problem, reached.reshape(guess.shape), guess, budget)
        return inside if self._value(inside) < self._value(guess) else guess, status

    def for_a_closer_look(self, budget: Budget) -> Budget:
        """Time to look at limits: what is left, or little once the design was stopped."""
        return Budget.of(min(budget.left, AFTER_STOP)) if self.is_stopped else budget

    def _stop(self, number: int, value: float) -> None:
        """Begin nothing more, and tell of it."""
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
        return [replace(criterion, sharpness=sharpness) for sharpness in self.options.sharpness]

    def _value(self, variables: Array) -> float:
        motion = self.problem.trajectory(variables).motion(self.problem.times)
        return self.problem.objective.value(motion)

    def _notify(self, number: int, value: float) -> None:
        self.evaluations += 1
        if self.progress is not None:
            self.progress(DesignProgress(number, self.starts, self.evaluations, value))
