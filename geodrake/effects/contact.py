"""Something that a body pushes against for a while."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geodrake.effects.base import Array, Parameter
from geodrake.effects.body_motion import BodyMotion
from geodrake.effects.episode import PointEpisode


@dataclass(frozen=True)
class Contact(PointEpisode):
    """Contact of a body during a window of time.

    effort = w(t) (J_vᵀ f + J_ωᵀ m), with the weight w of the window (see `Episode`).

    f (N) is the force that the body applies to what it touches, at its point P, and m (N·m) the
    moment about P. What pushes the robot applies −f. Both keep their direction in the world frame,
    as where something heavy is leaned on, or in the body's, as a tool's or a jet's.
    """

    name = "contact"
    law = "Jᵀ F of a wrench on a body during an episode, found in the residual"
    list_position = 63
    complexity = 3
    parameters = (
        *(Parameter(f"force_{axis}", "N") for axis in "xyz"),
        *(Parameter(f"moment_{axis}", "N·m") for axis in "xyz"),
    )
    signature = "at several joints at once, for a while, and then no more"
    depends_on = frozenset({"q", "time", "bodies"})

    def columns(self, body: BodyMotion, time: Array) -> Array:
        """[w J_vᵀ, w J_ωᵀ] (N, nv, 6) at the point P and instants (N,) since the log began, s."""
        J = np.stack([body.jacobian_at(self.point), body.angular], 1)  # (N, 2, 3, nv)
        if self.turning:
            J = body.rotation[:, None].transpose(0, 1, 3, 2) @ J
        columns = J.reshape(len(J), 6, J.shape[-1]).transpose(0, 2, 1)
        return np.asarray(self.weight(time)[:, None, None] * columns)
