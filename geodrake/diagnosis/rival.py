"""An effect that logs cannot tell from one that was added."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Rival:
    """What could have been added instead of an effect, as far as the log tells.

    Attributes:
        effect: Name; two names joined by " + " for effects found together.
        where: Joints or bodies.
        instead_of: Names of the effects that were added.
        error: Held-out nrms with the rival, everything that may move refitted.
        error_of_choice: The same with what was added, at the time of the choice.
        tie_probability: Chance that the rival is truly no worse than what was added.
    """

    effect: str
    where: tuple[str, ...]
    instead_of: tuple[str, ...]
    error: float
    error_of_choice: float
    tie_probability: float

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its effects."""
        return tuple(self.effect.split(" + "))
