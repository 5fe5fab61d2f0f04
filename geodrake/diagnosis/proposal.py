"""What a residual suggests."""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.effects.base import Effect


@dataclass(frozen=True)
class Proposal:
    """An effect that a residual suggests.

    Attributes:
        effects: The effect with the shapes to try.
        share: Share of the squared error at its joint that it explains.
        alarm: Probability that noise alone suggests as much.
    """

    effects: tuple[Effect, ...]
    share: float
    alarm: float
