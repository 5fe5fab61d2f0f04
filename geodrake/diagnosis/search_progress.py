"""What a search tells of itself while it goes on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import Effect
from geodrake.identification.logs.case import error_table
from geodrake.identification.logs.hypothesis import Hypothesis


@dataclass(frozen=True)
class FoundStep:
    """A step of a search, as it is taken; what comes later may still change it.

    Attributes:
        effect: Name of what was found; several joined by " + ".
        where: Joints or bodies.
        before: Held-out nrms before.
        after: Held-out nrms after.
        start: Held-out nrms before the first step.
        floor: nrms of the sensor noise; zero if the logs show none.
        is_last: Whether the search was stopped here; what was found is being fitted once more.
    """

    effect: str
    where: tuple[str, ...]
    before: float
    after: float
    start: float
    floor: float
    is_last: bool = False

    @property
    def share(self) -> float:
        """How far the error has come on its way to the noise, by its logarithm, from 0 to 1."""
        way = np.log(self.start / max(self.floor, _LEAST * self.start))
        done = np.log(self.start / max(self.after, _LEAST * self.start))
        return float(np.clip(done / way, 0.0, 1.0)) if way > 0 else 1.0


_LEAST = 1e-3
"""Noise that the logs do not show is taken for so much of the first error."""

Progress = Callable[[FoundStep], None]
"""Called with each step. It may raise `StopSearch`: what was found by then is the result."""


def found_step(
    start: Hypothesis, before: Hypothesis, after: Hypothesis, names: Sequence[str]
) -> FoundStep:
    """The step from one hypothesis to another.

    Args:
        start: The first hypothesis of the search.
        before: The hypothesis before.
        after: The hypothesis after.
        names: What was added, where no effect shows it, as with a delay of all efforts.
    """
    new = [e for e in after.unknowns.effects if e not in before.unknowns.effects]
    return FoundStep(
        " + ".join(dict.fromkeys(effect.name for effect in new)) or " + ".join(names),
        _places(new),
        before.nrms,
        after.nrms,
        start.nrms,
        error_table(after.dataset, after.held_out).floor_nrms,
    )


def _places(effects: Sequence[Effect]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for effect in effects for name in effect.where))
