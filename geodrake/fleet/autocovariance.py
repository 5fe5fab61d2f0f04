"""How much of what a fit leaves is of one kind for a while: what samples are worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from geodrake.effects import Effect
from geodrake.fleet.digest import Digest
from geodrake.fleet.digest_dataset import digest_dataset, model_of_digests
from geodrake.fleet.settings import DigestSettings
from geodrake.identification.logs.dataset import Dataset, JointData
from geodrake.identification.logs.hypothesis import CrossValidation
from geodrake.identification.logs.model_fit import model_unknowns
from geodrake.identification.logs.unknowns import Unknowns
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_ROUNDS = 2  # of weighing joints by what samples are worth
_FIRST_SHARE = 0.05  # of samples that are worth something, before anything is known


def with_autocovariances(
    digest: Digest,
    model: RobotModel,
    data: Sequence[JointData],
    *,
    extra: Sequence[type[Effect]] = (),
) -> Digest:
    """A digest with the autocovariances of what the refitted model leaves of each block.

    The model's bodies and effects are fitted to the other blocks, within what was known of them.

    Args:
        model: The model as it was given when the settings were made.
        data: The rows of its joints, over the columns of the digest.
        extra: Effect classes of the user's own that have columns.
    """
    dataset = digest_dataset(digest, model, extra=extra)
    unknowns = model_unknowns(dataset, model_of_digests(model, digest.settings))
    moving = digest.effort_std > 0.0
    power = np.where(moving, digest.effort_std, 1.0) ** 2
    share = np.full(len(digest.joints), _FIRST_SHARE)
    for _ in range(_ROUNDS):
        weights = np.where(moving, share / power, 0.0)
        x = CrossValidation(dataset, unknowns, weights, physical=False).held_out.x
        digest = _with(digest, data, _parameters(dataset, unknowns, x, digest.settings))
        share = digest.effective_share
    return digest


def _parameters(dataset: Dataset, unknowns: Unknowns, x: Array, settings: DigestSettings) -> Array:
    """(B, p) parameters of the columns of digests, of those of unknowns (B, ·)."""
    inertial, base = settings.base_matrix.shape[1], len(settings.independent)
    width = inertial + len(settings.columns) - base
    every = np.zeros((width, len(x)))
    np.add.at(every, unknowns.columns, x.T)
    return np.hstack([every[:inertial].T @ settings.base_matrix.T, every[inertial:].T])


def _with(digest: Digest, data: Sequence[JointData], x: Array) -> Digest:
    lags = digest.settings.lags
    return replace(
        digest,
        joints=tuple(
            replace(
                joint,
                autocovariances=np.array(
                    [
                        _of_block(
                            [each.b[:, 0] - each.A @ own[joint.columns] for each in rows],
                            int(count),
                            lags,
                        )
                        for rows, own, count in zip(rows_of.rows, x, rows_of.samples, strict=True)
                    ]
                ),
            )
            for joint, rows_of in zip(digest.joints, data, strict=True)
        ),
    )


def _of_block(residuals: Sequence[Array], samples: int, lags: int) -> Array:
    """(lags,) sums of r_t r_{t+k} over stretches without gaps, as if all samples had been kept."""
    total, kept = np.zeros(lags), sum(map(len, residuals))
    for r in residuals:
        size = next_fast_len(len(r) + lags, real=True)
        transform = rfft(r, size)
        total += irfft(np.square(transform.real) + np.square(transform.imag), size)[:lags]
    return total * (samples / max(kept, 1))
