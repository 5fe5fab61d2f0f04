"""What parameters may be off by beyond noise: by gains of efforts, and by what is unexplained."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Role
from geodrake.identification.fit import FitResult
from geodrake.identification.logs.criteria import WORTH
from geodrake.identification.logs.dataset import Dataset
from geodrake.identification.logs.unknowns import Unknowns
from geodrake.identification.normal_equations import scaled_cholesky, solved

Array = NDArray[np.float64]


def gain_shifts(
    dataset: Dataset, unknowns: Unknowns, weights: Array, fit: FitResult, *, known: bool
) -> Array:
    """(nv, p) what the parameters of a fit change by with the gain of each joint's efforts.

    A wrong gain 1 + g of joint j moves them by g times its row, to first order; that of a joint
    whose gain is fitted moves nothing else. It acts on the measured effort, of which known payloads
    are a part. It has gone into a model that was fitted to efforts of the same gains before: then
    what it moves is only what has changed since.

    Args:
        dataset: The reduced logs.
        unknowns: What was fitted.
        weights: (nv,) weight of a squared residual of each joint.
        fit: The fit.
        known: Whether the prior is that of a model which was fitted before.
    """
    pulls = np.zeros((len(dataset.joints), len(unknowns.columns)))
    fitted = {effect.where[0] for effect in unknowns.effects if effect.role is Role.SCALE}
    for j, (data, weight) in enumerate(zip(dataset.data, weights, strict=True)):
        if dataset.joints[j] in fitted:
            continue
        local = data.local(unknowns.columns)
        if known:
            gram = data.products(local, local).sum(axis=2)
            pull = gram @ (fit.x - unknowns.mean)
        else:
            pull = data.products(np.array([len(data.columns)]), local)[0].sum(axis=1)
        carried = np.append(data.carried.sum(axis=0), 0.0)[local]  # 0 where the joint sees nothing
        pulls[j] = weight * (pull + carried)
    return _moved(fit, pulls.T).T


def unexplained_covariance(
    dataset: Dataset, unknowns: Unknowns, weights: Array, fit: FitResult, samples: Array
) -> Array:
    """(p, p) covariance of the parameters of a fit by what stays unexplained.

    With A the information of the fit and G_j the weighted normal matrix of joint j, noise gives
    Σ_j A⁻¹ G_j A⁻¹, if samples are counted by what they are worth. Of the part of the residual that
    is no noise, all n_j of them are worth no more than `WORTH`.

    Args:
        dataset: The reduced logs.
        unknowns: What was fitted.
        weights: (nv,) weight of a squared residual of each joint.
        fit: The fit.
        samples: (nv,) n_j times the share of the squared residual that goes with the motion.
    """
    gram = np.zeros((len(unknowns.columns),) * 2)
    for data, weight, worth in zip(dataset.data, weights, samples, strict=True):
        local = data.local(unknowns.columns)
        gram += worth / WORTH * weight * data.products(local, local).sum(axis=2)
    return _moved(fit, _moved(fit, gram).T)


def _moved(fit: FitResult, pulls: Array) -> Array:
    """(p, k) what parameters change by with each of some slopes (p, k) of the fit's cost."""
    factor, scale = scaled_cholesky(fit.information)
    return np.asarray(scale[:, None] * solved(factor, scale[:, None] * pulls))
