"""P(n): the axioms of its distance, its geodesics and its means, against scipy."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from geodrake.errors import ConvergenceError
from geodrake.inertia import positive_definite as pd

SEEDS = st.integers(0, 2**32 - 1)
SIZES = st.integers(1, 6)
EXAMPLES = settings(max_examples=40)


def on_random_matrices(test):
    return EXAMPLES(given(SEEDS, SIZES)(test))


def random_matrices(rng, *shape, n=4):
    root = rng.normal(size=(*shape, n, n))
    return root @ np.swapaxes(root, -1, -2) + 0.1 * np.eye(n)


def random_symmetric(rng, *shape, n=4):
    half = rng.normal(size=(*shape, n, n))
    return half + np.swapaxes(half, -1, -2)


def close(actual, expected, precision=1e-9):
    scale = np.abs(expected).max()
    np.testing.assert_allclose(actual, expected, atol=precision * scale, rtol=0)


class TestAgainstScipy:
    @on_random_matrices
    def test_logarithm_and_exponential(self, seed, n):
        rng = np.random.default_rng(seed)
        A, B = random_matrices(rng, 2, n=n) + np.eye(n)  # logm warns where it is imprecise
        root = scipy.linalg.sqrtm(A)
        inverse = np.linalg.inv(root)
        # [Lee2019] Eqs. (2.2.8), (2.2.9) as they stand
        logarithm = root @ scipy.linalg.logm(inverse @ B @ inverse) @ root
        close(pd.logarithm(A, B), logarithm)
        V = 0.3 * random_symmetric(rng, n=n)
        close(pd.exponential(A, V), root @ scipy.linalg.expm(inverse @ V @ inverse) @ root)

    @on_random_matrices
    def test_distance_and_divergence(self, seed, n):
        A, B = random_matrices(np.random.default_rng(seed), 2, n=n)
        eigenvalues = scipy.linalg.eigvalsh(B, A)
        np.testing.assert_allclose(pd.relative_logarithms(A, B), np.log(eigenvalues), atol=1e-9)
        expected = np.sqrt((np.log(eigenvalues) ** 2).sum())  # [Lee2019] Eq. (2.2.10)
        np.testing.assert_allclose(pd.distance(A, B), expected, rtol=1e-9)
        ratio = np.linalg.solve(A, B)
        expected = -np.linalg.slogdet(ratio)[1] + np.trace(ratio) - n  # [Lee2019] Eq. (2.2.14)
        np.testing.assert_allclose(pd.log_det_divergence(B, A), expected, rtol=1e-8)


class TestAxioms:
    @on_random_matrices
    def test_invariance(self, seed, n):
        rng = np.random.default_rng(seed)
        P = random_matrices(rng, 3, n=n)
        G = scipy.linalg.qr(rng.normal(size=(n, n)))[0] * 10.0 ** rng.uniform(-3, 3, n)
        seen = G.T @ P @ G
        seen = 0.5 * (seen + np.swapaxes(seen, -1, -2))
        for measure in (pd.distance, pd.log_det_divergence):
            np.testing.assert_allclose(measure(seen[0], seen[1]), measure(P[0], P[1]), rtol=1e-9)
        mean = pd.karcher_mean(P)
        assert pd.distance(pd.karcher_mean(seen), G.T @ mean @ G) < 1e-9

    @on_random_matrices
    def test_geodesic_is_minimal_and_of_even_speed(self, seed, n):
        rng = np.random.default_rng(seed)
        A, B = random_matrices(rng, 2, n=n)
        t = rng.uniform(0, 1, 5)
        points = pd.geodesic(A, B, t)
        np.testing.assert_allclose(pd.distance(A, points), t * pd.distance(A, B), rtol=1e-8)
        np.testing.assert_allclose(pd.distance(points, B), (1 - t) * pd.distance(A, B), rtol=1e-8)
        velocity = pd.logarithm(A, B)
        length = np.sqrt(2 * pd.inner_product(A, velocity, velocity))  # the ½ of (2.2.5)
        np.testing.assert_allclose(length, pd.distance(A, B), rtol=1e-9)

    @on_random_matrices
    def test_measures_agree_nearby(self, seed, n):
        rng = np.random.default_rng(seed)
        P, V = random_matrices(rng, n=n), random_symmetric(rng, n=n)
        for length in (1e-2, 1e-5, 1e-7):
            step = length * V / np.sqrt(pd.inner_product(P, V, V))
            # [Lee2019] Eqs. (2.2.5), (2.2.16), and (2.2.10) which is √2 longer
            for divergence in (
                pd.log_det_divergence(P + step, P),
                pd.log_det_divergence(P, P + step),
                0.5 * pd.distance(P, P + step) ** 2,
            ):
                np.testing.assert_allclose(divergence, length**2, rtol=5 * length + 1e-6)


class TestKarcherMean:
    @EXAMPLES
    @given(SEEDS, SIZES, st.floats(0.0, 1.0))
    def test_of_two_is_on_the_geodesic(self, seed, n, t):
        A, B = random_matrices(np.random.default_rng(seed), 2, n=n)
        assert pd.distance(pd.karcher_mean([A, B]), pd.geodesic(A, B, 0.5)) < 1e-9
        assert pd.distance(pd.karcher_mean([A, B], [1 - t, t]), pd.geodesic(A, B, t)) < 1e-9

    @EXAMPLES
    @given(SEEDS, SIZES, st.integers(1, 12))
    def test_logarithms_balance(self, seed, n, k):
        rng = np.random.default_rng(seed)
        P, w = random_matrices(rng, k, n=n), rng.uniform(0, 1, k)
        mean = pd.karcher_mean(P, w)
        pull = np.einsum("k,kij->ij", w / w.sum(), pd.logarithm(mean, P))
        assert np.sqrt(2 * pd.inner_product(mean, pull, pull)) < 1e-9

    def test_is_the_minimum(self):
        rng = np.random.default_rng(0)
        P, w = random_matrices(rng, 6), rng.uniform(0, 1, 6)
        mean = pd.karcher_mean(P, w)
        best = (w * pd.distance(mean, P) ** 2).sum()
        for V in random_symmetric(rng, 20):
            near = pd.exponential(mean, 1e-2 * V)
            assert (w * pd.distance(near, P) ** 2).sum() > best

    def test_far_apart(self):
        P = random_matrices(np.random.default_rng(1), 5)
        scales = np.array([1e-6, 1.0, 1e6, 1e3, 1e-3])
        expected = pd.karcher_mean(P)  # scales multiply to one
        assert pd.distance(pd.karcher_mean(scales[:, None, None] * P), expected) < 1e-9

    def test_leading_axes(self):
        rng = np.random.default_rng(2)
        P, w = random_matrices(rng, 3, 2, 5), rng.uniform(0, 1, (3, 2, 5))
        means = pd.karcher_mean(P, w)
        assert means.shape == (3, 2, 4, 4)
        close(means[1, 0], pd.karcher_mean(P[1, 0], w[1, 0]))
        assert pd.karcher_mean(P, np.ones(5)).shape == (3, 2, 4, 4)

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


def test_distances_grow_without_limit_at_the_edge():
    P = random_matrices(np.random.default_rng(5))
    values, axes = np.linalg.eigh(P)
    shares = 10.0 ** -np.arange(0, 12)
    thin = (axes * np.array([[s, 1, 1, 1] for s in shares])[:, None] * values) @ axes.T
    thin = 0.5 * (thin + np.swapaxes(thin, -1, -2))
    np.testing.assert_allclose(pd.distance(P, thin), -np.log(shares), rtol=1e-4, atol=1e-9)
    assert (np.diff(pd.log_det_divergence(thin, P)) > 1.0).all()


def test_steps_of_any_length_stay_positive():
    rng = np.random.default_rng(6)
    P, V = random_matrices(rng), random_symmetric(rng)
    V /= np.sqrt(2 * pd.inner_product(P, V, V))
    for length in (1.0, 5.0, 10.0):
        reached = pd.exponential(P, length * V)
        np.testing.assert_allclose(pd.distance(P, reached), length, rtol=1e-6)
