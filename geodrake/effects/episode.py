"""What acts during a window of one log."""

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


@dataclass(frozen=True)
class Episode(BodyEffect):
    """What acts at a point P of a body during a window of time. Subclasses define `columns`.

    It is an event of one log, no property of the robot: where time is not known, or the log is
    another one, there is none. Its weight is w = ½ tanh((t − t₀)/r) − ½ tanh((t − t₁)/r): one from
    the start t₀ to the end t₁, zero before and after, with edges of duration r.

    Attributes:
        start: t₀, s since the log began.
        end: t₁, s since the log began.
        rise: r, s.
        log: Number of the log, from `log_number`; 0 for any.
        x: Position of P from the body's origin Bo along x of the body's frame, m.
        y: The same along y.
        z: The same along z.
        turning: 1 where what acts turns with the body, 0 where it keeps its direction in the world.
    """

    start: float
    end: float
    rise: float = 0.01
    log: int = 0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    turning: int = 0

    role = Role.EPISODE
    proposer = Proposer.EPISODE
    shapes = (
        *(Shape(name, "s") for name in ("start", "end", "rise")),
        *(Shape(axis, "m") for axis in "xyz"),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not -np.inf < self.start < self.end < np.inf:
            raise ArgumentError(
                f"{self.name} needs a start before its end; it got {self.start} and {self.end} s."
            )
        require_positive(self, "rise")
        if self.turning not in (0, 1):
            raise ArgumentError(f"turning of {self.name} must be 0 or 1; it is {self.turning}.")

    @abc.abstractmethod
    def columns(self, body: BodyMotion, time: Array) -> Array:
        """Columns (N, nv, k) at a motion of the body and instants (N,) since the log began, s.

        Args:
            body: Motion of the body, N samples.
            time: (N,) instants since the log began, s.
        """

    def weight(self, time: Array) -> Array:
        """W (N,) at instants since the log began, s."""
        after, before = ((time - edge) / self.rise for edge in (self.start, self.end))
        return np.asarray(0.5 * (np.tanh(after) - np.tanh(before)))

    def rows(self, motion: RobotMotion) -> dict[str, Array]:
        """The columns in the window, at the joints that move the body."""
        body = motion.body_motions(self.name).motion(self.body)
        columns = np.zeros((len(motion.v), len(motion.joints), len(self.parameters)))
        if motion.time is not None and self.log in (0, motion.log):
            columns = self.columns(body, motion.time)
        return {motion.joints[i]: columns[:, i] for i in body.dofs}

    @property
    def place(self) -> str:
        """The body and the window."""
        turning = " turning with it," if self.turning else ""
        return f"{self.body},{turning} {self.start:.2f}–{self.end:.2f} s"

    @property
    def point(self) -> Array:
        """(3,) position of P from Bo in the body's frame, m."""
        return np.array([self.x, self.y, self.z])

    @property
    def reported_shape(self) -> dict[str, float]:
        """Window and point: its place says whether it turns, and the log's number says nothing."""
        shape = super().reported_shape.items()
        return {name: value for name, value in shape if name not in ("log", "turning")}

    @property
    def free_shapes(self) -> int:
        """Start, end, rise and point, which is none where the wrench turns with the body."""
        return 3 if self.turning else 6

    @classmethod
    def candidates(cls, body: str) -> tuple[Self, ...]:
        """The first second of a log; a diagnosis looks for the window instead."""
        return cls.in_window(body, 0.0, 1.0)

    @classmethod
    def in_window(cls, body: str, start: float, end: float, **shape: Any) -> tuple[Self, ...]:
        """What may act on a body in a window: what keeps its direction, and what turns with it.

        Args:
            body: Name of the body.
            start: t₀, s since the log began.
            end: t₁, s since the log began.
            shape: Other shape parameters.
        """
        make: Callable[..., Self] = cls
        return tuple(make(body, start, end, **shape, turning=turning) for turning in (0, 1))
