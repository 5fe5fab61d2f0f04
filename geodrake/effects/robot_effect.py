"""Effects of the whole robot."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from geodrake.effects.base import Effect


@dataclass(frozen=True)
class RobotEffect(Effect):
    """An effect of the whole robot. Subclasses define `name`, `parameters`, `rows`."""

    places: ClassVar[str] = "robot"
    depends_on: ClassVar[frozenset[str]] = frozenset({"q", "v", "vd", "load", "bodies"})

    @property
    def where(self) -> tuple[str, ...]:
        """Nothing: it is everywhere."""
        return ()

    @classmethod
    def candidates(cls) -> Iterable[Effect]:
        """Instances a diagnosis should try."""
        return (cls(),)
