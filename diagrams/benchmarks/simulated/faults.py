"""Faults of recording, caused by drivers, buses and files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from diagrams.benchmarks.simulated.engines import Array, Generator
from geodrake.logs import JointLog


@dataclass
class Columns:
    """Columns of a log of n joints that faults modify, and a random generator."""

    time: Array  # (N,) s
    q: Array  # (N, n)
    v: Array | None
    effort: Array  # (N, n)
    kept: Array  # (N,) whether rows are written
    limits: Array  # (n,) of efforts
    rng: Generator

    @property
    def period(self) -> float:
        """Time between rows, s."""
        return float(np.median(np.diff(self.time)))


def _lagging(values: Array, seconds: float, period: float) -> Array:
    """Return values (N, n) after a first-order low-pass filter."""
    share = period / (seconds + period)
    return np.asarray(lfilter([share], [1.0, share - 1.0], values - values[0], axis=0) + values[0])


def _jitter(log: Columns) -> None:
    late = np.abs(log.rng.normal(0.0, 0.25 * log.period, len(log.time)))
    log.time = log.time + np.minimum(late, 0.9 * log.period)


def _lost_rows(log: Columns) -> None:
    log.kept &= log.rng.random(len(log.time)) > 0.03


def _gaps(log: Columns) -> None:
    for _ in range(8):
        first = int(log.rng.integers(len(log.time)))
        log.kept[first : first + int(log.rng.uniform(0.05, 0.7) / log.period)] = False


def _coarse_encoders(log: Columns) -> None:
    step = 2.0 * np.pi / float(log.rng.choice((4096, 16384, 65536)))
    log.q = np.round(log.q / step) * step


def _lagging_velocities(log: Columns) -> None:
    speeds = np.gradient(log.q, log.time, axis=0)
    log.v = _lagging(speeds, float(log.rng.uniform(0.01, 0.04)), log.period)


def _no_velocities(log: Columns) -> None:
    log.v = None


def _coarse_velocities(log: Columns) -> None:
    if log.v is not None:
        step = float(log.rng.uniform(0.01, 0.05)) * np.abs(log.v).max(axis=0)
        log.v = np.round(log.v / step) * step


def _lagging_positions(log: Columns) -> None:
    seconds = float(log.rng.uniform(0.003, 0.01))
    log.q = _lagging(log.q, seconds, log.period)
    log.v = None if log.v is None else _lagging(log.v, seconds, log.period)


def _filtered_efforts(log: Columns) -> None:
    log.effort = _lagging(log.effort, float(log.rng.uniform(0.004, 0.015)), log.period)


def _held_efforts(log: Columns) -> None:
    rows = int(log.rng.choice((2, 3, 4)))
    log.effort = log.effort[np.arange(len(log.time)) // rows * rows]


def _coarse_efforts(log: Columns) -> None:
    step = float(log.rng.uniform(0.002, 0.01)) * log.limits
    log.effort = np.round(log.effort / step) * step


def _clipped_efforts(log: Columns) -> None:
    joint = int(log.rng.integers(log.effort.shape[1]))
    most = float(np.quantile(np.abs(log.effort[:, joint]), 0.97))
    log.effort[:, joint] = np.clip(log.effort[:, joint], -most, most)


def _spikes(log: Columns) -> None:
    shape = log.effort.shape
    sizes = log.rng.choice((-1.0, 1.0), shape) * log.rng.uniform(0.3, 1.0, shape) * log.limits
    log.effort = log.effort + np.where(log.rng.random(shape) < 1e-3, sizes, 0.0)


def _noisy_joint(log: Columns) -> None:
    effort = log.effort[:, int(log.rng.integers(log.effort.shape[1]))]
    effort += log.rng.normal(0.0, 0.2 * effort.std(), len(effort))


def _few_digits(log: Columns) -> None:
    log.time, log.q = np.round(log.time, 4), np.round(log.q, 4)
    log.v = None if log.v is None else np.round(log.v, 3)
    log.effort = np.round(log.effort, 2 if log.limits.max() > 5.0 else 3)


FAULTS: Mapping[str, Callable[[Columns], None]] = {
    "jittered stamps": _jitter,
    "lost rows": _lost_rows,
    "gaps": _gaps,
    "coarse encoders": _coarse_encoders,
    "lagging velocities": _lagging_velocities,
    "no velocities": _no_velocities,
    "coarse velocities": _coarse_velocities,
    "lagging positions": _lagging_positions,
    "filtered efforts": _filtered_efforts,
    "held efforts": _held_efforts,
    "coarse efforts": _coarse_efforts,
    "clipped efforts": _clipped_efforts,
    "spikes": _spikes,
    "a noisy joint": _noisy_joint,
    "few digits": _few_digits,
}

LATE_BY = frozenset({"jittered stamps", "lagging positions", "filtered efforts", "held efforts"})
"""Faults that shift efforts in time relative to the motion."""


def spoiled(log: JointLog, faults: tuple[str, ...], limits: Array, rng: Generator) -> JointLog:
    """Return a log with faults, applied in the order of `FAULTS`; efforts have limits (n,)."""
    kept = np.ones(len(log.time), bool)
    columns = Columns(log.time, log.position, log.velocity, log.effort.copy(), kept, limits, rng)
    for name, spoil in FAULTS.items():
        if name in faults:
            spoil(columns)
    rows = columns.kept & np.concatenate([[True], np.diff(columns.time) > 0.0])
    return replace(
        log,
        time=columns.time[rows],
        position=columns.q[rows],
        velocity=None if columns.v is None else columns.v[rows],
        effort=columns.effort[rows],
    )
