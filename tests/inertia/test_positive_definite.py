"""Distances, geodesics and means of P(n) and of bodies, against SciPy and by their axioms."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from random_points import other_view, random_inertia, random_matrices, round_inertia

from geodrake.errors import ConvergenceError
from geodrake.inertia import (
    entropic_divergence,
    from_pseudo_inertia,
    pseudo_inertia,
    pullback_distance,
    pullback_metric,
    riemannian_distance,
)
from geodrake.inertia import positive_definite as pd

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.integers(1, 6)
UNITS = st.floats(1e-3, 1e3)
EXAMPLES = settings(max_examples=20)


def random_symmetric(rng, *shape, n=4):
    half = rng.normal(size=(*shape, n, n))
    return half + np.swapaxes(half, -1, -2)


def close(actual, expected, precision=1e-9):
    scale = np.abs(expected).max()
    np.testing.assert_allclose(actual, expected, atol=precision * scale, rtol=0)


@EXAMPLES
@given(SEEDS, SIZES)
def test_formulas_of_the_source_with_scipy(seed, n):
    A, B = random_matrices(np.random.default_rng(seed), 2, n=n)
    logarithms = np.log(scipy.linalg.eigvalsh(B, A))  # [Lee2019] Eqs. (2.2.10), (2.2.14)
    np.testing.assert_allclose(pd.relative_logarithms(A, B), logarithms, atol=1e-9)
    np.testing.assert_allclose(pd.distance(A, B), np.linalg.norm(logarithms), rtol=1e-9)
    ratio = np.linalg.solve(A, B)
    expected = -np.linalg.slogdet(ratio)[1] + np.trace(ratio) - n
    np.testing.assert_allclose(pd.log_det_divergence(B, A), expected, rtol=1e-8)


@EXAMPLES
@given(SEEDS, SIZES)
def test_geodesics_are_minimal_and_of_even_speed(seed, n):
    rng = np.random.default_rng(seed)
    A, B = random_matrices(rng, 2, n=n)
    t = np.append(rng.uniform(0, 1, 5), 3.0)
    points, whole = pd.geodesic(A, B, t), pd.distance(A, B)
    np.testing.assert_allclose(pd.distance(A, points), t * whole, rtol=1e-8)
    np.testing.assert_allclose(pd.distance(points, B), np.abs(1 - t) * whole, rtol=1e-8)


@EXAMPLES
@given(SEEDS, UNITS, UNITS)
def test_no_distance_or_mean_knows_frame_or_units(seed, metre, kilogram):
    rng = np.random.default_rng(seed)
    bodies, view = round_inertia(rng, 3), other_view(rng, metre, kilogram)
    seen = bodies @ view.T
    for distance in (
        lambda a, b, _: riemannian_distance(a, b),
        lambda a, b, _: entropic_divergence(a, b),
        pullback_distance,
    ):
        np.testing.assert_allclose(distance(*seen), distance(*bodies), rtol=1e-9, atol=1e-9)
    mean, there = (from_pseudo_inertia(pd.karcher_mean(pseudo_inertia(b))) for b in (bodies, seen))
    assert riemannian_distance(view @ mean, there) < 1e-8


@EXAMPLES
@given(SEEDS)
def test_distances_agree_nearby(seed):
    rng = np.random.default_rng(seed)
    phi, step = random_inertia(rng), rng.normal(size=10)
    step /= np.sqrt(step @ pullback_metric(phi) @ step)
    for length in (1e-2, 1e-5, 1e-7):
        near = phi + length * step
        # [Lee2019] Eqs. (2.2.5), (2.2.16), and (2.2.10) which is √2 longer
        for squared in (
            pullback_distance(near, phi, phi) ** 2,
            entropic_divergence(near, phi),
            entropic_divergence(phi, near),
            0.5 * riemannian_distance(phi, near) ** 2,
        ):
            np.testing.assert_allclose(squared, length**2, rtol=5 * length + 1e-6)


def test_only_the_pullback_distance_is_finite_at_the_edge():
    body = random_inertia(np.random.default_rng(1))
    values, axes = np.linalg.eigh(pseudo_inertia(body))
    shares = 10.0 ** -np.arange(2, 12)
    thinner = np.array([[share, 1, 1, 1] for share in shares])[:, None]
    thin = from_pseudo_inertia((axes * thinner * values) @ axes.T)
    np.testing.assert_allclose(riemannian_distance(thin, body), -np.log(shares), rtol=1e-4)
    assert (np.diff(entropic_divergence(thin, body)) > 2.0).all()
    np.testing.assert_allclose(pullback_distance(thin, body, body), np.sqrt(0.5), rtol=2e-2)


class TestKarcherMean:
    @EXAMPLES
    @given(SEEDS, SIZES, st.integers(1, 12))
    def test_logarithms_balance(self, seed, n, k):
        rng = np.random.default_rng(seed)
        P, w = random_matrices(rng, k, n=n), rng.uniform(0, 1, k)
        root = np.linalg.inv(np.linalg.cholesky(pd.karcher_mean(P, w)))
        logarithms = [scipy.linalg.logm(root @ each @ root.T) for each in P]
        assert np.linalg.norm(np.tensordot(w / w.sum(), logarithms, 1)) < 1e-9

    def test_far_apart(self):
        P = random_matrices(np.random.default_rng(1), 5)
        scales = np.array([1e-6, 1.0, 1e6, 1e3, 1e-3])
        expected = pd.karcher_mean(P)  # scales multiply to one
        assert pd.distance(pd.karcher_mean(scales[:, None, None] * P), expected) < 1e-9

    def test_leading_axes(self):
        rng = np.random.default_rng(2)
        P, w = random_matrices(rng, 3, 2, 5), rng.uniform(0, 1, (3, 2, 5))
        means = pd.karcher_mean(P, w)
        assert means.shape == pd.karcher_mean(P, np.ones(5)).shape == (3, 2, 4, 4)
        close(means[1, 0], pd.karcher_mean(P[1, 0], w[1, 0]))

    def test_failure_is_an_error(self):
        P = random_matrices(np.random.default_rng(3), 4)
        with pytest.raises(ConvergenceError, match=r"in 1 steps.*larger tolerance") as caught:
            pd.karcher_mean(P, max_iterations=1)
        assert caught.value.evidence["distance"] > 1e-10

    @pytest.mark.parametrize("spread", [1.0, 1e-5, 1e-9])
    def test_a_mean_is_found_to_rounding_and_no_further(self, spread):
        rng = np.random.default_rng(3)
        P = np.eye(4) + 0.05 * spread * random_symmetric(rng, 20, 5)
        mean = pd.karcher_mean(P, tolerance=1e-300)
        assert pd.distance(pd.karcher_mean(P, tolerance=1e-12), mean).max() < 1e-12
