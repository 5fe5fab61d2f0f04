"""A body that the robot holds during a part of a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import Array, Proposer, RobotMotion, Shape, Values
from geodrake.effects.episode import Episode
from geodrake.effects.payload import Payload
from geodrake.manifolds import Manifold


@dataclass(frozen=True)
class TemporaryPayload(Episode):
    """Rigid body that a link holds from when it is picked up until it is put down.

    effort = w(t) Y_B(q, v, v̇) φ, with the weight w of the episode (see `Episode`) and the payload's
    φ as that of `Payload`.

    Attributes:
        start: When it is picked up, s since the log began; None if it was before.
        end: When it is put down, s since the log began; None if it is not.
        rise: How long that takes, s.
        log: Number of the log, from `log_number`; 0 for any.
    """

    start: float | None = None
    end: float | None = None
    rise: float = 0.01
    log: int = 0

    name = "temporary_payload"
    law = "w(t) Y φ: a payload that is picked up or put down in a log"
    list_position = 60.5
    complexity = 2
    proposer = Proposer.HANDLING
    summary = Payload.summary
    shapes = tuple(Shape(name, "s") for name in ("start", "end", "rise"))
    parameters = Payload.parameters
    signature = "a load that is another one from some instant on"
    depends_on = frozenset({"q", "v", "vd", "time"})

    @property
    def window(self) -> tuple[float | None, float | None, float, int]:
        """When it is picked up and put down, how long that takes, and number of the log."""
        return self.start, self.end, self.rise, self.log

    @property
    def place(self) -> str:
        """Return the body, and when it holds the payload."""
        return f"{self.body}, {self.when}"

    @property
    def free_shapes(self) -> int:
        """Return how many of start and end there are."""
        return (self.start is not None) + (self.end is not None)

    @property
    def reported_shape(self) -> dict[str, float]:
        """Return when it is picked up and put down: the log's number says nothing."""
        shape = super().reported_shape.items()
        return {name: value for name, value in shape if name in ("start", "end")}

    @classmethod
    def unit_of(cls, name: str) -> str:
        """Unit of a parameter, or of what results report."""
        return "s" if name in ("start", "end", "rise") else Payload.unit_of(name)

    def reported(self, parameters: Array, deviations: Array) -> tuple[Values, Values]:
        """Mass and centre of mass with their standard deviations, and when it is held."""
        values, unsure = Payload(self.body).reported(parameters, deviations)
        return values | self.reported_shape, unsure

    @property
    def manifold(self) -> Manifold:
        """Inertial parameters of a body that can exist."""
        return Payload(self.body).manifold

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """The link's ten inertial columns at every joint, while it holds the payload."""
        held = np.zeros(len(motion.v))
        if motion.time is not None and self.is_of(motion.log):
            held = self.weight(motion.time)
        columns = held[:, None, None] * motion.body_columns(self.body)
        return {joint: columns[:, i] for i, joint in enumerate(motion.joints)}
