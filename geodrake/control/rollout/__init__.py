"""Rollouts: the model simulated under logged efforts or commands, compared with the motion.

Where `geodrake.diagnosis.compare` asks which effort a motion needs, a rollout asks which motion an
effort makes. Every window of a log starts at the measured state; from there on the simulated robot
is alone with the efforts, or the commands, that were logged, until the window ends.
"""

from __future__ import annotations

from geodrake.control.rollout.fit_rollouts import FittedValue, RolloutFit, fit_rollouts
from geodrake.control.rollout.roll_out import Rollout, case_rollout, commanded_motions, roll_out

__all__ = [
    "FittedValue",
    "Rollout",
    "RolloutFit",
    "case_rollout",
    "commanded_motions",
    "fit_rollouts",
    "roll_out",
]
