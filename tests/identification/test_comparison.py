"""Equal residuals for every regularizer, least squares without one, and solvers to cross-check."""

import numpy as np
import pytest
from identified_bodies import TWO as PRIOR
from identified_bodies import random_data

from geodrake.errors import ArgumentError, IdentificationError
from geodrake.identification import (
    REGULARIZERS,
    PointMasses,
    PointMassEuclidean,
    PointMassKL,
    Riemannian,
    compare_regularizers,
    identify,
    least_squares,
)
from geodrake.identification.least_squares import physical_least_squares
from geodrake.inertia import is_physical


def data(seed, *, rows=15, **options):
    return random_data(seed, PRIOR, rows=rows, **options)


def test_a_regularizer_has_its_own_prior_of_scalars():
    A, b = data(1, rows=40, extra=1)
    A[:, -1] = 0.0
    kinds = {"regularizers": ("pullback", "entropic"), "gamma": 20.0, "certify": False}
    own = {"pullback": [3.0]}
    found = compare_regularizers(A, b, PRIOR, extra_prior=[2.0], extra_priors=own, **kinds)
    extra = [found.results[name].extra[0] for name in kinds["regularizers"]]
    np.testing.assert_allclose(extra, [3.0, 2.0], rtol=1e-5)
    with pytest.raises(ArgumentError, match="pulback"):
        compare_regularizers(A, b, PRIOR, extra_priors={"pulback": [3.0]}, **kinds)


@pytest.mark.parametrize(("reference", "gamma"), [("euclidean", 2000.0), ("riemannian", 20.0)])
def test_all_residuals_are_equal(reference, gamma):
    A, b = data(0, rows=40, extra=1, noise=0.1)
    points = PointMasses.of_bodies(PRIOR, 30)
    kinds = ["euclidean", "pullback", "entropic", "riemannian"]
    regularizers = [*kinds, PointMassEuclidean(points), PointMassKL(points)]
    options = {"gamma": gamma, "sigma": 0.3, "extra_bounds": [[0.0, np.inf]], "certify": False}
    found = compare_regularizers(
        A, b, PRIOR, reference=reference, regularizers=regularizers, **options
    )
    assert list(found.results) == [*kinds, "point_mass_euclidean", "point_mass_kl"]
    alone = identify(A, b, PRIOR, regularizer=reference, **options)
    assert found.residual == pytest.approx(alone.residual, rel=1e-9)
    for name, result in found.results.items():
        x = np.append(result.phi.ravel(), result.extra)
        assert np.sum(((A @ x - b) / 0.3) ** 2) == pytest.approx(found.residual, rel=1e-5), name
        assert is_physical(result.phi).all() and result.regularizer == name
    assert (found.reference, found.gamma) == (reference, gamma)


def test_each_regularizer_is_best_by_its_own_measure():
    """Among solutions of one residual, none is closer to the prior in a regularizer's distance."""
    A, b = data(1)
    found = compare_regularizers(A, b, PRIOR, gamma=0.5, certify=False)
    for name, own in found.results.items():
        measure = REGULARIZERS[name]().divergence
        others = [measure(other.phi, PRIOR) for other in found.results.values()]
        assert own.divergence <= min(others) * (1 + 1e-6)


def test_open_directions_are_named():
    A, b = data(4, rows=60)
    A[:, 4] = 0.0  # Ixx of body 0
    A[:, 12] = 3.0 * A[:, 1]  # hy of body 1 like hx of body 0
    for solve in (
        lambda: least_squares(A, b, bodies=2),
        lambda: physical_least_squares(A, b, PRIOR),
    ):
        with pytest.raises(
            IdentificationError, match=r"do not identify 2 of 20 directions"
        ) as caught:
            solve()
        directions = caught.value.evidence["directions"]
        np.testing.assert_allclose(A @ directions.T, 0.0, atol=1e-9)
        assert "+1 Ixx[0]" in str(caught.value)
        assert "hy[1]" in str(caught.value) and "hx[0]" in str(caught.value)
    least = least_squares(A, b, minimum_norm=True)
    np.testing.assert_allclose(least.x, np.linalg.lstsq(A, b)[0], atol=1e-9)
    assert least.rank == 18


def test_physical_least_squares_is_the_limit_of_a_weak_prior():
    A, b = data(6, rows=60, noise=2.0)
    result = physical_least_squares(A, b, PRIOR)
    assert is_physical(result.x.reshape(2, 10)).all() and result.active_blocks
    weak = identify(A, b, PRIOR, regularizer="pullback", gamma=1e-6)
    assert result.residual == pytest.approx(weak.residual, rel=1e-4)
    free, (expected, residual) = least_squares(A, b, bodies=2), np.linalg.lstsq(A, b)[:2]
    np.testing.assert_allclose(free.x, expected, rtol=1e-9)
    assert result.residual > free.residual == pytest.approx(residual[0], rel=1e-9)
    assert free.rank == 20 and free.directions.shape == (0, 20)
    easy = data(6, rows=60, noise=1e-6)
    inside = physical_least_squares(*easy, PRIOR)
    np.testing.assert_allclose(inside.x, least_squares(*easy).x, rtol=1e-6)


def test_a_regularizer_without_a_solution_is_told_beside_the_others(monkeypatch):
    A, b = data(2)
    solve, options = Riemannian.solve, {"gamma": 1.0, "certify": False}

    def failing(self, problem, *rest):
        if problem.residual_bound is not None:
            raise IdentificationError("It jumps from one minimum to another.", advice="Lower it.")
        return solve(self, problem, *rest)

    expected = compare_regularizers(A, b, PRIOR, **options)
    monkeypatch.setattr(Riemannian, "solve", failing)
    found = compare_regularizers(A, b, PRIOR, **options)
    assert dict(found.failures) == {"riemannian": "It jumps from one minimum to another. Lower it."}
    assert list(found.results) == ["euclidean", "pullback", "entropic"] and not expected.failures
    for name, result in found.results.items():
        np.testing.assert_allclose(result.phi, expected.results[name].phi, rtol=1e-9)
    other = compare_regularizers(A, b, PRIOR, reference="riemannian", **options)
    assert not other.failures and list(other.results) == list(expected.results)


def test_a_prior_that_fits_better_than_the_reference_leaves_nothing_to_compare():
    A, b = data(9, rows=40, extra=1)
    kinds = {"regularizers": ("pullback", "entropic"), "gamma": 1e7, "certify": False}
    own = {"entropic": [0.1], "pullback": [2.0]}  # the true one is 2
    found = compare_regularizers(A, b, PRIOR, extra_priors=own, **kinds)
    assert list(found.results) == ["entropic"]
    assert "already fit better" in found.failures["pullback"]


def test_a_mistake_of_arguments_is_no_failure_of_a_regularizer():
    A, b = data(2, extra=1)
    kinds = ["entropic", PointMassKL(PointMasses.of_bodies(PRIOR, 30))]
    own = {"point_mass_kl": [1.0]}
    with pytest.raises(ArgumentError, match="has no divergence for extra parameters"):
        compare_regularizers(A, b, PRIOR, gamma=1.0, regularizers=kinds, extra_priors=own)
