"""Rollouts: simulation of a model under logged efforts or commands, compared with the motion.

While `geodrake.diagnosis.compare` computes the effort of a motion, a rollout computes the motion
due to an effort. Each window of a log starts at the measured state. Until its end, the simulation
uses only the logged efforts or commands.
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
