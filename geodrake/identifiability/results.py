"""What logs can tell of a model, as plain frozen dataclasses, and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from geodrake.excitation import IdentifiableParameters
from geodrake.model import RobotModel

Array = NDArray[np.float64]

_NOTHING = 1e-9  # parameters of a block that are rounding
_HALF, _FULL = 0.5, 0.9  # shares of a block below and above which it is not told, and is


@dataclass(frozen=True)
class ToldBlock:
    """How much of a body or of an effect logs tell.

    Attributes:
        name: Of the body, or of the effect: "<parameter> of <effect>" if it has several.
        where: Joints or body of the effect; () for a body.
        told: How many of its parameters are told, 0 to 10 for a body and 0 to 1 for an effect;
            part of one can be.
        possible: How many the best of motions could tell.
        value: Of an effect's parameter, its value in the model, or that of a fit to the logs; NaN
            for a body.
        deviation: Of an effect's parameter, the deviation of an estimate from these logs alone, in
            its own unit; infinite where they say nothing, NaN for a body.
        effect: Name of the effect; "" for a body.
        parameter: Name of the effect's parameter; "" for a body.
    """

    name: str
    where: tuple[str, ...]
    told: float
    possible: float
    value: float = np.nan
    deviation: float = np.nan
    effect: str = ""
    parameter: str = ""

    @property
    def share(self) -> float:
        """Told over possible; zero where nothing is possible."""
        return self.told / self.possible if self.possible > _NOTHING else 0.0

    @property
    def is_told(self) -> bool:
        """Whether it is mostly told."""
        return self.share >= _HALF


@dataclass(frozen=True)
class ToldCombination:
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
class LogIdentifiability:
    """What logs can tell of a model.

    Attributes:
        model: The model, with the effects that were asked for.
        identifiable: Directions with their variances, and how many are told.
        bodies: Every body, payloads included.
        effects: Every parameter of an effect.
        combinations: Every base parameter.
        noise: (nv,) deviation that a filtered sample counts with, N·m or N.
        floor: (nv,) estimated sensor noise after filtering, N·m or N.
        floor_variances: (n_B,) variances if the sensor noise were all there is, ascending.
        samples: (nv,) filtered samples of each joint.
        notes: What was done to the logs and noticed about the model.
    """

    model: RobotModel
    identifiable: IdentifiableParameters
    bodies: tuple[ToldBlock, ...]
    effects: tuple[ToldBlock, ...]
    combinations: tuple[ToldCombination, ...]
    noise: Array
    floor: Array
    floor_variances: Array
    samples: NDArray[np.int_]
    notes: tuple[str, ...]

    @property
    def told(self) -> int:
        """How many directions are told."""
        return self.identifiable.kept

    @property
    def possible(self) -> int:
        """How many the best of motions could tell."""
        return len(self.identifiable.variances)

    @property
    def blocks(self) -> tuple[str, ...]:
        """Names of the rows of `identifiable.shares`: bodies, payloads, parameters of effects."""
        carriers = (f.effect.where[0] for f in self.identifiable.target.payloads)
        return (
            *(body.name for body in self.bodies),
            *(f"payload of {name}" for name in carriers),
            *(f"{entry.name} of {_places(entry.where)}" for entry in self.effects),
        )

    @property
    def told_at_floor(self) -> int:
        """How many directions were told if the sensor noise were all there is."""
        return int(np.count_nonzero(self.floor_variances <= self.identifiable.threshold))

    @property
    def untold(self) -> tuple[ToldCombination, ...]:
        """The base parameters whose relative deviation is above the threshold, worst first."""
        most = np.sqrt(self.identifiable.threshold)
        rest = [c for c in self.combinations if not c.relative <= most]
        return tuple(sorted(rest, key=lambda c: -c.relative))

    def verdict(self) -> str:
        """What all this amounts to, in a few sentences."""
        most = 100 * np.sqrt(self.identifiable.threshold)
        words = (
            f"The logs tell {self.told} of {self.possible} directions to within {most:.3g} %"
            f"{self._whose_bodies()}."
        )
        unknown = [f"{e.name} of {_places(e.where)}" for e in self.effects if not e.is_told]
        if unknown:
            words += f" Not told: {_listed(unknown)}."
        elif self.effects:
            words += " All parameters of effects are told."
        if self.told_at_floor > self.told:
            words += (
                f" With a model that leaves nothing but sensor noise they would tell "
                f"{self.told_at_floor}."
            )
        return words

    def _whose_bodies(self) -> str:
        """Which bodies are told in full, and which not at all."""
        seen = [b for b in self.bodies if b.possible >= _HALF]
        full = [b.name for b in seen if b.share > _FULL]
        none = [b.name for b in seen if b.share < 1.0 - _FULL]
        words = f"; all there is to tell of {_listed(full)}" if full else ""
        return f"{words}; hardly anything of {_listed(none)}" if none else words


def _places(where: Sequence[str]) -> str:
    return "/".join(where) or "the robot"


def _listed(names: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    head, tail = ", ".join(names[:-1]), "".join(names[-1:])
    return f"{head} and {tail}" if head else tail
