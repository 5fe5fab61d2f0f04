"""`check_columns`: what columns are, if not what their names say, likeliest mistakes first."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.columns.evidence import ColumnFit, ColumnModel
from geodrake.diagnosis.columns.finding import ColumnFinding
from geodrake.diagnosis.columns.kinds import KINDS, words_of
from geodrake.diagnosis.columns.samples import column_samples
from geodrake.diagnosis.columns.search import ColumnSearch, Judged, MistakeFound
from geodrake.identification.logs.case import prepared_as_measured
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

MOST_JOINTS = 30
"""With more, weighing all that may be wrong takes minutes: nothing is checked."""

_LEAST_EFFORT = 1e-12  # N·m or N, by which efforts that were measured change
_WORTH_NAMING = 0.05  # probability of a rival


def check_columns(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    bandwidth: float | None = None,
    blocks: int | None = None,
) -> tuple[ColumnFinding, ...]:
    """Find mistakes in columns of logs: wrong signs, units, gains, zeros, times, swapped joints.

    Each mistake is an alternative assignment of columns to joints. One Gaussian evidence compares
    them, with bodies near the model's and free friction, offsets and rotors. Rivals are a payload,
    a tilted base, and efforts with an unknown component; `Beliefs` has the prior odds.

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
    samples = column_samples(model.with_volume, *prepared)
    if not (samples.effort.std(axis=0) > _LEAST_EFFORT).all():
        return ()  # which whoever fits them says
    gaussian = ColumnModel(samples, Beliefs())
    found = ColumnSearch(gaussian).found()
    return tuple(_finding(gaussian, step) for step in found if step.best.mistake.kind)


def _finding(gaussian: ColumnModel, found: MistakeFound) -> ColumnFinding:
    model, best, before = gaussian.samples.model, found.best, found.before
    kind, joints, values = _told(model, before, best)
    words, advice = words_of(kind, joints, values, all_joints=not best.mistake.joints)
    rivals = [
        (_rival_words(model, before, rival), chance)
        for rival, chance in found.rivals
        if chance >= _WORTH_NAMING
    ]
    return ColumnFinding(
        kind,
        joints,
        values,
        found.gain,
        found.probability,
        tuple(rivals),
        gaussian.nrms(before),
        gaussian.nrms(best.fit),
        words[0].upper() + words[1:],
        advice,
    )


def _rival_words(model: RobotModel, before: ColumnFit, rival: Judged) -> str:
    mistake, after = rival.mistake, rival.fit.assignment
    if mistake.kind:
        return words_of(*_told(model, before, rival), all_joints=not mistake.joints)[0]
    if mistake.joints:
        every = len(mistake.joints) == len(model.joints) > 1
        where = "all joints" if every else model.joints[mistake.joints[0]]
        return f"the efforts of {where} have an unknown component"
    if after.is_far and not before.assignment.is_far:
        return "bodies that differ much from the model's"
    tilted = after.gravity is not None and before.assignment.gravity is None
    return "a tilted base" if tilted else "a payload that the model lacks"


def _told(
    model: RobotModel, before: ColumnFit, judged: Judged
) -> tuple[str, tuple[str, ...], tuple[float, ...]]:
    """Return the kind of a mistake, its joints, and what corrects it at each of them."""
    mistake, was, is_now = judged.mistake, before.assignment, judged.fit.assignment
    at = list(mistake.joints or range(len(model.joints)))
    values = tuple[float, ...]()
    if mistake.kind == "effort_limit" and (limit := is_now.limit_of(at[0])) is not None:
        falls = np.isfinite(limit.no_load_speed)
        values = (limit.effort, limit.no_load_speed) if falls else (limit.effort,)
    elif mistake.kind == "time":
        values = (is_now.time / was.time,)
    elif mistake.kind == "position_zero":
        values = tuple((is_now.zero - was.zero)[at].tolist())
    elif len(KINDS[mistake.kind].changes) <= 2 and not mistake.kind.startswith("swapped"):
        for name in KINDS[mistake.kind].changes[:1]:
            values = tuple((getattr(is_now, name) / getattr(was, name))[at].tolist())
    return mistake.kind, tuple(model.joints[j] for j in at), values
