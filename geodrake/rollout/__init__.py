"""Rollouts: the model simulated under the measured efforts, held against the measured motion.

Where `geodrake.diagnosis.compare` asks which effort a motion needs, a rollout asks which motion an
effort makes. Every window of a log starts at the measured state; from there on the simulated robot
is alone with the efforts that were logged, until the window ends.
"""

from __future__ import annotations

from geodrake.rollout.results import JointDeparture, Rollout, Window
from geodrake.rollout.roll_out import HORIZON, MOST_WINDOWS, roll_out

__all__ = ["HORIZON", "MOST_WINDOWS", "JointDeparture", "Rollout", "Window", "roll_out"]
