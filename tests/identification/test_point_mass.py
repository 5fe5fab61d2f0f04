"""Point masses: exact priors, both regularizers against scipy, both forms, and what is refused."""

import numpy as np
import pytest
from identified_bodies import TWO as PRIOR
from identified_bodies import random_data
from scipy.optimize import minimize, nnls

from geodrake.errors import ArgumentError
from geodrake.identification import PointMasses, PointMassEuclidean, PointMassKL, identify
from geodrake.inertia import Ellipsoid, is_physical, pseudo_inertia

POINTS = PointMasses.of_bodies(PRIOR, [40, 25])
TURNED = [np.eye(3), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])]
KINDS = [PointMassEuclidean, PointMassKL]


def data(seed, *, rows=15, extra=0, noise=0.1):
    return random_data(seed, PRIOR, rows=rows, extra=extra, noise=noise, scale=(0.6, 1.5))


def test_points_have_the_bodies_parameters():
    np.testing.assert_allclose(POINTS.parameters(), PRIOR, rtol=1e-12, atol=1e-14)
    # R is the sum of point masses as the definition of P has it.
    mu = np.random.default_rng(0).uniform(0.0, 1.0, 65)
    phi = POINTS.parameters(mu)
    for body, places, part in zip(phi, POINTS.positions, np.split(mu, [40]), strict=True):
        homogeneous = np.column_stack([places, np.ones(len(places))])
        expected = np.einsum("n,ni,nj->ij", part, homogeneous, homogeneous)
        np.testing.assert_allclose(pseudo_inertia(body), expected, rtol=1e-12, atol=1e-15)
    # They fill the uniform ellipsoid, whose semi-axes are √(5 λ(Σᶜ)/m), and little beyond.
    com = PRIOR[0, 1:4] / PRIOR[0, 0]
    spread = pseudo_inertia(PRIOR[0])[:3, :3] / PRIOR[0, 0] - np.outer(com, com)
    radius = np.linalg.norm(
        np.linalg.solve(np.linalg.cholesky(spread), (POINTS.positions[0] - com).T), axis=0
    ) / np.sqrt(5.0)
    assert radius.max() < 1.15 and radius.min() < 0.5


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
