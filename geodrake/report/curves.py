"""Curves small enough for a page: thinned without losing an extreme, and packed as text."""

from __future__ import annotations

import base64
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LARGEST = 32767
_MISSING = -32768


def floats(values: Array) -> str:
    """Values as 32 bit floats in base64."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode()


def packed(values: Array) -> tuple[float, float, str]:
    """Values as 16 bit integers: offset and scale to float, and the integers in base64.

    A value is offset + scale · integer; −32768 stands for a missing one.
    """
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    offset, scale = 0.5 * (low + high), 0.5 * (high - low) / _LARGEST
    whole = np.full(len(values), _MISSING, "<i2")
    known = np.isfinite(values)
    whole[known] = np.round((values[known] - offset) / scale) if scale > 0 else 0
    return offset, scale, base64.b64encode(whole.tobytes()).decode()


def decimated(time: Array, curves: Array, most: int) -> tuple[Array, Array]:
    """At most so many points of every curve, with each bucket's least and largest value.

    Args:
        time: (K,) increasing instants.
        curves: (C, K) values on them; NaN where lines break.
        most: Most points, at least four.

    Returns:
        (M,) instants and (C, M) values; two points stand for a bucket, in the order in which a
        curve has its extremes there.
    """
    count = len(time)
    if count <= most:
        return time, curves
    breaks = np.flatnonzero(np.isnan(curves).all(0))
    if 4 * len(breaks) > most:  # too many gaps to show
        return decimated(*_without(time, curves, breaks), most)
    edges = [0, *(breaks + 1).tolist()]
    ends = [*breaks.tolist(), count]
    share = (most - 3 * len(edges)) / count
    times, values = [], []
    for first, last in zip(edges, ends, strict=True):
        if last > first:
            t, v = _extremes(time[first:last], curves[:, first:last], int(share * (last - first)))
            times.append(t)
            values.append(v)
        if last < count:
            times.append(time[last : last + 1])
            values.append(curves[:, last : last + 1])
    return np.concatenate(times), np.concatenate(values, axis=1)


def _without(time: Array, curves: Array, breaks: NDArray[np.intp]) -> tuple[Array, Array]:
    return np.delete(time, breaks), np.delete(curves, breaks, axis=1)


def _extremes(time: Array, curves: Array, most: int) -> tuple[Array, Array]:
    buckets = max(1, most // 2)
    if len(time) <= 2 * buckets:
        return time, curves
    at = np.linspace(0, len(time), buckets + 1).astype(int)
    times, values = np.empty(2 * buckets), np.empty((len(curves), 2 * buckets))
    for k, (first, last) in enumerate(pairwise(at.tolist())):
        part = curves[:, first:last]
        filled = np.where(np.isnan(part), part[:, :1], part)
        pair = np.sort([filled.argmin(1), filled.argmax(1)], axis=0)
        values[:, 2 * k : 2 * k + 2] = np.take_along_axis(part, pair.T, axis=1)
        times[2 * k : 2 * k + 2] = time[first], time[first + (last - first) // 2]
    return times, values


def gap_filled(time: Array) -> Array:
    """Instants with those that are missing, where a line breaks, put between their neighbours.

    Args:
        time: (K,) increasing instants; NaN where a line breaks, never two in a row.
    """
    missing = np.isnan(time)
    index = np.arange(len(time))
    return np.interp(index, index[~missing], time[~missing]) if (~missing).any() else time[:0]
