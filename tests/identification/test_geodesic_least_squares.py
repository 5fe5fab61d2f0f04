"""Geodesic least squares: projections against scipy, the two methods, and rejected rows."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from identified_bodies import TWO as PRIOR
from identified_bodies import random_data
from scipy.linalg import expm

from geodrake.errors import ArgumentError, ConvergenceError
from geodrake.identification import geodesic_least_squares
from geodrake.identification.coordinates import SYMMETRIC_BASIS
from geodrake.identification.geodesic_least_squares import project, spectral
from geodrake.inertia import from_pseudo_inertia, is_physical, pseudo_inertia
from geodrake.inertia.parameters import dual
from geodrake.inertia.positive_definite import distance
from geodrake.model import load_description
from geodrake.robot import inverse_dynamics_regressor

ROOTS = np.linalg.cholesky(pseudo_inertia(PRIOR))


def data(seed, *, rows=30, noise=0.1):
    return random_data(seed, PRIOR, rows=rows, noise=noise, scale=(0.8, 1.25))


def bodies(velocity):
    """P = L exp(Q) Lᵀ for Q (2, 4, 4)."""
    return np.array([L @ expm(Q) @ L.T for L, Q in zip(ROOTS, velocity, strict=True)])


def covectors(A):
    """X (m, 2, 4, 4) with aᵀ Φ = Σ tr(P(φ_j) X_j) for rows a of A."""
    return dual(A.reshape(len(A), -1, 10))


@given(seed=st.integers(0, 10_000), noise=st.floats(0.01, 5.0))
@settings(max_examples=10)
def test_projections_are_on_the_plane_and_geodesics_meet_it_at_right_angles(seed, noise):
    A, b = data(seed, noise=noise)
    X = covectors(A)
    found = project(ROOTS, X, b)
    assert found.exists.any()
    velocities = spectral(found.axes, found.rates)
    for i in np.flatnonzero(found.exists):
        P = bodies(velocities[i])
        assert np.einsum("bij,bji->", P, X[i]) == pytest.approx(b[i], rel=1e-6, abs=1e-6)
        assert np.linalg.eigvalsh(velocities[i]).max() <= 1 + 1e-6
        # [Lee2019] Eq. (A.2.10): −Q e^(−Q) is a multiple of the normal, in all bodies the same.
        left = np.array([-Q @ expm(-Q) for Q in velocities[i]]).ravel()
        normal = spectral(found.axes, found.sigma)[i].ravel()
        cosine = abs(left @ normal) / np.linalg.norm(left) / np.linalg.norm(normal)
        assert cosine == pytest.approx(1.0, abs=1e-6)


def test_rows_without_a_projection_are_found():
    """One body and its mass: within a factor e, masses up to m e exist, and none below zero."""
    phi = PRIOR[:1]
    A = np.repeat(np.eye(10)[:1], 5, axis=0)
    b = 4.0 * np.array([1e-6, 1.0, np.e * 0.999, np.e * 1.001, -0.1])
    found = project(np.linalg.cholesky(pseudo_inertia(phi)), covectors(A), b)
    assert found.exists.tolist() == [True, True, True, False, False]
    assert (found.rates[~found.exists] == 0).all()
    assert found.half_squared_distances[0] == pytest.approx(0.5 * np.log(1e-6) ** 2)


def test_both_methods_find_the_same_minimum():
    A, b = data(2)
    newton = geodesic_least_squares(A, b, PRIOR, gamma=300.0, tolerance=1e-6)
    cyclic = geodesic_least_squares(A, b, PRIOR, gamma=300.0, tolerance=1e-6, method="cyclic")
    assert newton.cost == pytest.approx(cyclic.cost, rel=1e-10)
    np.testing.assert_allclose(newton.phi, cyclic.phi, atol=1e-6)
    assert newton.iterations < cyclic.iterations and not newton.rejected
    assert is_physical(newton.phi).all()


def test_the_cost_is_the_source_one_and_stationary():
    A, b = data(3)
    gamma = 5.0
    result = geodesic_least_squares(A, b, PRIOR, gamma=gamma, sigma=0.5)
    X = covectors(A / 0.5)
    weights = 2.0 * np.sum((np.swapaxes(ROOTS, 1, 2) @ X @ ROOTS) ** 2, axis=(1, 2, 3))

    def cost(P):
        near = project(np.linalg.cholesky(P), X, b / 0.5)
        prior = 0.5 * np.sum(distance(P, pseudo_inertia(PRIOR)) ** 2)
        return weights @ near.half_squared_distances + gamma * prior

    P = pseudo_inertia(result.phi)
    assert result.cost == pytest.approx(cost(P), rel=1e-9)
    L, rng = np.linalg.cholesky(P), np.random.default_rng(0)
    for _ in range(20):
        V = np.einsum("bk,kij->bij", rng.normal(size=(2, 10)), SYMMETRIC_BASIS)
        ends = [
            cost(np.array([l @ expm(h * v) @ l.T for l, v in zip(L, V, strict=True)]))  # noqa: E741
            for h in (-1e-4, 1e-4)
        ]
        assert min(ends) > result.cost
        assert abs(ends[1] - ends[0]) / 2e-4 < 1e-3 * result.cost


@pytest.mark.parametrize(("gamma", "seed", "most"), [(1.0, 0, 1.5), (10.0, 2, 4.0)])
def test_an_arm_from_few_samples(gamma, seed, most):
    """Rows of all joints in random motion, little noise, and a prior that is off."""
    model = load_description(Path(__file__).parents[2] / "models" / "arm6.urdf")
    rng = np.random.default_rng(seed)
    q, v, a = rng.normal(size=(3, 10, len(model.joints)))
    Y = inverse_dynamics_regressor(model.plant, q, v, a)
    effort = Y @ model.phi.ravel()
    sigma = 0.02 * effort.std(0)
    b = (effort + sigma * rng.normal(size=effort.shape)).ravel()
    G = np.eye(4) + 0.1 * rng.normal(size=(len(model.phi), 4, 4))
    prior = from_pseudo_inertia(G @ pseudo_inertia(model.phi) @ G.transpose(0, 2, 1))
    A = Y.reshape(-1, model.phi.size)
    result = geodesic_least_squares(A, b, prior, gamma=gamma, sigma=np.tile(sigma, 10))
    assert is_physical(result.phi).all()
    assert result.distance <= 1e-6
    assert result.curvature > 0
    assert len(result.rejected) < 0.1 * len(b)
    assert result.residual < most * len(b)
    assert result.iterations < 100


@pytest.mark.parametrize(("noise", "gamma"), [(1e-1, 1e5), (1e-5, 10.0), (1e-9, 1e-3)])
def test_it_ends_where_rounding_hides_the_rest(noise, gamma):
    """However small the cost is, a tolerance that cannot be reached is no error."""
    rng = np.random.default_rng(10)
    A = rng.normal(size=(30, 20))
    b = A @ PRIOR.ravel() + noise * rng.normal(size=30)
    found = geodesic_least_squares(A, b, PRIOR, gamma=gamma, tolerance=1e-300)
    assert found.distance < 1e-10
    assert found.iterations < 20


def test_outliers_are_rejected_and_do_no_harm():
    A, b = data(5, noise=0.02)
    clean = geodesic_least_squares(A, b, PRIOR, gamma=1.0)
    bad = np.append(b, [1e4, -1e4])
    wild = np.vstack([A, np.eye(20)[0], np.eye(20)[10]])  # masses of ten tons, and below zero
    result = geodesic_least_squares(wild, bad, PRIOR, gamma=1.0)
    assert result.rejected == (30, 31)
    np.testing.assert_allclose(result.phi, clean.phi, atol=1e-8)


def test_bad_arguments_are_refused():
    A, b = data(6)
    for rows, values, options, message in (
        (A, b, {"method": "gradient"}, r"newton.*cyclic.*gradient"),
        (A, b, {"gamma": -1.0}, "gamma must be a finite number above 0; it is -1"),
        (A, b, {"max_iterations": 0}, "max_iterations must be"),
        (A[:, [*range(20), 0]], b, {}, "A has 21 columns, but 2 bodies of the prior need 20"),
        (np.eye(20)[:1], [-1.0], {}, "None of the 1 rows has a projection"),
    ):
        with pytest.raises(ArgumentError, match=message):
            geodesic_least_squares(rows, values, PRIOR, **({"gamma": 1.0} | options))
    with pytest.raises(ConvergenceError, match="from its minimum after 2 iterations"):
        geodesic_least_squares(A, b, PRIOR, gamma=1e-3, method="cyclic", max_iterations=2)
