"""The effects that a diagnosis tries: every effect at every place where it can be."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import catalogue
from geodrake.effects.base import Effect
from geodrake.effects.user_code import candidates_of
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

LONGEST_DELAY = 0.05
"""Delays between motion and effort are tried up to this one, s."""


def candidate_effects(
    model: RobotModel,
    peak_speeds: Array,
    extra: Sequence[type[Effect]] = (),
    *,
    known_gains: Collection[str] = (),
) -> tuple[Effect, ...]:
    """All instances of the catalogue's effects, and of a user's own, that a robot can have.

    Effects whose shape is found in a residual are not among them (see `proposals`), nor those of
    pairs of joints that do not follow each other (see `coupled`), nor those that only inertias
    known from other logs, or known payloads, identify.

    Args:
        model: The robot.
        peak_speeds: (nv,) largest speed of each joint in the logs; shape grids scale with it.
        extra: Further effect classes.
        known_gains: Joints at which known payloads take the place of known inertias, as
            `joints_with_known_gain` gives them.
    """
    single = [joint for joint in model.joints if joint in model.single_joints]
    known = [joint for joint in single if joint in known_gains]
    speed = dict(zip(model.joints, peak_speeds.tolist(), strict=True))
    found: list[Effect] = []
    for effect in (*catalogue(), *extra):
        unknown = effect.needs_known_inertia and model.information is None
        from_residual = effect.proposer is not None and effect.places != "joint_pair"
        if from_residual or (unknown and effect.places != "joint"):
            continue
        if effect.places == "joint":
            for joint in known if unknown else single:
                if effect.turning_only and joint in model.sliding_joints:
                    continue
                if speed[joint] > 0.0:
                    found.extend(candidates_of(effect, joint, speed[joint]))
        elif effect.places == "joint_pair":
            for pair in model.joint_pairs:
                found.extend(candidates_of(effect, pair))
        elif effect.places == "body":
            for body in model.bodies:
                found.extend(candidates_of(effect, body))
        elif effect.places == "robot":
            found.extend(candidates_of(effect))
    return tuple(found)


def candidate_delays(period: float, bandwidth: float) -> tuple[float, ...]:
    """Delays to try beside none, s: multiples of a step the data can resolve, to either side.

    Args:
        period: Time between two samples, s.
        bandwidth: Bandwidth of efforts and regressors, Hz.
    """
    step = max(period, LONGEST_DELAY / 10, min(0.02 / bandwidth, LONGEST_DELAY / 2))
    steps = np.arange(1, max(2, int(LONGEST_DELAY / step + 1e-9) + 1)) * step
    return (0.0, *steps.tolist(), *(-steps[: (len(steps) + 1) // 2]).tolist())
