"""Fits with physical bodies against Drake's conic solver, and in other frames and units."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from identified_bodies import frames_and_units
from scipy.linalg import block_diag

from geodrake.identification.conic_fit import solve_with_fallback
from geodrake.identification.normal_equations import (
    are_physical,
    inner_bodies,
    physical_minimizers,
)
from geodrake.identification.problem import FitProblem
from geodrake.inertia import from_mass_com_inertia, is_physical

SMALL = from_mass_com_inertia(1.0, np.zeros(3), 0.01 * np.eye(3))
BLOCKS = (0, 13)  # two bodies, with scalars between and behind them
SIZE = 25
LOWER, UPPER = np.full(SIZE, -np.inf), np.full(SIZE, np.inf)
LOWER[[10, 11]], UPPER[[11, 23]] = 0.0, 0.5


def problems(seed, count=3, pull=-3.0):
    """Normal matrices and right sides of fits whose data pull bodies and scalars out."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(count, 40, SIZE)) * rng.uniform(0.1, 10.0, SIZE)
    wish = np.tile(rng.normal(size=SIZE), (count, 1))
    for block in BLOCKS:
        body = from_mass_com_inertia(
            rng.uniform(0.5, 5.0), 0.1 * rng.normal(size=3), np.diag(rng.uniform(0.05, 0.07, 3))
        )
        wish[:, block : block + 10] = body + pull * 0.3 * rng.normal(size=10)
    gram = np.swapaxes(rows, 1, 2) @ rows + 1e-3 * np.eye(SIZE)
    return gram, (gram @ wish[..., None])[..., 0]


def start_of(count):
    x = np.zeros((count, SIZE))
    for block in BLOCKS:
        x[:, block : block + 10] = SMALL
    return x


def costs(gram, rhs, x):
    return 0.5 * np.einsum("fi,fij,fj->f", x, gram, x) - np.einsum("fi,fi->f", rhs, x)


@pytest.mark.parametrize("seed", range(6))
def test_as_good_as_the_conic_solver(seed):
    gram, rhs = problems(seed)
    found = physical_minimizers(gram, rhs, BLOCKS, start_of(3), (LOWER, UPPER))
    assert are_physical(found, BLOCKS).all()
    assert (found >= LOWER).all() and (found <= UPPER).all()
    for G, r, x in zip(gram, rhs, found, strict=True):
        root = np.linalg.cholesky(G)
        prior = np.where(np.isfinite(LOWER) | np.isfinite(UPPER), 0.0, start_of(1)[0])
        problem = FitProblem(
            factor=np.column_stack([root.T, np.linalg.solve(root, r)]),
            inertia_blocks=BLOCKS,
            prior_mean=prior,
            prior_information=1e-9 * np.eye(SIZE),
            lower=LOWER,
            upper=UPPER,
        )
        conic = solve_with_fallback(problem).x
        ours, theirs = (costs(G[None], r[None], each[None])[0] for each in (x, conic))
        assert ours < theirs + 2e-3 + 1e-6 * abs(theirs)


def test_where_all_is_physical_it_is_the_plain_minimum():
    gram, rhs = problems(0, pull=0.0)
    plain = np.linalg.solve(gram, rhs[..., None])[..., 0]
    free = np.full(SIZE, -np.inf), np.full(SIZE, np.inf)
    found = physical_minimizers(gram, rhs, BLOCKS, start_of(3), free)
    assert (costs(gram, rhs, found) - costs(gram, rhs, plain) < 1e-3).all()


@given(seed=st.integers(0, 1000), length=st.floats(0.1, 10.0), mass=st.floats(0.1, 10.0))
@settings(max_examples=15)
def test_frames_and_units_change_nothing(seed, length, mass):
    gram, rhs = problems(seed)
    changes = frames_and_units(seed, len(BLOCKS), length, mass)
    T = block_diag(changes[0], np.eye(3), changes[1], np.eye(2))
    back = np.linalg.inv(T)
    bounds = LOWER, UPPER
    first = physical_minimizers(gram, rhs, BLOCKS, start_of(3), bounds)
    turned = back.T @ gram @ back
    other = physical_minimizers(turned, rhs @ back, BLOCKS, start_of(3) @ T.T, bounds)
    cost = costs(gram, rhs, other @ back.T) - costs(gram, rhs, first)
    assert (np.abs(cost) < 2e-3).all()


def test_starts_are_inside_and_near():
    x = start_of(2)
    x[0, 0:10] = from_mass_com_inertia(2.0, np.zeros(3), np.diag([0.1, 0.1, 0.2]))  # a thin disc
    x[1, 0:10] = 0.0
    moved = inner_bodies(x, BLOCKS, SMALL)
    assert is_physical(moved[:, 0:10]).all()
    np.testing.assert_allclose(moved[0, 0:10], x[0, 0:10], atol=0.05)
    np.testing.assert_array_equal(moved[1, 0:10], SMALL)
    np.testing.assert_array_equal(moved[:, 10:], x[:, 10:])
