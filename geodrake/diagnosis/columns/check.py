"""Detection of mistakes in log columns (`check_columns`)."""

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
"""With more joints, comparing all possible mistakes takes minutes: nothing is checked."""

_LEAST_EFFORT = 1e-12  # N·m or N, smallest standard deviation of measured efforts
_LEAST_RIVAL = 0.05  # probability of a rival to be reported


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
    a tilted base, and efforts with an unknown component; `Beliefs` contains the prior odds.

    Args:
        model: The model.
        logs: Logs or their files, all recorded alike.
        bandwidth: Bandwidth of the filter, Hz; by default chosen from the motion.
        blocks: Number of blocks into which every log is split; residuals correlate within a block.

    Returns:
        Mistakes, in the order in which to correct them. Empty if the columns are right, if the
        logs do not show it, if an effort never changes (fits leave it out), or if there are over
        30 joints (the comparison would take minutes).

    Raises:
        LogError: A log cannot be used.
        ArgumentError: There is no log, or a setting is invalid.
    """
    prepared = prepared_as_measured(model, logs, bandwidth=bandwidth, blocks=blocks)
    if len(model.joints) > MOST_JOINTS:
        return ()
    samples = column_samples(model.with_volume, *prepared)
    if not (samples.effort.std(axis=0) > _LEAST_EFFORT).all():
        return ()  # fits leave it out
    gaussian = ColumnModel(samples, Beliefs())
    steps = ColumnSearch(gaussian).steps()
    return tuple(_finding(gaussian, step) for step in steps if step.best.mistake.kind)


def _finding(gaussian: ColumnModel, step: MistakeFound) -> ColumnFinding:
    model, best, before = gaussian.samples.model, step.best, step.before
    kind, joints, values = _correction(model, before, best)
    words, advice = words_of(kind, joints, values, all_joints=not best.mistake.joints)
    rivals = [
        (_rival_words(model, before, rival), chance)
        for rival, chance in step.rivals
        if chance >= _LEAST_RIVAL
    ]
    return ColumnFinding(
        kind,
        joints,
        values,
        step.gain,
        step.probability,
        tuple(rivals),
        gaussian.nrms(before),
        gaussian.nrms(best.fit),
        words[0].upper() + words[1:],
        advice,
    )


def _rival_words(model: RobotModel, before: ColumnFit, rival: Judged) -> str:
    mistake, after = rival.mistake, rival.fit.assignment
    if mistake.kind:
        return words_of(*_correction(model, before, rival), all_joints=not mistake.joints)[0]
    if mistake.joints:
        every = len(mistake.joints) == len(model.joints) > 1
        where = "all joints" if every else model.joints[mistake.joints[0]]
        return f"the efforts of {where} have an unknown component"
    if after.is_far and not before.assignment.is_far:
        return "bodies that differ much from the model's"
    tilted = after.gravity is not None and before.assignment.gravity is None
    return "a tilted base" if tilted else "a payload that the model lacks"


def _correction(
    model: RobotModel, before: ColumnFit, judged: Judged
) -> tuple[str, tuple[str, ...], tuple[float, ...]]:
    """Return the kind of a mistake, its joints, and the value that corrects it at each."""
    mistake, previous, current = judged.mistake, before.assignment, judged.fit.assignment
    joints = list(mistake.joints or range(len(model.joints)))
    values = tuple[float, ...]()
    if mistake.kind == "effort_limit" and (limit := current.limit_of(joints[0])) is not None:
        falls = np.isfinite(limit.no_load_speed)
        values = (limit.effort, limit.no_load_speed) if falls else (limit.effort,)
    elif mistake.kind == "time":
        values = (current.time / previous.time,)
    elif mistake.kind == "position_zero":
        values = tuple((current.zero - previous.zero)[joints].tolist())
    elif len(KINDS[mistake.kind].changes) <= 2 and not mistake.kind.startswith("swapped"):
        for name in KINDS[mistake.kind].changes[:1]:
            values = tuple((getattr(current, name) / getattr(previous, name))[joints].tolist())
    return mistake.kind, tuple(model.joints[j] for j in joints), values
