"""What is identifiable of a model from logs, as plain frozen dataclasses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Shown
from geodrake.excitation.identifiable import IdentifiableParameters
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_NOTHING = 1e-9  # parameters of a block that are rounding
_HALF = 0.5  # share of a block above which it counts as identifiable


@dataclass(frozen=True)
class IdentifiableBlock:
    """How much of a body or of an effect is identifiable.

    Attributes:
        name: Of the body, or of the effect: "<parameter> of <effect>" if it has several.
        where: Joints or body of the effect; () for a body.
        count: How many of its parameters are identifiable, 0 to 10 for a body and 0 to 1 for an
            effect; part of one can be.
        possible: How many are from the best of motions.
        value: Of an effect's parameter, its value in the model, or that of a fit to the logs; NaN
            for a body.
        deviation: Of an effect's parameter, the deviation of an estimate from these logs alone, in
            its own unit; infinite where they say nothing, NaN for a body.
        effect: Name of the effect; "" for a body.
        parameter: Name of the effect's parameter; "" for a body.
    """

    name: str
    where: tuple[str, ...]
    count: float
    possible: float
    value: float = np.nan
    deviation: float = np.nan
    effect: str = ""
    parameter: str = ""

    @property
    def label(self) -> str:
        """Its name, and of an effect where it acts."""
        place = "/".join(self.where) or "the robot"
        return f"{self.name} of {place}" if self.effect else self.name

    @property
    def share(self) -> float:
        """Identifiable over possible; zero where nothing is possible."""
        return self.count / self.possible if self.possible > _NOTHING else 0.0

    @property
    def is_identifiable(self) -> bool:
        """Whether most of it is identifiable."""
        return self.share >= _HALF


@dataclass(frozen=True)
class ParameterCombination:
    """A base parameter.

    Attributes:
        words: The combination, such as "Izz of column + Iyy of arm".
        value: Its value in the model, SI units.
        deviation: Deviation of an estimate from the logs alone; infinite where they say nothing.
        relative: The deviation over the size that such a parameter has, which is geometric: it
            depends neither on frames nor on units.
    """

    words: str
    value: float
    deviation: float
    relative: float


@dataclass(frozen=True, eq=False)
class LogIdentifiability(Shown):
    """What is identifiable of a model from logs.

    Attributes:
        model: The model, with the effects that were asked for.
        identifiable: Directions with their variances, and how many are identifiable.
        effects: Every parameter of an effect.
        noise: (nv,) deviation that a filtered sample counts with, N·m or N.
        floor: (nv,) estimated sensor noise after filtering, N·m or N.
        floor_variances: (n_B,) variances if the sensor noise were all there is, ascending.
        samples: (nv,) filtered samples of each joint.
        notes: What was done to the logs and noticed about the model.
    """

    model: RobotModel
    identifiable: IdentifiableParameters
    bodies: tuple[IdentifiableBlock, ...]
    effects: tuple[IdentifiableBlock, ...]
    combinations: tuple[ParameterCombination, ...]
    noise: Array
    floor: Array
    floor_variances: Array
    samples: NDArray[np.int_]
    notes: tuple[str, ...]

    @property
    def count(self) -> int:
        """How many directions are identifiable."""
        return self.identifiable.kept

    @property
    def possible(self) -> int:
        """How many are from the best of motions."""
        return len(self.identifiable.variances)

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of the rows of `identifiable.shares`: bodies, payloads, parameters of effects."""
        carriers = (f.effect.where[0] for f in self.identifiable.target.payloads)
        return (
            *(body.name for body in self.bodies),
            *(f"payload of {name}" for name in carriers),
            *(entry.label for entry in self.effects),
        )

    @property
    def count_at_floor(self) -> int:
        """How many directions would be if the sensor noise were all there is."""
        return int(np.count_nonzero(self.floor_variances <= self.identifiable.threshold))

    @property
    def unidentifiable(self) -> tuple[ParameterCombination, ...]:
        """The base parameters whose relative deviation is above the threshold, worst first."""
        most = np.sqrt(self.identifiable.threshold)
        rest = [c for c in self.combinations if not c.relative <= most]
        return tuple(sorted(rest, key=lambda c: -c.relative))
