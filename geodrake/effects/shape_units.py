"""Units of what is told of effects beside their linear parameters."""

from __future__ import annotations

from collections.abc import Mapping

_LINEAR = (("kg·m²", "kg"), ("N·m", "N"), ("rad", "m"))

SHAPE_UNITS: Mapping[str, str] = {
    "mass": "kg",
    **{f"com_{axis}": "m" for axis in "xyz"},
    **dict.fromkeys(("delay", "time_constant", "start", "end", "rise"), "s"),
    **dict.fromkeys(("center", "breakaway_angle", "half_width", "about_x", "about_y"), "rad"),
    **dict.fromkeys("xyz", "m"),
    "stribeck_velocity": "rad/s",
}
"""Unit of a shape, a delay or a payload's mass and centre, by its name, at joints that turn.

What is not here is a plain number.
"""


def when_sliding(unit: str) -> str:
    """The unit at a joint that slides of what has some unit at one that turns."""
    for angular, linear in _LINEAR:
        unit = unit.replace(angular, linear)
    return unit
