"""Errors to be expected of least squares, from its covariance: exact, and without drawing noise.

With changes δ of parameters whose covariance is D Λ Dᵀ — `IdentifiableParameters` has D and Λ — a
linear function y = Y δ has the covariance Y D Λ Dᵀ Yᵀ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geodrake.excitation import (
    ExcitationTrajectory,
    IdentifiableParameters,
    Target,
    identifiable_parameters,
    measurement_factor,
)
from geodrake.robot import pushforward_metric

Array = NDArray[np.float64]

_DENSE = 1000  # samples that stand for those of a motion sampled more often


def identified_by(
    target: Target, trajectory: ExcitationTrajectory, samples: int
) -> IdentifiableParameters:
    """What a motion identifies when it is measured so many times, at equal intervals."""
    count = trajectory.family.count if not trajectory.family.timed else min(samples, _DENSE)
    motion = trajectory.motion(trajectory.family.times(count))
    share = samples / len(motion)
    factor = np.sqrt(share) * measurement_factor(target, motion)
    return identifiable_parameters(target, factor, threshold=np.inf)


def root_covariance(found: IdentifiableParameters) -> Array:
    """(p, n_B) R with R Rᵀ the covariance of parameters, up to changes that data cannot see."""
    return np.asarray(found.directions * np.sqrt(found.variances))


def parameter_error(found: IdentifiableParameters, truth: Array) -> float:
    """√(E⟨δ, δ⟩/n_B) in the pushforward metric at the true bodies (nb, 10), [Lee2019] §4.6.2."""
    B = found.target.base.matrix
    H = pushforward_metric(B, truth)
    R = B @ root_covariance(found)
    return float(np.sqrt(np.einsum("ia,ij,ja->", R, H, R) / len(B)))


def effort_errors(
    found: IdentifiableParameters, regressor: Array, mass: Array
) -> tuple[Array, ...]:
    """(nv,) RMS errors of efforts (N·m) and of accelerations M⁻¹(τ − τ̂) (rad/s²).

    Args:
        found: What is identifiable.
        regressor: (N, nv, p) at the samples of validation.
        mass: (N, nv, nv) mass matrices there.
    """
    effort = regressor @ root_covariance(found)
    acceleration = np.linalg.solve(mass, effort)
    pair = [np.square(x).sum(axis=2).mean(axis=0) for x in (effort, acceleration)]
    return tuple(np.sqrt(pair))
