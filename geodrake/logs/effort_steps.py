"""Efforts that come in steps, as those of coarse converters do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from geodrake.logs.motion import JointLog

Array = NDArray[np.float64]

_ROWS = 20_000  # of a log that are looked at
_FEWEST, _MOST = 3, 500  # steps between the least and the greatest value
_TOLERANCE = 0.1  # of a distance between values, as printed numbers are rounded
_SHARE = 0.95  # of the distances between values that are whole steps
_ROUNDING = 1e-9  # of the largest value
_LEAST_SHARE = 0.25  # of the noise's power that steps make


def step_notes(log: JointLog) -> Iterator[str]:
    """Which efforts come in steps that make a good part of their noise, in words.

    A step s makes a noise of deviation s/√12. Numbers that are printed with few digits come in
    steps, too; where their noise is much larger nothing is said.
    """
    steps = dict(zip(log.joints, effort_steps(log).tolist(), strict=True))
    coarse = {joint: step for joint, step in steps.items() if step > 0.0}
    if coarse:
        each = ", ".join(
            f"{joint} of {step:.3g} (noise {step / np.sqrt(12.0):.2g})"
            for joint, step in coarse.items()
        )
        yield (
            f"efforts come in steps: {each}; a step over √12 is the deviation of the noise that it "
            "makes in single readings, before they are filtered"
        )


def effort_steps(log: JointLog) -> Array:
    """(n,) steps of the efforts of each joint, in their unit; 0 where none dominates the noise."""
    return np.array([_step(column) for column in log.effort[:_ROWS].T])


def _step(readings: Array) -> float:
    """The step of some readings (N,) in time, 0 for none."""
    readings = readings[np.isfinite(readings)]
    values = np.unique(readings)
    if len(values) < _FEWEST:
        return 0.0
    gaps = np.diff(values)
    gaps = gaps[gaps > _ROUNDING * np.abs(values).max()]
    reach = values[-1] - values[0]
    for step in (float(gaps.min()), float(np.median(gaps))) if len(gaps) else ():
        counts = np.rint(gaps / step)
        whole = (np.abs(gaps / step - counts) <= _TOLERANCE * counts) & (counts > 0)
        if reach <= _MOST * step and whole.mean() >= _SHARE:
            return step if _makes_the_noise(step, readings) else 0.0
    return 0.0


def _makes_the_noise(step: float, readings: Array) -> bool:
    """Whether a step makes a good part of the noise of readings, as their bends show it."""
    noise = np.sqrt(np.mean(np.diff(readings, 2) ** 2) / 6.0)
    return bool(step**2 / 12.0 >= _LEAST_SHARE * noise**2)
