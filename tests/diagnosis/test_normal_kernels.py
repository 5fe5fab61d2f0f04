"""Sums of normal matrices, against those of dense matrices."""

import numpy as np
import pytest

from geodrake.diagnosis.normal_kernels import (
    add_normal,
    calc_packed,
    calc_squares,
    nothing_packed,
)

JOINTS, WIDTH, COUNT = 4, 40, 25


@pytest.mark.parametrize("first", [0, 1, 10, COUNT])
def test_sums_are_those_of_dense_matrices(first):
    """The first columns are known before, or not."""
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(JOINTS, 60, WIDTH))
    grams = np.swapaxes(rows, 1, 2) @ rows
    places = np.array([rng.permutation(WIDTH)[:COUNT] for _ in range(JOINTS)])
    places[rng.random(places.shape) < 0.4] = -1
    known = calc_packed(grams, places[:, :first].copy(), nothing_packed(JOINTS))
    packed = calc_packed(grams, places, known)

    weights, x, moments = rng.random(JOINTS), rng.normal(size=COUNT), np.zeros((JOINTS, COUNT))
    total, squares = np.zeros((COUNT, COUNT)), np.zeros(JOINTS)
    for j, felt in enumerate(places >= 0):
        columns, effort = rows[j][:, places[j][felt]], rng.normal(size=60)
        moments[j, felt] = columns.T @ effort
        total[np.ix_(felt, felt)] += weights[j] * columns.T @ columns
        squares[j] = np.sum((effort - columns @ x[felt]) ** 2) - effort @ effort

    found = np.zeros((COUNT, COUNT))
    add_normal(packed, weights, found)
    np.testing.assert_allclose(found, total, atol=1e-12 * np.abs(total).max())
    found = calc_squares((packed, moments, np.zeros(JOINTS)), x)
    np.testing.assert_allclose(found, squares, rtol=1e-10)
