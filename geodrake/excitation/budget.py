"""Time that a design may take, and what stops it when that is up."""

from __future__ import annotations

import time
from dataclasses import dataclass


class OutOfTimeError(Exception):
    """Time is up; what is found by then is what counts. It never leaves a design."""


@dataclass(frozen=True)
class Budget:
    """Time on the clock of the wall.

    Attributes:
        end: Instant at which it is up, by `time.monotonic`, s.
    """

    end: float

    @classmethod
    def of(cls, seconds: float) -> Budget:
        """So many seconds from now on."""
        return cls(time.monotonic() + seconds)

    @property
    def left(self) -> float:
        """What is left of it, s; negative once it is up."""
        return self.end - time.monotonic()

    def part(self, share: float) -> Budget:
        """A share of what is left, from now on."""
        return Budget.of(share * self.left)

    def check(self) -> None:
        """Stop what is going on.

        Raises:
            OutOfTimeError: The time is up.
        """
        if self.left <= 0.0:
            raise OutOfTimeError


UNLIMITED = Budget(float("inf"))
