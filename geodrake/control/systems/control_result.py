"""What an adaptive controller makes of one sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pydrake.systems.framework import Context

from geodrake.control.regressor.control_model import ControlSample
from geodrake.inertia import Array

Covector = Callable[[Context], Array | None]
"""Gives the covector b (p,) for the update law; None where there is nothing to adapt to."""


@dataclass(frozen=True, eq=False)
class ControlResult:
    """What a controller makes of one sample.

    Attributes:
        effort: (nv,) effort to be applied.
        sample: The robot as the effort has it.
        covector: Gives the covector for the update law; None where adaptation waits. Only this may
            read other ports than those of what was seen.
        limited: Whether efforts would have been beyond their limits.
    """

    effort: Array
    sample: ControlSample
    covector: Covector | None
    limited: bool = False
