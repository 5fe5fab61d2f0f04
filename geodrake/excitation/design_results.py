"""How a design is made, where it is, and what it came to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import instance, instances, integer, number, positive, real_array
from geodrake.boundary.showing import Short, Shown
from geodrake.excitation.collisions import CollisionWorld
from geodrake.excitation.information import Objective
from geodrake.excitation.limits import MotionLimits
from geodrake.excitation.margins import LimitUse
from geodrake.excitation.trajectory import ExcitationTrajectory
from geodrake.logs.motion import Motion

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DesignOptions(Short):
    """How a design is made.

    Attributes:
        samples: Number of samples by which information is counted.
        rest: Whether the motion starts and ends at rest, without a jump of acceleration.
        start: (nv,) positions at the start by joint, rad or m; free if None. Free samples have no
            start, and none is looked at.
        collisions: What may not be hit.
        solver: "snopt" or "ipopt". Where much may collide, one may go far where the other stops.
        iterations: Most iterations of the solver, for each stage.
        seconds: Most time of the whole design, which its starts share, s.
        sharpness: Stages of the smooth forms of E-optimality and condition number; see
            `Criterion`.
        guess: (count, nv) coefficients of a motion to start from, besides the random ones. What
            is beyond the limits is scaled down.
    """

    samples: int = 300
    rest: bool = True
    start: ArrayLike | None = None
    collisions: CollisionWorld | None = None
    solver: str = "snopt"
    iterations: int = 300
    seconds: float = 180.0
    sharpness: tuple[float, ...] = (8.0, 64.0)
    guess: Array | None = None

    def __post_init__(self) -> None:
        for name in ("samples", "iterations"):
            integer(getattr(self, name), name, upper=_MOST)
        positive(self.seconds, "seconds")
        instance(self.solver, "solver", str)
        for sharpness in instances(self.sharpness, "sharpness", object):
            number(sharpness, "sharpness", lower=0.0, finite=False)
        if self.start is not None:
            real_array(self.start, "start", ("nv",))
        if self.guess is not None:
            real_array(self.guess, "guess")
        if self.collisions is not None:
            instance(self.collisions, "collisions", CollisionWorld)


_MOST = 1_000_000


@dataclass(frozen=True)
class DesignProgress:
    """Where a design is.

    Attributes:
        seed: Number of the start, from zero.
        evaluations: Evaluations of the criterion since the design began.
        value: What is minimized, now: the criterion's logarithm; limits may not yet be kept.
        is_stopped: Whether the design was stopped, and only the best motion is looked at.
    """

    seed: int
    seeds: int
    evaluations: int
    value: float
    is_stopped: bool = False


@dataclass(frozen=True)
class SeedOutcome:
    """What one start came to.

    Attributes:
        seed: Of the random motion that it began with; None for a given motion.
        random_value: Criterion of the motion that it began with, which keeps the limits.
        value: Criterion of the motion that it ended with, which keeps them too.
        evaluations: Evaluations of the criterion and its gradient.
    """

    seed: int | None
    random_value: float
    value: float
    evaluations: int
    seconds: float
    status: str


@dataclass(frozen=True, eq=False)
class ExcitationResult(Shown):
    """A designed motion.

    Attributes:
        objective: The criterion that it is best by, with the target.
        value: Its value, as the source defines it (not the logarithm).
        eigenvalues: (n_B,) of the normalized information matrix, ascending: the inverse variances
            of an estimate from `samples` samples, along its principal directions.
        samples: Number of samples that count.
        use: What it uses of its limits, all of which it keeps.
        outcomes: What each seed came to.
        is_interrupted: Whether the design was stopped before its end.
    """

    trajectory: ExcitationTrajectory
    objective: Objective
    value: float
    eigenvalues: Array
    samples: int
    use: LimitUse
    limits: MotionLimits
    outcomes: tuple[SeedOutcome, ...]
    notes: tuple[str, ...] = ()
    is_interrupted: bool = False

    @property
    def motion(self) -> Motion:
        """The samples that the value is of."""
        return self.trajectory.motion(self.trajectory.family.times(self.samples))
