"""Residuals that depend on the log or its clock: offsets, drift and oscillations."""

from __future__ import annotations

import numpy as np
from scipy.fft import next_fast_len

from geodrake.diagnosis.drafting.results import Array
from geodrake.diagnosis.results import Correlate
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.hypothesis import Hypothesis, residual_blocks

_LEAST_SHARE = 0.25
"""Share of the squared error that the clock must explain to be reported."""

_OVERSAMPLING = 8  # of the spectrum


def clock_correlates(case: Case, hypothesis: Hypothesis, joint: str) -> list[Correlate]:
    """Return how a joint's held-out error correlates with time, or with the choice of log.

    A single log is tested for slow drift and for its strongest oscillation; several logs are tested
    for different means. Amplitudes are cross-validated.
    """
    dataset = hypothesis.dataset
    j = dataset.joints.index(joint)
    blocks = residual_blocks(
        dataset, hypothesis.unknowns.columns, hypothesis.held_out.x, delay=hypothesis.delay
    )
    residual = np.concatenate(blocks[j])
    parts = [
        (f, block.trajectory, rows.time)
        for f, (fold, kept) in enumerate(zip(case.folds, dataset.data[j].rows, strict=True))
        for block, rows in zip(fold.blocks, kept, strict=False)
    ]
    time = np.concatenate([t for *_, t in parts])
    fold, log = (np.concatenate([np.full(len(p[2]), p[k]) for p in parts]) for k in (0, 1))
    if len(dataset.logs) > 1:
        means = (log[:, None] == np.arange(len(dataset.logs))).astype(float)
        share = _share(means, residual, fold)
        correlates = [Correlate(joint, "the log: its mean differs between logs", share)]
    else:
        elapsed = (time - time.min()) / max(float(np.ptp(time)), 1e-9)
        drift = _share(np.stack([np.ones_like(elapsed), elapsed, elapsed**2], -1), residual, fold)
        frequency = _strongest(time, residual)
        angle = 2.0 * np.pi * frequency * time
        swing = _share(np.stack([np.cos(angle), np.sin(angle)], -1), residual, fold)
        correlates = [
            Correlate(joint, "time: a slow drift", drift),
            Correlate(joint, f"time: an oscillation at {frequency:.3g} Hz", swing),
        ]
    return [correlate for correlate in correlates if correlate.share > _LEAST_SHARE]


def _strongest(time: Array, residual: Array) -> float:
    """Return the frequency of the largest spectral line, Hz, of at least three periods."""
    step = float(np.median(np.diff(np.sort(time))))
    index = np.round((time - time.min()) / step).astype(int)
    grid = np.zeros(int(index.max()) + 1)
    grid[index] = residual  # gaps between blocks stay zero
    padded = next_fast_len(_OVERSAMPLING * len(grid))
    spectrum = np.abs(np.fft.rfft(grid, padded))
    spectrum[: round(3 * padded / len(grid))] = 0.0
    return float(np.argmax(spectrum) / (padded * step))


def _share(columns: Array, residual: Array, fold: Array) -> float:
    """Return the share of the squared residual that columns (N, k) remove from held-out folds."""
    count = int(fold.max()) + 1
    gram = np.array([columns[fold == f].T @ columns[fold == f] for f in range(count)])
    rhs = np.array([columns[fold == f].T @ residual[fold == f] for f in range(count)])
    ridge = 1e-9 * np.trace(gram.sum(0)) * np.eye(columns.shape[1])
    amplitudes = np.linalg.solve(gram.sum(0) - gram + ridge, (rhs.sum(0) - rhs)[..., None])[..., 0]
    remainder = residual - np.einsum("nk,nk->n", columns, amplitudes[fold])
    return float(1.0 - remainder @ remainder / max(residual @ residual, 1e-300))
