"""Effort delays between those of a dataset's grid."""

from __future__ import annotations

import numpy as np

from geodrake.diagnosis.hypothesis import Hypothesis


def fine_delay(hypothesis: Hypothesis) -> tuple[float, float]:
    """The delay near that of a hypothesis at which its held-out squared error is least.

    Args:
        hypothesis: A hypothesis whose delay has neighbours on both sides of the grid.

    Returns:
        Delay on top of the model's, s, and its standard deviation, s, from a parabola through the
        squared errors of the delay and its neighbours, which are quadratic in small delays as
        likelihoods are not; the delay itself and NaN where there is no neighbour on one side, or no
        minimum between them.
    """
    delays = np.array(hypothesis.dataset.delays)
    order, chosen = np.argsort(delays), delays[hypothesis.delay]
    order = order[(delays[order] != chosen) | (order == hypothesis.delay)]
    at = int(np.flatnonzero(order == hypothesis.delay)[0])
    if not 0 < at < len(order) - 1:
        return float(chosen), np.nan
    near = order[at - 1 : at + 2]
    mse = hypothesis.held_out.mse
    weight = hypothesis.effective / np.maximum(mse, np.finfo(float).tiny)
    errors = [hypothesis.delayed(int(d)).held_out.mse @ weight for d in near]
    offsets = delays[near] - chosen
    curvature, slope, _ = np.polyfit(offsets, errors, 2)
    if curvature <= 0.0:
        return float(chosen), np.nan
    step = np.clip(-slope / (2.0 * curvature), offsets[0], offsets[-1])
    return float(chosen + step), float(1.0 / np.sqrt(curvature))
