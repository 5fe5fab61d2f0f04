"""`check_columns`: what columns are, if not what their names say, likeliest mistakes first."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.evidence import ColumnFit, ColumnModel
from geodrake.diagnosis.columns.finding import ColumnFinding, mistake_advice, mistake_words
from geodrake.diagnosis.columns.samples import column_samples
from geodrake.diagnosis.columns.search import ColumnSearch, Judged, MistakeFound
from geodrake.identification.logs.case import prepared_as_measured
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_LEAST_EFFORT = 1e-12  # N·m or N, by which efforts that were measured change
MOST_JOINTS = 30
"""With more, weighing all that may be wrong takes minutes: nothing is checked."""
_WORTH_NAMING = 0.05  # probability of a rival


def check_columns(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    bandwidth: float | None = None,
    blocks: int | None = None,
) -> tuple[ColumnFinding, ...]:
    """Find mistakes in columns of logs: wrong signs, units, gains, zeros, times, swapped joints.

    Every mistake is another assignment of columns to joints, and one Gaussian evidence weighs them:
    bodies near the model's, friction, offsets and rotors free. Its rivals are a payload, a slope,
    and efforts that have something unknown in them; `Beliefs` has the prior odds.

    Args:
        model: The model as it stands.
        logs: Logs or their files, all recorded alike.
        bandwidth: Bandwidth of the filter, Hz; by default chosen from the motion.
        blocks: Blocks into which every log is cut, within which residuals are correlated.

    Returns:
        What is wrong, in the order in which to correct it; nothing if the columns are right, if
        the logs do not tell, if an effort never changes, which fits refuse, or if there are more
        than 30 joints, as weighing all that may be wrong with them takes minutes.

    Raises:
        LogError: A log cannot be used.
        ArgumentError: There is no log, or a setting is no usable number.
    """
    prepared = prepared_as_measured(model, logs, bandwidth=bandwidth, blocks=blocks)
    if len(model.joints) > MOST_JOINTS:
        return ()
    samples = column_samples(model, *prepared)
    if not (samples.effort.std(axis=0) > _LEAST_EFFORT).all():
        return ()  # which whoever fits them says
    gaussian = ColumnModel(samples, Beliefs())
    found = ColumnSearch(gaussian).found()
    return tuple(_finding(gaussian, step) for step in found if step.best.mistake.kind)


def _finding(gaussian: ColumnModel, found: MistakeFound) -> ColumnFinding:
    joints, best = gaussian.parameters.model.joints, found.best
    mistake = best.mistake
    at = mistake.joints or tuple(range(len(joints)))
    names = tuple(joints[j] for j in at)
    values = _values(found.before.assignment, best)
    words = mistake_words(mistake.kind, names, values, all_joints=not mistake.joints)
    rivals = [
        (_rival_words(joints, found.before, rival), chance)
        for rival, chance in found.rivals
        if chance >= _WORTH_NAMING
    ]
    return ColumnFinding(
        mistake.kind,
        names,
        values,
        found.gain,
        found.probability,
        tuple(rivals),
        gaussian.nrms(found.before),
        gaussian.nrms(best.fit),
        words[0].upper() + words[1:],
        mistake_advice(mistake.kind, names, values),
    )


def _rival_words(joints: Sequence[str], before: ColumnFit, rival: Judged) -> str:
    mistake = rival.mistake
    if not mistake.kind:
        if mistake.joints:
            return f"the efforts of {joints[mistake.joints[0]]} have something unknown in them"
        tilted = rival.fit.assignment.tilted and not before.assignment.tilted
        return "a base on a slope" if tilted else "a payload that the model lacks"
    names = [joints[j] for j in mistake.joints or range(len(joints))]
    values = _values(before.assignment, rival)
    return mistake_words(mistake.kind, names, values, all_joints=not mistake.joints)


def _values(before: Assignment, best: Judged) -> tuple[float, ...]:
    """What corrects a mistake, at each of its joints."""
    kind, after = best.mistake.kind, best.fit.assignment
    if kind.startswith(("swapped", "without", "effort_magnitude")):
        return ()
    if kind == "time":
        return (after.time / before.time,)
    if kind == "effort_limit":
        limit = after.limit_of(best.mistake.joints[0])
        falls = np.isfinite(limit.no_load_speed)
        return (limit.effort, limit.no_load_speed) if falls else (limit.effort,)
    at = list(best.mistake.joints or range(len(after.gain)))
    if kind == "position_zero":
        return tuple((after.zero - before.zero)[at].tolist())
    quantity = {"effort": "gain", "position": "scale", "velocity": "rate"}[kind.split("_")[0]]
    return tuple((getattr(after, quantity) / getattr(before, quantity))[at].tolist())
