"""Shape parameters of effects: what a law is not linear in."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from geodrake.boundary.arguments import instance, instances, number, one_of

_SCALES = ("", "speed", "reach", "duration", "temperature")
_LINEAR = (("kg·m²", "kg"), ("N·m", "N"), ("rad", "m"))


@dataclass(frozen=True)
class Shape:
    """A shape parameter of an effect: its unit, and the values that a diagnosis tries.

    Attributes:
        name: Name of the field of the effect, or of a value that it reports.
        unit: SI unit at a joint that turns.
        grid: Values to try, as shares of a size if there is a `scale`; none for the default.
        scale: Size that the grid is relative to: "speed", the joint's peak speed, "reach", its
            range of motion, "duration", that of the longest log, or "temperature", its mean.
        usual: The value to try where that size is not known.
    """

    name: str
    unit: str = "1"
    grid: tuple[float, ...] = ()
    scale: str = ""
    usual: float | None = None

    def __post_init__(self) -> None:
        for what in ("name", "unit"):
            instance(getattr(self, what), what, str)
        for value in instances(self.grid, "grid", (int, float)):
            number(value, "grid")
        one_of(self.scale, "scale", _SCALES)
        if self.usual is not None:
            number(self.usual, "usual")

    def values(self, scales: Mapping[str, float]) -> tuple[float, ...]:
        """The values to try, where some sizes are known."""
        if not self.scale and self.grid:
            return self.grid
        if self.scale in scales:
            return tuple(scales[self.scale] * share for share in self.grid)
        return () if self.usual is None else (self.usual,)


def when_sliding(unit: str) -> str:
    """The unit at a joint that slides of what has some unit at one that turns."""
    for angular, linear in _LINEAR:
        unit = unit.replace(angular, linear)
    return re.sub(r"\((\w+)\)", r"\1", unit)  # m/(N) is m/N
