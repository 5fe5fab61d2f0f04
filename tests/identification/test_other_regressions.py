"""Point masses and geodesic least squares, against other solvers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from identified_bodies import TWO as PRIOR
from identified_bodies import random_data
from scipy.linalg import expm
from scipy.optimize import minimize, nnls

from geodrake.errors import ArgumentError, ConvergenceError
from geodrake.identification import (
    PointMasses,
    PointMassEuclidean,
    PointMassKL,
    geodesic_least_squares,
    identify,
)
from geodrake.identification.coordinates import SYMMETRIC_BASIS
from geodrake.identification.geodesic_least_squares import project, spectral
from geodrake.inertia import Ellipsoid, is_physical, pseudo_inertia
from geodrake.inertia.parameters import dual
from geodrake.inertia.positive_definite import distance

POINTS = PointMasses.of_bodies(PRIOR, [40, 25])
TURNED = [np.eye(3), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])]
KINDS = [PointMassEuclidean, PointMassKL]


def data(seed, *, rows=15, extra=0, noise=0.1):
    return random_data(seed, PRIOR, rows=rows, extra=extra, noise=noise, scale=(0.6, 1.5))


def test_euclidean_masses_are_those_of_nonnegative_least_squares():
    A, b = data(1)
    gamma = 0.05
    result = identify(A, b, PRIOR, regularizer=PointMassEuclidean(POINTS), gamma=gamma)
    root = np.sqrt(gamma)
    stacked = np.vstack([A @ POINTS.matrix(), root * np.eye(65)])
    mu, norm = nnls(stacked, np.append(b, root * POINTS.prior))
    assert result.residual + gamma * result.divergence == pytest.approx(norm**2, rel=1e-6)
    assert (mu == 0).any(), "no mass is spent: a weak test"
    np.testing.assert_allclose(result.masses, mu, atol=1e-5)
    np.testing.assert_allclose(result.phi, POINTS.parameters(mu), atol=1e-4)


def test_kl_masses_are_those_of_the_dual_problem():
    """μ = ⁰μ exp(−Rᵀ Aᵀ y/γ), where y maximizes the concave dual: an independent derivation."""
    A, b = data(2)
    gamma, B = 0.3, A @ POINTS.matrix()

    def dual(y):
        mu = POINTS.prior * np.exp(-B.T @ y / gamma)
        value = gamma * mu.sum() + 0.25 * y @ y + y @ b
        return value, 0.5 * y + b - B @ mu

    y = minimize(dual, np.zeros(len(b)), jac=True, method="BFGS", options={"gtol": 1e-10}).x
    mu = POINTS.prior * np.exp(-B.T @ y / gamma)
    result = identify(A, b, PRIOR, regularizer=PointMassKL(POINTS), gamma=gamma)
    np.testing.assert_allclose(result.masses, mu, rtol=1e-4, atol=1e-7)
    kl = np.sum(mu * np.log(mu / POINTS.prior) + POINTS.prior - mu)
    assert result.divergence == pytest.approx(kl, rel=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_point_to_set_is_the_regularized_form_of_its_gamma(kind):
    A, b = data(3, extra=1)
    options = {"regularizer": kind(POINTS), "extra_bounds": [[0.0, np.inf]], "sigma": 0.5}
    first = identify(A, b, PRIOR, gamma=0.7, **options)
    bound = identify(A, b, PRIOR, residual_bound=first.residual, **options)
    assert bound.residual == pytest.approx(first.residual, rel=1e-6)
    assert bound.gamma == pytest.approx(0.7, rel=1e-3)
    np.testing.assert_allclose(bound.phi, first.phi, atol=1e-4)
    assert is_physical(bound.phi).all() and bound.extra[0] >= 0
    # That of the parameters is the least of any masses.
    again = kind(POINTS).divergence(first.phi, PRIOR)
    assert again == pytest.approx(first.divergence, rel=1e-4)


def test_bad_points_are_refused():
    of, first, second = PointMasses.of_bodies, *POINTS.masses
    for make, message in (
        (lambda: of(PRIOR, 5), "counts must be"),
        (lambda: of(PRIOR, [10, 10, 10]), r"counts must have shape \(2,\)"),
        (lambda: of(PRIOR * [[-1.0], [1.0]]), r"Bodies \[0\] are not physical"),
        (
            lambda: PointMasses(POINTS.positions, (first, -second)),
            r"Bodies \[1\] have no points, or prior masses",
        ),
        (
            lambda: PointMasses(POINTS.positions, (first, first)),
            r"masses\[1\] must be \(25,\) .* \(40,\)",
        ),
        (lambda: PointMasses(POINTS.positions, (first,)), "Masses are needed for each of the 2"),
        (
            lambda: identify(
                *data(6), PRIOR * [[1.0], [1.1]], regularizer=PointMassKL(POINTS), gamma=1.0
            ),
            r"bodies \[1\] differ by up to 0\.08\. Pass points\.parameters\(\) as the prior",
        ),
    ):
        with pytest.raises(ArgumentError, match=message):
            make()


@pytest.mark.parametrize("kind", KINDS)
def test_a_bound_that_no_masses_reach_says_what_they_reach(kind):
    A, b = data(6, rows=60, noise=1.0)
    b = b - 2.0 * A @ PRIOR.ravel()  # negative masses would fit
    least = nnls(A @ POINTS.matrix(), b)[1] ** 2
    bound = 0.5 * (least + np.linalg.lstsq(A, b)[1][0])
    with pytest.raises(ArgumentError, match="physical bodies inside all constraints") as caught:
        identify(A, b, PRIOR, regularizer=kind(POINTS), residual_bound=bound)
    assert caught.value.evidence["minimum"] == pytest.approx(least, rel=1e-4)
    reached = identify(A, b, PRIOR, regularizer=kind(POINTS), residual_bound=1.001 * least)
    assert reached.residual == pytest.approx(1.001 * least, rel=1e-5)


def test_points_within_regions_have_the_bodies_parameters_and_fill_the_regions():
    regions = Ellipsoid([[0.0, 0.0, 0.2], [0.0, 0.02, 0.0]], [[0.2, 0.3, 0.4], [0.15] * 3], TURNED)
    points = PointMasses.within(PRIOR, regions, [60, 25])
    np.testing.assert_allclose(points.parameters(), PRIOR, rtol=1e-10, atol=1e-14)
    assert [len(mass) for mass in points.masses] == [60, 25]
    for body, number in enumerate((30, 12)):
        far, masses = points.positions[body][-number:], points.masses[body][-number:]
        center, axes, turn = (
            getattr(regions, n)[body] for n in ("center", "semi_axes", "rotation")
        )
        reach = np.linalg.norm((far - center) @ turn / axes, axis=1)
        assert reach.max() == pytest.approx(1.0) and reach.min() < 0.6
        np.testing.assert_allclose(masses, masses[0])
        # Twice as much mass there, and what is left is flat.
        given = masses.sum() * np.array([[*row, 1.0] for row in far])
        shape = given.T @ np.array([[*row, 1.0] for row in far]) / number
        rest = np.linalg.eigvalsh(pseudo_inertia(PRIOR[body]) - 2.0 * shape)
        assert abs(rest[0]) < 1e-9 * rest[-1]


ROOTS = np.linalg.cholesky(pseudo_inertia(PRIOR))


def noisy_data(seed, *, rows=30, noise=0.1):
    return random_data(seed, PRIOR, rows=rows, noise=noise, scale=(0.8, 1.25))


def bodies(velocity):
    """Return P = L exp(Q) Lᵀ for Q (2, 4, 4)."""
    return np.array([L @ expm(Q) @ L.T for L, Q in zip(ROOTS, velocity, strict=True)])


def covectors(A):
    """Return X (m, 2, 4, 4) with aᵀ Φ = Σ tr(P(φ_j) X_j) for rows a of A."""
    return dual(A.reshape(len(A), -1, 10))


@given(seed=st.integers(0, 10_000), noise=st.floats(0.01, 5.0))
@settings(max_examples=10)
def test_projections_are_on_the_plane_and_geodesics_meet_it_at_right_angles(seed, noise):
    A, b = noisy_data(seed, noise=noise)
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


def test_both_methods_find_the_same_minimum():
    A, b = noisy_data(2)
    newton = geodesic_least_squares(A, b, PRIOR, gamma=300.0, tolerance=1e-6)
    cyclic = geodesic_least_squares(A, b, PRIOR, gamma=300.0, tolerance=1e-6, method="cyclic")
    assert newton.cost == pytest.approx(cyclic.cost, rel=1e-10)
    np.testing.assert_allclose(newton.phi, cyclic.phi, atol=1e-6)
    assert newton.iterations < cyclic.iterations and not newton.rejected
    assert is_physical(newton.phi).all()


def test_the_cost_is_the_source_one_and_stationary():
    A, b = noisy_data(3)
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


def test_outliers_are_rejected_and_do_no_harm():
    A, b = noisy_data(5, noise=0.02)
    clean = geodesic_least_squares(A, b, PRIOR, gamma=1.0)
    bad = np.append(b, [1e4, -1e4])
    wild = np.vstack([A, np.eye(20)[0], np.eye(20)[10]])  # masses of ten tons, and below zero
    result = geodesic_least_squares(wild, bad, PRIOR, gamma=1.0)
    assert result.rejected == (30, 31)
    np.testing.assert_allclose(result.phi, clean.phi, atol=1e-8)


def test_bad_arguments_are_refused():
    A, b = noisy_data(6)
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
