"""Errors of the log or its clock: offsets, slow drift, swings that follow no joint."""

from __future__ import annotations

import numpy as np
from scipy.fft import next_fast_len

from geodrake.diagnosis.drafting.results import Array
from geodrake.diagnosis.results import Correlate
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.hypothesis import Hypothesis, residual_blocks

_LEAST_SHARE = 0.25
"""The clock is reported if it explains at least this share of the squared error."""

_FINER = 8  # steps of the spectrum in one that the log resolves


def clock_correlates(case: Case, hypothesis: Hypothesis, joint: str) -> list[Correlate]:
    """Return what a joint's held-out error owes to the clock of its log, or to which log it is.

    These are slow drift and the strongest oscillation, where notable; several logs have no clock in
    common, but each may have a mean of its own. Amplitudes are fitted to all folds but one, and
    judged on that one.
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
        apart = _share(means, residual, fold)
        found = [Correlate(joint, "the log: its mean differs between logs", apart)]
    else:
        late = (time - time.min()) / max(float(np.ptp(time)), 1e-9)
        drift = _share(np.stack([np.ones_like(late), late, late**2], -1), residual, fold)
        frequency = _strongest(time, residual)
        angle = 2.0 * np.pi * frequency * time
        swing = _share(np.stack([np.cos(angle), np.sin(angle)], -1), residual, fold)
        found = [
            Correlate(joint, "time: a slow drift", drift),
            Correlate(joint, f"time: an oscillation at {frequency:.3g} Hz", swing),
        ]
    return [correlate for correlate in found if correlate.share > _LEAST_SHARE]


def _strongest(time: Array, residual: Array) -> float:
    """Frequency of the largest line in the spectrum, Hz, three periods in the log at least."""
    step = float(np.median(np.diff(np.sort(time))))
    place = np.round((time - time.min()) / step).astype(int)
    grid = np.zeros(int(place.max()) + 1)
    grid[place] = residual  # gaps between blocks stay zero
    padded = next_fast_len(_FINER * len(grid))
    spectrum = np.abs(np.fft.rfft(grid, padded))
    spectrum[: round(3 * padded / len(grid))] = 0.0
    return float(np.argmax(spectrum) / (padded * step))


def _share(columns: Array, residual: Array, fold: Array) -> float:
    """Return the share of the squared residual columns (N, k) take away from folds left out."""
    count = int(fold.max()) + 1
    gram = np.array([columns[fold == f].T @ columns[fold == f] for f in range(count)])
    rhs = np.array([columns[fold == f].T @ residual[fold == f] for f in range(count)])
    ridge = 1e-9 * np.trace(gram.sum(0)) * np.eye(columns.shape[1])
    amplitudes = np.linalg.solve(gram.sum(0) - gram + ridge, (rhs.sum(0) - rhs)[..., None])[..., 0]
    left = residual - np.einsum("nk,nk->n", columns, amplitudes[fold])
    return float(1.0 - left @ left / max(residual @ residual, 1e-300))
