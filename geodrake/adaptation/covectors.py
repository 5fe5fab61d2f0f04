"""Covectors b that drive an update law, and the tracking errors V_t they belong to."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_continuous_lyapunov

from geodrake.errors import ArgumentError
from geodrake.inertia import Array


def tracking_energy(mass_matrix: ArrayLike, r: ArrayLike) -> float:
    """V_t = ½ rᵀ M r of the passivity-based controller ([Lee2019] Eq. (5.2.14)).

    Its rate is at most (p̂ − p)ᵀ Yᵀ r − rᵀ K r.

    Args:
        mass_matrix: (nv, nv) true mass matrix.
        r: (nv,) q̇ − v.
    """
    r = np.asarray(r, float)
    return float(0.5 * r @ np.asarray(mass_matrix, float) @ r)


def error_weight(K_p: ArrayLike, K_v: ArrayLike, Q: ArrayLike) -> Array:
    """P with Aᵀ P + P A = −Q for the error dynamics of computed torque ([Lee2019] Eq. (5.2.8)).

    Args:
        K_p: (nv,) position gains, 1/s².
        K_v: (nv,) velocity gains, 1/s.
        Q: (2 nv, 2 nv) positive definite.

    Raises:
        ArgumentError: A gain is not positive, or a shape is wrong.
    """
    K_p, K_v, Q = np.asarray(K_p, float), np.asarray(K_v, float), np.asarray(Q, float)
    n = len(K_p)
    if K_v.shape != (n,) or Q.shape != (2 * n, 2 * n) or not ((K_p > 0).all() and (K_v > 0).all()):
        raise ArgumentError(
            f"Expected positive gains (n,) and Q (2 n, 2 n); got {K_p.tolist()}, {K_v.tolist()} "
            f"and Q of shape {Q.shape}."
        )
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(K_p), -np.diag(K_v)]])
    P = solve_continuous_lyapunov(A.T, -Q)
    return np.asarray(0.5 * (P + P.T))


def computed_torque_covector(
    regressor: ArrayLike, mass_matrix: ArrayLike, P: ArrayLike, error: ArrayLike
) -> Array:
    """Yᵀ M̂⁻¹ Bᵀ P e (p,), which belongs to V_t = ½ eᵀ P e ([Lee2019] Eq. (5.4.46), with this ½).

    Args:
        regressor: (nv, p) Y(q, q̇, q̈), at the acceleration of the robot.
        mass_matrix: (nv, nv) estimated mass matrix M̂.
        P: (2 nv, 2 nv) from `error_weight`.
        error: (2 nv,) e = (q − q_d, q̇ − q̇_d).
    """
    Y, n = np.asarray(regressor, float), len(np.asarray(mass_matrix))
    pulled = np.asarray(P, float)[n:] @ np.asarray(error, float)
    return np.asarray(np.linalg.solve(np.asarray(mass_matrix, float), pulled) @ Y)


def prediction_covector(
    regressor: ArrayLike, parameters: ArrayLike, effort: ArrayLike, *, weight: ArrayLike = 1.0
) -> Array:
    """Yᵀ W (Y p̂ − effort) (p,): what a composite law adds to the covector of tracking.

    It adds −(p̂ − p)ᵀ Yᵀ W Y (p̂ − p) to the rate of V where the efforts are those of the truth.

    Args:
        regressor: (..., nv, p) regressor Y of one or several measured, usually filtered samples.
        parameters: (p,) estimate p̂.
        effort: (..., nv) measured efforts, filtered alike.
        weight: W ≥ 0; one for all velocities or (nv,).
    """
    Y = np.asarray(regressor, float)
    error = np.asarray(weight, float) * (Y @ np.asarray(parameters, float) - effort)
    return np.asarray(error.ravel() @ Y.reshape(-1, Y.shape[-1]))
