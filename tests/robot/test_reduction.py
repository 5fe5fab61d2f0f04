"""Triangular factors: exact where a Gram matrix is not, and independent of how rows are cut."""

import numpy as np

from geodrake.robot.reduction import triangular_factor


def blocks_of(matrix, cuts):
    return np.split(matrix, cuts)


def test_the_factor_is_triangular_and_has_the_gram_matrix():
    matrix = np.random.default_rng(0).normal(size=(10_000, 30))
    factor = triangular_factor(blocks_of(matrix, [3, 3, 4500, 9000]))
    assert factor.shape == (30, 30)
    np.testing.assert_array_equal(factor, np.triu(factor))
    np.testing.assert_allclose(factor.T @ factor, matrix.T @ matrix, rtol=1e-12, atol=1e-9)


def test_small_singular_values_survive_where_the_gram_matrix_loses_them():
    rng = np.random.default_rng(1)
    left = np.linalg.qr(rng.normal(size=(5000, 20)))[0]
    right = np.linalg.qr(rng.normal(size=(20, 20)))[0]
    singular = np.logspace(0, -10, 20)
    matrix = left * singular @ right.T
    found = np.linalg.svd(triangular_factor(np.array_split(matrix, 7)), compute_uv=False)
    np.testing.assert_allclose(found, singular, rtol=1e-4)
    smallest = np.linalg.eigvalsh(matrix.T @ matrix)[0]
    assert abs(smallest / singular[-1] ** 2 - 1.0) > 1.0


def test_a_factor_continues_as_a_block():
    matrix = np.random.default_rng(3).normal(size=(500, 8))
    once = triangular_factor([matrix])
    twice = triangular_factor([triangular_factor([matrix[:200]]), matrix[200:]])
    np.testing.assert_allclose(np.abs(once), np.abs(twice), atol=1e-12)
