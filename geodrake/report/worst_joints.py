"""The joints that are shown where there is not room for all."""

from __future__ import annotations

import numpy as np

from geodrake.identification.logs.model_errors import ErrorTable

MOST_JOINTS = 8


def worst_joints(errors: ErrorTable, most: int = MOST_JOINTS) -> tuple[str, ...]:
    """The joints of largest error over standard deviation, in the table's order.

    The joint of largest RMS is always among them, and one whose error is no number counts as worst.
    """
    nrms = np.array([joint.nrms for joint in errors.joints])
    rms = np.array([joint.rms for joint in errors.joints])
    order = np.argsort(-np.nan_to_num(nrms, nan=np.inf), kind="stable")
    worst = int(np.argmax(np.nan_to_num(rms, nan=np.inf)))
    chosen = [*order[:most]]
    if most > 1 and worst not in chosen:
        chosen[-1] = worst
    return tuple(errors.joints[i].joint for i in sorted(chosen))


def of_worst(shown: int, joints: int) -> str:
    """What to say where not all joints are shown."""
    if shown >= joints:
        return ""
    return f"The {shown} joints of largest nrms, of {joints}."
