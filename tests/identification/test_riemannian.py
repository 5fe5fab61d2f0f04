"""The Riemannian regularizer: derivatives, a second optimizer, constraints, and local minima."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from identified_bodies import TWO as PRIOR
from identified_bodies import random_data
from scipy.linalg import block_diag, expm
from scipy.optimize import minimize

from geodrake.identification import Riemannian, identify
from geodrake.identification.coordinates import SYMMETRIC_BASIS
from geodrake.identification.riemannian import half_squared_logs, log_derivatives
from geodrake.inertia import from_mass_com_inertia, is_physical, pseudo_inertia, pullback_metric

PRIOR_AND_FRICTION = np.append(PRIOR.ravel(), 0.0)


def data(seed, *, rows=12, **options):
    """Fewer rows than parameters."""
    return random_data(seed, PRIOR, rows=rows, **options)


def squared_distance(phi):
    """½ Σ log² λ by generalized eigenvalues, one body at a time."""
    total = 0.0
    for body, prior in zip(phi, PRIOR, strict=True):
        ratios = np.linalg.eigvals(np.linalg.solve(pseudo_inertia(prior), pseudo_inertia(body)))
        if ratios.real.min() <= 0:
            return np.inf
        total += 0.5 * np.sum(np.log(ratios.real) ** 2)
    return total


def cost(x, A, b, gamma):
    """The cost as the source states it, without any of the package's coordinates; finite."""
    if not is_physical(x[:20].reshape(2, 10)).all():
        return 1e12
    return np.sum((A @ x - b) ** 2) + gamma * squared_distance(x[:20].reshape(2, 10))


@given(seed=st.integers(0, 10_000), spread=st.floats(1e-3, 1.5))
@settings(max_examples=6)
def test_derivatives_are_those_of_finite_differences(seed, spread):
    V = np.random.default_rng(seed).normal(size=(5, 4, 4)) * spread
    S, h = np.array([expm(0.5 * (v + v.T)) for v in V]), 1e-5
    gradient, hessian = log_derivatives(S)
    for k, basis in enumerate(SYMMETRIC_BASIS):
        size = h * np.linalg.eigvalsh(S)[:, 0, None]
        step = size[..., None] * basis
        slope = (half_squared_logs(S + step) - half_squared_logs(S - step)) / (2 * size[:, 0])
        np.testing.assert_allclose(
            gradient[:, k], slope, rtol=1e-6, atol=1e-6 * np.abs(gradient).max()
        )
        change = (log_derivatives(S + step)[0] - log_derivatives(S - step)[0]) / (2 * size)
        np.testing.assert_allclose(hessian[:, k], change, atol=1e-6 * np.abs(hessian).max())


def test_another_optimizer_finds_the_same():
    """BFGS on the source's own cost, in the parameters themselves."""
    A, b = data(0, extra=1)
    result = identify(A, b, PRIOR, regularizer="riemannian", gamma=0.3)
    x = np.append(result.phi.ravel(), result.extra)
    found = result.residual + 0.3 * result.divergence
    assert found == pytest.approx(cost(x, A, b, 0.3), rel=1e-9)
    root = block_diag(*np.linalg.inv(np.linalg.cholesky(pullback_metric(PRIOR))), [[1.0]])
    other = minimize(
        lambda y: cost(PRIOR_AND_FRICTION + root.T @ y, A, b, 0.3), np.zeros(21), method="BFGS"
    )
    assert found <= other.fun * (1 + 1e-9)
    assert found == pytest.approx(other.fun, rel=1e-6)
    assert is_physical(result.phi).all() and result.minima.strict


def test_several_minima_are_found_and_reported():
    """A mass measured weakly and far away: light near the prior, or heavy near the data.

    Where the mass alone is measured, the nearest bodies differ in nothing else, and the cost is
    one of the mass m alone.
    """
    prior = from_mass_com_inertia(1.0, np.zeros(3), 0.01 * np.eye(3))[None]
    measured, sigma = 24.6, np.sqrt(120.0)
    masses = np.exp(np.linspace(-3, 5, 200_001))
    costs = ((masses - measured) / sigma) ** 2 + 0.5 * np.log(masses) ** 2
    lowest = np.flatnonzero((costs[1:-1] < costs[:-2]) & (costs[1:-1] < costs[2:])) + 1
    assert len(lowest) == 2
    arguments = (np.eye(10)[:1], [measured], prior)
    options = {"gamma": 1.0, "sigma": sigma}
    result = identify(*arguments, regularizer=Riemannian(), **options)
    best = lowest[np.argmin(costs[lowest])]
    assert result.phi[0, 0] == pytest.approx(masses[best], rel=1e-3)
    assert not result.minima.agree and result.minima.distinct == 2
    np.testing.assert_allclose(
        np.unique(result.minima.costs.round(6)), np.sort(costs[lowest]), rtol=1e-4
    )
    assert len(result.minima.starts) == 4
