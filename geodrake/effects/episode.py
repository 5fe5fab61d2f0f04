"""Effects during part of one log."""

from __future__ import annotations

import abc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from geodrake.effects.base import (
    Array,
    BodyEffect,
    Proposer,
    RobotMotion,
    Role,
    Shape,
    require_positive,
)
from geodrake.effects.body_motion import BodyMotion
from geodrake.errors import ArgumentError


class Episode(BodyEffect):
    """An effect on a body during part of one log.

    It is an event of that log, not a property of the robot: it is zero in other logs, or without
    time. Its weight is w = ½ tanh((t − t₀)/r) − ½ tanh((t − t₁)/r): one from the start t₀ to the
    end t₁, zero before and after, with edges of duration r.

    Subclasses are dataclasses with the fields `start` and `end`, s since the log began, None if
    outside the log; `rise`, r in s; and `log`, the identifier from `log_number`, or 0 for any log.
    """

    start: Any
    end: Any
    rise: Any
    log: Any

    role = Role.EPISODE

    def __post_init__(self) -> None:
        super().__post_init__()
        start, end = self._edges
        if not start < end:
            raise ArgumentError(
                f"{self.name} needs a start before its end; it got {start} and {end} s."
            )
        require_positive(self, "rise")

    @property
    def window(self) -> tuple[float | None, float | None, float, int]:
        """Start, end, rise, and identifier of the log."""
        return self.start, self.end, self.rise, self.log

    @property
    def _edges(self) -> tuple[float, float]:
        start, end, _, _ = self.window
        return -np.inf if start is None else start, np.inf if end is None else end

    def weight(self, time: Array) -> Array:
        """Return w (N,) at times since the log began, s."""
        after, before = ((time - edge) / self.window[2] for edge in self._edges)
        return np.asarray(0.5 * (np.tanh(after) - np.tanh(before)))

    def is_of(self, log: int) -> bool:
        """Return whether it is an event of the log with this identifier."""
        return self.window[3] in (0, log)

    @property
    def when(self) -> str:
        """The time window in words."""
        start, end, _, _ = self.window
        if end is None:
            return "all of one log" if start is None else f"from {start:.2f} s on"
        return f"until {end:.2f} s" if start is None else f"{start:.2f}–{end:.2f} s"


@dataclass(frozen=True)
class PointEpisode(Episode):
    """An effect at a point P of a body during an episode. Subclasses define `columns`."""

    start: float  # t₀, s since the log began
    end: float  # t₁, s since the log began
    rise: float = 0.01  # r, s
    log: int = 0  # identifier from `log_number`; 0 for any log
    x: float = 0.0  # position of P from the body's origin Bo along x of the body's frame, m
    y: float = 0.0
    z: float = 0.0
    turning: int = 0  # 1 if forces are fixed in the body's frame, 0 if fixed in the world

    proposer = Proposer.EPISODE
    shapes = (
        *(Shape(name, "s") for name in ("start", "end", "rise")),
        *(Shape(axis, "m") for axis in "xyz"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.turning not in (0, 1):
            raise ArgumentError(f"turning of {self.name} must be 0 or 1; it is {self.turning}.")

    @abc.abstractmethod
    def columns(self, body: BodyMotion, time: Array) -> Array:
        """Return columns (N, nv, k) for the body's motion at times (N,) since the log began, s."""

    def rows(self, motion: RobotMotion) -> dict[str, Array]:
        """Return the columns in the window, at the joints that move the body."""
        body = motion.body_motions(self.name).motion(self.body)
        columns = np.zeros((len(motion.v), len(motion.joints), len(self.parameters)))
        if motion.time is not None and self.is_of(motion.log):
            columns = self.columns(body, motion.time)
        return {motion.joints[i]: columns[:, i] for i in body.dofs}

    @property
    def place(self) -> str:
        """The body and the window."""
        turning = " turning with it," if self.turning else ""
        return f"{self.body},{turning} {self.when}"

    @property
    def point(self) -> Array:
        """(3,) position of P from Bo in the body's frame, m."""
        return np.array([self.x, self.y, self.z])

    @property
    def reported_shape(self) -> dict[str, float]:
        """Window and point."""
        shape = super().reported_shape.items()
        return {name: value for name, value in shape if name not in ("log", "turning")}

    @property
    def free_shapes(self) -> int:
        """Start, end and rise, and the point unless forces turn with the body."""
        return 3 if self.turning else 6

    @classmethod
    def candidates(cls, body: str) -> tuple[Self, ...]:
        """Return the effect in the first second of a log; a diagnosis proposes windows instead."""
        return cls.in_window(body, 0.0, 1.0)

    @classmethod
    def in_window(cls, body: str, start: float, end: float, **shape: Any) -> tuple[Self, ...]:
        """Return the candidates in a window: forces fixed in the world, or in the body's frame."""
        make: Callable[..., Self] = cls
        return tuple(make(body, start, end, **shape, turning=turning) for turning in (0, 1))
