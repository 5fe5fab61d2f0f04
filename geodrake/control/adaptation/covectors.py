"""Covectors b that drive an update law, and the tracking errors V_t they belong to."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_continuous_lyapunov

from geodrake.boundary.arguments import Sizes, one_or_each, positive_definite, real_array
from geodrake.errors import ArgumentError
from geodrake.inertia import Array


def tracking_energy(mass_matrix: ArrayLike, r: ArrayLike) -> float:
    """V_t = ½ rᵀ M r of the passivity-based controller ([Lee2019] Eq. (5.2.14)).

    Its rate is at most (p̂ − p)ᵀ Yᵀ r − rᵀ K r.

    Args:
        mass_matrix: (nv, nv) true mass matrix.
        r: (nv,) q̇ − v.

    Raises:
        ArgumentError: The mass matrix is not symmetric positive definite, or a shape is wrong.
    """
    sizes: Sizes = {}
    M = positive_definite(mass_matrix, "mass_matrix", ("nv", "nv"), sizes)
    return calc_tracking_energy(M, real_array(r, "r", ("nv",), sizes))


def calc_tracking_energy(mass_matrix: Array, r: Array) -> float:
    """Kernel of `tracking_energy`, which trusts its arrays; for every sample."""
    return float(0.5 * r @ mass_matrix @ r)


def error_weight(K_p: ArrayLike, K_v: ArrayLike, Q: ArrayLike) -> Array:
    """P with Aᵀ P + P A = −Q for the error dynamics of computed torque ([Lee2019] Eq. (5.2.8)).

    Args:
        K_p: (nv,) position gains, 1/s².
        K_v: (nv,) velocity gains, 1/s.
        Q: (2 nv, 2 nv) positive definite.

    Raises:
        ArgumentError: A gain is not positive, Q is not positive definite, or a shape is wrong.
    """
    sizes: Sizes = {}
    K_p, K_v = real_array(K_p, "K_p", ("nv",), sizes), real_array(K_v, "K_v", ("nv",), sizes)
    n = len(K_p)
    Q = positive_definite(Q, "Q", (2 * n, 2 * n))
    if not ((K_p > 0).all() and (K_v > 0).all()):
        raise ArgumentError(f"Expected positive gains; got {K_p.tolist()} and {K_v.tolist()}.")
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

    Raises:
        ArgumentError: A matrix is not symmetric positive definite, or a shape is wrong.
    """
    sizes: Sizes = {}
    Y = real_array(regressor, "regressor", ("nv", "p"), sizes)
    M = positive_definite(mass_matrix, "mass_matrix", ("nv", "nv"), sizes)
    P = positive_definite(P, "P", (2 * len(M), 2 * len(M)))
    return calc_computed_torque_covector(Y, M, P, real_array(error, "error", (2 * len(M),)))


def calc_computed_torque_covector(
    regressor: Array, mass_matrix: Array, P: Array, error: Array
) -> Array:
    """Kernel of `computed_torque_covector`, which trusts its arrays; for every sample."""
    pulled = P[len(mass_matrix) :] @ error
    return np.asarray(np.linalg.solve(mass_matrix, pulled) @ regressor)


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

    Raises:
        ArgumentError: A shape is wrong, a value is not finite, or a weight is negative.
    """
    sizes: Sizes = {}
    Y = real_array(regressor, "regressor", ("...", "nv", "p"), sizes)
    p = real_array(parameters, "parameters", ("p",), sizes)
    effort = real_array(effort, "effort", Y.shape[:-1])
    W = one_or_each(weight, "weight", Y.shape[-2])
    return calc_prediction_covector(Y, p, effort, W)


def calc_prediction_covector(
    regressor: Array, parameters: Array, effort: Array, weight: Array | float = 1.0
) -> Array:
    """Kernel of `prediction_covector`, which trusts its arrays; for every sample."""
    error = np.asarray(weight * (regressor @ parameters - effort))
    return np.asarray(error.ravel() @ regressor.reshape(-1, regressor.shape[-1]))
