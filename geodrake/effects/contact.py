"""Something that a body pushes against for a while."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import Array, BodyEffect, Parameter, RobotMotion, require_positive
from geodrake.effects.body_motion import BodyMotion
from geodrake.errors import ArgumentError


@dataclass(frozen=True)
class Contact(BodyEffect):
    """Contact of a body during a window of time.

    effort = w(t) (J_vᵀ f + J_ωᵀ m), with w = ½ tanh((t − t₀)/r) − ½ tanh((t − t₁)/r): one from the
    start t₀ to the end t₁, zero before and after, with edges of duration r.

    f (N) is the force that the body applies to what it touches, at its point P, and m (N·m) the
    moment about P; both keep their direction in the world frame. What pushes the robot applies −f.

    It is an event of one log, no property of the robot: where time is not known, or the log is
    another one, there is none.

    Attributes:
        start: t₀, s since the log began.
        end: t₁, s since the log began.
        rise: r, s.
        log: Number of the log, from `log_number`; 0 for any.
        x: Position of P from the body's origin Bo along x of the body's frame, m.
        y: The same along y.
        z: The same along z.
    """

    start: float
    end: float
    rise: float = 0.01
    log: int = 0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    name = "contact"
    parameters = (
        *(Parameter(f"force_{axis}", "N") for axis in "xyz"),
        *(Parameter(f"moment_{axis}", "N·m") for axis in "xyz"),
    )
    signature = "at several joints at once, for a while, and then no more"
    confused_with = ("payload", "wrong_inertia", "coulomb_friction")
    from_residual = True
    sees_bodies = True
    sees_time = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not -np.inf < self.start < self.end < np.inf:
            raise ArgumentError(
                f"{self.name} needs a start before its end; it got {self.start} and {self.end} s."
            )
        require_positive(self, "rise")

    @property
    def place(self) -> str:
        """The body and the window."""
        return f"{self.body}, {self.start:.2f}–{self.end:.2f} s"

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """[J_vᵀ, J_ωᵀ] within the window, at the joints that move the body."""
        body = motion.body_motions(self.name).motion(self.body)
        columns = np.zeros((len(motion.v), len(motion.joints), len(self.parameters)))
        if motion.time is not None and self.log in (0, motion.log):
            columns = self.columns(body, motion.time)
        return {motion.joints[i]: columns[:, i] for i in body.dofs}

    def columns(self, body: BodyMotion, time: Array) -> Array:
        """Columns (N, nv, 6) at a motion of the body and instants (N,) since the log began, s."""
        after, before = ((time - edge) / self.rise for edge in (self.start, self.end))
        within = 0.5 * (np.tanh(after) - np.tanh(before))
        J = np.concatenate([body.jacobian_at(self.point), body.angular], 1)
        return np.asarray(within[:, None, None] * J.transpose(0, 2, 1))

    @property
    def point(self) -> Array:
        """(3,) position of P from Bo in the body's frame, m."""
        return np.array([self.x, self.y, self.z])

    @property
    def free_shapes(self) -> int:
        """Start, end, rise and place."""
        return 6

    @classmethod
    def candidates(cls, body: str) -> tuple[Contact, ...]:
        """The first second of a log; a diagnosis looks for the window instead."""
        return (cls(body, 0.0, 1.0),)


def log_number(name: str) -> int:
    """A number that tells a log from others."""
    return zlib.crc32(name.encode(errors="surrogateescape")) or 1
