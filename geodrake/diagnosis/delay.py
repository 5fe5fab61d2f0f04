"""Effort delays between those of a dataset's grid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.diagnosis.parabola import least_between
from geodrake.effects import FittedEffect
from geodrake.effects.delays import effort_delays
from geodrake.identification.logs.hypothesis import Hypothesis

Array = NDArray[np.float64]
Joints = tuple[int, ...]

_NO_TIME = 1e-9
"""A delay below this, s, is none: it is rounding."""


def seconds_of(hypothesis: Hypothesis) -> Array:
    """(nv,) delays of a hypothesis on top of its model's, s."""
    return hypothesis.dataset.delays[list(hypothesis.delay), np.arange(len(hypothesis.delay))]


def later(start: Hypothesis, end: Hypothesis) -> list[Joints]:
    """Joints whose efforts are advanced further by another hypothesis; see `late_together`.

    Args:
        start: The hypothesis before.
        end: The hypothesis after.
    """
    return late_together(seconds_of(end) - seconds_of(start))


def late_together(seconds: Array) -> list[Joints]:
    """Joints that are late together: all of them where delays (nv,) are alike, else each alone."""
    late = np.abs(seconds) > _NO_TIME
    if late.all() and np.ptp(seconds) <= _NO_TIME:
        return [tuple(range(len(seconds)))]
    return [(int(joint),) for joint in np.flatnonzero(late)]


def fine_delays(hypothesis: Hypothesis, late: Sequence[Joints]) -> tuple[Array, Array]:
    """`fine_delay` of groups of joints: (nv,) delays and deviations; others are as they are.

    Args:
        hypothesis: The hypothesis.
        late: Groups of joints, by index, that share one delay each.
    """
    delays, deviations = seconds_of(hypothesis), np.full(len(hypothesis.delay), np.inf)
    for joints in late:
        delays[[*joints]], deviations[[*joints]] = fine_delay(hypothesis, joints)
    return delays, deviations


def fitted_delays(delays: Array, joints: Sequence[str]) -> list[FittedEffect]:
    """The effects of a fitted model that make delays (nv,), s, at its joints.

    Args:
        delays: (nv,) delays, s.
        joints: Names of the nv joints.
    """
    none = np.empty(0)
    return [FittedEffect(effect, none, none) for effect in effort_delays(delays, joints)]


def fine_delay(hypothesis: Hypothesis, joints: Joints) -> tuple[float, float]:
    """The delay near that of a hypothesis at which its held-out squared error is least.

    Args:
        hypothesis: A hypothesis whose delay has neighbours on both sides of the grid.
        joints: Indices of the joints that have it.

    Returns:
        Delay on top of the model's, s, and its standard deviation, s, from a parabola through the
        squared errors of the delay and its neighbours, which are quadratic in small delays as
        likelihoods are not; the delay itself and infinity where there is no neighbour on one side,
        or no minimum between them.
    """
    delays, own = hypothesis.dataset.delays[:, joints[0]], hypothesis.delay[joints[0]]
    order, chosen = np.argsort(delays), delays[own]
    order = order[(delays[order] != chosen) | (order == own)]
    at = int(np.flatnonzero(order == own)[0])
    if not 0 < at < len(order) - 1:
        return float(chosen), np.inf
    near = order[at - 1 : at + 2]
    mse = hypothesis.held_out.mse
    weight = hypothesis.effective / np.maximum(mse, np.finfo(float).tiny)
    errors = [delayed_at(hypothesis, joints, d).held_out.mse @ weight for d in near.tolist()]
    least = least_between(delays[near] - chosen, np.array(errors))
    return float(chosen + least.step), least.deviation


def delayed_at(hypothesis: Hypothesis, joints: Joints, delay: int) -> Hypothesis:
    """A hypothesis with another delay (an index) at some joints.

    Args:
        hypothesis: The hypothesis.
        joints: Indices of the joints.
        delay: Index of the dataset's delay.
    """
    every = enumerate(hypothesis.delay)
    return hypothesis.delayed([delay if j in joints else own for j, own in every])
