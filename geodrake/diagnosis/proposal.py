"""What a residual suggests."""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.effects.base import Effect


@dataclass(frozen=True)
class Proposal:
    """An effect that a residual suggests."""

    effects: tuple[Effect, ...]  # the effect with the shapes to try
    share: float  # share of the squared error at its joint that it explains
    alarm: float  # probability that noise alone suggests as much
