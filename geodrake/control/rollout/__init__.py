"""Rollouts: the model simulated under the measured efforts, compared with the measured motion.

Where `geodrake.diagnosis.compare` asks which effort a motion needs, a rollout asks which motion an
effort makes. Every window of a log starts at the measured state; from there on the simulated robot
is alone with the efforts that were logged, until the window ends.
"""

from __future__ import annotations

from geodrake.control.rollout.results import Rollout
from geodrake.control.rollout.roll_out import roll_out

__all__ = [
    "Rollout",
    "roll_out",
]
